"""The equations of motion as the first-order system that the time integration asks for."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from surrofe2.macro.mesh import Bar
from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressLaw,
    StressResponse,
    SwitchingLaw,
    describe,
)

Array = NDArray[np.float64]

N_STAGES = 6


class TrialError(Exception):
    """A trial state has no stress somewhere; the step that tried it must be shortened."""

    def __init__(
        self, t: float, clock: str, point: int, position: Array, F: Array, reason: str
    ) -> None:
        entries = ", ".join(f"[{row[0]:.6g}, {row[1]:.6g}]" for row in F)
        super().__init__(
            f"point {point} at ({position[0]:.6g}, {position[1]:.6g}) µm, {clock.format(t)}, "
            f"F = [{entries}]: {reason}"
        )
        self.t = t


class SwitchedError(Exception):
    """Points left their branch of the law within a step; it must be begun anew.

    t, u: where they were found.
    """

    def __init__(self, t: float, u: Array, switched: NDArray[np.int8]) -> None:
        super().__init__(f"{np.count_nonzero(switched)} points changed their branch of the law")
        self.t, self.u, self.switched = t, u, switched


@dataclass(frozen=True, slots=True)
class Evaluation:
    """One right-hand side with everything that was computed on the way.

    Attributes:
        t: µs.
        u, v: (n_free, 2) µm and µm/µs.
        F, F_dot: (n_points, 2, 2); J: (n_points,) det F.
        response: what the stress law answered.
        internal, load: (n_free, 2) internal force and load on the free nodes, µN.
        powers: (2,) internal and load power, pJ/µs.
    """

    t: float
    u: Array
    v: Array
    F: Array
    F_dot: Array
    J: Array
    response: StressResponse
    internal: Array
    load: Array
    powers: Array


@dataclass
class Tally:
    """What a run has cost so far."""

    counts: Counter[str] = field(default_factory=Counter)
    effort: Counter[str] = field(default_factory=Counter)
    law_seconds: float = 0.0


class RightHandSide:
    """ẏ = f(t, y) with y = [u, v] of the free nodes: u̇ = v, v̇ = M⁻¹ (load − internal force).

    Calling it changes nothing that a later call depends on: the state of the stress law moves
    on only in `accept`.

    Attributes:
        clock: how a message calls the time; a quasi-static load has a factor in its place.
        last: the latest evaluation; after a step of Dormand–Prince, that of its end point.
        start: the evaluation by which the step under way began.
        recent_powers: (2,) powers of the latest six evaluations: after a step, those of its
            stages 2 to 7.
        calls: evaluations since it was last set to 0.
    """

    def __init__(
        self,
        bar: Bar,
        law: StressLaw,
        amplitude_at: Callable[[float], float],
        tally: Tally,
        clock: str = "t = {:.6g} µs",
    ) -> None:
        self.bar = bar
        self.law = law
        self.amplitude_at = amplitude_at
        self.tally = tally
        self.clock = clock
        self.last: Evaluation | None = None
        self.start: Evaluation
        self.recent_powers: deque[Array] = deque(maxlen=N_STAGES)
        self.calls = 0
        self._committed: Any = None

    def __call__(self, t: float, y: Array) -> Array:
        """(4 n_free,) rate of y; raises as `evaluate` does."""
        self.calls += 1
        u, v = y.reshape(2, -1, 2)
        now = self.evaluate(t, u, v)
        self.recent_powers.append(now.powers)
        return self.rate(now)

    def rate(self, now: Evaluation) -> Array:
        """(4 n_free,) rate of y by an evaluation."""
        acceleration = self.bar.solve_mass(now.load - now.internal)
        return np.concatenate([now.v.ravel(), acceleration.ravel()])

    def evaluate(self, t: float, u: Array, v: Array, *, tangents: bool = False) -> Evaluation:
        """Stress, internal force and load at (t, u, v); the law's tangents where asked for.

        Raises:
            TrialError: there is no stress somewhere.
            SwitchedError: the law left a branch; the step must be begun anew.
        """
        self.tally.counts["right_hand_sides"] += 1
        F, F_dot, J = deformation_gradient(self.bar, u, v)
        if not J.min() > 0.0:
            point = int(np.argmin(J > 0.0))
            self.fail(t, point, F, f"det F = {J[point]:.6g}; the element is inverted there")
        response = self._respond(t, F, F_dot, tangents)
        if response.switched is not None:
            raise SwitchedError(t, u, response.switched)
        internal = internal_force(self.bar, F, response.stress)
        load = self.amplitude_at(t) * self.bar.load
        powers = np.array([np.vdot(internal, v), np.vdot(load, v)])
        if not np.isfinite(internal).all():
            bad = ~np.isfinite(response.stress).all(axis=(1, 2))
            self.fail(t, int(np.argmax(bad)), F, describe(Status.NOT_FINITE))
        self.last = Evaluation(t, u, v, F, F_dot, J, response, internal, load, powers)
        return self.last

    def accept(self) -> Evaluation:
        """Let the law commit its latest answer: the evaluation by which the next step begins.

        Raises `TrialError` if the law objects.
        """
        last = self.evaluation
        started = perf_counter()
        acceptance = self.law.accept(last.F, last.F_dot, last.response)
        self.tally.law_seconds += perf_counter() - started
        return self._begin(last, acceptance)

    def restart_step(self, switched: NDArray[np.int8]) -> Evaluation:
        """The start of the step under way with these points on another branch of the law."""
        start, law = self.start, cast(SwitchingLaw, self.law)
        response = replace(start.response, state=self._committed)
        started = perf_counter()
        acceptance = law.restart_step(start.F, start.F_dot, response, switched)
        self.tally.law_seconds += perf_counter() - started
        self.tally.counts["repeated_steps"] += 1
        return self._begin(start, acceptance)

    def _begin(self, at: Evaluation, acceptance: Acceptance) -> Evaluation:
        """Commit what the law said of an evaluation."""
        self._check_status(at.t, at.F, acceptance.status)
        self._committed = acceptance.state
        left = acceptance.left_bifurcation
        if left is not None:
            self.tally.effort["left_bifurcation"] += int(left.sum())
        if acceptance.stress is not None:
            internal = internal_force(self.bar, at.F, acceptance.stress)
            at = replace(
                at,
                response=replace(
                    at.response,
                    stress=acceptance.stress,
                    switched=None,
                    tangents=None,
                    left_bifurcation=left,
                ),
                internal=internal,
                powers=np.array([np.vdot(internal, at.v), at.powers[1]]),
            )
        self.start = self.last = at
        return at

    @property
    def evaluation(self) -> Evaluation:
        """The latest evaluation."""
        if self.last is None:
            raise InputError("right-hand side: nothing was evaluated yet; call it first")
        return self.last

    def dissipation_rate(self) -> float:
        """∫ J (σ(F, Ḟ) − σ(F, 0)) : L dV at the latest evaluation, pJ/µs; NaN without σ(F, 0).

        The power of the stress in excess of the equilibrium stress at the same F, deviator and
        pressure at their own points, which is the excess internal force times v.
        """
        last = self.evaluation
        still = self._ask(last.F, np.zeros_like(last.F_dot))
        self.tally.counts["dissipation_points"] += len(last.F)
        if still.status.any():
            self.tally.counts["dissipation_failures"] += 1
            return float("nan")
        excess = internal_force(self.bar, last.F, last.response.stress - still.stress)
        return float(np.vdot(excess, last.v))

    def fail(self, t: float, point: int, F: Array, reason: str) -> NoReturn:
        """Raise the `TrialError` that names the point."""
        raise TrialError(t, self.clock, point, self.bar.point_position(point), F[point], reason)

    def _respond(self, t: float, F: Array, F_dot: Array, tangents: bool) -> StressResponse:
        response = self._ask(F, F_dot, tangents)
        self.tally.counts["stress_calls"] += 1
        self.tally.counts["stress_points"] += len(F)
        self._check_status(t, F, response.status)
        return response

    def _ask(self, F: Array, F_dot: Array, tangents: bool = False) -> StressResponse:
        # Laws without tangents need not know the word.
        wish: dict[str, Any] = {"tangents": True} if tangents else {}
        started = perf_counter()
        response = self.law.respond(F, F_dot, self._committed, **wish)
        self.tally.law_seconds += perf_counter() - started
        for name, value in response.effort.items():
            self.tally.effort[name] += int(value)
        return response

    def _check_status(self, t: float, F: Array, status: NDArray[np.int8]) -> None:
        if status.any():
            point = int(np.flatnonzero(status)[0])
            self.fail(t, point, F, describe(status[point]))
