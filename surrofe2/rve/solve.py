"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import one_blas_thread
from surrofe2.base.simd import TILE
from surrofe2.law.stress_law import Array, Status, Tangents
from surrofe2.plant_cell.neighbours import Near
from surrofe2.plant_cell.tiles import Constants, Topology, pack, put_points, unpack
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.continuation import Continuation, Path, is_far
from surrofe2.rve.newton import SKIP, SOLVE, chord, newton
from surrofe2.rve.particle_state import Answer, Drive, empty_answer, stress_at
from surrofe2.rve.rve_state import RveState, with_copies
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.slow_manifold import Moving, follow, newton_slow, renew_slow
from surrofe2.rve.tangents import KINDS, affine_tangents, slow_tangents
from surrofe2.rve.unit_cell import UnitCell, relax

Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

_NEAR = 0.01  # |F − I| up to which the reference's own factors are tried at a cold start
_OK = int(Status.OK)  # a member of an enumeration takes a microsecond to look up
OPEN, PASSED_OVER = -1, 1
"""Counts of iterations: solvers take up a lane that has 0 or OPEN, and pass over one above 0."""


def dashpot_rate(initialisation: str, F_dot: Array) -> Array:
    """The rate that particles feel while elastic or constrained-runs positions are solved for."""
    elastic = initialisation in ("elastic", "slow-manifold")
    return np.zeros_like(F_dot) if elastic else F_dot


@dataclass(slots=True, eq=False)
class Solved:
    """What is known of the points of a call; the functions of this file fill it in.

    Attributes:
        drive: F and Ḟ in tiles. start: where to begin; it is not touched.
        cold: whether to make new factors; `start` need not be near then.
        near: the contacts that are solved with.
        covered: (tiles, TILE) whether earlier lists, if there were any, had all contacts that act.
        answer: stress, nothing where the status is not OK, and force evaluations.
        status: (tiles, TILE) codes of `Status`.
        state: the warm start for the next call.
        newton_solves: how many points needed Newton's method.
    """

    unit: UnitCell
    settings: RveSettings
    drive: Drive
    start: RveState
    cold: bool
    near: Near
    covered: Flags
    answer: Answer
    status: NDArray[np.int8]
    state: RveState
    newton_solves: int = 0

    @classmethod
    def unsolved(
        cls, unit: UnitCell, settings: RveSettings, drive: Drive, start: RveState, cold: bool,
        near: Near,
    ) -> Solved:  # fmt: skip
        """Nothing known yet."""
        answer = empty_answer(len(drive.F))
        state = replace(
            start,
            z=start.z.copy(),
            F=drive.F,
            F_dot=drive.rate,
            near=near,
            iterations=answer.iterations,
            is_checked=cold,
        )
        status = np.zeros(answer.iterations.shape, dtype=np.int8)
        covered = np.ones(status.shape, dtype=np.bool_)
        return cls(unit, settings, drive, start, cold, near, covered, answer, status, state)

    @property
    def law(self) -> tuple[Topology, Constants]:
        """What kernels need to compute forces."""
        return self.near.topology, self.unit.constants

    @property
    def felt(self) -> Drive:
        """F, and the rate at which positions are solved for."""
        return Drive(self.drive.F, dashpot_rate(self.settings.initialisation, self.drive.rate))

    def at(self, index: Index, *, cold: bool) -> Solved:
        """The points `index` alone, unsolved."""
        points = self.start.points
        drive = Drive(*(pack(unpack(tensor, points)[index]) for tensor in self.drive))
        near, start = self.near.take(index, points), self.start.take(index)
        return Solved.unsolved(self.unit, self.settings, drive, start, cold, near)

    def put(self, index: Index, part: Solved) -> None:
        """Take over what was found at the points `index`."""
        self.covered = self.has_all_contacts()
        put_points(self.covered, index, part.has_all_contacts())
        put_points(self.answer.stress, index, part.answer.stress)
        put_points(self.answer.residual, index, part.answer.residual)
        put_points(self.status, index, part.status)
        self.state = self.state.put(index, part.state)
        self.answer = self.answer._replace(iterations=self.state.iterations)
        self.newton_solves += part.newton_solves
        if part.near.topology is not self.near.topology:
            self.near = self.unit.neighbours.near(self.drive.F, self.state.z)

    def has_all_contacts(self) -> Flags:
        """(tiles, TILE) whether the contacts that were solved with are all that act."""
        covered = self.covered & self.near.covers(self.drive.F, self.state.z, exactly=True)
        if self.state.elastic is not None:
            covered &= self.near.covers(self.drive.F, self.state.elastic, exactly=True)
        return covered

    def tangents(self) -> Tangents:
        """∂P/∂F and ∂P/∂Ḟ at the solution; NaN where there is none."""
        points, state = self.start.points, self.state
        values = np.empty((len(self.status), 2, 2, 8, TILE))
        if self.settings.initialisation == "slow-manifold":
            slow_tangents(self.drive, state.z, state.relaxed, *self.law, values)
            if state.left.any():
                affine = np.empty_like(values)
                kind = KINDS.index("constrained-runs")
                affine_tangents(self.drive, state.z, kind, *self.law, affine)
                np.copyto(values, affine, where=state.left[:, None, None, None, :])
        else:
            kind = KINDS.index(self.settings.initialisation)
            affine_tangents(self.drive, state.z, kind, *self.law, values)
        tangents = unpack(values, points).reshape(points, 2, 2, 2, 2, 2)
        tangents[unpack(self.status, points) != _OK] = np.nan
        return Tangents(tangents[:, :, :, 0].copy(), tangents[:, :, :, 1].copy())

    def effort(self) -> dict[str, int]:
        """Summable counts of what the answer cost."""
        points, newly_left = self.start.points, self.state.left & ~self.start.left
        return {
            "rve_solves": points,
            "force_evaluations": int(np.abs(unpack(self.answer.iterations, points)).sum()),
            "newton_solves": self.newton_solves,
            "left_bifurcation": int(unpack(newly_left, points).sum()),
        }


def solve_rves(
    unit: UnitCell, settings: RveSettings, drive: Drive, start: RveState, *, cold: bool
) -> Solved:
    """Initialise every RVE, with the contacts near `start`, or all where particles move farther.

    Args:
        drive: F and Ḟ in tiles.
        start: where to begin; it is not touched. It need not be near if `cold`, which makes new
            factors.
    """
    near = start.near
    if near is None or not near.covers(drive.F, start.z).all():
        near = unit.neighbours.near(drive.F, start.z)
    solved = Solved.unsolved(unit, settings, drive, start, cold, near)
    _initialise(solved)
    wrong = ~solved.has_all_contacts() & (solved.status == _OK)
    if wrong.any():
        index = np.flatnonzero(unpack(wrong, start.points))
        part = solved.at(index, cold=cold)
        part.near = unit.neighbours.everywhere(part.drive.F, part.start.z)
        _initialise(part)
        solved.put(index, part)
    if solved.near is not near:
        solved.state = replace(solved.state, near=solved.near)
    return solved


def _initialise(solved: Solved) -> None:
    settings = solved.settings
    match settings.initialisation, settings.solver:
        case "cauchy-born", _:
            _evaluate(solved)
        case "slow-manifold", _:
            _solve_slow(solved)
        case initialisation, solver:
            if solver == "iterated":
                _iterate(solved)
            else:
                _solve(solved)
            if initialisation == "elastic":
                _evaluate(solved)


def _evaluate(solved: Solved) -> None:
    """Stress at z with velocities L x (eqs. 64, 67)."""
    stress_at(solved.drive, solved.state.z, *solved.law, solved.answer)


def _iterate(solved: Solved) -> None:
    """The paper's iteration from the last state, carried along by the incremental F."""
    start, settings, (F, rate) = solved.start, solved.settings, solved.felt
    x = np.einsum("tabl,tbpl->tapl", F, start.z)
    v = np.einsum("tabl,tbpl->tapl", rate, start.z) + start.beyond_affine
    stepping = Stepping(settings.micro_step, settings.stop, settings.max_iterations)
    mass = solved.unit.neighbours.mass
    iterate(Drive(F, rate), x, v, mass, *solved.law, stepping, solved.answer)
    solved.status[solved.answer.iterations < 0] = Status.NOT_CONVERGED
    lanes = np.moveaxis(F, -1, 1)
    z = np.moveaxis(np.linalg.solve(lanes, np.moveaxis(x, -1, 1)), 1, -1)
    fluctuation = v - np.einsum("tabl,tbpl->tapl", rate, z)
    solved.state = replace(solved.state, z=np.ascontiguousarray(z), fluctuation=fluctuation)


# Positions with affine velocities: constrained runs, solved directly, and elastic equilibria


def _solve(solved: Solved) -> None:
    """With kept factors where they serve, else by Newton's method, else along a path."""
    start, iterations, felt = solved.start, solved.answer.iterations, solved.felt
    z = solved.state.z
    if solved.cold:
        iterations[np.abs(felt.F - start.F).max(axis=(1, 2)) > _NEAR] = OPEN
    at = Drive(start.F, dashpot_rate(solved.settings.initialisation, start.F_dot))
    tolerance = solved.settings.tolerance
    chord(felt, z, at, start.factors.address, *solved.law, tolerance, solved.answer)
    if solved.cold or (iterations < 0).any():
        _solve_open(solved, z, start.z)
        solved.status[(iterations < 0) & (solved.status == _OK)] = Status.NOT_CONVERGED


def _solve_open(solved: Solved, z: Array, z_start: Array) -> None:
    """Newton's method in lanes that are open, from z in place; where it fails, along a path."""
    iterations, far = solved.answer.iterations, np.zeros_like(solved.state.left)
    if solved.cold:
        far = is_far(solved.drive.F)
    iterations[far] = PASSED_OVER
    _newton(solved, z, renewed=solved.cold)
    iterations[far] = OPEN  # the path has to lead there
    astray = (iterations < 0) | (solved.status == Status.UNSTABLE)
    if astray.any():
        _follow_path(solved, z, z_start, np.flatnonzero(unpack(astray, solved.start.points)))


def _newton(solved: Solved, z: Array, renewed: bool = False) -> None:
    """Solve lanes that are open; check stability there, or everywhere with new factors."""
    failed = solved.answer.iterations < 0
    solved.newton_solves += int(unpack(failed, solved.start.points).sum())
    tiles = np.asarray(failed.any(axis=1)) | renewed
    factors = solved.state.factors.renewed(tiles)
    task = np.where(tiles, SOLVE, SKIP).astype(np.int8)
    solved.answer.stable[:] = True
    tolerance = solved.settings.tolerance
    newton(solved.felt, z, factors.address, task, *solved.law, tolerance, solved.answer)
    solved.status[(failed | renewed) & ~solved.answer.stable] = Status.UNSTABLE
    solved.state = replace(solved.state, factors=factors)


def _follow_path(solved: Solved, z: Array, z_start: Array, index: Index) -> None:
    """Lead the points `index`, which Newton's method misses or finds unstable, from the start."""
    F, start, points = solved.drive.F, solved.start, solved.start.points
    path = Path.between(*(unpack(each, points)[index] for each in (start.F, F, z_start)))
    tolerance = solved.settings.tolerance
    with one_blas_thread():
        Continuation(solved.unit, tolerance).follow(path)
    solved.newton_solves += int(path.solves.sum())
    arrived = path.arrived
    codes = np.where(path.unstable, Status.UNSTABLE, Status.NOT_CONVERGED)
    _put(solved.answer.iterations, index, points, np.where(arrived, PASSED_OVER, OPEN))
    _put(solved.status, index, points, np.where(arrived, _OK, codes))
    left, passed = np.zeros_like(solved.state.left), np.zeros_like(solved.state.left)
    _put(left, index, points, path.left)
    _put(passed, index, points, arrived)
    solved.state = replace(solved.state, left=solved.state.left | left)
    there = np.flatnonzero(arrived)
    if not len(there):
        return
    index = index[there]
    solved.covered = (solved.covered & solved.near.covers(F, z, exactly=True)) | passed
    _put(z, index, points, path.z[there])
    solved.near = solved.unit.neighbours.near(F, z)
    found = relax(*solved.law, path.z[there], path.end[there], tolerance)
    _put(z, index, points, found.z)
    _put(solved.answer.stress, index, points, found.stress)
    _put(solved.answer.iterations, index, points, found.iterations)
    lanes, row = with_copies(index, points)
    factors = solved.state.factors.put(lanes, found.factors.take(row))
    solved.state = replace(solved.state, factors=factors)
    if solved.felt.rate.any():
        # With dashpots on, such a point is as stable as the elastic equilibrium beside it.
        solved.answer.iterations[passed & (solved.answer.iterations > 0)] = OPEN
        status = solved.status.copy()
        _newton(solved, z)
        solved.status[:] = status


def _put(tiles: NDArray[Any], index: Index, points: int, values: NDArray[Any]) -> None:
    """Overwrite the points `index` of packed `tiles` by values (k, …), and copies of the last."""
    lanes, row = with_copies(index, points)
    put_points(tiles, lanes, pack(values[row]))


# The slow manifold, where velocities are those of the elastic equilibrium as F moves


def _solve_slow(solved: Solved) -> None:
    """Warm where possible, else from a new elastic equilibrium.

    At a bifurcation the slopes of that equilibrium have no bound, and neither have the velocities.
    From there on, where the state's `left` says so, they are affine as in constrained runs.
    """
    start, points = solved.start, solved.start.points
    if solved.cold:
        _start_slow(solved)
    else:
        moving = Moving(start.z.copy(), start.relaxed.copy(), start.beyond_affine.copy())
        at, tolerance = Drive(start.F, start.F_dot), solved.settings.tolerance
        address = start.factors.address
        follow(solved.drive, moving, at, address, *solved.law, tolerance, solved.answer)
        solved.state = replace(solved.state, **moving._asdict())
        if solved.answer.iterations.min() < 0:
            index = np.flatnonzero(unpack(solved.answer.iterations < 0, points))
            part = solved.at(index, cold=False)
            _start_slow(part)
            solved.put(index, part)
    if solved.state.left.any():
        held = np.flatnonzero(unpack(solved.state.left & (solved.status == _OK), points))
        if len(held):
            _hold_back(solved, held)


def _start_slow(solved: Solved) -> None:
    """From a new elastic equilibrium, and its factors, to Ḟ."""
    answer, drive, tolerance = solved.answer, solved.drive, solved.settings.tolerance
    elastic = solved.start.relaxed.copy()
    answer.iterations[:] = OPEN
    _solve_open(solved, elastic, solved.start.relaxed)
    found = (answer.iterations > 0) & (solved.status == _OK)
    tiles = np.ones(len(elastic), dtype=np.bool_)
    address = solved.state.factors.address  # of blocks that Newton's method has made just now
    renew_slow(drive.F, elastic, address, tiles, *solved.law, np.empty_like(found))
    moving, at = Moving(elastic.copy(), elastic, np.zeros_like(elastic)), solved.felt
    answer.iterations[:] = 0
    follow(drive, moving, at, address, *solved.law, tolerance, answer)
    soft = found & (answer.iterations < 0)
    if soft.any():  # z_el is stable but so soft that `follow` misses z
        counts = np.where(soft, 0, PASSED_OVER).astype(np.int32)
        newton_slow(drive, moving, *solved.law, tolerance, answer._replace(iterations=counts))
        answer.iterations[soft] = counts[soft]
    solved.status[~found & (solved.status == _OK)] = Status.NOT_CONVERGED
    missed = found & (answer.iterations < 0)
    solved.state = replace(solved.state, left=solved.state.left | missed, **moving._asdict())


def _hold_back(solved: Solved, index: Index) -> None:
    """Positions with affine velocities at the points `index`, where a bifurcation was met."""
    points = solved.start.points
    elastic, F, rate = (
        unpack(each, points)[index] for each in (solved.state.relaxed, *solved.drive)
    )
    found = relax(*solved.law, elastic, F, solved.settings.tolerance, rate)
    spent = np.abs(unpack(solved.answer.iterations, points)[index]) + found.iterations
    _put(solved.state.z, index, points, found.z)
    _put(solved.state.beyond_affine, index, points, np.zeros_like(found.z))
    _put(solved.answer.stress, index, points, found.stress)
    _put(solved.answer.iterations, index, points, np.where(found.found, spent, -1))
    _put(solved.status, index, points, np.where(found.found, _OK, Status.NOT_CONVERGED))
    solved.newton_solves += len(index)
