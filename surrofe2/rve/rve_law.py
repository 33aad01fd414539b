"""The stress law of a tissue of plant cells: an RVE behind every point."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.lanes import Topology, pack, unpack
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.simd import TILE
from surrofe2.rve.constrained_runs import iterate
from surrofe2.rve.direct import chord, newton, renew, stress_at
from surrofe2.rve.micro_state import list_covers
from surrofe2.rve.rve_state import RveState, rest_state
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.unit_cell import make_unit_cell
from surrofe2.stress_law import Acceptance, Array, Status, StressResponse, check_deformation

_RENEW_AFTER = 4
"""Force evaluations of a warm solve above which `accept` refactorises."""
_SUBSTEPS = (2, 4, 8, 16)
"""Into how many parts the way from F = I is cut where Newton fails from there."""


class RveLaw:
    """σ(F, Ḟ) of periodic cells put into the state they would have in a tissue (section 5).

    Args:
        cell: parameters of the plant cell.
        initialisation: "cauchy-born" (eq. 64), "elastic" (65 to 67) or "constrained-runs"
            (69 to 72).
        solver: "direct" (Newton on the fixed point, model.md) or "iterated" (the paper's).
        settings: tolerances, see `RveSettings`; any of its fields also as a keyword.

    Attributes:
        rest_length: wall rest length l₀ that frees the undeformed cell of stress, µm.

    Raises:
        InputError: unknown names, or parameters without a stress-free stable reference.
    """

    def __init__(
        self,
        cell: CellParameters,
        initialisation: str = "constrained-runs",
        solver: str = "direct",
        **settings: Any,
    ) -> None:
        try:
            self.settings = RveSettings(initialisation=initialisation, solver=solver, **settings)
        except TypeError:
            known = ", ".join(sorted(RveSettings.__dataclass_fields__))
            raise InputError(
                f"rve: unknown setting among {', '.join(sorted(settings))}; known are {known}"
            ) from None
        self.cell = cell
        self._unit = make_unit_cell(cell)

    @classmethod
    def from_settings(cls, cell: CellParameters, settings: RveSettings) -> RveLaw:
        """The law with settings made elsewhere."""
        law = cls(cell)
        law.settings = settings
        return law

    @property
    def rest_length(self) -> float:
        """Wall rest length l₀, µm."""
        return self._unit.rest_length

    @property
    def density(self) -> float:
        """Macroscopic density, ng/µm²."""
        return self.cell.density

    @property
    def initialisation(self) -> str:
        """How the RVE is put into its state."""
        return self.settings.initialisation

    @property
    def solver(self) -> str:
        """How the micro problem is solved."""
        return self.settings.solver

    @property
    def reference_position(self) -> NDArray[np.float64]:
        """(particles, 2) relaxed reference positions, walls first, µm."""
        return self._unit.position.copy()

    def rest_state(self, points: int) -> RveState:
        """State of n RVEs at F = I, to warm-start from."""
        return rest_state(self._unit, points)

    def respond(self, F: Any, F_dot: Any, state: RveState | None = None) -> StressResponse:
        """Cauchy stress at n points by one RVE each; see `StressLaw.respond`."""
        F, F_dot = check_deformation(F, F_dot)
        points = len(F)
        if points == 0:
            return StressResponse(np.empty((0, 2, 2)), np.empty(0, np.int8), state, {})
        cold = state is None
        if cold:
            state = self.rest_state(points)
        elif not isinstance(state, RveState) or state.points != points:
            raise InputError(
                f"state: not a state of an RveLaw for {points} points; pass what an earlier "
                "answer for the same points carried, or None"
            )
        batch = _Batch(self, pack(F), pack(F_dot), state, cold)
        batch.solve()
        status = unpack(batch.status, points)
        stress = unpack(batch.stress, points)
        stress[status != Status.OK] = np.nan
        return StressResponse(stress, status, batch.state, batch.effort(points))

    def accept(self, F: Any, F_dot: Any, response: StressResponse) -> Acceptance:
        """Check stability (elastic Hessian, dashpots off) and renew tired factorisations."""
        state = response.state
        if self.initialisation == "cauchy-born" or self.solver == "iterated":
            return Acceptance(response.status, state)
        tired = (state.iterations > _RENEW_AFTER).any(axis=1)
        lu, slopes = state.lu, state.slopes
        if tired.any():
            lu, slopes = lu.copy(), slopes.copy()
        stable = np.empty((len(lu), TILE), dtype=np.bool_)
        renew(
            state.F, self._rate(state.F_dot), state.z, lu, slopes, tired, self._unit.topologies[0],
            self._unit.constants, stable,
        )  # fmt: skip
        status = response.status.copy()
        status[~unpack(stable, state.points) & (status == Status.OK)] = Status.UNSTABLE
        return Acceptance(status, replace(state, lu=lu, slopes=slopes))

    def _rate(self, F_dot: Array) -> Array:
        """The rate that particles feel while they are solved for."""
        return np.zeros_like(F_dot) if self.initialisation == "elastic" else F_dot


class _Batch:
    """One call of `respond`: tiles in, status and stress out; the given state is not touched."""

    def __init__(self, law: RveLaw, F: Array, F_dot: Array, state: RveState, cold: bool) -> None:
        self.law, self.unit, self.settings = law, law._unit, law.settings
        self.F, self.F_dot, self.rate = F, F_dot, law._rate(F_dot)
        tiles = len(F)
        self.stress = np.full((tiles, 2, 2, TILE), np.nan)
        self.residual = np.full((tiles, 1, TILE), np.nan)
        self.status = np.zeros((tiles, TILE), dtype=np.int8)
        self.iterations = np.zeros((tiles, TILE), dtype=np.int32)
        self.newton_solves = 0
        self.before = state
        self.cold = cold
        self.state = replace(state, z=state.z.copy(), F=F, F_dot=F_dot, iterations=self.iterations)

    def solve(self) -> None:
        """Initialise every RVE, then make sure that its list of contacts was long enough."""
        for reach, topology in zip(
            (p.reach for p in self.unit.patches), self.unit.topologies, strict=True
        ):
            self._solve_with(topology)
            covered = np.empty_like(self.status, dtype=np.bool_)
            list_covers(
                self.F, self.state.z, self.unit.position, reach, self.law.cell.repulsion_cutoff,
                covered,
            )  # fmt: skip
            if (covered | (self.status != Status.OK)).all():
                return
            self.status[~covered] = Status.LIST_TOO_SHORT

    def effort(self, points: int) -> dict[str, int]:
        """Summable counts of what the answer cost."""
        return {
            "rve_solves": points,
            "force_evaluations": int(np.abs(unpack(self.iterations, points)).sum()),
            "newton_solves": self.newton_solves,
        }

    def _solve_with(self, topology: Topology) -> None:
        self.status[:] = Status.OK
        if self.law.initialisation == "cauchy-born":
            self._evaluate(topology)
        elif self.law.solver == "iterated":
            self._iterate(topology)
        else:
            self._solve_directly(topology)
            if self.law.initialisation == "elastic":
                self._evaluate(topology)

    def _evaluate(self, topology: Topology) -> None:
        """Stress at z with velocities L x (eqs. 64, 67)."""
        stress_at(
            self.F, self.F_dot, self.state.z, topology, self.unit.constants, self.unit.area,
            self.stress, self.residual,
        )  # fmt: skip

    def _iterate(self, topology: Topology) -> None:
        """The paper's iteration from the last state, carried along by the incremental F."""
        before = self.before
        x = np.einsum("tabl,tbpl->tapl", self.F, before.z)
        v = np.einsum("tabl,tbpl->tapl", self.rate, before.z) + before.fluctuation
        iterate(
            self.F, self.rate, x, v, self.unit.patches[0].mass, topology, self.unit.constants,
            self.unit.area, self.settings.micro_step, self.settings.stop,
            self.settings.max_iterations, self.stress, self.residual, self.iterations,
        )  # fmt: skip
        self.status[self.iterations < 0] = Status.NOT_CONVERGED
        lanes = np.moveaxis(self.F, -1, 1)
        z = np.moveaxis(np.linalg.solve(lanes, np.moveaxis(x, -1, 1)), 1, -1)
        fluctuation = v - np.einsum("tabl,tbpl->tapl", self.rate, z)
        self.state = replace(self.state, z=np.ascontiguousarray(z), fluctuation=fluctuation)
        if self.law.initialisation == "elastic":
            self._evaluate(topology)

    def _solve_directly(self, topology: Topology) -> None:
        before, constants, area = self.before, self.unit.constants, self.unit.area
        self.state.z[:] = before.z
        if self.cold:
            self.iterations[:] = -1
        else:
            chord(
                self.F, self.rate, self.state.z, before.F, self.law._rate(before.F_dot),
                before.lu, before.slopes, topology, constants, area, self.settings.tolerance,
                self.stress, self.iterations,
            )  # fmt: skip
        if (self.iterations < 0).any():
            self._newton(topology, self.F, self.rate, self.state.z)
        if (self.iterations < 0).any():
            self._walk(topology)
        self.status[self.iterations < 0] = Status.NOT_CONVERGED

    def _newton(self, topology: Topology, F: Array, rate: Array, z: Array) -> None:
        failed = self.iterations < 0
        self.newton_solves += int(failed.sum())
        lu, slopes = self.state.lu.copy(), self.state.slopes.copy()
        stable = np.ones_like(failed)
        newton(
            F, rate, z, lu, slopes, failed.any(axis=1), topology, self.unit.constants,
            self.unit.area, self.settings.tolerance, self.stress, self.iterations, stable,
        )  # fmt: skip
        self.status[failed & ~stable] = Status.UNSTABLE
        self.state = replace(self.state, lu=lu, slopes=slopes)

    def _walk(self, topology: Topology) -> None:
        """Reach points that Newton misses in growing numbers of steps from F = I."""
        for substeps in _SUBSTEPS:
            failed = self.iterations < 0
            z = self.state.z.copy()
            z[:] = np.where(failed[:, None, None, :], self.unit.position.T[..., None], z)
            for part in np.arange(1, substeps + 1) / substeps:
                F = part * self.F + (1.0 - part) * np.eye(2)[..., None]
                self.iterations[failed] = -1
                self._newton(topology, F, part * self.rate, z)
                failed &= self.iterations > 0
            if failed.any():
                np.copyto(self.state.z, z, where=failed[:, None, None, :])
            if not (self.iterations < 0).any():
                return
