"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import pack, put_points, unpack
from surrofe2.rve.constrained_runs import iterate
from surrofe2.rve.continuation import Walked, Walker, has_room, is_far
from surrofe2.rve.newton import SKIP, SOLVE, chord, newton, solve_tiles, stress_at
from surrofe2.rve.rve_state import RveState, flags, with_copies
from surrofe2.rve.slow_manifold import follow, newton_slow, renew_slow
from surrofe2.rve.systems import AnyTopology
from surrofe2.rve.tangents import KINDS, affine_tangents, slow_tangents
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.simd import TILE
from surrofe2.stress_law import Array, Status, Tangents

if TYPE_CHECKING:
    from surrofe2.rve.rve_law import RveLaw

_NEAR = 0.01  # |F − I| up to which the reference's own factors are tried at a cold start
_OK = int(Status.OK)  # a member of an enumeration takes a microsecond to look up


def felt_rate(initialisation: str, F_dot: Array) -> Array:
    """The rate that particles feel while elastic or constrained-runs positions are solved for."""
    elastic = initialisation in ("elastic", "slow-manifold")
    return np.zeros_like(F_dot) if elastic else F_dot


def covered_by(unit: UnitCell, level: int, F: Array, z: Array) -> NDArray[np.bool_]:
    """(tiles, TILE): whether the contacts that list `level` holds are all there can be."""
    return unit.covered(level, F, z)


class Batch:
    """One call of `respond`: tiles in, status and stress out; the given state is not touched."""

    def __init__(self, law: RveLaw, F: Array, F_dot: Array, state: RveState, cold: bool) -> None:
        self.law, self.unit, self.settings = law, law.unit_cell, law.settings
        self.F, self.F_dot, self.rate = F, F_dot, felt_rate(law.initialisation, F_dot)
        tiles = len(F)
        self.stress = np.empty((tiles, 2, 2, TILE))  # nothing where the status is not OK
        self.residual = np.empty((tiles, 1, TILE))
        self.status = np.zeros((tiles, TILE), dtype=np.int8)
        self.iterations = np.zeros((tiles, TILE), dtype=np.int32)
        self.newton_solves = 0
        self.before = state
        self.cold = cold
        self.state = replace(state, F=F, F_dot=F_dot, iterations=self.iterations, is_checked=cold)

    def solve(self, level: int = 0) -> None:
        """Initialise every RVE; where the list of contacts was too short, again with a longer."""
        self.topology = self.unit.topologies[level]
        self.level, self.held_up = level, np.zeros_like(self.status, dtype=np.bool_)
        self._solve_with(self.topology)
        covered = covered_by(self.unit, level, self.F, self.state.z) & ~self.held_up
        if covered.all():
            return
        if level == len(self.unit.patches) - 1:
            self.status[~covered & (self.status == _OK)] = Status.LIST_TOO_SHORT
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
        tangents[unpack(self.status, points) != _OK] = np.nan
        return Tangents(tangents[:, :, :, 0].copy(), tangents[:, :, :, 1].copy())

    def effort(self, points: int) -> dict[str, int]:
        """Summable counts of what the answer cost."""
        return {
            "rve_solves": points,
            "force_evaluations": int(np.abs(unpack(self.iterations, points)).sum()),
            "newton_solves": self.newton_solves,
            "left_bifurcation": self._newly_left(points),
        }

    def _newly_left(self, points: int) -> int:
        """How many points left a branch in this call."""
        left, before = self.state.left, self.before.left
        if left is None or left is before:
            return 0
        return int(unpack(left if before is None else left & ~before, points).sum())

    def _solve_with(self, topology: AnyTopology) -> None:
        self.status[:] = _OK
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

    def _evaluate(self, topology: AnyTopology) -> None:
        """Stress at z with velocities L x (eqs. 64, 67)."""
        stress_at(
            self.F, self.F_dot, self.state.z, topology, self.unit.constants, self.unit.area,
            self.stress, self.residual,
        )  # fmt: skip

    def _iterate(self, topology: AnyTopology) -> None:
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

    def _solve_directly(self, topology: AnyTopology) -> None:
        before, z = self.before, self.before.z.copy()
        self.state = replace(self.state, z=z, factors=before.factors)
        self.iterations[:] = 0
        if self.cold:
            self.iterations[np.abs(self.F - before.F).max(axis=(1, 2)) > _NEAR] = -1
        solve_tiles(
            chord, self.F, self.rate, z, before.F,
            felt_rate(self.law.initialisation, before.F_dot), before.factors.address,
            topology, self.unit.constants, self.unit.area, self.settings.tolerance,
            self.stress, self.iterations,
        )  # fmt: skip
        if self.cold or (self.iterations < 0).any():
            self._newton_where_open(topology, z, before.z)
            self.status[(self.iterations < 0) & (self.status == _OK)] = Status.NOT_CONVERGED

    def _newton_where_open(self, topology: AnyTopology, z: Array, z_before: Array) -> None:
        self._newton(topology, self.F, self.rate, z, renewed=self.cold)
        astray = (self.iterations < 0) | (self.status == Status.UNSTABLE)
        if self.cold:
            astray |= is_far(self.F)
        if astray.any():
            self._walk(topology, z, z_before, astray)

    def _follow(self, topology: AnyTopology) -> None:
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
        self._newton_where_open(topology, elastic, before.relaxed)
        found = lost & (self.iterations > 0) & (self.status == _OK)
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
        self._newton_slow(topology, lost & found & (self.iterations < 0))
        kept = ~lost  # lanes of the same tiles that were warm stay as they were
        self.iterations[kept] = solved[kept]
        np.copyto(self.stress, stress, where=kept[:, None, None, :])
        np.copyto(self.state.z, z, where=kept[:, None, None, :])
        self.status[lost & ~found & (self.status == _OK)] = Status.NOT_CONVERGED
        self.status[(self.iterations < 0) & (self.status == _OK)] = Status.NOT_CONVERGED

    def _follow_from(self, at_F: Array, at_rate: Array, topology: AnyTopology) -> None:
        state = self.state
        follow(
            self.F, self.F_dot, state.z, state.elastic, state.fluctuation, at_F, at_rate,
            state.factors.address, topology, self.unit.constants, self.unit.area,
            self.settings.tolerance, self.stress, self.iterations,
        )  # fmt: skip

    def _newton_slow(self, topology: AnyTopology, soft: NDArray[np.bool_]) -> None:
        """Where z_el is stable but so soft that `follow` misses z."""
        if not soft.any():
            return
        state, counts = self.state, np.where(soft, 0, 1).astype(np.int32)
        newton_slow(
            self.F, self.F_dot, state.z, state.elastic, state.fluctuation, topology,
            self.unit.constants, self.unit.area, self.settings.tolerance, self.stress, counts,
        )  # fmt: skip
        self.iterations[soft] = counts[soft]

    def _newton(
        self, topology: AnyTopology, F: Array, rate: Array, z: Array, renewed: bool = False
    ) -> None:
        """Solve where `chord` did not; check stability there, or everywhere with new factors."""
        failed = self.iterations < 0
        self.newton_solves += int(failed.sum())
        tiles = np.asarray(failed.any(axis=1)) | renewed
        factors, stable = self.state.factors.renewed(tiles), np.ones_like(failed)
        task = np.where(tiles, SOLVE, SKIP).astype(np.int8)
        solve_tiles(
            newton, F, rate, z, factors.address, task, topology, self.unit.constants,
            self.unit.area, self.settings.tolerance, self.stress, self.iterations, stable,
        )  # fmt: skip
        self.status[(failed | renewed) & ~stable] = Status.UNSTABLE
        self.state = replace(self.state, factors=factors)

    def _walk(
        self, topology: AnyTopology, z_found: Array, z_before: Array, astray: NDArray[np.bool_]
    ) -> None:
        """Follow points that Newton's method misses, or finds unstable, from where they were."""
        if self.level < len(self.unit.patches) - 1:
            self.held_up = astray & ~has_room(self.unit, self.level, self.F, z_before)
        index = np.flatnonzero(unpack(astray & ~self.held_up, self.before.points))
        if not len(index):
            return
        start, end, z = (
            unpack(values, self.before.points)[index]
            for values in (self.before.F, self.F, z_before)
        )
        walked = Walker(self.unit, topology, self.settings.tolerance).walk(start, end, z)
        self.newton_solves += walked.newton_solves
        self._take_over(index, walked, z_found)
        self._at_rate(topology, index, z_found)

    def _take_over(self, index: NDArray[np.intp], walked: Walked, z_found: Array) -> None:
        """Replace what was found at the points `index`, and the copies that fill up a tile."""
        index, row = with_copies(index, self.before.points)
        lost = np.where(walked.unstable, Status.UNSTABLE, Status.NOT_CONVERGED)
        for mine, new in (
            (z_found, walked.solved.z),
            (self.stress, walked.solved.stress),
            (self.iterations, np.where(walked.arrived, walked.solved.iterations, -1)),
            (self.status, np.where(walked.arrived, _OK, lost)),
        ):
            put_points(mine, index, pack(new[row]))
        factors = self.state.factors.put(index, walked.solved.factors.take(row))
        self.state = replace(self.state, factors=factors)
        if walked.left.any():
            left = unpack(flags(self.state), self.status.size)
            left[index] |= walked.left[row]
            self.state = replace(self.state, left=pack(left))

    def _at_rate(self, topology: AnyTopology, index: NDArray[np.intp], z: Array) -> None:
        """From elastic equilibria at the points `index` to those with dashpots on.

        Such a point is as stable as the elastic equilibrium beside it.
        """
        walked = np.zeros(self.before.points, dtype=np.bool_)
        walked[index] = True
        arrived = pack(walked) & (self.status == _OK) & (self.iterations > 0)
        if arrived.any() and self.rate.any():
            self.iterations[arrived] = -1
            status = self.status.copy()
            self._newton(topology, self.F, self.rate, z)
            self.status[:] = status
