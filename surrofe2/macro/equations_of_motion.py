"""The equations of motion as a first-order system, and the states at which they have no rate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, cast

import numpy as np
import scipy  # scipy.sparse is loaded where a matrix is factorised
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.clock import clock
from surrofe2.base.errors import InputError
from surrofe2.law.ahead import ForesightLaw
from surrofe2.law.stress_law import (
    Status,
    StressLaw,
    StressResponse,
    SwitchingLaw,
    Tangents,
    describe,
)
from surrofe2.macro.elements import (
    Matrix,
    deformation_gradient,
    gradient_matrix,
    internal_force,
    point_tangents,
    stress_power,
    summed,
    with_transpose,
)
from surrofe2.macro.forces import Contact, Slopes
from surrofe2.macro.system import System, Works


class Evaluation(NamedTuple):
    """The equations of motion at one state, of m free unknowns and n nodes and bodies.

    Attributes:
        t: µs.
        within: a time inside the piece of all amplitudes that the state belongs to, µs.
        y: (2 m,) displacement and velocity of the free unknowns, µm and µm/µs.
        u, v: (n, 2) displacement and velocity of all nodes and bodies.
        internal: (n, 2) internal force, µN.
        forces: (k, n, 2) the other forces of the system, µN.
        residual: (m,) forces − internal − what prescribed accelerations take, µN.
        powers: powers of all that acts, pJ/µs.
        rate: (2 m,) rate of y.
        F, F_dot: (n_points, 2, 2).
        response: answer of the stress law.
    """

    t: float
    within: float
    y: Array
    u: Array
    v: Array
    internal: Array
    forces: Array
    residual: Array
    powers: Works
    rate: Array
    F: Array
    F_dot: Array
    response: StressResponse

    @property
    def acceleration(self) -> Array:
        """Acceleration ü of the free unknowns, (m,), µm/µs²."""
        return self.rate[self.y.size // 2 :]


class NoStress(Exception):  # noqa: N818 - of a trial state; the caller tries a shorter step
    """A point has no stress, so the caller must take a shorter step.

    Its text says which point, where, when, its F, and why.

    Attributes:
        status: code of the stress law, `Status.OK` where it is not the law that failed.
    """

    status: int = Status.OK


class OutOfBalance(NoStress):
    """Every point has a stress, but Newton's method finds no equilibrium."""


class Switched(Exception):  # noqa: N818 - as above
    """Points left their branch of the law within a step, which must be started again.

    Attributes:
        y: (2 m,) the state at which they left it.
        points: (n_points,) `StressResponse.switched` there.
    """

    def __init__(self, y: Array, points: NDArray[np.int8]) -> None:
        super().__init__("points left their branch of the law")
        self.y = y
        self.points = points


@dataclass(slots=True)
class Tally:
    """The cost of a run so far: what is counted, effort of the law by name, and its seconds."""

    counts: Counter[str] = field(default_factory=Counter)
    effort: Counter[str] = field(default_factory=Counter)
    law_seconds: float = 0.0


class EquationsOfMotion:
    """The first-order system ẏ = f(t, y), y = [u, v] of the free unknowns.

    u̇ = v and v̇ = M⁻¹ (forces − internal force).

    `evaluate` changes nothing that a later call depends on: the state of the stress law moves on
    only in `accept` and `restart_step`, the piece of the amplitudes only in `enter_piece`.

    Attributes:
        system: mesh, mass and forces.
        law: the stress law.
        clock: a format in which messages write the time, or a factor of the loads.
        corners: (p + 1,) ends of the pieces of all amplitudes, µs.
        piece: number of the piece that is computed now.
        within: a time in its middle, µs.
        tally: cost of the run.
        law_state: state that the stress law committed last.
        is_committing: whether the law may have committed more than was recorded of the run.
    """

    def __init__(
        self, system: System, law: StressLaw, clock: str = "t = {:.6g} µs", t: float = 0.0
    ) -> None:
        self.system = system
        self.law = law
        self.clock = clock
        self.discretisation = system.discretisation
        self.corners = system.problem.corners()
        self.go_to(t)
        self.tally = Tally()
        self._start: Evaluation
        self.law_state: Any = None
        self.is_committing = False

    @property
    def piece_end(self) -> float:
        """End of the piece of the amplitudes that is computed now, µs."""
        return float(self.corners[self.piece + 1])

    def go_to(self, t: float) -> None:
        """Enter the piece of the amplitudes in which t is.

        At a corner this is the piece before it: the next step crosses the corner first.
        """
        self.enter_piece(max(0, int(np.searchsorted(self.corners, t)) - 1))

    def enter_piece(self, piece: int) -> None:
        """Take the amplitudes of this piece from here on."""
        self.piece = piece
        self.within = 0.5 * float(self.corners[piece] + self.corners[piece + 1])

    def evaluate(self, t: float, y: Array, *, tangents: bool = False) -> Evaluation:
        """Compute stress, forces and rate at (t, y), and the law's tangents where asked for.

        Raises:
            NoStress: a point has none.
            Switched: a point left its branch of the law. With tangents this comes first: whether
                such a point has a stress is not known yet.
        """
        self.tally.counts["right_hand_sides"] += 1
        u, v = self.system.spread(y, t, self.within)
        F, F_dot, J = deformation_gradient(self.discretisation, self.system.from_mesh(u), v)
        if not J.min() > 0.0:
            point = int(np.argmin(J > 0.0))
            reason = f"det F = {J[point]:.6g}; the element is inverted there"
            raise self.no_stress(t, point, F, reason)
        # Explicit steps, which need no tangents, have few points that leave: a second lookup would
        # cost more than their RVEs.
        if tangents and isinstance(self.law, ForesightLaw):
            started = clock()
            leaving = self.law.leaving(F, F_dot, self.law_state)
            self.tally.law_seconds += clock() - started
            if leaving is not None:
                raise Switched(y, leaving)
        response = self._ask(F, F_dot, tangents)
        self.tally.counts["stress_calls"] += 1
        self.tally.counts["stress_points"] += len(F)
        if response.status.any():
            raise self._failed(t, F, response.status, response.reasons)
        if response.switched is not None:
            raise Switched(y, response.switched)
        now = self._evaluation(t, y, (u, v), F, F_dot, response)
        if not np.isfinite(now.internal).all():
            bad = ~np.isfinite(response.stress).all(axis=(1, 2))
            raise self.no_stress(t, int(np.argmax(bad)), F, describe(Status.NOT_FINITE))
        # a surface law without an answer gives a force of NaN; the surface is the last force
        surface = self.system.surface
        if surface is not None and not np.isfinite(now.powers.forces[-1]):
            message = surface.refusal(self.discretisation.nodes, u, v)
            raise NoStress(f"{self.clock.format(t)}, {message}")
        return now

    def with_forces_of_now(self, now: Evaluation) -> Evaluation:
        """Return the same state, by the same stress, with the forces of the system as it is now."""
        return self._evaluation(now.t, now.y, (now.u, now.v), now.F, now.F_dot, now.response)

    def grip(self, now: Evaluation) -> Evaluation:
        """Let friction follow from this state on, the end of a step.

        Returns:
            The evaluation by which the next step begins.
        """
        if not any(contact.sticks for contact in self.system.contacts):
            return now
        gripped = partial(Contact.gripped, u=now.u, v=now.v)
        self.system = self.system.with_forces(Contact, gripped)
        self._start = self.with_forces_of_now(now)
        return self._start

    def accept(self, now: Evaluation) -> Evaluation:
        """Let the law commit its answer at the end of a step.

        Returns:
            The evaluation by which the next step begins.

        Raises:
            NoStress: the law does not accept a point.
        """
        self.is_committing = True
        started = clock()
        accepted = self.law.accept(now.F, now.F_dot, now.response)
        self.tally.law_seconds += clock() - started
        return self._begin(now, accepted)

    def begin(self, t: float, y: Array) -> Evaluation:
        """Return the evaluation by which the first step begins, accepted by the law.

        Raises:
            NoStress, Switched: as of `evaluate` and `accept`.
        """
        return self.accept(self.evaluate(t, y))

    def resume(
        self,
        t: float,
        y: Array,
        stress: Array,
        law_state: Any,
        drags: Mapping[str, Array] | None = None,
    ) -> Evaluation:
        """Return the evaluation by which a step begins, by the stress that an earlier call computed
        there.

        Args:
            law_state: state that the law had committed there.
            drags: friction of the springs there, µN/µm, by name of the body; for a run in time.
        """
        u, v = self.system.spread(y, t, self.within)
        if drags:
            self.system = self.system.gripped(u, drags)
        F, F_dot, _ = deformation_gradient(self.discretisation, self.system.from_mesh(u), v)
        response = StressResponse(stress, np.zeros(len(F), dtype=np.int8), law_state)
        self.law_state = law_state
        self._start = self._evaluation(t, y, (u, v), F, F_dot, response)
        return self._start

    def cross_corner(self, now: Evaluation) -> tuple[Evaluation, Array]:
        """Cross a corner of an amplitude.

        Returns:
            The evaluation by which its next piece begins, and the row of works of a jump of
            prescribed velocities.
        """
        before = self.within
        self.enter_piece(self.piece + 1)
        y, work = self.system.across_corner(now.y, now.t, before, self.within)
        motion = self.system.spread(y, now.t, self.within)
        _, v = motion
        if np.array_equal(v, now.v):  # no velocity jumps, so the stress stays
            self._start = self._evaluation(now.t, y, motion, now.F, now.F_dot, self._start.response)
            return self._start, work
        while True:
            try:
                return self.begin(now.t, y), work
            except Switched as switched:
                self.restart_step(switched.points)

    def restart_step(self, points: NDArray[np.int8]) -> Evaluation:
        """Return the start of the current step with these points on another branch of the law.

        Raises:
            NoStress: a point has none there.
        """
        start = self._start
        law = cast(SwitchingLaw, self.law)
        response = replace(start.response, state=self.law_state)
        started = clock()
        restarted = law.restart_step(start.F, start.F_dot, response, points)
        self.tally.law_seconds += clock() - started
        self.tally.counts["repeated_steps"] += 1
        return self._begin(start, restarted)

    def learn_ahead(self, t: float, switched: Switched) -> NDArray[np.int8]:
        """Let the law learn at a trial in which points left their branch, if it can.

        Returns:
            (n_points,) codes why points still must leave their branch, 0 where they need not.
        """
        if not isinstance(self.law, ForesightLaw):
            return switched.points
        u, v = self.system.spread(switched.y, t, self.within)
        F, F_dot, _ = deformation_gradient(self.discretisation, self.system.from_mesh(u), v)
        self.is_committing = True
        started = clock()
        points = self.law.learn_ahead(F, F_dot, switched.points)
        self.tally.law_seconds += clock() - started
        return points

    def dissipation_rates(self, now: Evaluation) -> Array | None:
        """Compute ∫ J (σ(F, Ḟ) − σ(F, 0)) : L dV of each element, (n_el,) pJ/µs.

        Deviator and pressure count at their own points: it is the excess internal force times v.
        None: a point has no σ(F, 0).
        """
        still = self._ask(now.F, np.zeros_like(now.F_dot))
        self.tally.counts["dissipation_points"] += len(now.F)
        if still.status.any():
            self.tally.counts["dissipation_failures"] += 1
            return None
        excess = now.response.stress - still.stress
        return stress_power(self.discretisation, now.F, now.F_dot, excess)

    def reaction(self, now: Evaluation) -> Array:
        """Compute the force (n, 2) by which supports act on what they hold: M a − forces, µN."""
        reaction = now.internal - now.forces.sum(axis=0) + self.inertia(now)
        reaction.ravel()[self.system.free] = 0.0
        return reaction

    def inertia(self, now: Evaluation) -> Array:
        """Compute M ü (n, 2) of all rows, those of supports that move included, µN."""
        pushed = self.system.prescribed_acceleration(now.t, now.within)
        a = np.zeros((self.system.n_rows, 2)) if pushed is None else pushed
        a.ravel()[self.system.free] = now.acceleration
        return self.system.inertia(a)

    def tangents(self, now: Evaluation) -> Slopes:
        """Compute K = ∂(f − l)/∂u (µN/µm) and C = ∂(f − l)/∂v (µN µs/µm), sparse (m, m).

        f is the internal force and l all others. Neither matrix need be symmetric.
        """
        return self.slope(now, 1.0, 0.0), self.slope(now, 0.0, 1.0)

    def slope(self, now: Evaluation, of_u: float, of_v: float) -> Matrix:
        """Compute of_u K + of_v C of `tangents`, at about half the cost of both."""
        slopes = _tangents(now.response)
        P = of_u * now.response.first_piola(now.F)
        slope = of_u * slopes.P_by_F + of_v * slopes.P_by_F_dot
        blocks = point_tangents(self.discretisation, now.F, P, slope)
        total = summed(self._free_gradients, blocks)
        free = self.system.free
        for K, C in self._slopes_of_forces(now):
            total = total + (of_u * K + of_v * C).tocsc()[free][:, free]
        return total

    def stiffness_times(self, now: Evaluation, w: Array) -> Array:
        """Compute ∂(f − l)/∂u w, (m,), for a displacement w (n, 2) of all rows, supports
        included.
        """
        of_forces = [K for K, _ in self._slopes_of_forces(now)]
        return self._applied(now, "pij,pj->pi", of_forces, w)[self.system.free]

    def stiffness_transposed_times(self, now: Evaluation, w: Array) -> Array:
        """Compute (∂(f − l)/∂u)ᵀ w, (n, 2), for w (n, 2) of all rows."""
        of_forces = [K.T for K, _ in self._slopes_of_forces(now)]
        return self._applied(now, "pij,pi->pj", of_forces, w).reshape(-1, 2)

    def _applied(
        self, now: Evaluation, at_each_point: str, of_forces: Sequence[Matrix], w: Array
    ) -> Array:
        """Sum linear maps of w (n, 2), of all rows: tangents of all points, and slopes of forces.

        Args:
            at_each_point: rule of `einsum` by which the blocks of tangents are applied.
            of_forces: the slopes.

        Returns:
            (2 n,).
        """
        S = self._gradients
        P = now.response.first_piola(now.F)
        blocks = point_tangents(self.discretisation, now.F, P, _tangents(now.response).P_by_F)
        at_points = np.einsum(at_each_point, blocks, (S @ w.ravel()).reshape(-1, 4))
        total = S.T @ at_points.ravel()
        for slope in of_forces:
            total += slope @ w.ravel()
        return np.asarray(total)

    def slopes_of_each_force(self, now: Evaluation) -> list[Slopes | None]:
        """Return ∂(−l)/∂u and ∂(−l)/∂v of each force of the system; None of one that is dead."""
        return [force.slopes(now.t, now.within, now.u, now.v) for force in self.system.forces]

    @cached_property
    def _gradients(self) -> Matrix:
        """The matrix from displacement of all rows to its gradient at all points."""
        return gradient_matrix(self.discretisation, self.system.n_rows)

    @cached_property
    def _free_gradients(self) -> tuple[Matrix, Matrix]:
        """The same matrix from the free unknowns, and its transpose."""
        return with_transpose(self._gradients[:, self.system.free])

    def _slopes_of_forces(self, now: Evaluation) -> list[Slopes]:
        """Return the slopes of the forces that have any."""
        return [slopes for slopes in self.slopes_of_each_force(now) if slopes is not None]

    def no_stress(self, t: float, point: int, F: Array, reason: str) -> NoStress:
        """Make the failure that names the point, where it is, when, and its F."""
        x, y = self.discretisation.point_positions()[point]
        entries = ", ".join(f"[{row[0]:.6g}, {row[1]:.6g}]" for row in F[point])
        return NoStress(
            f"point {point} at ({x:.6g}, {y:.6g}) µm, {self.clock.format(t)}, "
            f"F = [{entries}]: {reason}"
        )

    def out_of_balance(self, now: Evaluation, residual: Array, reason: str) -> NoStress:
        """Make the failure that names a point near the unknown with the largest residual (m,)."""
        node = int(self.system.free[abs(residual).argmax()]) // 2
        is_of_mesh = node < len(self.discretisation.nodes)
        point = self.discretisation.point_near(node) if is_of_mesh else 0  # a body has no point
        return OutOfBalance(str(self.no_stress(now.t, point, now.F, reason)))

    def _begin(self, now: Evaluation, accepted: StressResponse) -> Evaluation:
        """Return the evaluation by which a step begins, after what the law committed there.

        Args:
            now: the evaluation that the law was given.
            accepted: its response.

        Raises:
            NoStress: the law rejects a point.
        """
        if accepted.status.any():
            raise self._failed(now.t, now.F, accepted.status)
        self.law_state = accepted.state
        # a law that keeps the stress returns that very array
        if accepted.stress is not now.response.stress:
            left_bifurcation = accepted.left_bifurcation
            if left_bifurcation is not None:
                self.tally.effort["left_bifurcation"] += int(left_bifurcation.sum())
            response = replace(
                now.response, stress=accepted.stress, switched=None, tangents=None,
                left_bifurcation=left_bifurcation,
            )  # fmt: skip
            now = self._evaluation(now.t, now.y, (now.u, now.v), now.F, now.F_dot, response)
        self._start = now
        return now

    def _evaluation(
        self,
        t: float,
        y: Array,
        motion: tuple[Array, Array],
        F: Array,
        F_dot: Array,
        response: StressResponse,
    ) -> Evaluation:
        """Compute forces and rate by a stress."""
        system = self.system
        u, v = motion
        internal = internal_force(self.discretisation, F, response.stress, system.n_rows)
        forces = np.zeros((len(system.forces), *u.shape))
        for k, force in enumerate(system.forces):
            forces[k] = force.at(t, self.within, u, v)
        unbalanced = forces.sum(axis=0) - internal
        pushed = system.prescribed_acceleration(t, self.within)
        if pushed is not None:
            unbalanced -= system.inertia(pushed)
        residual = system.pick(unbalanced)
        rate = np.concatenate([y[y.size // 2 :], system.solve_mass(residual)])
        powers = Works(
            internal=float(np.vdot(internal, v)),
            forces=np.einsum("kni,ni->k", forces, v),
            inertia=float(np.dot(y[y.size // 2 :], residual)),
            impulses=system.pushes(forces),
        )
        now = Evaluation(
            t, self.within, y, u, v, internal, forces, residual, powers, rate, F, F_dot, response
        )
        if not system.moving:
            return now
        # Supports that move do work and have inertia; both need the acceleration that is known now.
        of_supports = float(np.vdot(self.reaction(now), v))
        of_inertia = float(np.vdot(self.inertia(now), v))
        return now._replace(powers=powers._replace(motion=of_supports, inertia=of_inertia))

    def _ask(self, F: Array, F_dot: Array, tangents: bool = False) -> StressResponse:
        """Call the law from its committed state, and count what that costs."""
        started = clock()
        response = self.law.respond(F, F_dot, self.law_state, tangents=tangents)
        self.tally.law_seconds += clock() - started
        for name, value in response.effort.items():
            self.tally.effort[name] += int(value)
        return response

    def _failed(
        self, t: float, F: Array, status: NDArray[np.int8], reasons: Mapping[int, str] | None = None
    ) -> NoStress:
        """Make the failure of the first point without stress."""
        point = int(np.flatnonzero(status)[0])
        details = ((reasons or {}).get(point), describe(status[point]))
        failure = self.no_stress(t, point, F, "; ".join(filter(None, details)))
        failure.status = int(status[point])
        return failure


def _tangents(response: StressResponse) -> Tangents:
    """Return the tangents of a response; an `InputError` where it has none."""
    if response.tangents is None:
        raise InputError("tangents: the stress law gave none; ask it for them")
    return response.tangents


def factorised(matrix: Matrix) -> Callable[[Array], Array] | None:
    """Return matrix⁻¹, applied to (n,) or (n, k); None where the matrix is singular."""
    try:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(matrix).solve
    except RuntimeError:  # SuperLU's word for an exactly singular matrix
        return None
    return solve
