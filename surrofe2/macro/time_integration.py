"""Dormand–Prince 5(4) steps that a failing stress law can turn back.

scipy's RK45 chooses and tries the steps; it is wrapped, never altered. A trial that has no stress
leaves it through `TrialError`, before it has moved, and one that finds the law on another branch
through `SwitchedError`: that step is tried again at the same length, its first stage anew.

The length of the next step is ours. Where stability and not accuracy limits the step, the usual
control h ε^(−1/5) swings between rejected and needless short steps; a weaker response to the
error ε settles (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, IV.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import RK45

from surrofe2.errors import SimulationError
from surrofe2.macro.right_hand_side import (
    N_STAGES,
    Evaluation,
    RightHandSide,
    SwitchedError,
    TrialError,
)
from surrofe2.macro.settings import MacroSettings

Array = NDArray[np.float64]

MAX_HALVINGS = 10
_SAFETY, _GAIN = 0.9, 0.4
NO_MEMORY: Array = np.empty(0)

# Where in the step the evaluations of one trial lie: stages 2 to 6, then the end point.
_TIME_FRACTIONS = (*RK45.C[1:], 1.0)


class AcceptedStep(Protocol):
    """What is recorded of a step, whichever way it was made; see `Step`."""

    @property
    def t_old(self) -> float: ...  # noqa: D102
    @property
    def t(self) -> float: ...  # noqa: D102
    @property
    def y(self) -> Array: ...  # noqa: D102
    @property
    def next_step(self) -> float: ...  # noqa: D102
    @property
    def evaluation(self) -> Evaluation: ...  # noqa: D102
    @property
    def memory(self) -> Array: ...  # noqa: D102
    @property
    def interpolate(self) -> Callable[[float], Array]: ...  # noqa: D102
    def work(self, t: float) -> Array: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Step:
    """An accepted step from t_old to t.

    Attributes:
        y: (n,) state at t.
        next_step: length proposed for the next step, µs.
        interpolate: y at a time within the step, fourth order.
        evaluation: the right-hand side at t. The method's last stage is the first of the next
            step, so it costs nothing.
        stage_powers: (7, 2) internal and load power at the seven stages.
    """

    t_old: float
    t: float
    y: Array
    next_step: float
    interpolate: Callable[[float], Array]
    evaluation: Evaluation
    stage_powers: Array

    @property
    def memory(self) -> Array:
        """Nothing: the method starts anew from y at each step."""
        return NO_MEMORY

    def work(self, t: float) -> Array:
        """(2,) internal and load work from t_old to t, pJ.

        The quadrature that the method itself would use were the work two more components of y
        without a say in the error control: fifth order at the end of the step, fourth within.
        """
        length = self.t - self.t_old
        theta = (t - self.t_old) / length
        work: Array = length * (self.stage_powers.T @ RK45.P) @ theta ** np.arange(1, 5)
        return work


def damped(length: float, proposed: float, largest: float) -> float:
    """Length of the next step after one of `length` for which scipy's control proposes `proposed`.

    0.9 h ε^(−0.08) instead of 0.9 h ε^(−0.2), and half of the latter where ε is so small that this
    is longer.
    """
    weaker = length * _SAFETY * (proposed / (length * _SAFETY)) ** _GAIN
    return min(largest, max(weaker, 0.5 * proposed))


class Stepper:
    """Accepted steps, one after another, from (t, y) to t_end."""

    def __init__(
        self,
        right_hand_side: RightHandSide,
        t: float,
        y: Array,
        t_end: float,
        settings: MacroSettings,
        first_step: float | None = None,
    ) -> None:
        self._right_hand_side = right_hand_side
        self._settings = settings
        self._t_end = t_end
        right_hand_side(t, y)
        self.start = right_hand_side.evaluation
        right_hand_side.accept()
        self._solver = self._restart(t, y, first_step)
        self._first_powers = right_hand_side.start.powers

    @property
    def next_step(self) -> float:
        """Length proposed for the next step, µs."""
        return float(self._solver.h_abs)

    @property
    def memory(self) -> Array:
        """See `Step.memory`."""
        return NO_MEMORY

    def advance(self) -> Step:
        """The next accepted step.

        Each failed trial halves the length that was tried. After ten halvings in a row
        `TrialError` is passed on. A trial in which points left their branch of the law is
        repeated as it was; each time there are more of them, so that comes to an end.
        """
        halvings, rejected = 0, False
        while True:
            try:
                return self._try_step(may_grow=halvings == 0 and not rejected)
            except SwitchedError:
                rejected = rejected or self._right_hand_side.calls > N_STAGES
            except TrialError:
                self._right_hand_side.tally.counts["failed_trials"] += 1
                if halvings == MAX_HALVINGS:
                    raise
                halvings += 1

    def _try_step(self, may_grow: bool) -> Step:
        solver, right_hand_side = self._solver, self._right_hand_side
        t_old, y_old = solver.t, solver.y
        right_hand_side.calls = 0
        try:
            message = solver.step()
        except (TrialError, SwitchedError) as failure:
            self._count_rejected()
            stage = (right_hand_side.calls - 1) % N_STAGES
            length = (failure.t - t_old) / _TIME_FRACTIONS[stage]
            solver.h_abs = 0.5 * length
            if isinstance(failure, SwitchedError):
                self._begin_at(right_hand_side.restart_step(failure.switched))
                solver.h_abs = length
            raise
        self._count_rejected()
        if solver.status == "failed":
            raise SimulationError(f"time integration stopped at t = {t_old:.6g} µs: {message}")
        length = solver.t - t_old
        evaluation = right_hand_side.evaluation
        try:
            start = right_hand_side.accept()
        except TrialError:
            self._solver = self._restart(t_old, y_old, 0.5 * length)
            raise
        # After a failure, as after a step of too large an error, do not grow straight back into it.
        solver.h_abs = damped(length, solver.h_abs, math.inf if may_grow else length)
        step = Step(
            t_old=t_old,
            t=solver.t,
            y=solver.y,
            next_step=solver.h_abs,
            interpolate=solver.dense_output(),
            evaluation=evaluation,
            stage_powers=np.array([self._first_powers, *right_hand_side.recent_powers]),
        )
        self._begin_at(start)
        right_hand_side.tally.counts["steps"] += 1
        return step

    def _begin_at(self, start: Evaluation) -> None:
        """Take an evaluation at the time reached for the first stage of the next trial."""
        self._first_powers = start.powers
        self._solver.f = self._right_hand_side.rate(start)

    def _restart(self, t: float, y: Array, first_step: float | None) -> RK45:
        """A solver that stands at (t, y); the law's committed state is where it was."""
        if first_step is not None:
            first_step = min(first_step, self._t_end - t) or None
        while True:
            try:
                return RK45(
                    self._right_hand_side,
                    t,
                    y,
                    self._t_end,
                    first_step=first_step,
                    max_step=self._settings.largest_step,
                    atol=self._settings.absolute_tolerance,
                    rtol=self._settings.relative_tolerance,
                )
            except SwitchedError as found:
                self._right_hand_side.restart_step(found.switched)

    def _count_rejected(self) -> None:
        """All trials of one step but the last were complete and too inaccurate."""
        trials = (self._right_hand_side.calls - 1) // N_STAGES
        self._right_hand_side.tally.counts["rejected_steps"] += trials
