"""Far loads: the elastic equilibrium followed in steps, over bifurcations, and the way down.

See docs/theory.md, stability. The path is straight in F, dashpots off, from where z is known to
where it is asked for. A step from one stable equilibrium to the next is halved where Newton's
method fails, where the state it finds is unstable, or where particles jump. The shortest step that
still fails has met the end of its branch: from there particles move down the elastic energy E to a
minimum, and the path follows that branch on.

A step down is Newton's, with the modulus of every eigenvalue of the Hessian H = Σ λ q qᵀ::

    δx = Σ q (q·f)/|λ|,  halved until E falls,        f = −∂E/∂x

Where H is positive definite that is H⁻¹ f, and eigenvalues need not be known. At rest in a saddle f
says nothing, and the kick is along the softest mode, to the side of lower energy: a rotated or
mirrored RVE leaves to the rotated or mirrored side. Sides of one energy are images of each other
by a symmetry of the RVE. Among them, and among modes of one stiffness, a pattern w that is fixed in
material coordinates chooses, δx ∝ Σ |λ| q (q·w) over these modes: it depends neither on the sign
nor on the choice of eigenvectors that numpy returns.

Forces and Hessian are by x of all particles but the held one, ordered x₁, y₁, x₂, … as everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import scipy  # scipy.linalg is loaded where an RVE leaves its branch

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import loop_body, parallel_kernel
from surrofe2.base.simd import TILE, load, pack, spread, store, unpack, where_less
from surrofe2.base.tensors import rotation, transpose
from surrofe2.plant_cell.block_matrices import dense_pattern
from surrofe2.plant_cell.forces import elastic_energy, fold_images, local_forces
from surrofe2.plant_cell.neighbours import Topology
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.plant_cell.pair_sums import BY_F, BY_RATE, difference, make_workspace
from surrofe2.rve.newton import ASTRAY, SEEK, SEEK_LIMIT, move, renew, row_x, set_elastic_jacobian
from surrofe2.rve.rve_state import (
    OPEN,
    Drive,
    Factors,
    place,
    place_images,
    stored_energy,
)
from surrofe2.rve.unit_cell import Equilibria, UnitCell, relax

LONGEST = 0.05
"""Longest step along a path, as the largest change of an entry of Rᵀ F."""
SHORTEST = 0.004
"""Step that is not halved any further, in the same measure."""
SHORTEST_UNIFORM = 2e-5
"""The same length with a uniform fluid. Its walls may bow, and stay stable, within a short part of
the path once they are slack."""
BEND = 0.02
"""Largest distance of a particle from where the slopes at both ends of a step lead, (A52), µm times
`Constants.scale`: both ends then lie on one branch. It is looked at with a uniform fluid alone."""
JUMP = 1.0
"""Material displacement of a particle beyond which a step has left the branch, µm times
`Constants.scale`. KICK, DOWN and ROAM are multiplied by it, too."""
EFFORT = 2700
"""Newton iterations on the path of a point after which it is given up."""
OF_STEP_DOWN = 10
"""Newton iterations that a step down to a minimum counts as, for it takes about as long."""

RESTING = 1e-4
"""Mean particle force below which the rest of a descent is left to Newton's method, µN: `seek`
continues from there to the tolerance of the law."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
ALIKE = 1e-3
"""Relative difference of stiffness up to which unstable modes count as equally soft."""
EVEN = 1e-5
"""Difference of the energies on the two sides of a saddle, over their fall, up to which they count
as equal."""
DOWN = 0.4
"""Longest displacement of a particle in one step down, µm: that of a Newton step,
`newton.LONGEST_STEP`."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
LEAST = 1e-12
"""Least stiffness by which a force is divided, over the largest diagonal entry of the Hessian."""
STEPS = 100
"""Steps down after which a descent is given up."""
HALVINGS = 30
"""Halvings of one step after which it counts as not falling."""
ROAM = 2.0
"""Way that particles may go, µm, before their contacts are listed again: five steps of DOWN."""
_NOT_ZERO = 1e-300
"""Least length by which is divided."""


class Continuation:
    """The elastic equilibria of m points, followed from F = start to F = end by `follow`.

    Args:
        tolerance: mean force at which an equilibrium counts as solved, µN.
        start, end: (m, 2, 2); a rotation between the two is made at once.
        z: (m, 2, n) equilibria at `start`, µm.

    Attributes:
        z: (m, 2, n) equilibria where the points are now, µm.
        done: (m,) the part of the path behind them, from 0 to 1.
        step: (m,) the next step, as a part of the path; shortest, longest: its bounds.
        effort: (m,) Newton iterations so far.
        solves: (m,) calls of Newton's method so far.
        has_left: (m,) whether a point left its branch.
        unstable: (m,) whether the branch of a point ended at an unstable equilibrium.
        predicts: whether steps begin where the slope of the branch leads, and are checked by it.
        slope: (m, 2, n) ∂z/∂(part of the path) at z; zero where it is not used.
    """

    def __init__(self, unit: UnitCell, tolerance: float, start: Array, end: Array, z: Array):
        self.unit = unit
        self.tolerance = tolerance
        turned = rotation(end)
        # a turned equilibrium is one, too, with the same z (A16); only the stretch takes steps
        self.start = turned @ transpose(rotation(start)) @ start
        self.end = end
        self.z = z.copy()
        self.done = np.zeros(len(z))
        # the change of F as the material sees it, the same for a rotated RVE
        change = transpose(turned) @ (self.end - self.start)
        length = np.abs(change).max(axis=(1, 2))
        if unit.cell.symmetry == "D6":  # a hexagon's own turns change entries, but no stretches
            length = np.linalg.norm(change, ord=2, axis=(1, 2))
        shortest = SHORTEST_UNIFORM if unit.topology.pressures else SHORTEST
        # as parts of the path; the largest is 1, the whole of a short one
        self.longest = LONGEST / np.maximum(length, LONGEST)
        self.shortest = shortest / np.maximum(length, shortest)
        # half of the path at most, so that every path is checked on its way
        self.step = np.minimum(self.longest, 0.5)
        self.effort = np.zeros(len(z), dtype=np.int_)
        self.solves = np.zeros(len(z), dtype=np.int_)
        self.has_left = np.zeros(len(z), dtype=np.bool_)
        self.unstable = np.zeros(len(z), dtype=np.bool_)
        self.predicts = unit.topology.pressures > 0
        self.slope = self._slopes(np.arange(len(z)), self.start, self.z)

    @property
    def arrived(self) -> Flags:
        """True where a point has reached a stable equilibrium at the end of the path, (m,)."""
        arrived: Flags = self.done >= 1.0
        return arrived

    def follow(self) -> None:
        """Lead all points towards the end of the path, until they arrive or `EFFORT` is spent.

        `active` holds the numbers of the points that are under way. Arrays of one step (F, z,
        trial, slope, succeeds) have a row for each of these, and `stuck` numbers such rows.
        """
        active = np.arange(len(self.z))
        while len(active):
            z_before = self.z[active]
            F, trial, slope, succeeds = self._next(active)
            step = self.step[active]
            shortest = self.shortest[active]
            part = np.minimum(self.done[active] + step, 1.0)
            z = trial.z
            self.solves[active] += 1
            # where even the shortest step fails, the branch has ended
            stuck = np.flatnonzero(~succeeds & (step <= shortest))
            if len(stuck):
                ended = active[stuck]
                self.unstable[ended] = trial.is_solved[stuck]
                z[stuck], succeeds[stuck], steps_down = self._leave(
                    F[stuck], z_before[stuck], trial.take(stuck), EFFORT - self.effort[ended]
                )
                self.effort[ended] += OF_STEP_DOWN * steps_down
                self.solves[ended] += 1
                self.has_left[ended] |= succeeds[stuck]
                slope[stuck] = self._slopes(ended, F[stuck], z[stuck])
            moved = active[succeeds]
            self.z[moved] = z[succeeds]
            self.done[moved] = part[succeeds]
            self.slope[moved] = slope[succeeds]
            step = step * np.where(succeeds, 2.0, 0.5)
            self.step[active] = np.clip(step, shortest, self.longest[active])
            continues = ~self.arrived[active] & (self.effort[active] < EFFORT)
            continues[stuck] &= succeeds[stuck]  # else there is no other branch either
            active = active[continues]

    def _next(self, active: Index) -> tuple[Array, Equilibria, Array, Flags]:
        """Try the next step of the `active` points, and shorter ones in lanes that are free.

        A tile solves eight points in the time of one. If fewer are active, its other lanes try the
        step halved, quartered, … at once. The longest one that succeeds is taken; `step` becomes
        its length, and `effort` counts it and the longer ones, as if they had been tried in turn.

        Returns:
            F after the step, (k, 2, 2); the equilibria there; the slopes there, (k, 2, n); and
            whether they are on the same branch, (k,).
        """
        count = len(active)
        tries = max(TILE // len(active), 1)
        shortest = self.shortest[active]
        step = np.maximum(self.step[active, None] * 0.5 ** np.arange(tries), shortest[:, None])
        part = np.minimum(self.done[active, None] + step, 1.0)[:, :, None, None]
        F = (1.0 - part) * self.start[active, None] + part * self.end[active, None]
        z = np.repeat(self.z[active], tries, axis=0)
        slope_before = np.repeat(self.slope[active], tries, axis=0)
        moved = (part[:, :, 0, 0] - self.done[active, None]).reshape(-1, 1, 1)
        trial = seek(self.unit, F.reshape(-1, 2, 2), z + moved * slope_before, self.tolerance)
        scale = self.unit.constants.scale
        follows = trial.stable & ~_jumped(trial.z, z, scale)
        slope = self._slopes(np.repeat(active, tries), F.reshape(-1, 2, 2), trial.z)
        if self.predicts:
            # how far z is from where the mean of both slopes leads: large across two branches
            bend = trial.z - z - 0.5 * moved * (slope_before + slope)
            follows &= _farthest(bend) <= scale * BEND
        succeeds = follows.reshape(count, tries)
        effort = self.effort[active, None] + trial.iterations.reshape(count, tries).cumsum(axis=1)
        # the first try that succeeds, or after which none would follow
        is_last = succeeds | (step <= shortest[:, None]) | (effort >= EFFORT)
        is_last[:, -1] = True
        taken = is_last.argmax(axis=1)
        every = np.arange(count)
        self.step[active] = step[every, taken]
        self.effort[active] = effort[every, taken]
        # the tries of a point are rows next to one another
        row = tries * every + taken
        return F[every, taken], trial.take(row), slope[row], succeeds[every, taken]

    def _slopes(self, index: Index, F: Array, z: Array) -> Array:
        """Return ∂z/∂(part of the path) (m, 2, n) of the points `index` at equilibria z at F."""
        slope = np.zeros_like(z)
        if self.predicts:
            change = (self.end - self.start)[index].reshape(-1, 1, 4)
            # slopes that are not finite are those of no equilibrium
            by_F = np.nan_to_num(elastic_slopes(self.unit, F, z))
            along_path = (by_F * change).sum(axis=2).reshape(len(z), -1, 2)
            # particle 0 is held, and has no slope
            slope[:, :, 1:] = along_path.transpose(0, 2, 1)
        return slope

    def _leave(
        self, F: Array, z: Array, trial: Equilibria, spare: Index
    ) -> tuple[Array, Flags, Index]:
        """Move points whose branch has ended down to a stable equilibrium.

        They start from the unstable equilibrium in `trial`, or, where there is none or it lies far
        off, from z, the last stable one.

        Args:
            spare: (m,) Newton iterations that are left.

        Returns:
            z, (m, 2, n); whether it is stable, (m,); and how many steps down were tried, (m,).
        """
        has_jumped = _jumped(trial.z, z, self.unit.constants.scale)
        has_saddle = trial.is_solved & ~trial.stable & ~has_jumped
        begin = np.where(has_saddle[:, None, None], trial.z, z)
        most = np.maximum(spare // OF_STEP_DOWN, 1)
        below, is_stable, steps_down = descend(self.unit, F, begin, most)
        solved = seek(self.unit, F, below, self.tolerance)
        z_after = np.where(solved.is_solved[:, None, None], solved.z, below)
        is_stable &= solved.stable & ~_paired(self.unit.topology, F, z_after)
        return z_after, is_stable, steps_down


def seek(unit: UnitCell, F: Array, z: Array, tolerance: float) -> Equilibria:
    """Search for elastic equilibria near z (m, 2, n) at F (m, 2, 2) by Newton's method.

    `iterations` of the result counts evaluations of forces even where none was found.
    """
    # two particles may go ASTRAY in opposite directions; F takes that to positions x
    skin = 2.0 * unit.constants.scale * ASTRAY * np.linalg.norm(F, axis=(1, 2)).max()
    topology = unit.neighbours.near(pack(F), pack(z), skin).topology
    equilibria = relax(topology, unit.constants, z, F, tolerance, task=SEEK)
    # OPEN: the limit was reached; other negative numbers: given up after so many
    count = np.where(equilibria.iterations == OPEN, SEEK_LIMIT, np.abs(equilibria.iterations))
    return equilibria._replace(iterations=count)


def elastic_slopes(unit: UnitCell, F: Array, z: Array) -> Array:
    """Return ∂z/∂F_xx, xy, yx, yy, (m, 2n − 2, 4), of elastic equilibria z (m, 2, n) at F."""
    tensors = pack(F)
    tiles = pack(z)
    # nothing moves here, so that contacts that act are enough
    topology = unit.neighbours.near(tensors, tiles, 0.0).topology
    drive = Drive(tensors, np.zeros_like(tensors))
    factors = Factors.empty(drive, tiles, topology)
    every = np.ones(len(tiles), dtype=np.bool_)
    renew(drive, tiles, factors.address, every, topology, unit.constants)
    return unpack(factors.slopes(topology), len(z))[:, :, BY_F:BY_RATE]


def _jumped(z: Array, before: Array, scale: float) -> Flags:
    """Return (m,) whether a particle moved farther than it does along one branch."""
    return _farthest(z - before) > scale * JUMP


def _farthest(displacements: Array) -> Array:
    """Return (m,) the length of the longest displacement of m RVEs (m, 2, n)."""
    squares = (displacements * displacements).sum(axis=1)
    return np.asarray(np.sqrt(squares).max(axis=1))


def _paired(topology: Topology, F: Array, z: Array) -> Flags:
    """Return (m,) whether two fluid particles of an RVE coincide, at F (m, 2, 2), z (m, 2, n).

    That is SPH's pairing instability: forces between fluid particles vanish as their distance does,
    so the solver accepts such a pair as an equilibrium, which no tissue has.
    """
    i, j = topology.fluid_pairs.T
    apart = F @ (z[:, :, i] - z[:, :, j])
    nearest: Array = (apart * apart).sum(axis=1).min(axis=1, initial=np.inf)
    return nearest < PAIRED**2


class Descent(NamedTuple):
    """RVEs in tiles on their way down the energy, after the last step of each.

    energy: (tiles, 1, TILE) elastic energy E, pJ.
    falls: (tiles, TILE) whether the last step lowered it.
    forces: (tiles, 2n − 2, TILE) f = −∂E/∂x, µN.
    slope: (tiles, rows², TILE) ∂f/∂x = −H, µN/µm, a dense matrix of 2n − 2 rows, and two more for
        each pressure.
    nearest: (tiles, 1, TILE) smallest square of a distance of fluid particles, µm².
    """

    energy: Array
    falls: Flags
    forces: Array
    slope: Array
    nearest: Array


@parallel_kernel
def go_down(F, z, step, topology, constants, descent):
    """Move z (tiles, 2, n, TILE) by the step δx (tiles, 2n − 2, TILE), both in place.

    A step is halved until E falls below `descent.energy`, that of the step before. Where it never
    does, z stays. Then all fields of `descent` are those of the new z.

    F: (tiles, 2, 2, TILE).
    """
    for t in numba.prange(z.shape[0]):
        of_tile = Descent(
            descent.energy[t],
            descent.falls[t],
            descent.forces[t],
            descent.slope[t],
            descent.nearest[t],
        )
        _go_down_tile(F[t], z[t], step[t], topology, constants, of_tile)


@loop_body
def _go_down_tile(F, z, step, topology, constants, descent):
    """Do as `go_down` for one tile."""
    workspace = make_workspace(topology)
    no_columns = np.empty((0, 8, TILE))
    trial = np.empty((1, TILE))
    energy = descent.energy
    falls = descent.falls
    falls[:] = False
    for _ in range(HALVINGS):
        place(workspace, z, F, topology)
        move(step, F, workspace.z)
        place_images(workspace, F, topology)
        elastic_energy(workspace, topology, constants, trial)
        remaining = 0
        for lane in range(TILE):
            if falls[lane]:
                continue
            if trial[0, lane] < energy[0, lane]:
                falls[lane] = True
                energy[0, lane] = trial[0, lane]
            else:
                step[:, lane] *= 0.5
                remaining += 1
        if remaining == 0:
            break
    for lane in range(TILE):
        if not falls[lane]:
            step[:, lane] = 0.0
    move(step, F, z)
    place(workspace, z, F, topology)
    set_elastic_jacobian(workspace, F, topology, constants, descent.slope, no_columns)
    local_forces(workspace, topology, constants)
    fold_images(workspace.f, topology)
    for i in range(1, topology.particles):
        store(load(workspace.f, 0, i), descent.forces, row_x(i))
        store(load(workspace.f, 1, i), descent.forces, row_x(i) + 1)
    # two fluid particles that meet end a descent, see `_paired`
    nearest = spread(np.inf)
    for k in range(topology.fluid_pairs.shape[0]):
        rx, ry = difference(workspace.x, topology.fluid_pairs[k, 0], topology.fluid_pairs[k, 1])
        square = rx * rx + ry * ry
        nearest = where_less(square, nearest, square, nearest)
    store(nearest, descent.nearest, 0)


def descend(
    unit: UnitCell, F: Array, z: Array, most: Index | int = STEPS
) -> tuple[Array, Flags, Index]:
    """Move RVEs from z (m, 2, n) at F (m, 2, 2) down to a minimum of E, in at most `most` steps.

    Returns:
        z; (m,) whether it is a minimum: mean force below `RESTING`, no unstable mode; and (m,) how
        many steps were tried.
    """
    scale = unit.constants.scale
    z = z.copy()
    arrived = np.zeros(len(z), dtype=np.bool_)
    tried = np.zeros(len(z), dtype=np.int_)
    limit = np.minimum(np.full(len(z), most), STEPS)
    energy = np.full(len(z), np.inf)
    # The first step has no length, and any energy is below ∞: it only evaluates energy, forces and
    # Hessian where the descent begins.
    active = np.arange(len(z))
    step = np.zeros((len(z), 2 * z.shape[2] - 2))
    while len(active):
        # Whenever an RVE stops, the others are packed into tiles again, so that no lane is idle.
        count = len(active)
        tensors = pack(F[active])
        moving = pack(z[active])
        tiles = len(tensors)
        free = step.shape[1]
        room = 0.0  # way on which the list of contacts is still valid, µm; none is listed yet
        unknowns = free + 2 * unit.topology.pressures
        descent = Descent(
            energy=pack(energy[active, None]),
            falls=np.empty((tiles, TILE), dtype=np.bool_),
            forces=np.empty((tiles, free, TILE)),
            slope=np.empty((tiles, unknowns * unknowns, TILE)),
            nearest=np.empty((tiles, 1, TILE)),
        )
        continues = np.ones(count, dtype=np.bool_)
        while continues.all():
            if room < scale * DOWN:
                # two particles may go ROAM in opposite directions
                topology = unit.neighbours.near(tensors, moving, 2.0 * scale * ROAM).topology
                room = scale * ROAM
                # full matrices, whatever those of a topology are: all eigenvalues are wanted
                dense = dense_pattern(topology.particles, topology.pressures)
                topology = topology._replace(**dense._asdict())
            room -= float(_lengths(step).max())
            go_down(tensors, moving, pack(step), topology, unit.constants, descent)
            are_apart = descent.nearest[:, 0] >= PAIRED**2
            continues = unpack(descent.falls & are_apart, count)
            continues &= tried[active] < limit[active]
            for k in np.flatnonzero(continues).tolist():
                tile, lane = divmod(k, TILE)
                point = active[k]
                step[k], arrived[point] = _step(
                    F[point],
                    moving[tile, :, :, lane],
                    descent.forces[tile, :, lane],
                    -descent.slope[tile, :, lane],
                    topology,
                    unit.constants,
                )
                tried[point] += 1
                continues[k] = not arrived[point]
        z[active] = unpack(moving, count)
        energy[active] = unpack(descent.energy, count)[:, 0]
        active = active[continues]
        step = step[continues]
    return z, arrived, tried


def _step(
    F: Array, z: Array, forces: Array, values: Array, topology: Topology, constants: Constants
) -> tuple[Array, bool]:
    """Return the next step (2n − 2,) of one RVE on its way down, and whether this is a minimum.

    It is Newton's step, or at rest in a saddle the kick out of it. At a minimum the step is of no
    use. A minimum may be one but for rounding; `seek` decides whether it is stable.

    Args:
        F: (2, 2). z: (2, n). forces: (2n − 2,) µN.
        values: (rows²,) the dense Hessian with its pressures, µN/µm.
    """
    hessian = _without_pressures(values, len(forces))
    is_resting = bool(_lengths(forces[None]).mean() < RESTING)
    # a Cholesky factorisation is the cheapest test of definiteness; its code is 0 if it succeeds
    factor, code = scipy.linalg.lapack.dpotrf(hessian, clean=False)
    is_definite = code == 0
    if is_definite:
        if is_resting:
            return forces, True
        step = scipy.linalg.lapack.dpotrs(factor, forces)[0]
    else:
        step = over_saddle(F, forces, hessian, is_resting, constants.scale * KICK)
        if is_resting and not step.any():  # rounding alone has made the factorisation fail
            return forces, True
        if is_resting and rises(F, z, step, topology, constants):
            step = -step
    longest = max(_lengths(step[None]).max(), _NOT_ZERO)
    return step * min(constants.scale * DOWN / longest, 1.0), False


def rises(F: Array, z: Array, step: Array, topology: Topology, constants: Constants) -> bool:
    """Return whether E is higher after the step δx (2n − 2,) from z (2, n) than after its opposite.

    Energies that differ by less than `EVEN` of their fall count as equal.
    """
    moved = np.zeros_like(z)
    moved[:, 1:] = np.linalg.solve(F, step.reshape(-1, 2).T)
    states = np.array([z - moved, z, z + moved])
    behind, middle, ahead = stored_energy(
        np.broadcast_to(F, (3, 2, 2)), states, topology, constants
    )
    return bool(ahead - behind > EVEN * abs(behind + ahead - 2.0 * middle))


def _without_pressures(values: Array, free: int) -> Array:
    """Return the Hessian (free, free) with its pressures eliminated.

    values: (rows²,) the dense matrix, in which the pressures come last.
    """
    size = round(np.sqrt(len(values)))
    matrix = values.reshape(size, size)
    if size == free:
        return matrix
    # regular: the idle unknown of each pressure has a 1 of its own
    pressures_by_x = np.linalg.solve(matrix[free:, free:], matrix[free:, :free])
    return np.asarray(matrix[:free, :free] - matrix[:free, free:] @ pressures_by_x)


def over_saddle(
    F: Array, forces: Array, hessian: Array, resting: bool, kick: float = KICK
) -> Array:
    """Return H⁻¹ f with the sign of unstable modes turned, or, at rest, a kick along the softest.

    The longest displacement of a kick is `kick`, µm. Without an unstable mode it is zero.

    Args:
        F: (2, 2). forces: (2n − 2,) µN. hessian: (2n − 2, 2n − 2) µN/µm.
    """
    # The unstable modes alone: all of them take twice as long, and a solution does for the others.
    stiffness, modes = scipy.linalg.eigh(
        hessian, subset_by_value=(-np.inf, 0.0), driver="evr", check_finite=False
    )
    if resting:
        # none is positive here: the softest is the most negative
        is_softest = stiffness < (1.0 - ALIKE) * stiffness.min(initial=0.0)
        stiffness = stiffness[is_softest]
        modes = modes[:, is_softest]
        # The pattern w of the head of this file: fixed in material coordinates, and as it has no
        # symmetry of an RVE, it singles out one of mirrored branches.
        angle = np.arange(1, len(forces) // 2 + 1) * np.sqrt(2.0)
        pattern = (F @ np.stack([np.cos(angle), np.sin(2.0 * angle)])).T.ravel()
        step = modes @ (-stiffness * (modes.T @ pattern))
        return step * (kick / max(_lengths(step[None]).max(), _NOT_ZERO))
    # without this stiffness a particle that touches nothing would move by 0/0; now it stays
    least = LEAST * np.abs(np.diagonal(hessian)).max()
    shifted = hessian + least * np.eye(len(forces))
    step = scipy.linalg.lapack.dsysv(shifted, forces)[2]
    # from q·f/λ, which the solution has, to q·f/|λ|
    turned = 1.0 / np.maximum(-stiffness, least) - 1.0 / (stiffness + least)
    return step + modes @ (turned * (modes.T @ forces))


def _lengths(vectors: Array) -> Array:
    """Return the lengths (m, n − 1) of the displacements of m steps (m, 2n − 2)."""
    pairs = vectors.reshape(len(vectors), vectors.shape[1] // 2, 2)
    lengths: Array = np.sqrt((pairs * pairs).sum(axis=2))
    return lengths
