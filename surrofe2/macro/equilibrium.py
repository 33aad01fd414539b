"""Equilibrium under constant loads: what it is, and Newton with line search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.macro.contact import Contact, Grip
from surrofe2.macro.discretisation import displacement_basis
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.evaluation import Evaluation, NoStress, Switched
from surrofe2.macro.extremes import NO_EXTREMES
from surrofe2.macro.forces import Matrix, Slopes
from surrofe2.macro.frames import Frames
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.system import System
from surrofe2.macro.tangents import Assembly, factorised

Array = NDArray[np.float64]

MAX_ITERATIONS = 20
_LEAST_FRACTION = 1.0 / 64.0
_DECREASE = 1e-4
_COUNTS = ("load_steps", "halvings", "factorisations")


@dataclass(frozen=True, slots=True)
class Rest:
    """The tissue at rest under constant loads.

    Attributes:
        system: mesh, mass and forces.
        factor: of all loads and prescribed motions.
        u: (n, 2) displacement of nodes and bodies, µm; from `System.rest` where there is one.
        F, stress: (n_points, 2, 2) deformation gradient; Cauchy stress, µN/µm.
        stiffness, damping: (m, m) of the free unknowns, as of `Assembly.tangents`.
        forces: (k, 2) forces on the tissue, of `System.force_names`, µN.
        rows: (steps + 1, k + 6) at each load step, from factor 0 on: factor, displacement of the
            first watched point, energy stored in contact, works of the internal force, the k other
            forces and the reaction.
        acts: (k + 2, n, 2) these forces at the last of them, µN.
        residuals: of Newton's iterations in the last load step, relative to the largest force.
        counts: load steps, halvings, Newton iterations.
        next_step: factor of the next load step.
        extremes: (2, 4, 2, 2) as in `MacroState`, of the equilibria on the way.
        law_state: what the law has committed.
        drags: by body, friction at all points of its contact, µN/µm.
    """

    system: System
    factor: float
    u: Array
    F: Array
    stress: Array
    stiffness: Matrix
    damping: Matrix
    forces: Array
    rows: Array
    acts: Array
    residuals: tuple[float, ...]
    counts: dict[str, int]
    next_step: float
    extremes: Array
    law_state: Any
    drags: dict[str, Array]

    @property
    def frame(self) -> Frames:
        """Whole fields, the factor of the load in the place of time."""
        u, space = self.u, self.system.discretisation
        return Frames.of(space, self.factor, (u, 0.0 * u), self.F, self.stress)

    @property
    def basis(self) -> skfem.Basis:
        """scikit-fem's basis of displacements, made at every call."""
        return displacement_basis(self.system.problem.mesh)

    @property
    def displacement(self) -> Array:
        """(2 n_nodes,) displacement as a nodal vector of `basis`, µm."""
        return self.u[: len(self.system.discretisation.nodes)].ravel()

    @property
    def path(self) -> Array:
        """(steps + 1, 3) factor and displacement of the first watched point, µm."""
        return self.rows[:, :3]

    def to_arrays(self) -> dict[str, Array]:
        """What `find_rest` goes on from, but for the law's state."""
        numbers = {"factor": self.factor, "next_step": self.next_step, **self.counts}
        arrays = {name: np.array(value) for name, value in numbers.items()}
        tensors = {"u": self.u, "stress": self.stress, "extremes": self.extremes}
        drags = {f"drag {name}": drag for name, drag in self.drags.items()}
        if self.system.rest is not None:
            tensors["rest"] = self.system.rest
        return arrays | tensors | {"rows": self.rows, "acts": self.acts} | drags

    @property
    def energies(self) -> dict[str, Array]:
        """By name, (steps + 1,) pJ: `internal` and the work of each force and of `motion` along
        the path, by the trapezoidal rule (second order in the load step), `contact` and `contact
        dissipated`, and `balance`, the other works − internal, zero to Newton's tolerance.
        """
        system = self.system
        stored, internal, *others, motion = self.rows[:, 3:].T
        works = {force.name: work for force, work in zip(system.forces, others, strict=True)}
        if system.moving:
            works["motion"] = motion
        contact = {}
        if system.contacts:
            done = np.sum([works[each.name] for each in system.contacts], axis=0)
            contact = {"contact": stored, "contact dissipated": stored[0] - stored - done}
        balance = np.sum([*works.values()], axis=0) - internal
        return {"internal": internal, **works, **contact, "balance": balance}

    @property
    def watched(self) -> Array:
        """(2,) displacement of the watched point, µm."""
        watched: Array = self.system.at_watched_points(self.u)[0]
        return watched


@dataclass(frozen=True, slots=True)
class Newton:
    """Newton's method for the equilibrium of a system at a factor of its loads."""

    equations: EquationsOfMotion
    assembly: Assembly
    settings: MacroSettings

    def rest_at(self, factor: float, u: Array, last: Rest | None = None) -> Rest:
        """The equilibrium at `factor` by Newton from u, after the last; the law commits it.

        Newton begins anew as long as points leave their branch of the law.

        Raises:
            NoStress: there is none.
        """
        while True:
            try:
                now, residuals, slopes = self.balanced(factor, u)
                break
            except Switched as switched:
                self.equations.restart_step(switched.points)
        self.equations.tally.counts["load_steps"] += factor != 0.0
        system = self.equations.system
        acts = np.stack([now.internal, *now.forces, self.equations.reaction(now)])
        works, before = np.zeros(len(acts)), np.empty((0, len(acts) + 4))
        if last is not None:
            # Mean force times displacement: of second order in the load step.
            step = np.einsum("kni,ni->k", 0.5 * (last.acts + acts), now.u - last.u)
            works, before = last.rows[-1, 4:] + step, last.rows
        stored = sum(each.energy(now.u) for each in system.contacts)
        row = np.concatenate([[factor], system.at_watched_points(now.u)[0], [stored], works])
        return self._rest(now, residuals, slopes, np.vstack([before, row]), acts)

    def known(self, there: Mapping[str, Array], law_state: Any) -> Rest:
        """An equilibrium that was found before, as of `Rest.to_arrays`; raises as `evaluate`."""
        equations, factor = self.equations, float(there["factor"])
        u = equations.system.pick(there["u"])
        y = np.concatenate([u, np.zeros(u.size)])
        start = equations.resume(factor, y, there["stress"], law_state)
        again = equations.evaluate(factor, y, tangents=True)
        for name in _COUNTS:
            equations.tally.counts[name] = int(there[name])
        slopes = self.assembly.tangents(again)
        return self._rest(start, [], slopes, there["rows"], there["acts"])

    def _rest(
        self, now: Evaluation, residuals: list[float], slopes: Slopes, rows: Array, acts: Array
    ) -> Rest:
        equations = self.equations
        return Rest(
            system=equations.system,
            factor=now.t,
            u=now.u,
            F=now.F,
            stress=now.response.stress,
            stiffness=slopes[0],
            damping=slopes[1],
            forces=equations.system.resultants(now.forces, equations.reaction(now)),
            rows=rows,
            acts=acts,
            residuals=tuple(residuals),
            counts=self.counts(),
            next_step=0.0,
            extremes=NO_EXTREMES,
            law_state=equations.law_state,
            drags={contact.name: contact.drag(now.u) for contact in equations.system.contacts},
        )

    def gripping(self, u: Array, drags: Mapping[str, Array]) -> Newton:
        """The same, with contacts that go on from an equilibrium; u and drags as of `Rest`."""
        system = self.equations.system
        forces = tuple(
            replace(force, grip=Grip(u, drags.get(force.name, np.zeros(force.lengths.size))))
            if isinstance(force, Contact)
            else force
            for force in system.forces
        )
        self.equations.system = replace(system, forces=forces)
        return replace(self, assembly=replace(self.assembly, system=self.equations.system))

    def counts(self) -> dict[str, int]:
        return {name: self.equations.tally.counts[name] for name in _COUNTS}

    def balanced(self, factor: float, u: Array) -> tuple[Evaluation, list[float], Slopes]:
        """The equilibrium on one branch of the law, the residuals on the way to it, and K and C.

        Newton goes on where the equilibrium of the tissue has lost that of a point.

        Raises:
            NoStress: there is none. Switched: points left the branch.
        """
        y = np.concatenate([u, np.zeros(u.size)])
        residuals: list[float] = []
        while True:
            now = self.equations.evaluate(factor, y, tangents=True)
            while True:
                slopes = self.assembly.tangents(now)
                residuals.append(self.relative_residual(now, slopes[0]))
                if residuals[-1] <= self.settings.newton_tolerance:
                    break
                now = self.corrected(now, slopes[0], last=len(residuals) > MAX_ITERATIONS)
            start = self.equations.accept(now)
            if start is now or start.response.left_bifurcation is None:
                return now, residuals, slopes
            y = now.y

    def corrected(self, now: Evaluation, K: Matrix, *, last: bool) -> Evaluation:
        """Newton's correction, halved until the residual is smaller and every point has a stress.

        Args:
            K: derivative of the residual.
            last: that there were corrections enough.

        Raises:
            NoStress: no correction does. Switched: points left their branch of the law.
        """
        equations, residual = self.equations, -now.residual
        if last:
            reason = f"Newton did not converge in {MAX_ITERATIONS} iterations"
            raise equations.out_of_balance(now, residual, reason)
        equations.tally.counts["factorisations"] += 1
        solve = factorised(K)
        if solve is None:
            raise equations.out_of_balance(now, residual, "the stiffness is singular")
        correction = np.append(solve(residual), np.zeros(residual.size))
        size = np.linalg.norm(residual)
        fraction, reason = 1.0, "the line search found no smaller residual"
        while fraction >= _LEAST_FRACTION:
            try:
                trial = equations.evaluate(now.t, now.y - fraction * correction, tangents=True)
            except NoStress as failure:
                reason = str(failure)
            else:
                if np.linalg.norm(trial.residual) <= (1.0 - _DECREASE * fraction) * size:
                    return trial
            fraction *= 0.5
        raise equations.out_of_balance(now, residual, reason)

    def relative_residual(self, now: Evaluation, K: Matrix) -> float:
        """Largest residual relative to the largest of internal force, other forces, those at
        factor 1, and the force that moves the stiffest unknown by what the tolerance allows.
        """
        full = [force.at(1.0, now.within, now.u, now.v) for force in self.equations.system.forces]
        forces = (now.internal, now.forces, *full)
        least = float(abs(K.diagonal()).max()) * self.settings.absolute_tolerance
        scale = max(least, *(abs(force).max(initial=0.0) for force in forces))
        return float(abs(now.residual).max() / scale)
