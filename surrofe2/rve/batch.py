"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.lanes import Topology, pack, put_points, unpack
from surrofe2.plant_cell.simd import TILE
from surrofe2.rve.constrained_runs import iterate
from surrofe2.rve.direct import SKIP, SOLVE, chord, newton, stress_at
from surrofe2.rve.micro_state import list_covers
from surrofe2.rve.rve_state import RveState
from surrofe2.rve.slow_manifold import follow, renew_slow
from surrofe2.rve.tangents import KINDS, affine_tangents, slow_tangents
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.stress_law import Array, Status, Tangents

if TYPE_CHECKING:
    from surrofe2.rve.rve_law import RveLaw

_SUBSTEPS = (2, 4, 8, 16)
"""Into how many parts the way from F = I is cut where Newton fails from there."""


def felt_rate(initialisation: str, F_dot: Array) -> Array:
    """The rate that particles feel while elastic or constrained-runs positions are solved for."""
    elastic = initialisation in ("elastic", "slow-manifold")
    return np.zeros_like(F_dot) if elastic else F_dot


def covered_by(unit: UnitCell, reach: float, F: Array, z: Array) -> NDArray[np.bool_]:
    """(tiles, TILE): whether contacts listed up to `reach` are all there can be."""
    covered = np.empty((len(F), TILE), dtype=np.bool_)
    list_covers(F, z, unit.position, reach, unit.cell.repulsion_cutoff, covered)
    return covered


class Batch:
    """One call of `respond`: tiles in, status and stress out; the given state is not touched."""

    def __init__(self, law: RveLaw, F: Array, F_dot: Array, state: RveState, cold: bool) -> None:
        self.law, self.unit, self.settings = law, law.unit_cell, law.settings
        self.F, self.F_dot, self.rate = F, F_dot, felt_rate(law.initialisation, F_dot)
        tiles = len(F)
        self.stress = np.full((tiles, 2, 2, TILE), np.nan)
        self.residual = np.full((tiles, 1, TILE), np.nan)
        self.status = np.zeros((tiles, TILE), dtype=np.int8)
        self.iterations = np.zeros((tiles, TILE), dtype=np.int32)
        self.newton_solves = 0
        self.before = state
        self.cold = cold
        self.state = replace(state, F=F, F_dot=F_dot, iterations=self.iterations)

    def solve(self, level: int = 0) -> None:
        """Initialise every RVE; where the list of contacts was too short, again with a longer."""
        patch, self.topology = self.unit.patches[level], self.unit.topologies[level]
        self._solve_with(self.topology)
        covered = covered_by(self.unit, patch.reach, self.F, self.state.z)
        if covered.all():
            return
        if level == len(self.unit.patches) - 1:
            self.status[~covered & (self.status == Status.OK)] = Status.LIST_TOO_SHORT
        elif not covered.any():
            self.solve(level + 1)
        else:
            self._solve_again(np.flatnonzero(~unpack(covered, self.before.points)), level + 1)

    def _solve_again(self, index: NDArray[np.intp], level: int) -> None:
        """Replace the answers of the points `index` by those with a longer list."""
        points = self.before.points
        F, F_dot = (pack(unpack(tensor, points)[index]) for tensor in (self.F, self.F_dot))
        part = Batch(self.law, F, F_dot, self.before.take(index), self.cold)
        part.solve(level)
        for name in ("stress", "residual", "status", "iterations"):
            put_points(getattr(self, name), index, getattr(part, name))
        self.state = self.state.put(index, part.state)
        self.newton_solves += part.newton_solves
        self.topology = part.topology

    def tangents(self, points: int) -> Tangents:
        """∂P/∂F and ∂P/∂Ḟ at the solution; NaN where there is none."""
        values = np.empty((len(self.F), 2, 2, 8, TILE))
        state, topology = self.state, self.topology
        constants, area = self.unit.constants, self.unit.area
        if self.law.initialisation == "slow-manifold":
            slow_tangents(
                self.F, self.F_dot, state.z, state.relaxed, topology, constants, area, values
            )
        else:
            kind = self.law.initialisation
            affine_tangents(
                self.F, self.F_dot, state.z, KINDS.index(kind), topology, constants, area, values
            )
        tangents = unpack(values, points).reshape(points, 2, 2, 2, 2, 2)
        tangents[unpack(self.status, points) != Status.OK] = np.nan
        return Tangents(tangents[:, :, :, 0].copy(), tangents[:, :, :, 1].copy())

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
        elif self.law.initialisation == "slow-manifold":
            self._follow(topology)
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
        v = np.einsum("tabl,tbpl->tapl", self.rate, before.z) + before.beyond_affine
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
        before, z = self.before, self.before.z.copy()
        self.state = replace(self.state, z=z, factors=before.factors)
        if self.cold:
            self.iterations[:] = -1
        else:
            chord(
                self.F, self.rate, z, before.F, felt_rate(self.law.initialisation, before.F_dot),
                before.factors.address, topology, self.unit.constants, self.unit.area,
                self.settings.tolerance, self.stress, self.iterations,
            )  # fmt: skip
        self._newton_where_open(topology, z)
        self.status[self.iterations < 0] = Status.NOT_CONVERGED

    def _newton_where_open(self, topology: Topology, z: Array) -> None:
        if (self.iterations < 0).any():
            self._newton(topology, self.F, self.rate, z)
        if (self.iterations < 0).any():
            self._walk(topology, z)

    def _follow(self, topology: Topology) -> None:
        """Slow manifold: warm where possible, else from a fresh elastic equilibrium."""
        before = self.before
        self.state = replace(
            self.state,
            z=before.z.copy(),
            elastic=before.relaxed.copy(),
            fluctuation=before.beyond_affine.copy(),
            factors=before.factors,
        )
        self.iterations[:] = -1
        if not self.cold:
            self._follow_from(before.F, before.F_dot, topology)
        lost = self.iterations < 0
        if not lost.any():
            return
        elastic = np.where(lost[:, None, None, :], before.relaxed, self.state.relaxed)
        self._newton_where_open(topology, elastic)
        found = lost & (self.iterations > 0) & (self.status == Status.OK)
        np.copyto(self.state.relaxed, elastic, where=lost[:, None, None, :])
        np.copyto(self.state.z, elastic, where=lost[:, None, None, :])
        stable, tiles = np.empty_like(lost), np.asarray(lost.any(axis=1))
        self.state = replace(self.state, factors=self.state.factors.renewed(tiles))
        renew_slow(
            self.F, self.state.relaxed, self.state.factors.address, tiles, topology,
            self.unit.constants, stable,
        )  # fmt: skip
        solved, stress, z = self.iterations.copy(), self.stress.copy(), self.state.z.copy()
        at_rest = np.where(lost[:, None, None, :], 0.0, self.F_dot)
        self._follow_from(self.F, at_rest, topology)
        kept = ~lost  # lanes of the same tiles that were warm stay as they were
        self.iterations[kept] = solved[kept]
        np.copyto(self.stress, stress, where=kept[:, None, None, :])
        np.copyto(self.state.z, z, where=kept[:, None, None, :])
        self.status[lost & ~found & (self.status == Status.OK)] = Status.NOT_CONVERGED
        self.status[(self.iterations < 0) & (self.status == Status.OK)] = Status.NOT_CONVERGED

    def _follow_from(self, at_F: Array, at_rate: Array, topology: Topology) -> None:
        state = self.state
        follow(
            self.F, self.F_dot, state.z, state.elastic, state.fluctuation, at_F, at_rate,
            state.factors.address, topology, self.unit.constants, self.unit.area,
            self.settings.tolerance, self.stress, self.iterations,
        )  # fmt: skip

    def _newton(self, topology: Topology, F: Array, rate: Array, z: Array) -> None:
        failed = self.iterations < 0
        self.newton_solves += int(failed.sum())
        tiles = np.asarray(failed.any(axis=1))
        factors, stable = self.state.factors.renewed(tiles), np.ones_like(failed)
        newton(
            F, rate, z, factors.address, np.where(tiles, SOLVE, SKIP).astype(np.int8), topology,
            self.unit.constants, self.unit.area, self.settings.tolerance, self.stress,
            self.iterations, stable,
        )  # fmt: skip
        self.status[failed & ~stable] = Status.UNSTABLE
        self.state = replace(self.state, factors=factors)

    def _walk(self, topology: Topology, z_found: Array) -> None:
        """Reach points that Newton misses in growing numbers of steps from F = I."""
        for substeps in _SUBSTEPS:
            failed = self.iterations < 0
            z = z_found.copy()
            z[:] = np.where(failed[:, None, None, :], self.unit.position.T[..., None], z)
            for part in np.arange(1, substeps + 1) / substeps:
                F = part * self.F + (1.0 - part) * np.eye(2)[..., None]
                self.iterations[failed] = -1
                self._newton(topology, F, part * self.rate, z)
                failed &= self.iterations > 0
            if failed.any():
                np.copyto(z_found, z, where=failed[:, None, None, :])
            if not (self.iterations < 0).any():
                return
