"""Time steps of either method, and the explicit one, Dormand–Prince 5(4).

A method tries one step and returns a `StepResult`, or raises why there is none. Here its error
decides whether the step is accepted, the law is asked to accept its end, and the next length is
chosen; it is halved where the law fails. A trial in which points leave their branch of the law is
repeated at its length. Every corner of an amplitude is the end of a step; there the method starts
again, with a short step.

Dormand and Prince, A family of embedded Runge–Kutta formulae, J. Comput. Appl. Math. 6 (1980)
19–26; the interpolation is Shampine's, Math. Comp. 46 (1986) 135–150, with his optimal c₆. The
last stage is the first of the next step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import SimulationError
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Evaluation, NoStress, Switched
from surrofe2.macro.settings import MacroSettings

MAX_HALVINGS = 10  # in a row, before a run stops
NO_MEMORY: Array = np.empty(0)  # of a method at its first step
# The next length is this much shorter than the error allows, so that few steps are rejected.
_SAFETY = 0.9
# Smallest ratio of the next trial to a rejected one.
_SHRINK = 0.2
# Smallest step that an error may ask for, over the duration.
_SMALLEST = 1e-10
# Smallest step at all, over the spacing of floating-point numbers at t.
_ROUNDING = 10.0
# A step that would end so close before the end, relative to its length, ends there.
_CLOSE = 1e-9
# An error of 0 counts as this, so that its power is finite.
_LEAST_ERROR = 1e-9


@dataclass(frozen=True, slots=True)
class StepResult:
    """A complete step; all that is integrated from its start, y and the work, is within it

        h [θ m + θ (1 − θ) (r₀ − m) + θ² (1 − θ) (2 m − r₀ − r₁) + θ² (1 − θ)² b],

    θ from 0 to 1, h the length, r₀ and r₁ the rates at its ends, m the mean rate: the cubic
    through both ends, and a bulge.

    Attributes:
        start, end: evaluations at both ends.
        error: root mean square of the error of y relative to the tolerances; accepted up to 1.
        mean_power: a row of `Works`, pJ/µs.
        bulge, power_bulge: b of y and of the work; 0 if there is none.
        memory: for the step that begins at its end; empty where the method needs none.
        work_before: of a jump of prescribed velocities where it begins, pJ; 0 if there is none.
    """

    start: Evaluation
    end: Evaluation
    error: float
    mean_power: Array
    bulge: Array | float
    power_bulge: Array | float
    memory: Array
    work_before: Array | float = 0.0

    @property
    def length(self) -> float:
        """Length of the step, µs."""
        return self.end.t - self.start.t

    def interpolate(self, t: float) -> Array:
        """Return y (2 m,) at a time within the step."""
        start = self.start
        end = self.end
        mean = (end.y - start.y) / self.length
        return start.y + self._integral(t, mean, start.rate, end.rate, self.bulge)

    def work(self, t: float) -> Array:
        """Return a row of `Works` from the start to t, pJ."""
        first = self.start.powers.row
        last = self.end.powers.row
        since = self._integral(t, self.mean_power, first, last, self.power_bulge)
        return self.work_before + since

    def _integral(self, t: float, mean: Array, first: Array, last: Array, b: Any) -> Array:
        """Evaluate the formula of the class at t; `b` is the bulge."""
        s = (t - self.start.t) / self.length
        bent = (1.0 - s) * (first - mean + s * (2.0 * mean - first - last + (1.0 - s) * b))
        integral: Array = self.length * s * (mean + bent)
        return integral


@dataclass(frozen=True, slots=True)
class StepControl:
    """The rule by which the length of the next step follows the error of the last.

    Attributes:
        order: the error goes with this power of the length.
        gain: 1 answers the error in full. A weaker answer settles where stability and not
            accuracy limits the step, while the full one swings between rejected and needlessly
            short steps (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, IV.2).
        largest_growth: largest ratio of the next length to this one.
        splits_rest: a run ends by two equal steps rather than by a long and a short one.
    """

    order: int
    gain: float
    largest_growth: float
    splits_rest: bool

    def ratio(self, error: float, *, may_grow: bool = True) -> float:
        """Return the length of the next step to this one, or of the next trial where `error` is
        above 1.
        """
        wanted = _SAFETY * max(error, _LEAST_ERROR) ** (-1.0 / self.order)
        if error > 1.0:
            return max(_SHRINK, wanted)
        wanted = min(wanted, self.largest_growth if may_grow else 1.0)
        return float(max(_SAFETY * (wanted / _SAFETY) ** self.gain, 0.5 * wanted))


class Method(Protocol):
    """A time integration method, one step of which is a pure function.

    Attributes:
        control: how lengths follow errors.
    """

    control: ClassVar[StepControl]

    def first_length(self, start: Evaluation, t_end: float) -> float:
        """Return the length of the first step, µs; raises as `step`."""

    def step(
        self, start: Evaluation, memory: Array, t: float, restarted: Switched | None
    ) -> StepResult:
        """Make the step from `start` to time t.

        Args:
            memory: what the step before left for this one; empty at the start.
            restarted: where the same step was restarted before; a guess of its end.

        Raises:
            NoStress, Switched: as of `EquationsOfMotion.evaluate`, on the way.
        """


class Stepper:
    """Makes accepted steps, one after another, from `start` to t_end.

    Attributes:
        now: where the next step begins.
        memory: what the method knows of earlier steps.
        next_length: length proposed for the next step, µs.

    Raises:
        SimulationError: there is no stress near where it starts.
    """

    def __init__(
        self,
        equations: EquationsOfMotion,
        method: Method,
        settings: MacroSettings,
        t_end: float,
        start: Evaluation,
        next_length: float | None = None,
        memory: Array = NO_MEMORY,
    ) -> None:
        self._equations = equations
        self._method = method
        self._largest = min(settings.largest_step, equations.system.problem.resolved_by)
        self._t_end = t_end
        self.now = start
        self.memory = memory
        self._work_before: Array | float = 0.0
        self.next_length = next_length or self._first_length("the run cannot start")

    def advance(self) -> StepResult:
        """Make the next accepted step.

        Each trial without stress, or whose end the law does not accept, halves its length. A trial
        in which points switched is repeated as it was, each time with more of them.

        Raises:
            SimulationError: ten halvings in a row, or the error asks for a step below rounding.
        """
        counts = self._equations.tally.counts
        control = self._method.control
        if self.now.t >= self._equations.piece_end:
            self._cross_corner()
        halvings = 0
        rejected = False
        restarted = None
        while True:
            t = self._target()
            length = t - self.now.t
            try:
                trial = self._tried(t, restarted)
                start = self._equations.accept(trial.end) if trial.error <= 1.0 else None
            except Switched as switched:
                restarted = switched
                continue
            except NoStress as failure:
                counts["failed_trials"] += 1
                if halvings == MAX_HALVINGS:
                    raise SimulationError(
                        f"no time step succeeds after {MAX_HALVINGS} halvings: {failure}"
                    ) from failure
                halvings += 1
                rejected = False
                restarted = None
                self.next_length = 0.5 * length
                continue
            restarted = None
            if start is None:
                counts["rejected_steps"] += 1
                rejected = True
                self.next_length = length * control.ratio(trial.error)
                if self.next_length < _SMALLEST * self._t_end:
                    raise SimulationError(
                        f"time integration stopped at t = {self.now.t:.6g} µs: the error "
                        "asks for steps below rounding; loosen the tolerances"
                    )
                continue
            counts["steps"] += 1
            ratio = control.ratio(trial.error, may_grow=not rejected)
            # After a failure the step does not grow straight back into it.
            wanted = length * (min(ratio, 1.0) if halvings else ratio)
            # A step cut short to meet the end says nothing against the longer one.
            longest = max(wanted, self.next_length if t == self._end() else 0.0)
            self.next_length = min(self._largest, longest)
            self.now = self._equations.grip(start)
            self.memory = trial.memory
            work = self._work_before
            self._work_before = 0.0
            return replace(trial, work_before=work)

    def _tried(self, t: float, restarted: Switched | None) -> StepResult:
        """Try the step to t; where points switch, restart it with them and raise `Switched`."""
        try:
            return self._method.step(self.now, self.memory, t, restarted)
        except Switched as switched:
            self.now = self._equations.restart_step(switched.points)
            raise

    def _target(self) -> float:
        """Return the time to step to."""
        t = self.now.t
        remaining = self._end() - t
        h = min(self.next_length, self._largest)
        h = max(h, _ROUNDING * float(np.spacing(t)))
        if h * (1.0 + _CLOSE) >= remaining:
            return self._end()
        if self._method.control.splits_rest and 2.0 * h > remaining:
            return t + 0.5 * remaining
        return t + h

    def _end(self) -> float:
        """Return the end of the run, or of the piece of the amplitudes if that comes first."""
        return min(self._t_end, self._equations.piece_end)

    def _cross_corner(self) -> None:
        """Start again on the other side of a corner of an amplitude."""
        try:
            self.now, self._work_before = self._equations.cross_corner(self.now)
        except NoStress as failure:
            message = f"the load jumps where there is no stress: {failure}"
            raise SimulationError(message) from failure
        self.memory = NO_MEMORY
        self.next_length = self._first_length("the run cannot continue at a corner of the load")

    def _first_length(self, problem: str) -> float:
        """Return the length of a first step by the method.

        Raises:
            SimulationError: there is no stress; the message begins with `problem`.
        """
        try:
            while True:
                try:
                    return min(self._method.first_length(self.now, self._end()), self._largest)
                except Switched as switched:
                    self.now = self._equations.restart_step(switched.points)
        except NoStress as failure:
            raise SimulationError(f"{problem}: {failure}") from failure


# The tableau of Dormand and Prince. Row k of the weights, of the rates of the stages before, leads
# to stage k; the last row leads to the end of the step.
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
# Fourth-order minus fifth-order weights.
ERROR = np.array([-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40])
# Weights of the rates in `StepResult.bulge`: fourth order within the step, fifth at its end.
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


# Fraction of the relative tolerance that the energy of a step may err by.
_ENERGY = 0.1
# The first length, as Hairer, Nørsett and Wanner choose it: below the first number, y or its rate
# is as good as zero; then, and where the rate hardly changes, such lengths are taken.
_NEARLY_ZERO = 1e-5
_SHORT = 1e-6


@dataclass(frozen=True, slots=True)
class DormandPrince:
    """The explicit `Method`; it needs no memory, for each step starts from y alone.

    Attributes:
        rhs: a function that evaluates the equations at (t, y).
        absolute_tolerance, relative_tolerance: error of y allowed in a step.
        mass: (m, m) of the free unknowns, ng, where a step must also keep energy to a tenth of
            the relative tolerance. A stiff contact needs that: it is damped where stability
            limits the step, which the error of y does not see.
    """

    rhs: Callable[[float, Array], Evaluation]
    absolute_tolerance: float
    relative_tolerance: float
    mass: Any = None

    control: ClassVar[StepControl] = StepControl(
        order=5, gain=0.4, largest_growth=10.0, splits_rest=False
    )

    def step(
        self, start: Evaluation, memory: Array, t: float, restarted: Switched | None = None
    ) -> StepResult:
        """Make the step from `start` to time t.

        Its work is what the method itself would find were the work two more components of y that do
        not count in the error.
        """
        h = t - start.t
        rates = np.empty((STAGES, start.y.size))
        rates[0] = start.rate
        powers = [start.powers.row]
        residuals = [start.residual]
        for number in range(1, STAGES - 1):  # stage 0 is the start, the last one the end
            y = start.y + h * (WEIGHTS[number] @ rates[:number])
            # the last but one is at t itself, without rounding
            t_stage = start.t + TIMES[number] * h if number < STAGES - 2 else t
            trial = self.rhs(t_stage, y)
            rates[number] = trial.rate
            powers.append(trial.powers.row)
            residuals.append(trial.residual)
        now = self.rhs(t, start.y + h * (WEIGHTS[-1] @ rates[:-1]))
        rates[-1] = now.rate
        powers.append(now.powers.row)
        residuals.append(now.residual)
        allowed = self._allowed(np.maximum(abs(start.y), abs(now.y)))
        error = _root_mean_square(h * (ERROR @ rates) / allowed)
        if self.mass is not None:
            error = max(error, self._energy_error(start, now, h * np.array(residuals), rates))
        return StepResult(
            start=start,
            end=now,
            error=error,
            mean_power=WEIGHTS[-1] @ np.array(powers[:-1]),
            bulge=BULGE @ rates,
            power_bulge=BULGE @ np.array(powers),
            memory=NO_MEMORY,
        )

    def first_length(self, start: Evaluation, t_end: float) -> float:
        """Choose the first length by two rates.

        Hairer, Nørsett and Wanner 1993, Solving Ordinary Differential Equations I, II.4, which has
        all numbers here.
        """
        allowed = self._allowed(abs(start.y))
        size = _root_mean_square(start.y / allowed)
        speed = _root_mean_square(start.rate / allowed)
        short = _SHORT if min(size, speed) < _NEARLY_ZERO else 0.01 * size / speed
        short = min(short, t_end - start.t)
        ahead = self.rhs(start.t + short, start.y + short * start.rate)
        fastest = max(speed, _root_mean_square((ahead.rate - start.rate) / allowed) / short)
        length = max(_SHORT, 1e-3 * short) if fastest <= 1e-15 else (0.01 / fastest) ** 0.2
        return min(100.0 * short, length, t_end - start.t)

    def _energy_error(
        self, start: Evaluation, end: Evaluation, impulses: Array, rates: Array
    ) -> float:
        """Compute kinetic energy gained less work of all forces, relative to what is allowed.

        Args:
            impulses: (stages, m) length of the step times the residuals, µN µs.
            rates: (stages, 2 m) rates of y.
        """
        before = start.y[start.y.size // 2 :]
        after = end.y[end.y.size // 2 :]
        # The gain is the impulse times the mean velocity, M (v₁ − v₀) · (v₀ + v₁)/2.
        gained = 0.5 * (before + after) @ (WEIGHTS[-1] @ impulses[:-1])
        works = np.einsum("sm,sm->s", rates[:-1, : before.size], impulses[:-1])
        energy = 0.5 * (before @ (self.mass @ before) + after @ (self.mass @ after))
        allowed = _ENERGY * self.relative_tolerance * (energy + abs(WEIGHTS[-1]) @ abs(works))
        allowed += self.absolute_tolerance**2 * float(self.mass.sum())
        return float(abs(gained - WEIGHTS[-1] @ works) / allowed)

    def _allowed(self, size: Array) -> Array:
        """Return the error allowed of entries of this size."""
        return self.absolute_tolerance + self.relative_tolerance * size


def _root_mean_square(values: Array) -> float:
    """Return the root of the mean square of the entries."""
    return float(np.linalg.norm(values)) / float(np.sqrt(values.size))
