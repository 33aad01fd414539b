"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import one_blas_thread
from surrofe2.base.simd import TILE, pack, put_points, take_points, unpack
from surrofe2.base.tensors import rotation, transpose
from surrofe2.law.stress_law import Status, Tangents
from surrofe2.plant_cell.neighbours import Near, Topology
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.continuation import Continuation, seek
from surrofe2.rve.newton import SKIP, SOLVE, chord, newton
from surrofe2.rve.rve_state import (
    OPEN,
    PASSED_OVER,
    UNDER_WAY,
    Answer,
    Drive,
    Factors,
    RveState,
    empty_answer,
    stress_at,
    with_copies,
)
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.slow_manifold import Moving, follow, newton_slow, renew_slow
from surrofe2.rve.tangents import KINDS, affine_tangents, slow_tangents
from surrofe2.rve.unit_cell import UnitCell

NEAR = 0.01
"""|F − I| up to which the reference's own factors are tried at a cold start."""
FAR = 0.15
"""Largest entry of |U − I| up to which a cold solve may go from F = I in one step."""
_OK = int(Status.OK)  # a member of an enumeration takes a microsecond to look up


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
    covered: Flags = field(init=False)
    answer: Answer = field(init=False)
    status: NDArray[np.int8] = field(init=False)
    state: RveState = field(init=False)
    newton_solves: int = 0

    def __post_init__(self) -> None:
        self.answer = empty_answer(len(self.drive.F))
        self.covered = np.ones(self.answer.iterations.shape, dtype=np.bool_)
        self.status = np.zeros(self.covered.shape, dtype=np.int8)
        self.state = replace(
            self.start,
            z=self.start.z.copy(),
            F=self.drive.F,
            F_dot=self.drive.rate,
            near=self.near,
            iterations=self.answer.iterations,
            is_checked=self.cold,
        )

    @property
    def kernel_arguments(self) -> tuple[Topology, Constants]:
        """The pairs of particles and the constants, which all kernels take."""
        return self.near.topology, self.unit.constants

    @property
    def felt(self) -> Drive:
        """F, and the rate at which positions are solved for."""
        return Drive(self.drive.F, dashpot_rate(self.settings.initialisation, self.drive.rate))

    def at(self, index: Index, *, cold: bool = False) -> Solved:
        """The points `index` alone, unsolved."""
        drive = Drive(*(take_points(tensor, index) for tensor in self.drive))
        start = self.start.take(index)
        near = self.near.take(index)
        return Solved(self.unit, self.settings, drive, start, cold, near)

    def put(self, index: Index, part: Solved) -> None:
        """Take over what was found at the points `index`."""
        lanes, row = with_copies(index, self.start.points)
        self.covered = self.has_all_contacts()
        put_points(self.covered, lanes, part.has_all_contacts(), row)
        put_points(self.answer.stress, lanes, part.answer.stress, row)
        put_points(self.status, lanes, part.status, row)
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
        points = self.start.points
        state = self.state
        slow = self.settings.initialisation == "slow-manifold"
        values = np.empty((len(self.status), 2, 2, 8, TILE))
        if not slow or state.left.any():
            kind = KINDS.index("constrained-runs" if slow else self.settings.initialisation)
            affine_tangents(self.drive, state.z, kind, *self.kernel_arguments, values)
        if slow:
            moving = np.empty_like(values)
            slow_tangents(self.drive, state.z, state.relaxed, *self.kernel_arguments, moving)
            np.copyto(values, moving, where=~state.left[:, None, None, None, :])
        tangents = unpack(values, points).reshape(points, 2, 2, 2, 2, 2)
        tangents[unpack(self.status, points) != _OK] = np.nan
        return Tangents(tangents[:, :, :, 0].copy(), tangents[:, :, :, 1].copy())

    def effort(self) -> dict[str, int]:
        """Summable counts of what the answer cost."""
        points = self.start.points
        newly_left = self.state.left & ~self.start.left
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
    solved = Solved(unit, settings, drive, start, cold, near)
    _initialise(solved)
    wrong = ~solved.has_all_contacts() & (solved.status == _OK)
    if wrong.any():
        index = np.flatnonzero(unpack(wrong, start.points))
        part = solved.at(index, cold=cold)
        part.near = unit.neighbours.near(part.drive.F, part.start.z, np.inf)
        _initialise(part)
        solved.put(index, part)
    if solved.near is not near:
        solved.state = replace(solved.state, near=solved.near)
    return solved


def _initialise(solved: Solved) -> None:
    initialisation = solved.settings.initialisation
    solver = solved.settings.solver
    if initialisation == "slow-manifold":
        _solve_slow(solved)
    elif initialisation != "cauchy-born" and solver == "iterated":
        _iterate(solved)
    elif initialisation != "cauchy-born":
        _solve(solved)
    if initialisation in ("cauchy-born", "elastic"):  # at z, with velocities L x (eqs. 64, 67)
        stress_at(solved.drive, solved.state.z, *solved.kernel_arguments, solved.answer)


def _iterate(solved: Solved) -> None:
    """The paper's iteration from the last state, carried along by the incremental F."""
    start = solved.start
    settings = solved.settings
    F, rate = solved.felt
    x = np.einsum("tabl,tbpl->tapl", F, start.z)
    v = np.einsum("tabl,tbpl->tapl", rate, start.z) + start.beyond_affine
    stepping = Stepping(settings.micro_step, settings.stop, settings.max_iterations)
    mass = solved.unit.neighbours.mass
    iterate(Drive(F, rate), x, v, mass, *solved.kernel_arguments, stepping, solved.answer)
    solved.status[solved.answer.iterations < 0] = Status.NOT_CONVERGED
    lanes = np.moveaxis(F, -1, 1)
    z = np.moveaxis(np.linalg.solve(lanes, np.moveaxis(x, -1, 1)), 1, -1)
    fluctuation = v - np.einsum("tabl,tbpl->tapl", rate, z)
    solved.state = replace(solved.state, z=np.ascontiguousarray(z), fluctuation=fluctuation)


# Positions with affine velocities: constrained runs, solved directly, and elastic equilibria


def _solve(solved: Solved) -> None:
    """With kept factors where they serve, else by Newton's method, else along a path."""
    start = solved.start
    iterations = solved.answer.iterations
    settings = solved.settings
    if solved.cold:
        iterations[np.abs(solved.drive.F - start.F).max(axis=(1, 2)) > NEAR] = OPEN
    at = Drive(start.F, dashpot_rate(settings.initialisation, start.F_dot))
    z = solved.state.z
    address = start.factors.address
    tolerance = settings.tolerance
    chord(solved.felt, z, at, address, *solved.kernel_arguments, tolerance, solved.answer)
    if solved.cold or (iterations < 0).any():
        _solve_open(solved)


def _solve_open(solved: Solved) -> None:
    """Newton's method in lanes that are open, from z; where it fails or may jump, along a path."""
    iterations = solved.answer.iterations
    led = _are_led(solved)
    iterations[led] = PASSED_OVER
    _newton(solved, renewed=np.logical_and(~led.all(axis=1), solved.cold))
    iterations[led] = OPEN  # the path has to lead there
    astray = (iterations < 0) | (solved.status == Status.UNSTABLE)
    if astray.any():
        _follow_path(solved, np.flatnonzero(unpack(astray, solved.start.points)))
    failed = (solved.answer.iterations < 0) & (solved.status == _OK)
    solved.status[failed] = Status.NOT_CONVERGED


def _are_led(solved: Solved) -> Flags:
    """(tiles, TILE) which lanes are too far from where they begin for one step.

    With a uniform fluid all that are open: walls of an irregular tissue have other stable states
    nearby, to which Newton's method jumps unnoticed. SPH fluid has more of them than paths avoid.
    """
    if solved.unit.cell.has_uniform_fluid:
        return np.asarray(solved.answer.iterations < 0)
    return is_far(solved.drive.F) if solved.cold else np.zeros_like(solved.answer.stable)


def is_far(F: Array) -> Flags:
    """(tiles, TILE) whether F (tiles, 2, 2, TILE) is too far from I to be reached in one step."""
    flat = unpack(F, len(F) * TILE)
    U = transpose(rotation(flat)) @ flat
    return pack(np.abs(U - np.eye(2)).max(axis=(1, 2)) > FAR)


def _newton(solved: Solved, renewed: Flags | bool = False) -> None:
    """Solve lanes that are open; check stability there, or everywhere with new factors.

    renewed: (tiles,) which tiles get new factors in any case.
    """
    failed = solved.answer.iterations < 0
    solved.newton_solves += int(unpack(failed, solved.start.points).sum())
    renewed = np.asarray(renewed)
    tiles = np.asarray(failed.any(axis=1)) | renewed
    factors = solved.state.factors.renewed(tiles)
    task = np.where(tiles, SOLVE, SKIP).astype(np.int8)
    solved.answer.stable[:] = True
    z = solved.state.z
    tolerance = solved.settings.tolerance
    newton(
        solved.felt, z, factors.address, task, *solved.kernel_arguments, tolerance, solved.answer
    )
    solved.status[(failed | renewed[..., None]) & ~solved.answer.stable] = Status.UNSTABLE
    solved.state = replace(solved.state, factors=factors.made_at(tiles, solved.felt, z))


def _follow_path(solved: Solved, index: Index) -> None:
    """Lead the points `index`, which Newton's method misses or finds unstable, from the start."""
    part = solved.at(index, cold=solved.cold)
    start, end = (unpack(F, len(index)) for F in (part.start.F, part.drive.F))
    begin = _elastic_start(part, start)
    path = Continuation(part.unit, part.settings.tolerance, start, end, begin)
    with one_blas_thread():
        path.follow()
    z = pack(path.z)
    arrived = pack(path.arrived)
    has_left = part.start.left | pack(path.left)
    part.near = part.unit.neighbours.near(part.drive.F, z)
    part.state = replace(part.state, z=z, left=has_left, elastic=None, fluctuation=None)
    part.answer.iterations[:] = np.where(arrived, OPEN, PASSED_OVER)
    _newton(part)
    part.answer.iterations[~arrived] = OPEN
    # With dashpots on, such a point is as stable as the elastic equilibrium beside it.
    codes = np.where(path.unstable, Status.UNSTABLE, Status.NOT_CONVERGED)
    part.status[:] = pack(np.where(path.arrived, _OK, codes))
    part.newton_solves += int(path.solves.sum())
    solved.put(index, part)


def _elastic_start(part: Solved, F: Array) -> Array:
    """(m, 2, n) z that paths of all points begin from, at F (m, 2, 2).

    Steps with a uniform fluid are checked by slopes of elastic equilibria. Dashpots move walls
    farther off these than the check allows, so that every step would seem to leave the branch.
    """
    z = unpack(part.start.relaxed, len(F))
    felt = dashpot_rate(part.settings.initialisation, part.start.F_dot)
    if not (part.unit.cell.has_uniform_fluid and felt.any()):
        return z
    elastic = seek(part.unit, F, z, part.settings.tolerance)
    return np.where(elastic.stable[:, None, None], elastic.z, z)


# The slow manifold, where velocities are those of the elastic equilibrium as F moves


def _solve_slow(solved: Solved) -> None:
    """Warm where possible, else from a new elastic equilibrium.

    At a bifurcation the slopes of that equilibrium have no bound, and neither have the velocities.
    From there on, where the state's `left` says so, they are affine as in constrained runs.
    """
    start = solved.start
    points = solved.start.points
    if solved.cold:
        _start_slow(solved)
    else:
        moving = Moving(solved.state.z, start.relaxed.copy(), start.beyond_affine.copy())
        at = Drive(start.F, start.F_dot)
        tolerance = solved.settings.tolerance
        address = start.factors.address
        follow(
            solved.drive, moving, at, address, *solved.kernel_arguments, tolerance, solved.answer
        )
        solved.state = replace(solved.state, **moving._asdict())
        if solved.answer.iterations.min() < 0:
            index = np.flatnonzero(unpack(solved.answer.iterations < 0, points))
            part = solved.at(index)
            _start_slow(part)
            solved.put(index, part)
    held = solved.state.left & (solved.status == _OK)
    if held.any():
        _hold_back(solved, np.flatnonzero(unpack(held, points)))


def _start_slow(solved: Solved) -> None:
    """From a new elastic equilibrium, and its factors, to Ḟ."""
    z = solved.start.relaxed.copy()
    solved.state = replace(solved.state, z=z, elastic=None, fluctuation=None)
    solved.answer.iterations[:] = OPEN
    _solve_open(solved)
    answer = solved.answer
    drive = solved.drive
    elastic = solved.state.z
    is_elastic = solved.status == _OK
    tolerance = solved.settings.tolerance
    tiles = np.ones(len(elastic), dtype=np.bool_)
    factors = solved.state.factors.made_at(tiles, solved.felt, elastic)
    address = factors.address  # of blocks that Newton's method has made just now
    renew_slow(
        drive.F, elastic, address, tiles, *solved.kernel_arguments, np.empty_like(is_elastic)
    )
    moving = Moving(elastic.copy(), elastic, np.zeros_like(elastic))
    answer.iterations[:] = UNDER_WAY
    follow(drive, moving, solved.felt, address, *solved.kernel_arguments, tolerance, answer)
    soft = is_elastic & (answer.iterations < 0)
    if soft.any():  # z_el is stable but so soft that `follow` misses z
        counts = np.where(soft, UNDER_WAY, PASSED_OVER).astype(np.int32)
        newton_slow(
            drive, moving, *solved.kernel_arguments, tolerance, answer._replace(iterations=counts)
        )
        answer.iterations[soft] = counts[soft]
    has_left = solved.state.left | (is_elastic & (answer.iterations < 0))
    solved.state = replace(solved.state, left=has_left, factors=factors, **moving._asdict())


def _hold_back(solved: Solved, index: Index) -> None:
    """Positions with affine velocities at the points `index`, where a bifurcation was met."""
    part = solved.at(index)
    state = solved.state.take(index)
    part.covered = take_points(solved.covered, index)
    z = state.relaxed.copy()
    answer = part.answer
    task = np.full(len(z), SOLVE, dtype=np.int8)
    unused = Factors.empty(part.drive, z, part.kernel_arguments[0])
    newton(
        part.drive, z, unused.address, task, *part.kernel_arguments, part.settings.tolerance, answer
    )
    is_solved = answer.iterations > 0
    answer.iterations[:] = np.where(is_solved, answer.iterations + np.abs(state.iterations), OPEN)
    part.status[~is_solved] = Status.NOT_CONVERGED
    part.state = replace(state, z=z, fluctuation=np.zeros_like(z), iterations=answer.iterations)
    part.newton_solves = len(index)
    solved.put(index, part)
