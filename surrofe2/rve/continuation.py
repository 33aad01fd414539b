"""Far loads: the elastic equilibrium followed in steps, over bifurcations.

See docs/theory.md, stability. The way is straight in F, dashpots off, from where z is known to
where it is asked for. A step from one stable equilibrium to the next is halved where Newton's
method fails, where the state it finds is unstable, or where particles jump. The shortest step that
still fails has met the end of its branch: from there particles move down the elastic energy E to a
minimum, and the way goes on along that branch. The way down is Newton's, with the modulus of
every eigenvalue of the Hessian H = Σ λ q qᵀ::

    δx = Σ q (q·f)/|λ|,  halved until E falls,        f = −∂E/∂x

At rest in a saddle f says nothing, and the kick is the part of a fixed pattern w that lies in the
unstable directions, δx ∝ Σ_{λ<0} |λ| q (q·w): it depends neither on the sign nor on the choice of
eigenvectors that numpy returns. w is fixed in material coordinates, so a rotated RVE leaves
along the rotated direction. Which of two mirrored branches is reached is w's choice, and a
reflected RVE may choose the other.

Forces and Hessian are by x of all particles but the held one, ordered x₁, y₁, x₂, … as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.block_pattern import make_pattern
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.tiles import Constants, Topology, make_workspace, pack, tiles_for, unpack
from surrofe2.rve.newton import set_elastic_jacobian
from surrofe2.rve.particle_state import list_covers, place, stored_energy
from surrofe2.rve.unit_cell import Equilibria, UnitCell, relax
from surrofe2.simd import TILE, load, store
from surrofe2.tensors import rotation, transpose

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

LONGEST, SHORTEST = 0.05, 0.004
"""Longest step, and the one that is not halved any further: largest change of an entry of F."""
JUMP = 1.0
"""Material displacement of a particle, µm, that no step along one branch makes."""
FAR = 0.15
"""Largest entry of |U − I| up to which a cold solve may go from F = I in one step."""
ROOM = 1.5
"""How much farther particles may move, µm, on a walk that is begun with a list of contacts."""
RESTING = 1e-4
"""Mean particle force below which a minimum is left to Newton's method, µN."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
DOWN = 0.4
"""Longest displacement of a particle in one step down, µm."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
STEPS, HALVINGS = 100, 30
"""Steps down to a minimum, and halvings of each, after which there is none."""
EFFORT, OF_LEAVING = 150, 10
"""Newton solves on the way of a point after which it is given up; a branch left counts as ten."""


def is_far(F: Reals) -> Flags:
    """(tiles, TILE) whether F (tiles, 2, 2, TILE) is too far from I to be reached in one step."""
    flat = unpack(F, len(F) * TILE)
    U = transpose(rotation(flat)) @ flat
    return pack(np.abs(U - np.eye(2)).max(axis=(1, 2)) > FAR)


def has_room(unit: UnitCell, level: int, F: Reals, z: Reals) -> Flags:
    """(tiles, TILE) whether a walk from z to F may be begun with the contacts of `level`."""
    covered = np.empty((len(F), TILE), dtype=np.bool_)
    reach = unit.patches[level].reach - 2.0 * ROOM
    list_covers(F, z, unit.position, reach, unit.cell.repulsion_cutoff, covered)
    return covered


@dataclass(frozen=True, slots=True)
class Walked:
    """The end of the way of m points.

    Attributes:
        solved: at the end of the way; of no meaning for points that have not arrived.
        arrived: (m,) whether a stable equilibrium was found at the end.
        unstable: (m,) whether the way ended at an equilibrium with no stable one below it.
        left: (m,) whether a branch was left on the way.
        newton_solves: how many it took.
    """

    solved: Equilibria
    arrived: Flags
    unstable: Flags
    left: Flags
    newton_solves: int


class Walker:
    """Follows equilibria of one unit cell with one list of contacts."""

    def __init__(self, unit: UnitCell, topology: Topology, tolerance: float) -> None:
        self.unit, self.topology, self.tolerance = unit, topology, tolerance

    def walk(self, start: Reals, end: Reals, z: Reals) -> Walked:
        """From z (m, 2, n) at F = `start` to F = `end`, (m, 2, 2) each.

        A rotation of F between the two is made at once: it leaves z as it is.
        """
        z, count, solves = z.copy(), len(z), 0
        start = rotation(end) @ transpose(rotation(start)) @ start
        way = np.maximum(np.abs(end - start).max(axis=(1, 2)), SHORTEST)
        longest, shortest = np.minimum(1.0, LONGEST / way), SHORTEST / way
        done, step = np.zeros(count), np.minimum(longest, 0.5)
        left, arrived, unstable = np.zeros((3, count), dtype=np.bool_)
        active, effort = np.arange(count), np.zeros(count)
        while len(active):
            effort[active] += 1.0
            part = np.minimum(done[active] + step[active], 1.0)
            t = part[:, None, None]
            F = (1.0 - t) * start[active] + t * end[active]
            trial = self.newton(F, z[active])
            solves += len(active)
            good, there = trial.stable & ~_jumped(trial.z, z[active]), trial.z
            stuck = np.flatnonzero(~good & (step[active] <= shortest[active]))
            if len(stuck):
                unstable[active[stuck]] = trial.found[stuck]
                there[stuck], good[stuck] = self._leave(F, z[active], trial, stuck)
                left[active[stuck]] |= good[stuck]
                effort[active[stuck]] += OF_LEAVING
                solves += len(stuck)
            lost = np.isin(np.arange(len(active)), stuck) & ~good
            z[active[good]] = there[good]
            done[active[good]] = part[good]
            step[active] = np.where(
                good,
                np.minimum(2.0 * step[active], longest[active]),
                np.maximum(0.5 * step[active], shortest[active]),
            )
            arrived[active] = good & (part >= 1.0)
            active = active[~arrived[active] & ~lost & (effort[active] < EFFORT)]
        return Walked(self.newton(end, z), arrived, unstable & ~arrived, left, solves + count)

    def newton(self, F: Reals, z: Reals) -> Equilibria:
        """The elastic equilibrium by Newton's method from z (m, 2, n)."""
        return relax(self.topology, self.unit.constants, z, F, self.tolerance)

    def _leave(
        self, F: Reals, z: Reals, trial: Equilibria, stuck: NDArray[np.intp]
    ) -> tuple[Reals, Flags]:
        """z of the points `stuck` in a stable state, and whether there is one.

        Down from the unstable equilibrium, or, where none was found or it lies far off, from the
        last stable one.
        """
        saddle = trial.found & ~trial.stable & ~_jumped(trial.z, z)
        begin = np.where(saddle[:, None, None], trial.z, z)[stuck]
        landscape = Landscape.of(F[stuck], self.topology, self.unit.constants)
        below, found = descend(landscape, begin)
        solved = self.newton(F[stuck], below)
        found &= solved.stable & ~paired(landscape, solved.z, np.arange(len(stuck)))
        return solved.z, found


def _jumped(z: Reals, before: Reals) -> Flags:
    jumped: Flags = np.abs(z - before).max(axis=(1, 2)) > JUMP
    return jumped


@parallel_kernel
def curvatures(F, z, topology, c, forces, slope):
    """Elastic forces −∂E/∂x (tiles, 2n − 2, TILE), µN, and their slope (tiles, size, TILE)."""
    for t in numba.prange(z.shape[0]):
        _curvature_tile(F[t], z[t], topology, c, forces[t], slope[t])


@kernel
def _curvature_tile(F, z, topology, c, forces, slope):
    work, no_columns = make_workspace(topology), np.empty((0, 8, TILE))
    place(work, z, F, topology)
    set_elastic_jacobian(work, F, topology, c, slope, no_columns)
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    for i in range(1, topology.particles):
        store(load(work.f, 0, i), forces, 2 * i - 2)
        store(load(work.f, 1, i), forces, 2 * i - 1)


@dataclass(frozen=True, slots=True)
class Landscape:
    """Elastic energy of m RVEs at deformations F (m, 2, 2); `of` takes any pattern of matrices."""

    F: Reals
    topology: Topology
    constants: Constants

    @classmethod
    def of(cls, F: Reals, topology: Topology, constants: Constants) -> Landscape:
        """With dense matrices, whatever those of the topology are: all eigenvalues are wanted."""
        dense = make_pattern(np.zeros(topology.particles, dtype=np.int32), [])
        return cls(F, topology._replace(**dense._asdict()), constants)

    def take(self, index: NDArray[np.intp]) -> Landscape:
        """That of the RVEs `index` alone."""
        return replace(self, F=self.F[index])

    def energy(self, z: Reals) -> Reals:
        """(m,) elastic energy at material positions z (m, 2, n), pJ."""
        return stored_energy(self.F, z, self.topology, self.constants)

    def slopes(self, z: Reals) -> tuple[Reals, Reals]:
        """Forces −∂E/∂x (m, 2n − 2), µN, and Hessian (m, 2n − 2, 2n − 2), µN/µm."""
        count, tiles, free = len(z), tiles_for(len(z)), 2 * z.shape[2] - 2
        forces, slope = np.empty((tiles, free, TILE)), np.empty((tiles, free * free, TILE))
        curvatures(pack(self.F), pack(z), self.topology, self.constants, forces, slope)
        return unpack(forces, count), -unpack(slope, count).reshape(count, free, free)

    def moved(self, z: Reals, step: Reals) -> Reals:
        """z after displacements δx = step (m, 2n − 2) of all particles but the first."""
        dz = np.linalg.solve(self.F, step.reshape(len(z), -1, 2).transpose(0, 2, 1))
        return z + np.pad(dz, ((0, 0), (0, 0), (1, 0)))


def descend(landscape: Landscape, z: Reals) -> tuple[Reals, Flags]:
    """From z (m, 2, n) down to a minimum of E.

    Returns:
        z there, and (m,) whether it is one: mean force below `RESTING`, Hessian positive definite.
    """
    z, found = z.copy(), np.zeros(len(z), dtype=np.bool_)
    active = np.arange(len(z))
    for _ in range(STEPS):
        active = active[~paired(landscape, z, active)]
        if not len(active):
            break
        here = landscape.take(active)
        forces, hessian = here.slopes(z[active])
        eigenvalues, modes = np.linalg.eigh(hessian)
        resting = _lengths(forces).mean(axis=1) < RESTING
        minimum = resting & (eigenvalues[:, 0] > 0.0)
        found[active[minimum]] = True
        active, here = active[~minimum], here.take(np.flatnonzero(~minimum))
        if not len(active):
            break
        rest = resting[~minimum, None]
        forces, eigenvalues, modes = forces[~minimum], eigenvalues[~minimum], modes[~minimum]
        kick = _limited(_kick(here.F, eigenvalues, modes), KICK, exactly=True)
        down = _limited(_newton_step(forces, eigenvalues, modes), DOWN)
        z[active], lower = _lower(here, z[active], np.where(rest, kick, down))
        active = active[lower]
    return z, found


def paired(landscape: Landscape, z: Reals, index: NDArray[np.intp]) -> Flags:
    """(len(index),) whether two fluid particles of an RVE have met: SPH's pairing instability.

    The model's forces between fluid particles vanish with their distance, so such a pair is an
    equilibrium of the numbers and none of the tissue.
    """
    walls = landscape.topology.walls
    i, j = (landscape.topology.fluid_pairs - walls).T
    x = (landscape.F[index] @ z[index])[:, :, walls:]
    nearest: Reals = np.linalg.norm(x[:, :, i] - x[:, :, j], axis=1).min(axis=1, initial=np.inf)
    return nearest < PAIRED


def _lower(landscape: Landscape, z: Reals, step: Reals) -> tuple[Reals, Flags]:
    """z after the step, halved until E falls; (m,) whether it does."""
    before, moved = landscape.energy(z), z.copy()
    open_points = np.arange(len(z))
    for _ in range(HALVINGS):
        here = landscape.take(open_points)
        trial = here.moved(z[open_points], step[open_points])
        lower = here.energy(trial) < before[open_points]
        moved[open_points[lower]] = trial[lower]
        open_points = open_points[~lower]
        if not len(open_points):
            break
        step = 0.5 * step
    falls = np.ones(len(z), dtype=np.bool_)
    falls[open_points] = False
    return moved, falls


def _newton_step(forces: Reals, eigenvalues: Reals, modes: Reals) -> Reals:
    stiffness = np.maximum(np.abs(eigenvalues), 1e-9 * np.abs(eigenvalues[:, -1:]))
    along = np.einsum("mik,mi->mk", modes, forces) / stiffness
    return np.einsum("mik,mk->mi", modes, along)


def _kick(F: Reals, eigenvalues: Reals, modes: Reals) -> Reals:
    particles = modes.shape[1] // 2
    angle = np.arange(1, particles + 1) * np.sqrt(2.0)
    pattern = F @ np.stack([np.cos(angle), np.sin(2.0 * angle)])
    pattern = pattern.transpose(0, 2, 1).reshape(len(F), -1)
    along = np.einsum("mik,mi->mk", modes, pattern) * np.maximum(-eigenvalues, 0.0)
    return np.einsum("mik,mk->mi", modes, along)


def _limited(step: Reals, longest: float, exactly: bool = False) -> Reals:
    """Steps (m, 2n − 2) with the longest displacement at most (or exactly) `longest`."""
    factor = longest / np.maximum(_lengths(step).max(axis=1), 1e-300)
    return step * (factor if exactly else np.minimum(factor, 1.0))[:, None]


def _lengths(vectors: Reals) -> Reals:
    """(m, n − 1) of vectors (m, 2n − 2)."""
    lengths: Reals = np.linalg.norm(vectors.reshape(len(vectors), -1, 2), axis=2)
    return lengths
