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
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, pack, spread, store, unpack, where_less
from surrofe2.base.tensors import rotation, transpose
from surrofe2.plant_cell.block_matrices import dense_pattern
from surrofe2.plant_cell.forces import elastic_energy, fold_images, local_forces
from surrofe2.plant_cell.neighbours import Topology
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.plant_cell.pair_sums import difference, make_workspace
from surrofe2.rve.newton import ASTRAY, SEEK, SEEK_LIMIT, move, renew, set_elastic_jacobian
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
SHORTEST = 0.004
"""Longest step, and the one that is not halved any further: largest change of an entry of Rᵀ F."""
SHORTEST_UNIFORM = 2e-5
"""The latter with a uniform fluid: slack walls bow within a short part of the path, and stably."""
BEND = 0.02
"""With a uniform fluid: distance of a particle from where the slopes at both ends of a step lead,
µm times `Constants.scale`, within which the two lie on one branch."""
JUMP = 1.0
"""Material displacement of a particle, µm times `Constants.scale`, that no step along one branch
makes; so are the lengths below, but that of fluid particles."""
EFFORT = 2700
OF_STEP_DOWN = 10
"""Newton iterations on the path of a point after which it is given up; a step down counts ten."""

RESTING = 1e-4
"""Mean particle force below which a minimum is left to Newton's method, µN."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
ALIKE = 1e-3
EVEN = 1e-5
"""Relative difference of the stiffness of unstable modes that count as one, and of the energies on
the two sides of a saddle, over their fall, that do."""
DOWN = 0.4
"""Longest displacement of a particle in one step down, µm."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
LEAST = 1e-12
"""Stiffness of a mode that counts as one, over the largest of a particle."""
STEPS = 100
HALVINGS = 30
"""Steps down to a minimum, and halvings of each, after which there is none."""
ROAM = 2.0
"""How far particles may move, µm, before their contacts are listed again."""


class Continuation:
    """m points that are led from F = start to F = end; `follow` does it.

    Args:
        start, end: (m, 2, 2); a rotation between the two is made at once.
        z: (m, 2, n) equilibria at `start`.

    Attributes:
        z: (m, 2, n) their equilibria where they have come to.
        done: (m,) the part of the path so far. step: the next step, as such a part.
        effort: (m,) what it took, in Newton iterations. solves: (m,) of Newton's method.
        left: (m,) whether a branch was left.
        unstable: (m,) whether the last equilibrium met was unstable.
        predicts: whether steps begin where the slope of the branch leads, and are checked by it.
        slope: (m, 2, n) ∂z/∂(part of the path) at z; zero where it is not used.
    """

    def __init__(self, unit: UnitCell, tolerance: float, start: Array, end: Array, z: Array):
        self.unit = unit
        self.tolerance = tolerance
        turned = rotation(end)
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
        self.longest, self.shortest = (
            limit / np.maximum(length, limit) for limit in (LONGEST, shortest)
        )
        self.step = np.minimum(self.longest, 0.5)
        self.effort, self.solves = np.zeros((2, len(z)), dtype=np.int_)
        self.left, self.unstable = np.zeros((2, len(z)), dtype=np.bool_)
        self.predicts = unit.topology.pressures > 0
        self.slope = self._slopes(np.arange(len(z)), self.start, self.z)

    @property
    def arrived(self) -> Flags:
        """(m,) whether a stable equilibrium was found at the end."""
        arrived: Flags = self.done >= 1.0
        return arrived

    def follow(self) -> None:
        """Lead all points towards the end of the path, as far as `EFFORT` goes.

        `active` numbers points of the path. What one step finds is numbered as `active` is: F, z,
        trial, slope there, good (a step on the same branch) and `stuck`, whose branch has ended.
        """
        active = np.arange(len(self.z))
        while len(active):
            z = self.z[active]
            F, trial, slope, good = self._next(active)
            step = self.step[active]
            shortest = self.shortest[active]
            part = np.minimum(self.done[active] + step, 1.0)
            there = trial.z
            self.solves[active] += 1
            stuck = np.flatnonzero(~good & (step <= shortest))
            if len(stuck):
                ended = active[stuck]
                self.unstable[ended] = trial.found[stuck]
                begin = trial.take(stuck)
                spare = EFFORT - self.effort[ended]
                there[stuck], good[stuck], tried = self._leave(F[stuck], z[stuck], begin, spare)
                self.effort[ended] += OF_STEP_DOWN * tried
                self.solves[ended] += 1
                self.left[ended] |= good[stuck]
                slope[stuck] = self._slopes(ended, F[stuck], there[stuck])
            ahead = active[good]
            self.z[ahead] = there[good]
            self.done[ahead] = part[good]
            self.slope[ahead] = slope[good]
            step = step * np.where(good, 2.0, 0.5)
            self.step[active] = np.clip(step, shortest, self.longest[active])
            keeps_on = ~self.arrived[active] & (self.effort[active] < EFFORT)
            keeps_on[stuck] &= good[stuck]
            active = active[keeps_on]

    def _next(self, active: Index) -> tuple[Array, Equilibria, Array, Flags]:
        """The next step of the `active` points, halved as often as a tile has room to try at once.

        Returns:
            F, what was found there, the slope there, and whether that is the next equilibrium of
            the branch; the path's step is the one that was taken, its effort that of all before it,
            too.
        """
        # a tile solves eight points for the price of one: its free lanes try shorter steps at once
        count = len(active)
        tries = max(TILE // len(active), 1)
        shortest = self.shortest[active]
        step = np.maximum(self.step[active, None] * 0.5 ** np.arange(tries), shortest[:, None])
        part = np.minimum(self.done[active, None] + step, 1.0)[:, :, None, None]
        F = (1.0 - part) * self.start[active, None] + part * self.end[active, None]
        z = np.repeat(self.z[active], tries, axis=0)
        before = np.repeat(self.slope[active], tries, axis=0)
        moved = (part[:, :, 0, 0] - self.done[active, None]).reshape(-1, 1, 1)
        trial = seek(self.unit, F.reshape(-1, 2, 2), z + moved * before, self.tolerance)
        scale = self.unit.constants.scale
        follows = trial.stable & ~_jumped(trial.z, z, scale)
        slope = self._slopes(np.repeat(active, tries), F.reshape(-1, 2, 2), trial.z)
        if self.predicts:
            bend = trial.z - z - 0.5 * moved * (before + slope)
            follows &= _farthest(bend) <= scale * BEND
        good = follows.reshape(count, tries)
        effort = self.effort[active, None] + trial.iterations.reshape(count, tries).cumsum(axis=1)
        last = good | (step <= shortest[:, None]) | (effort >= EFFORT)
        last[:, -1] = True
        taken = last.argmax(axis=1)
        every = np.arange(count)
        self.step[active] = step[every, taken]
        self.effort[active] = effort[every, taken]
        row = tries * every + taken
        return F[every, taken], trial.take(row), slope[row], good[every, taken]

    def _slopes(self, index: Index, F: Array, z: Array) -> Array:
        """∂z/∂(part of the path) (m, 2, n) of the points `index` at equilibria z at F."""
        slope = np.zeros_like(z)
        if self.predicts:
            change = (self.end - self.start)[index].reshape(-1, 1, 4)
            by_F = np.nan_to_num(elastic_slopes(self.unit, F, z))  # not finite: of no equilibrium
            by_deformation = (by_F * change).sum(axis=2).reshape(len(z), -1, 2)
            slope[:, :, 1:] = by_deformation.transpose(0, 2, 1)
        return slope

    def _leave(
        self, F: Array, z: Array, trial: Equilibria, spare: Index
    ) -> tuple[Array, Flags, Index]:
        """z of points in a stable state, whether there is one, and how many steps down it took.

        Down from the unstable equilibrium, or, where none was found or it lies far off, from the
        last stable one.
        """
        saddle = trial.found & ~trial.stable & ~_jumped(trial.z, z, self.unit.constants.scale)
        begin = np.where(saddle[:, None, None], trial.z, z)
        most = np.maximum(spare // OF_STEP_DOWN, 1)
        below, is_stable, tried = descend(self.unit, F, begin, most)
        solved = seek(self.unit, F, below, self.tolerance)
        there = np.where(solved.found[:, None, None], solved.z, below)
        is_stable &= solved.stable & ~_paired(self.unit.topology, F, there)
        return there, is_stable, tried


def seek(unit: UnitCell, F: Array, z: Array, tolerance: float) -> Equilibria:
    """Elastic equilibria near z (m, 2, n) by Newton's method; iterations, however it ends."""
    skin = 2.0 * unit.constants.scale * ASTRAY * np.linalg.norm(F, axis=(1, 2)).max()
    topology = unit.neighbours.near(pack(F), pack(z), skin).topology
    equilibria = relax(topology, unit.constants, z, F, tolerance, task=SEEK)
    count = np.where(equilibria.iterations == OPEN, SEEK_LIMIT, np.abs(equilibria.iterations))
    return equilibria._replace(iterations=count)


def elastic_slopes(unit: UnitCell, F: Array, z: Array) -> Array:
    """(m, free, 4) ∂z/∂F_xx, xy, yx, yy of elastic equilibria z (m, 2, n) at F (m, 2, 2)."""
    tensors = pack(F)
    tiles = pack(z)
    topology = unit.neighbours.near(tensors, tiles, 0.0).topology
    drive = Drive(tensors, np.zeros_like(tensors))
    factors = Factors.empty(drive, tiles, topology)
    every = np.ones(len(tiles), dtype=np.bool_)
    renew(drive, tiles, factors.address, every, topology, unit.constants)
    return unpack(factors.slopes(topology), len(z))[:, :, :4]


def _jumped(z: Array, before: Array, scale: float) -> Flags:
    """(m,) whether a particle moved farther than it does along one branch."""
    return _farthest(z - before) > scale * JUMP


def _farthest(way: Array) -> Array:
    """(m,) the longest of the displacements (m, 2, n)."""
    return np.asarray(np.sqrt((way * way).sum(axis=1)).max(axis=1))


def _paired(topology: Topology, F: Array, z: Array) -> Flags:
    """(m,) whether two fluid particles of an RVE at F (m, 2, 2) and z (m, 2, n) have met.

    That is SPH's pairing instability. The model's forces between fluid particles vanish with their
    distance, so such a pair is an equilibrium of the numbers and none of the tissue.
    """
    i, j = topology.fluid_pairs.T
    apart = F @ (z[:, :, i] - z[:, :, j])
    nearest: Array = (apart * apart).sum(axis=1).min(axis=1, initial=np.inf)
    return nearest < PAIRED**2


class Found(NamedTuple):
    """What there is after a step, of RVEs in tiles.

    energy: (tiles, 1, TILE) E, pJ. falls: (tiles, TILE) whether it is lower than before.
    forces: (tiles, 2n − 2, TILE) f = −∂E/∂x, µN. slope: (tiles, ·, TILE) −H, µN/µm,
        a dense matrix of 2n − 2 rows, and of two more for each pressure.
    nearest: (tiles, 1, TILE) smallest square of a distance of fluid particles, µm².
    """

    energy: Array
    falls: Flags
    forces: Array
    slope: Array
    nearest: Array


@parallel_kernel
def go_down(F, z, step, topology, c, after):
    """Move z (tiles, 2, n, TILE) by the step δx (tiles, 2n − 2, TILE), in place.

    The step is halved until E falls below the energy `found` before; else z stays.
    """
    for t in numba.prange(z.shape[0]):
        here = Found(
            after.energy[t], after.falls[t], after.forces[t], after.slope[t], after.nearest[t]
        )
        _go_down_tile(F[t], z[t], step[t], topology, c, here)


@kernel
def _go_down_tile(F, z, step, topology, c, after):
    work = make_workspace(topology)
    no_columns = np.empty((0, 8, TILE))
    trial = np.empty((1, TILE))
    energy = after.energy
    falls = after.falls
    falls[:] = False
    for _ in range(HALVINGS):
        place(work, z, F, topology)
        move(step, F, work.z)
        place_images(work, F, topology)
        elastic_energy(work, topology, c, trial)
        remaining = 0
        for k in range(TILE):
            if falls[k]:
                continue
            if trial[0, k] < energy[0, k]:
                falls[k] = True
                energy[0, k] = trial[0, k]
            else:
                step[:, k] *= 0.5
                remaining += 1
        if remaining == 0:
            break
    for k in range(TILE):
        if not falls[k]:
            step[:, k] = 0.0
    move(step, F, z)
    place(work, z, F, topology)
    set_elastic_jacobian(work, F, topology, c, after.slope, no_columns)
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    for i in range(1, topology.particles):
        store(load(work.f, 0, i), after.forces, 2 * i - 2)
        store(load(work.f, 1, i), after.forces, 2 * i - 1)
    nearest = spread(np.inf)
    for k in range(topology.fluid_pairs.shape[0]):
        rx, ry = difference(work.x, topology.fluid_pairs[k, 0], topology.fluid_pairs[k, 1])
        square = rx * rx + ry * ry
        nearest = where_less(square, nearest, square, nearest)
    store(nearest, after.nearest, 0)


def descend(
    unit: UnitCell, F: Array, z: Array, most: Index | int = STEPS
) -> tuple[Array, Flags, Index]:
    """From z (m, 2, n) at F (m, 2, 2) down to a minimum of E, in at most so many steps.

    Returns:
        z there, (m,) whether it is one: mean force below `RESTING`, no unstable mode; and (m,) how
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
        room = 0.0
        unknowns = free + 2 * unit.topology.pressures
        here = Found(
            energy=pack(energy[active, None]),
            falls=np.empty((tiles, TILE), dtype=np.bool_),
            forces=np.empty((tiles, free, TILE)),
            slope=np.empty((tiles, unknowns * unknowns, TILE)),
            nearest=np.empty((tiles, 1, TILE)),
        )
        continues = np.ones(count, dtype=np.bool_)
        while continues.all():
            if room < scale * DOWN:
                topology = unit.neighbours.near(tensors, moving, 2.0 * scale * ROAM).topology
                room = scale * ROAM
                # full matrices, whatever those of a topology are: all eigenvalues are wanted
                dense = dense_pattern(topology.particles, topology.pressures)
                topology = topology._replace(**dense._asdict())
            room -= float(_lengths(step).max())
            go_down(tensors, moving, pack(step), topology, unit.constants, here)
            apart = here.nearest[:, 0] >= PAIRED**2
            continues = unpack(here.falls & apart, count) & (tried[active] < limit[active])
            for k in np.flatnonzero(continues).tolist():
                tile, lane = divmod(k, TILE)
                forces = here.forces[tile, :, lane]
                hessian = -here.slope[tile, :, lane]
                at = F[active[k]], moving[tile, :, :, lane]
                step[k], arrived[active[k]] = _step(*at, forces, hessian, topology, unit.constants)
                tried[active[k]] += 1
                continues[k] = not arrived[active[k]]
        z[active] = unpack(moving, count)
        energy[active] = unpack(here.energy, count)[:, 0]
        active = active[continues]
        step = step[continues]
    return z, arrived, tried


def _step(
    F: Array, z: Array, forces: Array, values: Array, topology: Topology, c: Constants
) -> tuple[Array, bool]:
    """(2n − 2,) Newton's step, or the kick out of a saddle at rest; whether this is a minimum.

    A minimum may be one but for rounding: `seek` has the last word on whether it is stable.
    """
    hessian = _without_pressures(values, len(forces))
    resting = bool(_lengths(forces[None]).mean() < RESTING)
    factor, not_definite = scipy.linalg.lapack.dpotrf(hessian, clean=False)
    if not not_definite:
        if resting:
            return forces, True
        step = scipy.linalg.lapack.dpotrs(factor, forces)[0]
    else:
        step = over_saddle(F, forces, hessian, resting, c.scale * KICK)
        if resting and not step.any():  # rounding alone has made the factorisation fail
            return forces, True
        if resting and rises(F, z, step, topology, c):
            step = -step
    step = step * min(c.scale * DOWN / max(_lengths(step[None]).max(), 1e-300), 1.0)
    return step, False


def rises(F: Array, z: Array, step: Array, topology: Topology, c: Constants) -> bool:
    """Whether E is higher after the step δx (2n − 2,) from z (2, n) than after its opposite."""
    moved = np.zeros_like(z)
    moved[:, 1:] = np.linalg.solve(F, step.reshape(-1, 2).T)
    sides = np.array([z - moved, z, z + moved])
    before, here, after = stored_energy(np.broadcast_to(F, (3, 2, 2)), sides, topology, c)
    return bool(after - before > EVEN * abs(before + after - 2.0 * here))


def _without_pressures(values: Array, free: int) -> Array:
    """(free, free) of the dense matrix in `values`, its pressures, which come last, eliminated."""
    size = round(np.sqrt(len(values)))
    matrix = values.reshape(size, size)
    if size == free:
        return matrix
    follow = np.linalg.solve(matrix[free:, free:], matrix[free:, :free])
    return np.asarray(matrix[:free, :free] - matrix[:free, free:] @ follow)


def over_saddle(
    F: Array, forces: Array, hessian: Array, resting: bool, kick: float = KICK
) -> Array:
    """H⁻¹ f with the sign of the unstable modes turned, or, `resting`, a kick along the softest.

    The kick is zero where there is no unstable mode.
    """
    # The unstable modes alone: all of them take twice as long, and a solution does for the others.
    stiffness, modes = scipy.linalg.eigh(
        hessian, subset_by_value=(-np.inf, 0.0), driver="evr", check_finite=False
    )
    if resting:
        softest = stiffness < (1.0 - ALIKE) * stiffness.min(initial=0.0)
        stiffness = stiffness[softest]
        modes = modes[:, softest]
        # displacements that single out one of mirrored branches, whatever F
        angle = np.arange(1, len(forces) // 2 + 1) * np.sqrt(2.0)
        pattern = (F @ np.stack([np.cos(angle), np.sin(2.0 * angle)])).T.ravel()
        step = modes @ (-stiffness * (modes.T @ pattern))
        return step * (kick / max(_lengths(step[None]).max(), 1e-300))
    least = LEAST * np.abs(np.diagonal(hessian)).max()  # a particle that touches nothing stays
    shifted = hessian + least * np.eye(len(forces))
    step = scipy.linalg.lapack.dsysv(shifted, forces)[2]
    turned = 1.0 / np.maximum(-stiffness, least) - 1.0 / (stiffness + least)
    return step + modes @ (turned * (modes.T @ forces))


def _lengths(vectors: Array) -> Array:
    """(m, n − 1) of vectors (m, 2n − 2)."""
    pairs = vectors.reshape(len(vectors), vectors.shape[1] // 2, 2)
    lengths: Array = np.sqrt((pairs * pairs).sum(axis=2))
    return lengths
