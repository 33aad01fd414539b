"""Quasi-static equilibrium: the load in steps, Newton with line search at each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro.contact import Contact, Grip
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Evaluation, NoStress, Switched
from surrofe2.macro.extremes import NO_EXTREMES, widen_extremes
from surrofe2.macro.forces import Matrix, Slopes
from surrofe2.macro.frames import Frames
from surrofe2.macro.problem import Problem
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.simulation import as_problem, system_of
from surrofe2.macro.system import System
from surrofe2.macro.tangents import Assembly, factorised, make_assembly
from surrofe2.stress_law import StressLaw, require_tangents

Array = NDArray[np.float64]

MAX_HALVINGS = 10
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
        u: (n, 2) displacement of nodes and bodies, µm.
        F, stress: (n_points, 2, 2) deformation gradient; Cauchy stress, µN/µm.
        stiffness, damping: (m, m) of the free unknowns, as of `Assembly.tangents`.
        forces: (k, 2) forces on the tissue, of `System.force_names`, µN.
        path: (steps + 1, 3) factor and displacement of the first watched point at each load step,
            from (0, 0, 0) on.
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
    path: Array
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

    def to_arrays(self) -> dict[str, Array]:
        """What `find_rest` goes on from, but for the law's state."""
        numbers = {"factor": self.factor, "next_step": self.next_step, **self.counts}
        arrays = {name: np.array(value) for name, value in numbers.items()}
        tensors = {"u": self.u, "stress": self.stress, "extremes": self.extremes}
        drags = {f"drag {name}": drag for name, drag in self.drags.items()}
        return arrays | tensors | {"path": self.path} | drags

    @property
    def watched(self) -> Array:
        """(2,) displacement of the watched point, µm."""
        watched: Array = self.system.at_watched_points(self.u)[0]
        return watched


def find_rest(
    problem: Problem | LoadCase,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    factor: float = 1.0,
    load_steps: int = 1,
    reached: Callable[[Rest], None] | None = None,
    resume: Mapping[str, Array] | None = None,
    law_state: Any = None,
) -> Rest:
    """Equilibrium of all forces at v = 0 and `factor` times the loads, reached from factor 0.

    Each load step starts from the last equilibrium; Newton's correction is halved until the
    residual falls and every point has a stress, and a load step that cannot be solved is halved.

    Args:
        problem: as of `simulate`. Its amplitudes in time have no say here.
        factor: of all loads and prescribed motions; 0 is the tissue without load.
        load_steps: load steps to begin with.
        reached: called with each equilibrium on the way, the one without load first.
        resume: `Rest.to_arrays` of an equilibrium of the same problem on the way to the same
            factor, with its `law_state`; what is found is that of the uninterrupted way, to the
            bit.

    Friction depends on the way: a point of contact sticks where it touched until Coulomb's law lets
    it slip, from equilibrium to equilibrium, so more load steps follow its way more closely.

    Raises:
        InputError: the law has no tangents.
        MismatchError: `resume` is of another mesh.
        SimulationError: a load step halved ten times finds no equilibrium; `partial` is the last
            `Rest`.
    """
    require_tangents(law, "rest")
    if not np.isfinite(factor):
        raise InputError(f"factor: {factor}; it must be finite")
    if load_steps < 1:
        raise InputError(f"load_steps: {load_steps}; it must be at least 1")
    system = system_of(as_problem(problem, settings), law, proportional=True)
    equations = EquationsOfMotion(system, law, clock="load factor {:.6g}")
    newton = _Newton(equations, make_assembly(system), settings)
    found: Rest | NoStress | Switched
    if resume is None:
        step, met = factor / load_steps, NO_EXTREMES
        newton = newton.gripping(np.zeros((system.n_rows, 2)), {})
        found = newton.rest_at(0.0, np.zeros(system.free.size), np.zeros((1, 3)))
    else:
        if resume["u"].shape != (system.n_rows, 2):
            raise MismatchError("resume: the mesh is not that of the state; start anew")
        step, met = float(resume["next_step"]), resume["extremes"]
        drags = {each.name: resume[f"drag {each.name}"] for each in system.contacts}
        newton = newton.gripping(resume["u"], drags)
        found = newton.known(resume, law_state)
    if not isinstance(found, Rest):
        raise SimulationError(f"the load cannot start: {found.message}")
    rest, failed = _on_the_way(found, met, step), False
    if reached is not None and resume is None:
        reached(rest)
    while rest.factor != factor:
        left = factor - rest.factor
        target = factor if abs(step) >= abs(left) * (1.0 - 1e-9) else rest.factor + step
        newton = newton.gripping(rest.u, rest.drags)
        found = newton.rest_at(target, system.pick(rest.u), rest.path)
        if isinstance(found, NoStress):
            equations.tally.counts["halvings"] += 1
            step, failed = 0.5 * (target - rest.factor), True
            # Counted from the first length: near a limit load every second step would succeed.
            if abs(step) < abs(factor) / load_steps * 0.5**MAX_HALVINGS:
                raise SimulationError(
                    f"no load step succeeds after {MAX_HALVINGS} halvings: {found.message}",
                    partial=rest,
                )
            continue
        step, failed = min(step if failed else 2.0 * step, factor / load_steps, key=abs), False
        rest = _on_the_way(found, rest.extremes, step)
        if reached is not None:
            reached(rest)
    return replace(rest, counts=newton.counts())


def _on_the_way(found: Rest, met: Array, next_step: float) -> Rest:
    """An equilibrium with what the load met up to there, and how it goes on."""
    extremes = met.copy()
    widen_extremes(extremes, found.F, np.zeros_like(found.F))
    return replace(found, extremes=extremes, next_step=next_step)


@dataclass(frozen=True, slots=True)
class _Newton:
    equations: EquationsOfMotion
    assembly: Assembly
    settings: MacroSettings

    def rest_at(self, factor: float, u: Array, path: Array) -> Rest | NoStress:
        """The equilibrium at `factor` by Newton from u; the law commits it.

        Newton begins anew as long as points leave their branch of the law.
        """
        found = self.balanced(factor, u)
        while isinstance(found, Switched):
            restarted = self.equations.restart_step(found.points)
            found = restarted if isinstance(restarted, NoStress) else self.balanced(factor, u)
        if isinstance(found, NoStress):
            return found
        self.equations.tally.counts["load_steps"] += factor != 0.0
        here = np.append(factor, self.equations.system.at_watched_points(found[0].u)[0])
        return self._rest(*found, np.vstack([path, here]) if factor != path[-1, 0] else path)

    def known(self, there: Mapping[str, Array], law_state: Any) -> Rest | NoStress | Switched:
        """An equilibrium that was found before, as of `Rest.to_arrays`."""
        equations, factor = self.equations, float(there["factor"])
        u = equations.system.pick(there["u"])
        y = np.concatenate([u, np.zeros(u.size)])
        start = equations.resume(factor, y, there["stress"], law_state)
        again = equations.evaluate(factor, y, tangents=True)
        if not isinstance(again, Evaluation):
            return again
        for name in _COUNTS:
            equations.tally.counts[name] = int(there[name])
        return self._rest(start, [], self.assembly.tangents(again), there["path"])

    def _rest(self, now: Evaluation, residuals: list[float], slopes: Slopes, path: Array) -> Rest:
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
            path=path,
            residuals=tuple(residuals),
            counts=self.counts(),
            next_step=0.0,
            extremes=NO_EXTREMES,
            law_state=equations.law_state,
            drags={contact.name: contact.drag(now.u) for contact in equations.system.contacts},
        )

    def gripping(self, u: Array, drags: Mapping[str, Array]) -> _Newton:
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
        """As of `Rest`."""
        return {name: self.equations.tally.counts[name] for name in _COUNTS}

    def balanced(
        self, factor: float, u: Array
    ) -> tuple[Evaluation, list[float], Slopes] | NoStress | Switched:
        """The equilibrium on one branch of the law, the residuals on the way to it, and K and C.

        Newton goes on where the equilibrium of the tissue has lost that of a point.
        """
        y = np.concatenate([u, np.zeros(u.size)])
        residuals: list[float] = []
        while True:
            now = self.equations.evaluate(factor, y, tangents=True)
            while isinstance(now, Evaluation):
                slopes = self.assembly.tangents(now)
                residuals.append(self.relative_residual(now, slopes[0]))
                if residuals[-1] <= self.settings.newton_tolerance:
                    break
                now = self.corrected(now, slopes[0], last=len(residuals) > MAX_ITERATIONS)
            else:
                return now
            start = self.equations.accept(now)
            if isinstance(start, NoStress):
                return start
            if start is now or start.response.left_bifurcation is None:
                return now, residuals, slopes
            y = now.y

    def corrected(
        self, now: Evaluation, K: Matrix, *, last: bool
    ) -> Evaluation | NoStress | Switched:
        """Newton's correction, halved until the residual is smaller and every point has a stress.

        Args:
            K: derivative of the residual.
            last: that there were corrections enough.
        """
        equations, residual = self.equations, -now.residual
        if last:
            reason = f"Newton did not converge in {MAX_ITERATIONS} iterations"
            return equations.out_of_balance(now, residual, reason)
        equations.tally.counts["factorisations"] += 1
        solve = factorised(K)
        if solve is None:
            return equations.out_of_balance(now, residual, "the stiffness is singular")
        correction = np.append(solve(residual), np.zeros(residual.size))
        size = np.linalg.norm(residual)
        fraction, reason = 1.0, "the line search found no smaller residual"
        while fraction >= _LEAST_FRACTION:
            trial = equations.evaluate(now.t, now.y - fraction * correction, tangents=True)
            if isinstance(trial, Switched):
                return trial
            if isinstance(trial, NoStress):
                reason = trial.message
            elif np.linalg.norm(trial.residual) <= (1.0 - _DECREASE * fraction) * size:
                return trial
            fraction *= 0.5
        return equations.out_of_balance(now, residual, reason)

    def relative_residual(self, now: Evaluation, K: Matrix) -> float:
        """Largest residual relative to the largest of internal force, other forces, those at
        factor 1, and the force that moves the stiffest unknown by what the tolerance allows.
        """
        full = [force.at(1.0, now.within, now.u, now.v) for force in self.equations.system.forces]
        forces = (now.internal, now.forces, *full)
        least = float(abs(K.diagonal()).max()) * self.settings.absolute_tolerance
        scale = max(least, *(abs(force).max(initial=0.0) for force in forces))
        return float(abs(now.residual).max() / scale)
