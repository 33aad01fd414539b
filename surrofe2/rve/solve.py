"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import one_blas_thread
from surrofe2.base.simd import TILE
from surrofe2.law.stress_law import Array, Status, Tangents
from surrofe2.plant_cell.tiles import pack, put_points, unpack
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.continuation import Continuation, Followed, Path, is_far
from surrofe2.rve.newton import SKIP, SOLVE, chord, newton
from surrofe2.rve.particle_state import Drive, empty_answer, list_covers, pairs_apart, stress_at
from surrofe2.rve.rve_state import RveState, with_copies
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.tangents import KINDS, affine_tangents
from surrofe2.rve.unit_cell import UnitCell, relax

_NEAR = 0.01  # |F − I| up to which the reference's own factors are tried at a cold start
_OK = int(Status.OK)  # a member of an enumeration takes a microsecond to look up


Paths = tuple[NDArray[np.intp], Path] | None
"""Points, and how far they have come."""


def dashpot_rate(initialisation: str, F_dot: Array) -> Array:
    """The rate that particles feel while elastic or constrained-runs positions are solved for."""
    elastic = initialisation in ("elastic", "slow-manifold")
    return np.zeros_like(F_dot) if elastic else F_dot


def covered_by(unit: UnitCell, level: int, F: Array, z: Array) -> NDArray[np.bool_]:
    """(tiles, TILE): whether the contacts that list `level` holds are all there can be.

    First by the bound of `list_covers`; where that is too coarse, the pairs up to a longer reach
    that the list leaves out are looked at one by one.
    """
    patch, cutoff, position = unit.patches[level], unit.constants.cutoff, unit.reference.position
    covered = np.empty((len(F), TILE), dtype=np.bool_)
    list_covers(F, z, position, patch.reach, cutoff, covered)
    if covered.all():
        return covered
    farther, apart, unlisted = np.empty_like(covered), np.empty_like(covered), patch.unlisted
    list_covers(F, z, position, unlisted.reach, cutoff, farther)
    pairs_apart(F, z, unlisted.pairs, unlisted.offset, cutoff, apart)
    return covered | (farther & apart)


def solve_rves(
    kind: type[Solution],
    unit: UnitCell,
    settings: RveSettings,
    drive: Drive,
    before: RveState,
    cold: bool,
    level: int = 0,
    earlier: Paths = None,
) -> Solution:
    """Initialise every RVE; where the list of contacts was too short, again with a longer.

    Args:
        kind: as `slow_solution.solution_kind` says.
        drive: F and Ḟ in tiles.
        before: where to start from; it is not touched. It need not be near if `cold`, which makes
            new factors.
        level: which of the unit's lists of contacts to take first.
        earlier: how far points have come by shorter lists.
    """
    solution = kind(unit, settings, drive, before, cold, level, earlier)
    solution.solve()
    covered = covered_by(unit, level, drive.F, solution.state.z) | solution.lost
    covered &= ~solution.needs_longer_list
    if covered.all():
        return solution
    if level == len(unit.patches) - 1:
        solution.status[~covered & (solution.status == _OK)] = Status.LIST_TOO_SHORT
        return solution
    index = np.flatnonzero(~unpack(covered, before.points))
    part_drive = Drive(*(pack(unpack(tensor, before.points)[index]) for tensor in drive))
    paths = solution.paths_of(index)
    part = solve_rves(kind, unit, settings, part_drive, before.take(index), cold, level + 1, paths)
    if len(index) == before.points:
        part.newton_solves += solution.newton_solves
        return part
    solution.put(index, part)
    return solution


class Solution:
    """What was found for the points of `before` at `drive`, with one list of contacts.

    Attributes:
        answer: stress, nothing where the status is not OK.
        status: (tiles, TILE) codes of `Status`.
        state: the warm start for the next call.
        needs_longer_list: (tiles, TILE) points whose path ended where this list of contacts is too
            short.
        lost: (tiles, TILE) points whose path ended without a stress, whatever the list.
        newton_solves: how many points needed Newton's method.
    """

    def __init__(
        self,
        unit: UnitCell,
        settings: RveSettings,
        drive: Drive,
        before: RveState,
        cold: bool,
        level: int,
        earlier: Paths,
    ) -> None:
        self.unit, self.settings, self.initialisation = unit, settings, settings.initialisation
        self.given = drive
        self.drive = Drive(drive.F, dashpot_rate(self.initialisation, drive.rate))
        self.before, self.cold, self.level, self.paths = before, cold, level, earlier
        self.law = unit.patches[level].topology, unit.constants
        self.answer = empty_answer(len(drive.F))
        self.status = np.zeros(self.answer.iterations.shape, dtype=np.int8)
        self.needs_longer_list = np.zeros_like(self.status, dtype=np.bool_)
        self.lost = np.zeros_like(self.needs_longer_list)
        self.newton_solves = 0
        self.state = replace(
            before,
            F=drive.F,
            F_dot=drive.rate,
            iterations=self.answer.iterations,
            is_checked=cold,
        )

    def paths_of(self, index: NDArray[np.intp]) -> Paths:
        """How far the points `index` have come, numbered by their places in it."""
        if self.paths is None:
            return None
        followed, path = self.paths
        _, place, row = np.intersect1d(index, followed, return_indices=True)
        return place, path.take(row)

    def put(self, index: NDArray[np.intp], part: Solution) -> None:
        """Replace what was found at the points `index`; tangents are then by the longer list."""
        put_points(self.answer.stress, index, part.answer.stress)
        put_points(self.answer.residual, index, part.answer.residual)
        put_points(self.answer.iterations, index, part.answer.iterations)
        put_points(self.status, index, part.status)
        self.state = self.state.put(index, part.state)
        self.newton_solves += part.newton_solves
        self.law = part.law

    def tangents(self) -> Tangents:
        """∂P/∂F and ∂P/∂Ḟ at the solution; NaN where there is none."""
        points = self.before.points
        values = self._all_tangents()
        tangents = unpack(values, points).reshape(points, 2, 2, 2, 2, 2)
        tangents[unpack(self.status, points) != _OK] = np.nan
        return Tangents(tangents[:, :, :, 0].copy(), tangents[:, :, :, 1].copy())

    def _all_tangents(self) -> Array:
        """(tiles, 2, 2, 8, TILE), whether there is a solution or not."""
        values = np.empty((len(self.status), 2, 2, 8, TILE))
        kind = KINDS.index(self.initialisation)
        affine_tangents(self.given, self.state.z, kind, *self.law, values)
        return values

    def effort(self) -> dict[str, int]:
        """Summable counts of what the answer cost."""
        points, newly_left = self.before.points, self.state.left & ~self.before.left
        return {
            "rve_solves": points,
            "force_evaluations": int(np.abs(unpack(self.answer.iterations, points)).sum()),
            "newton_solves": self.newton_solves,
            "left_bifurcation": int(unpack(newly_left, points).sum()),
        }

    def solve(self) -> None:
        """Initialise every RVE with the list of contacts at hand."""
        if self.initialisation == "cauchy-born":
            self._evaluate()
        elif self.settings.solver == "iterated":
            self._iterate()
        else:
            self._solve_directly()
            if self.initialisation == "elastic":
                self._evaluate()

    def _evaluate(self) -> None:
        """Stress at z with velocities L x (eqs. 64, 67)."""
        stress_at(self.given, self.state.z, *self.law, self.answer)

    def _iterate(self) -> None:
        """The paper's iteration from the last state, carried along by the incremental F."""
        before, settings, (F, rate) = self.before, self.settings, self.drive
        x = np.einsum("tabl,tbpl->tapl", F, before.z)
        v = np.einsum("tabl,tbpl->tapl", rate, before.z) + before.beyond_affine
        stepping = Stepping(settings.micro_step, settings.stop, settings.max_iterations)
        iterate(self.drive, x, v, self.unit.patches[0].mass, *self.law, stepping, self.answer)
        self.status[self.answer.iterations < 0] = Status.NOT_CONVERGED
        lanes = np.moveaxis(F, -1, 1)
        z = np.moveaxis(np.linalg.solve(lanes, np.moveaxis(x, -1, 1)), 1, -1)
        fluctuation = v - np.einsum("tabl,tbpl->tapl", rate, z)
        self.state = replace(self.state, z=np.ascontiguousarray(z), fluctuation=fluctuation)
        if self.initialisation == "elastic":
            self._evaluate()

    def _solve_directly(self) -> None:
        before, z, iterations = self.before, self.before.z.copy(), self.answer.iterations
        self.state = replace(self.state, z=z)
        if self.cold:
            # −1, as where `chord` failed: such a point is left to Newton's method
            iterations[np.abs(self.drive.F - before.F).max(axis=(1, 2)) > _NEAR] = -1
        at = Drive(before.F, dashpot_rate(self.initialisation, before.F_dot))
        tolerance = self.settings.tolerance
        chord(self.drive, z, at, before.factors.address, *self.law, tolerance, self.answer)
        if self.cold or (iterations < 0).any():
            self._newton_where_open(z, before.z)
            self.status[(iterations < 0) & (self.status == _OK)] = Status.NOT_CONVERGED

    def _newton_where_open(self, z: Array, z_before: Array) -> None:
        iterations, far = self.answer.iterations, np.zeros_like(self.needs_longer_list)
        if self.cold:
            far = is_far(self.drive.F)
        iterations[far] = 1  # looks solved, so that Newton's method passes it over
        self._newton(z, renewed=self.cold)
        iterations[far] = -1  # open again: the path has to lead there
        astray = (iterations < 0) | (self.status == Status.UNSTABLE)
        if astray.any():
            self._follow(z, z_before, astray)

    def _newton(self, z: Array, renewed: bool = False) -> None:
        """Solve where `chord` did not; check stability there, or everywhere with new factors."""
        failed = self.answer.iterations < 0
        self.newton_solves += int(failed.sum())
        tiles = np.asarray(failed.any(axis=1)) | renewed
        factors = self.state.factors.renewed(tiles)
        task = np.where(tiles, SOLVE, SKIP).astype(np.int8)
        address, tolerance = factors.address, self.settings.tolerance
        self.answer.stable[:] = True
        newton(self.drive, z, address, task, *self.law, tolerance, self.answer)
        self.status[(failed | renewed) & ~self.answer.stable] = Status.UNSTABLE
        self.state = replace(self.state, factors=factors)

    def _follow(self, z_found: Array, z_before: Array, astray: NDArray[np.bool_]) -> None:
        """Follow points that Newton's method misses, or finds unstable, from where they were."""
        F, points = self.drive.F, self.before.points
        index = np.flatnonzero(unpack(astray, points))
        path = Path.between(*(unpack(each, points)[index] for each in (self.before.F, F, z_before)))
        if self.paths is not None:
            _, here, there = np.intersect1d(index, self.paths[0], return_indices=True)
            path.put(here, self.paths[1].take(there))
        self.paths = index, path
        with one_blas_thread():
            followed = Continuation(self.unit, self.settings.tolerance).follow(path)
        self.newton_solves += followed.newton_solves
        self._take_over(index, path, followed, z_found)
        self._at_rate(index, z_found)

    def _take_over(
        self, index: NDArray[np.intp], path: Path, followed: Followed, z_found: Array
    ) -> None:
        """Replace what was found at the points `index`, and the copies that fill up a tile."""
        arrived = followed.arrived
        codes = np.where(followed.unstable, Status.UNSTABLE, Status.NOT_CONVERGED)
        points, row = with_copies(index, self.before.points)
        put_points(self.answer.iterations, points, pack(np.where(arrived, 1, -1)[row]))
        put_points(self.status, points, pack(np.where(arrived, _OK, codes)[row]))
        put_points(self.lost, points, pack(~arrived[row]))
        if path.left.any():
            left = unpack(self.state.left, self.status.size).copy()
            left[points] |= path.left[row]
            self.state = replace(self.state, left=pack(left))
        there = np.flatnonzero(arrived)
        if self.level < len(self.unit.patches) - 1:
            covered = covered_by(self.unit, self.level, pack(path.end), pack(path.z))
            listed = unpack(covered, len(index))
            put_points(self.needs_longer_list, points, pack((arrived & ~listed)[row]))
            there = np.flatnonzero(arrived & listed)
        if not len(there):
            return
        solved = relax(*self.law, path.z[there], path.end[there], self.settings.tolerance)
        points, row = with_copies(index[there], self.before.points)
        put_points(z_found, points, pack(solved.z[row]))
        put_points(self.answer.stress, points, pack(solved.stress[row]))
        put_points(self.answer.iterations, points, pack(solved.iterations[row]))
        factors = self.state.factors.put(points, solved.factors.take(row))
        self.state = replace(self.state, factors=factors)

    def _at_rate(self, index: NDArray[np.intp], z: Array) -> None:
        """From elastic equilibria at the points `index` to those with dashpots on.

        Such a point is as stable as the elastic equilibrium beside it.
        """
        followed = np.zeros(self.before.points, dtype=np.bool_)
        followed[index] = True
        iterations = self.answer.iterations
        arrived = pack(followed) & (self.status == _OK) & (iterations > 0)
        if arrived.any() and self.drive.rate.any():
            iterations[arrived] = -1
            status = self.status.copy()
            self._newton(z)
            self.status[:] = status
