"""Dormand–Prince 5(4): one explicit step with error, dense output and work.

Dormand and Prince, A family of embedded Runge–Kutta formulae, J. Comput. Appl. Math. 6 (1980)
19–26; the interpolation is Shampine's, Math. Comp. 46 (1986) 135–150, with his optimal c₆. The
last stage is the first of the next step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.macro.equations_of_motion import Evaluation, Switched
from surrofe2.macro.time_stepping import NO_MEMORY, StepControl, StepResult

Array = NDArray[np.float64]

STAGES = 7
TIMES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
WEIGHTS = tuple(
    np.array(row)
    for row in (
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    )
)
"""Of the rates of the stages before, for each stage; the last row leads to the end."""
ERROR = np.array([-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40])
"""Fourth-order minus fifth-order weights."""
BULGE = np.array(
    [
        -12715105075 / 11282082432,
        0.0,
        87487479700 / 32700410799,
        -10690763975 / 1880347072,
        701980252875 / 199316789632,
        -1453857185 / 822651844,
        69997945 / 29380423,
    ]
)
"""Of the rates, for `StepResult.bulge`: fourth order within the step, fifth at its end."""


_ENERGY = 0.1
"""Part of the relative tolerance that the energy of a step may err by."""


@dataclass(frozen=True, slots=True)
class DormandPrince:
    """The explicit `Method`; it needs no memory, for each step starts anew from y.

    Attributes:
        rhs: ẏ and powers at (t, y), or why there are none.
        absolute_tolerance, relative_tolerance: error of y allowed in a step.
        mass: (m, m) of the free unknowns, ng, where a step must also keep energy to a tenth of
            the relative tolerance. A stiff contact needs that: it is damped where stability
            limits the step, which the error of y does not see.
    """

    rhs: Callable[[float, Array], Evaluation]
    absolute_tolerance: float
    relative_tolerance: float
    mass: Any = None

    control = StepControl(order=5, gain=0.4, largest_growth=10.0, splits_rest=False)

    def step(
        self, start: Evaluation, memory: Array, t: float, found: Switched | None = None
    ) -> StepResult:
        """The step from `start` to time t.

        Its work is what the method itself would find were the work two more components of y
        without a say in the error.
        """
        h = t - start.t
        rates, powers = np.empty((STAGES, start.y.size)), np.empty((STAGES, start.powers.size))
        rates[0], powers[0], residuals = start.rate, start.powers, [start.residual]
        for number in range(1, STAGES - 1):
            y = start.y + h * (WEIGHTS[number] @ rates[:number])
            at = start.t + TIMES[number] * h if number < STAGES - 2 else t
            trial = self.rhs(at, y)
            rates[number], powers[number] = trial.rate, trial.powers
            residuals.append(trial.residual)
        now = self.rhs(t, start.y + h * (WEIGHTS[-1] @ rates[:-1]))
        rates[-1], powers[-1] = now.rate, now.powers
        residuals.append(now.residual)
        allowed = self._allowed(np.maximum(abs(start.y), abs(now.y)))
        error = _root_mean_square(h * (ERROR @ rates) / allowed)
        if self.mass is not None:
            error = max(error, self._energy_error(start, now, h * np.array(residuals), rates))
        return StepResult(
            start=start,
            end=now,
            error=error,
            mean_power=WEIGHTS[-1] @ powers[:-1],
            bulge=BULGE @ rates,
            power_bulge=BULGE @ powers,
            memory=NO_MEMORY,
        )

    def first_length(self, start: Evaluation, t_end: float) -> float:
        """Hairer, Nørsett and Wanner 1993, Solving Ordinary Differential Equations I, II.4."""
        allowed = self._allowed(abs(start.y))
        size, speed = _root_mean_square(start.y / allowed), _root_mean_square(start.rate / allowed)
        short = 1e-6 if min(size, speed) < 1e-5 else 0.01 * size / speed
        short = min(short, t_end - start.t)
        ahead = self.rhs(start.t + short, start.y + short * start.rate)
        fastest = max(speed, _root_mean_square((ahead.rate - start.rate) / allowed) / short)
        length = max(1e-6, 1e-3 * short) if fastest <= 1e-15 else (0.01 / fastest) ** 0.2
        return min(100.0 * short, length, t_end - start.t)

    def _energy_error(
        self, start: Evaluation, end: Evaluation, impulses: Array, rates: Array
    ) -> float:
        """Kinetic energy gained less work of all forces, relative to what is allowed."""
        before, after = start.y[start.y.size // 2 :], end.y[end.y.size // 2 :]
        # The gain is the impulse times the mean velocity, M (v₁ − v₀) · (v₀ + v₁)/2.
        gained = 0.5 * (before + after) @ (WEIGHTS[-1] @ impulses[:-1])
        works = np.einsum("sm,sm->s", rates[:-1, : before.size], impulses[:-1])
        energy = 0.5 * (before @ (self.mass @ before) + after @ (self.mass @ after))
        allowed = _ENERGY * self.relative_tolerance * (energy + abs(WEIGHTS[-1]) @ abs(works))
        allowed += self.absolute_tolerance**2 * float(self.mass.sum())
        return float(abs(gained - WEIGHTS[-1] @ works) / allowed)

    def _allowed(self, size: Array) -> Array:
        return self.absolute_tolerance + self.relative_tolerance * size


def _root_mean_square(values: Array) -> float:
    return float(np.linalg.norm(values)) / float(np.sqrt(values.size))
