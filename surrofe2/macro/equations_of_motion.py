"""The equations of motion as a first-order system, and the states at which they have no rate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from surrofe2.macro.discretisation import Discretisation
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressLaw,
    StressResponse,
    SwitchingLaw,
    describe,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The equations of motion at one state, with everything that was computed on the way.

    Attributes:
        t: µs.
        y: (4 n_free,) displacement u and velocity v of the free nodes, µm and µm/µs.
        F, F_dot: (n_points, 2, 2).
        response: what the stress law answered.
        internal, load: (n_free, 2) internal force and load on the free nodes, µN.
        powers: (2,) internal and load power, pJ/µs.
        rate: (4 n_free,) rate of y.
    """

    t: float
    y: Array
    F: Array
    F_dot: Array
    response: StressResponse
    internal: Array
    load: Array
    powers: Array
    rate: Array

    @property
    def u(self) -> Array:
        """(n_free, 2) µm."""
        return self.y[: self.y.size // 2].reshape(-1, 2)

    @property
    def v(self) -> Array:
        """(n_free, 2) µm/µs."""
        return self.y[self.y.size // 2 :].reshape(-1, 2)

    @property
    def acceleration(self) -> Array:
        """(n_free, 2) ü, µm/µs²."""
        return self.rate[self.y.size // 2 :].reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class NoStress:
    """There is no stress at some point: whoever tried the state must take a shorter step.

    Attributes:
        message: which point, where, when, its F, and why.
    """

    message: str


@dataclass(frozen=True, slots=True)
class Switched:
    """Points left their branch of the law within a step: the step must be restarted.

    Attributes:
        y: (4 n_free,) state at which they were found.
        points: (n_points,) int8, as of `StressResponse.switched`.
        message: says so.
    """

    y: Array
    points: NDArray[np.int8]
    message: str = "points left their branch of the law"


@dataclass(slots=True)
class Tally:
    """What a run has cost so far."""

    counts: Counter[str] = field(default_factory=Counter)
    effort: Counter[str] = field(default_factory=Counter)
    law_seconds: float = 0.0


class EquationsOfMotion:
    """ẏ = f(t, y) with y = [u, v] of the free nodes: u̇ = v, v̇ = M⁻¹ (load − internal force).

    `evaluate` changes nothing that a later call depends on: the state of the stress law moves on
    only in `accept` and `restart_step`.

    Attributes:
        clock: how a message calls the time; a quasi-static load has a factor in its place.
        law_state: what the stress law committed last.
        is_committing: whether the law may have committed more than was recorded of the run.
    """

    def __init__(
        self,
        discretisation: Discretisation,
        law: StressLaw,
        amplitude_at: Callable[[float], float],
        clock: str = "t = {:.6g} µs",
    ) -> None:
        self.discretisation = discretisation
        self.law = law
        self.amplitude_at = amplitude_at
        self.clock = clock
        self.tally = Tally()
        self._start: Evaluation
        self.law_state: Any = None
        self.is_committing = False

    def evaluate(
        self, t: float, y: Array, *, tangents: bool = False
    ) -> Evaluation | NoStress | Switched:
        """Stress, forces and rate at (t, y); the law's tangents where asked for."""
        self.tally.counts["right_hand_sides"] += 1
        u, v = y.reshape(2, -1, 2)
        F, F_dot, J = deformation_gradient(self.discretisation, u, v)
        if not J.min() > 0.0:
            point = int(np.argmin(J > 0.0))
            reason = f"det F = {J[point]:.6g}; the element is inverted there"
            return self.no_stress(t, point, F, reason)
        response = self._ask(F, F_dot, tangents)
        self.tally.counts["stress_calls"] += 1
        self.tally.counts["stress_points"] += len(F)
        if response.status.any():
            return self._failed(t, F, response.status)
        if response.switched is not None:
            return Switched(y, response.switched)
        now = self._evaluation(t, y, F, F_dot, response)
        if not np.isfinite(now.internal).all():
            bad = ~np.isfinite(response.stress).all(axis=(1, 2))
            return self.no_stress(t, int(np.argmax(bad)), F, describe(Status.NOT_FINITE))
        return now

    def accept(self, now: Evaluation) -> Evaluation | NoStress:
        """Let the law commit its answer: the evaluation by which the next step begins."""
        self.is_committing = True
        started = perf_counter()
        acceptance = self.law.accept(now.F, now.F_dot, now.response)
        self.tally.law_seconds += perf_counter() - started
        start = self._begin(now, acceptance)
        self.is_committing = isinstance(start, Evaluation)
        return start

    def begin(self, t: float, y: Array) -> Evaluation | NoStress | Switched:
        """The evaluation by which the first step begins, accepted by the law."""
        start = self.evaluate(t, y)
        return self.accept(start) if isinstance(start, Evaluation) else start

    def resume(self, t: float, y: Array, stress: Array, law_state: Any) -> Evaluation:
        """The evaluation by which a step begins, of the stress that an earlier call found there.

        law_state: what the law had committed there.
        """
        u, v = y.reshape(2, -1, 2)
        F, F_dot, _ = deformation_gradient(self.discretisation, u, v)
        response = StressResponse(stress, np.zeros(len(F), dtype=np.int8), law_state)
        self.law_state = law_state
        self._start = self._evaluation(t, y, F, F_dot, response)
        return self._start

    def restart_step(self, points: NDArray[np.int8]) -> Evaluation | NoStress:
        """The start of the step under way with these points on another branch of the law."""
        start, law = self._start, cast(SwitchingLaw, self.law)
        response = replace(start.response, state=self.law_state)
        started = perf_counter()
        acceptance = law.restart_step(start.F, start.F_dot, response, points)
        self.tally.law_seconds += perf_counter() - started
        self.tally.counts["repeated_steps"] += 1
        return self._begin(start, acceptance)

    def dissipation_rate(self, now: Evaluation) -> float:
        """∫ J (σ(F, Ḟ) − σ(F, 0)) : L dV, pJ/µs; NaN where there is no σ(F, 0).

        The power of the stress in excess of the equilibrium stress at the same F, deviator and
        pressure at their own points, which is the excess internal force times v.
        """
        still = self._ask(now.F, np.zeros_like(now.F_dot))
        self.tally.counts["dissipation_points"] += len(now.F)
        if still.status.any():
            self.tally.counts["dissipation_failures"] += 1
            return float("nan")
        excess = internal_force(self.discretisation, now.F, now.response.stress - still.stress)
        return float(np.vdot(excess, now.v))

    def no_stress(self, t: float, point: int, F: Array, reason: str) -> NoStress:
        """The failure that names the point."""
        x, y = self.discretisation.point_position(point)
        entries = ", ".join(f"[{row[0]:.6g}, {row[1]:.6g}]" for row in F[point])
        return NoStress(
            f"point {point} at ({x:.6g}, {y:.6g}) µm, {self.clock.format(t)}, "
            f"F = [{entries}]: {reason}"
        )

    def out_of_balance(self, now: Evaluation, residual: Array, reason: str) -> NoStress:
        """The failure that names a point near the node with the largest residual (n_free, 2)."""
        row = int(abs(residual).max(axis=1).argmax())
        return self.no_stress(now.t, self.discretisation.point_near(row), now.F, reason)

    def _begin(self, at: Evaluation, acceptance: Acceptance) -> Evaluation | NoStress:
        """Commit what the law said of an evaluation."""
        if acceptance.status.any():
            return self._failed(at.t, at.F, acceptance.status)
        self.law_state = acceptance.state
        left = acceptance.left_bifurcation
        if left is not None:
            self.tally.effort["left_bifurcation"] += int(left.sum())
        if acceptance.stress is not None:
            response = replace(
                at.response,
                stress=acceptance.stress,
                switched=None,
                tangents=None,
                left_bifurcation=left,
            )
            at = self._evaluation(at.t, at.y, at.F, at.F_dot, response)
        self._start = at
        return at

    def _evaluation(
        self, t: float, y: Array, F: Array, F_dot: Array, response: StressResponse
    ) -> Evaluation:
        """The forces and the rate by a stress."""
        v = y[y.size // 2 :].reshape(-1, 2)
        internal = internal_force(self.discretisation, F, response.stress)
        load = self.amplitude_at(t) * self.discretisation.load
        powers = np.array([np.vdot(internal, v), np.vdot(load, v)])
        acceleration = self.discretisation.inverse_mass @ (load - internal)
        rate = np.concatenate([v.ravel(), acceleration.ravel()])
        return Evaluation(t, y, F, F_dot, response, internal, load, powers, rate)

    def _ask(self, F: Array, F_dot: Array, tangents: bool = False) -> StressResponse:
        started = perf_counter()
        response = self.law.respond(F, F_dot, self.law_state, tangents=tangents)
        self.tally.law_seconds += perf_counter() - started
        for name, value in response.effort.items():
            self.tally.effort[name] += int(value)
        return response

    def _failed(self, t: float, F: Array, status: NDArray[np.int8]) -> NoStress:
        point = int(np.flatnonzero(status)[0])
        return self.no_stress(t, point, F, describe(status[point]))
