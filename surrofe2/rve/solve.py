"""One call of an RVE law: tiles of deformation in, tiles of stress and status out.

`Solved` carries the points of a call through these functions, which fill it in. Most of them take
the lanes that the one before has not solved, marked by `answer.iterations` < 0 (see the table in
`rve_state`): kept factors first, then Newton's method with new ones, then a path in small steps.
"""

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
# a plain number, since a member of an enumeration takes a microsecond to look up
_OK = int(Status.OK)


def dashpot_rate(initialisation: str, F_dot: Array) -> Array:
    """Return the rate that particles feel while their positions are solved for.

    It is 0 with "elastic", and with "slow-manifold", which begins with the elastic equilibrium.
    """
    elastic = initialisation in ("elastic", "slow-manifold")
    return np.zeros_like(F_dot) if elastic else F_dot


@dataclass(slots=True, eq=False)
class Solved:
    """The points of a call: what is asked, and what the functions of this file have solved so far.

    Attributes:
        drive: F and Ḟ in tiles.
        start: state to begin from; it is not changed.
        cold: whether to make new factors; `start` need not be near then.
        near: the list of contacts that is solved with.
        covered: (tiles, TILE) whether lists that were used before had all contacts that act.
        answer: stress, which counts only where the status is OK, and force evaluations.
        status: (tiles, TILE) codes of `Status`.
        state: the warm start for the next call.
        newton_solves: number of points that needed Newton's method.
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
        """The topology and the constants, which all kernels take."""
        return self.near.topology, self.unit.constants

    @property
    def felt(self) -> Drive:
        """F, and the rate at which positions are solved for."""
        return Drive(self.drive.F, dashpot_rate(self.settings.initialisation, self.drive.rate))

    def at(self, index: Index, *, cold: bool = False) -> Solved:
        """Return the points `index` alone, unsolved."""
        drive = Drive(*(take_points(tensor, index) for tensor in self.drive))
        start = self.start.take(index)
        near = self.near.take(index)
        return Solved(self.unit, self.settings, drive, start, cold, near)

    def put(self, index: Index, part: Solved) -> None:
        """Take over the results of `part`, which has the points `index`."""
        lanes, row = with_copies(index, self.start.points)
        # by the list and the state that were solved with, both of which change below
        self.covered = self.has_all_contacts()
        put_points(self.covered, lanes, part.has_all_contacts(), row)
        put_points(self.answer.stress, lanes, part.answer.stress, row)
        put_points(self.status, lanes, part.status, row)
        self.state = self.state.put(index, part.state)
        self.answer = self.answer._replace(iterations=self.state.iterations)
        self.newton_solves += part.newton_solves
        if part.near.topology is not self.near.topology:
            # all points share one list, which must have the contacts of both
            self.near = self.unit.neighbours.near(self.drive.F, self.state.z)

    def has_all_contacts(self) -> Flags:
        """Return (tiles, TILE) whether no contact acts that was not listed while solving."""
        covered = self.covered & self.near.covers(self.drive.F, self.state.z, exactly=True)
        if self.state.elastic is not None:
            covered &= self.near.covers(self.drive.F, self.state.elastic, exactly=True)
        return covered

    def tangents(self) -> Tangents:
        """Return ∂P/∂F and ∂P/∂Ḟ at the solution; NaN where there is none."""
        points = self.start.points
        state = self.state
        is_slow = self.settings.initialisation == "slow-manifold"
        values = np.empty((len(self.status), 2, 2, 8, TILE))
        if not is_slow or state.has_left.any():
            # beyond a bifurcation velocities are affine, as in constrained runs
            kind = KINDS.index("constrained-runs" if is_slow else self.settings.initialisation)
            affine_tangents(self.drive, state.z, kind, *self.kernel_arguments, values)
        if is_slow:
            slow_values = np.empty_like(values)
            slow_tangents(self.drive, state.z, state.relaxed, *self.kernel_arguments, slow_values)
            np.copyto(values, slow_values, where=~state.has_left[:, None, None, None, :])
        # the 8 columns are the entries of F, then those of Ḟ
        tangents = unpack(values, points).reshape(points, 2, 2, 2, 2, 2)
        tangents[unpack(self.status, points) != _OK] = np.nan
        return Tangents(
            P_by_F=tangents[:, :, :, 0].copy(),
            P_by_F_dot=tangents[:, :, :, 1].copy(),
        )

    def effort(self) -> dict[str, int]:
        """Return counts of work, by name, that can be added over calls."""
        points = self.start.points
        newly_left = self.state.has_left & ~self.start.has_left
        return {
            "rve_solves": points,
            "force_evaluations": int(np.abs(unpack(self.answer.iterations, points)).sum()),
            "newton_solves": self.newton_solves,
            "left_bifurcation": int(unpack(newly_left, points).sum()),
        }


def solve_rves(
    unit: UnitCell, settings: RveSettings, drive: Drive, start: RveState, *, cold: bool
) -> Solved:
    """Put every RVE into the state of its initialisation, and compute its stress.

    Only contacts near `start` are computed. Where particles have moved so far that others act,
    points are solved again with all contacts.

    Args:
        drive: F and Ḟ in tiles.
        start: state to begin from; it is not changed.
        cold: whether to make new factors; `start` need not be near then.
    """
    near = start.near
    if near is None or not near.covers(drive.F, start.z).all():
        near = unit.neighbours.near(drive.F, start.z)
    solved = Solved(unit, settings, drive, start, cold, near)
    _initialise(solved)
    lacks_contacts = ~solved.has_all_contacts() & (solved.status == _OK)
    if lacks_contacts.any():
        index = np.flatnonzero(unpack(lacks_contacts, start.points))
        part = solved.at(index, cold=cold)
        part.near = unit.neighbours.near(part.drive.F, part.start.z, np.inf)
        _initialise(part)
        solved.put(index, part)
    if solved.near is not near:
        solved.state = replace(solved.state, near=solved.near)
    return solved


def _initialise(solved: Solved) -> None:
    """Solve all points by the initialisation and the solver of the settings."""
    initialisation = solved.settings.initialisation
    solver = solved.settings.solver
    if initialisation == "slow-manifold":
        _solve_slow(solved)
    elif initialisation != "cauchy-born" and solver == "iterated":
        _iterate(solved)
    elif initialisation != "cauchy-born":
        _solve(solved)
    if initialisation in ("cauchy-born", "elastic"):
        # positions were solved without velocities; the stress is that with v = L x (eqs. 64, 67)
        stress_at(solved.drive, solved.state.z, *solved.kernel_arguments, solved.answer)


def _iterate(solved: Solved) -> None:
    """Iterate as the paper does, from the last state, whose z moves along with F."""
    start = solved.start
    settings = solved.settings
    F, rate = solved.felt
    x = np.einsum("tabl,tbpl->tapl", F, start.z)
    v = np.einsum("tabl,tbpl->tapl", rate, start.z) + start.beyond_affine
    stepping = Stepping(settings.micro_step, settings.stop, settings.max_iterations)
    mass = solved.unit.neighbours.mass
    iterate(Drive(F, rate), x, v, mass, *solved.kernel_arguments, stepping, solved.answer)
    solved.status[solved.answer.iterations < 0] = Status.NOT_CONVERGED
    # back to material positions, z = F⁻¹ x, with lanes first for numpy
    lanes_of_F = np.moveaxis(F, -1, 1)
    lanes_of_x = np.moveaxis(x, -1, 1)
    z = np.moveaxis(np.linalg.solve(lanes_of_F, lanes_of_x), 1, -1)
    fluctuation = v - np.einsum("tabl,tbpl->tapl", rate, z)
    solved.state = replace(solved.state, z=np.ascontiguousarray(z), fluctuation=fluctuation)


# Positions with affine velocities: constrained runs, solved directly, and elastic equilibria


def _solve(solved: Solved) -> None:
    """Solve with kept factors where they converge, else by Newton's method, else along a path."""
    start = solved.start
    iterations = solved.answer.iterations
    settings = solved.settings
    if solved.cold:
        is_beyond = np.abs(solved.drive.F - start.F).max(axis=(1, 2)) > NEAR
        iterations[is_beyond] = OPEN  # kept factors are not tried there
    before = Drive(start.F, dashpot_rate(settings.initialisation, start.F_dot))
    z = solved.state.z
    address = start.factors.address
    tolerance = settings.tolerance
    chord(solved.felt, z, before, address, *solved.kernel_arguments, tolerance, solved.answer)
    if solved.cold or (iterations < 0).any():
        _solve_open(solved)


def _solve_open(solved: Solved) -> None:
    """Solve lanes that are open: by Newton's method from z, or along a path.

    Paths are for lanes in which Newton's method fails, finds an unstable state, or might jump.
    """
    iterations = solved.answer.iterations
    needs_path = _need_path(solved)
    iterations[needs_path] = PASSED_OVER
    # a cold solve makes new factors in any case, except where a path will
    _newton(solved, renewed=np.logical_and(~needs_path.all(axis=1), solved.cold))
    iterations[needs_path] = OPEN
    is_astray = (iterations < 0) | (solved.status == Status.UNSTABLE)
    if is_astray.any():
        _follow_path(solved, np.flatnonzero(unpack(is_astray, solved.start.points)))
    failed = (solved.answer.iterations < 0) & (solved.status == _OK)
    solved.status[failed] = Status.NOT_CONVERGED


def _need_path(solved: Solved) -> Flags:
    """Return (tiles, TILE) which lanes are too far from where they begin for one step.

    With a uniform fluid these are all that are open: walls of an irregular tissue have other stable
    states nearby, to which Newton's method jumps unnoticed. SPH fluid has so many that a path would
    not avoid them either; there it is the lanes of a cold solve that are far from F = I.
    """
    if solved.unit.cell.has_uniform_fluid:
        return np.asarray(solved.answer.iterations < 0)
    if solved.cold:
        return is_far(solved.drive.F)
    return np.zeros_like(solved.answer.stable)


def is_far(F: Array) -> Flags:
    """Return (tiles, TILE) whether F (tiles, 2, 2, TILE) is too far from I for one step."""
    flat = unpack(F, len(F) * TILE)
    U = transpose(rotation(flat)) @ flat
    return pack(np.abs(U - np.eye(2)).max(axis=(1, 2)) > FAR)


def _newton(solved: Solved, renewed: Flags | bool = False) -> None:
    """Solve lanes that are open by Newton's method, and check the stability of all it solves.

    renewed: (tiles,) True for tiles that get new factors, and are checked, in any case.
    """
    failed = solved.answer.iterations < 0
    solved.newton_solves += int(unpack(failed, solved.start.points).sum())
    renewed = np.asarray(renewed)
    tiles = np.asarray(failed.any(axis=1)) | renewed
    factors = solved.state.factors.renewed(tiles)
    task = np.where(tiles, SOLVE, SKIP).astype(np.int8)
    # lanes that are not checked here count as stable
    solved.answer.stable[:] = True
    z = solved.state.z
    tolerance = solved.settings.tolerance
    newton(
        solved.felt, z, factors.address, task, *solved.kernel_arguments, tolerance, solved.answer
    )
    solved.status[(failed | renewed[..., None]) & ~solved.answer.stable] = Status.UNSTABLE
    solved.state = replace(solved.state, factors=factors.made_at(tiles, solved.felt, z))


def _follow_path(solved: Solved, index: Index) -> None:
    """Lead the points `index` from their start to F in small steps, then solve them there."""
    part = solved.at(index, cold=solved.cold)
    F_start = unpack(part.start.F, len(index))
    F_end = unpack(part.drive.F, len(index))
    z_start = _elastic_start(part, F_start)
    path = Continuation(part.unit, part.settings.tolerance, F_start, F_end, z_start)
    with one_blas_thread():
        path.follow()
    z = pack(path.z)
    arrived = pack(path.arrived)
    has_left = part.start.has_left | pack(path.has_left)
    part.near = part.unit.neighbours.near(part.drive.F, z)
    # z is that of the elastic equilibrium itself, whose velocities are not known yet
    part.state = replace(part.state, z=z, has_left=has_left, elastic=None, fluctuation=None)
    # where rates are felt, one more solve takes them in, from the equilibrium beside it
    part.answer.iterations[:] = np.where(arrived, OPEN, PASSED_OVER)
    _newton(part)
    part.answer.iterations[~arrived] = OPEN
    # With dashpots on, such a point is as stable as the elastic equilibrium beside it.
    codes = np.where(path.unstable, Status.UNSTABLE, Status.NOT_CONVERGED)
    part.status[:] = pack(np.where(path.arrived, _OK, codes))
    part.newton_solves += int(path.solves.sum())
    solved.put(index, part)


def _elastic_start(part: Solved, F: Array) -> Array:
    """Return z (m, 2, n) from which paths of all points begin, at F (m, 2, 2).

    It is that of the start, but with a uniform fluid the elastic equilibrium beside it: steps are
    checked by slopes of elastic equilibria then, and dashpots move walls farther off these than the
    check allows, so that every step would seem to leave the branch.
    """
    z = unpack(part.start.relaxed, len(F))
    felt = dashpot_rate(part.settings.initialisation, part.start.F_dot)
    if not (part.unit.cell.has_uniform_fluid and felt.any()):
        return z
    elastic = seek(part.unit, F, z, part.settings.tolerance)
    return np.where(elastic.stable[:, None, None], elastic.z, z)


# The slow manifold, where velocities are those of the elastic equilibrium as F moves


def _solve_slow(solved: Solved) -> None:
    """Solve from the last state where possible, else from a new elastic equilibrium.

    At a bifurcation the slopes of that equilibrium have no bound, and neither have the velocities.
    From there on, where the state's `has_left` is True, they are affine as in constrained runs.
    """
    start = solved.start
    points = solved.start.points
    if solved.cold:
        _start_slow(solved)
    else:
        moving = Moving(
            z=solved.state.z,
            elastic=start.relaxed.copy(),
            fluctuation=start.beyond_affine.copy(),
        )
        follow(
            solved.drive,
            moving,
            Drive(start.F, start.F_dot),
            start.factors.address,
            *solved.kernel_arguments,
            solved.settings.tolerance,
            solved.answer,
        )
        solved.state = replace(solved.state, **moving._asdict())
        is_open = solved.answer.iterations < 0
        if is_open.any():
            index = np.flatnonzero(unpack(is_open, points))
            part = solved.at(index)
            _start_slow(part)
            solved.put(index, part)
    is_beyond = solved.state.has_left & (solved.status == _OK)
    if is_beyond.any():
        _solve_affine(solved, np.flatnonzero(unpack(is_beyond, points)))


def _start_slow(solved: Solved) -> None:
    """Solve from a new elastic equilibrium at F, with new factors, at which the rate is still 0."""
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
    # Newton's method has just made these blocks, so they may be written to
    address = factors.address
    # stability is not asked for: Newton's method has just checked it
    renew_slow(
        drive.F, elastic, address, tiles, *solved.kernel_arguments, np.empty_like(is_elastic)
    )
    moving = Moving(elastic.copy(), elastic, np.zeros_like(elastic))
    answer.iterations[:] = UNDER_WAY
    follow(drive, moving, solved.felt, address, *solved.kernel_arguments, tolerance, answer)
    is_soft = is_elastic & (answer.iterations < 0)
    if is_soft.any():
        # z_el is stable but so soft that kept factors do not lead to z
        iterations = np.where(is_soft, UNDER_WAY, PASSED_OVER).astype(np.int32)
        answer_of_soft = answer._replace(iterations=iterations)
        newton_slow(drive, moving, *solved.kernel_arguments, tolerance, answer_of_soft)
        answer.iterations[is_soft] = iterations[is_soft]
    # without z although z_el is stable: the velocities have no bound
    has_left = solved.state.has_left | (is_elastic & (answer.iterations < 0))
    solved.state = replace(solved.state, has_left=has_left, factors=factors, **moving._asdict())


def _solve_affine(solved: Solved, index: Index) -> None:
    """Solve positions with affine velocities at the points `index`, beyond a bifurcation."""
    part = solved.at(index)
    state = solved.state.take(index)
    part.covered = take_points(solved.covered, index)
    z = state.relaxed.copy()
    answer = part.answer
    task = np.full(len(z), SOLVE, dtype=np.int8)
    # `newton` writes factors, but the state keeps those of z_el, at which a later solve begins
    unused = Factors.empty(part.drive, z, part.kernel_arguments[0])
    newton(
        part.drive, z, unused.address, task, *part.kernel_arguments, part.settings.tolerance, answer
    )
    is_solved = answer.iterations > 0
    # both solves count: that of z_el, and this one
    answer.iterations[:] = np.where(is_solved, answer.iterations + np.abs(state.iterations), OPEN)
    part.status[~is_solved] = Status.NOT_CONVERGED
    part.state = replace(state, z=z, fluctuation=np.zeros_like(z), iterations=answer.iterations)
    part.newton_solves = len(index)
    solved.put(index, part)
