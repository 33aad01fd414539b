"""Leaving an unstable equilibrium: down the elastic energy along its unstable directions.

Where an equilibrium loses stability, particles move on until the elastic energy E is at a
minimum (docs/theory.md). The way down is Newton's, with the modulus of every eigenvalue of the
Hessian H = Σ λ q qᵀ::

    δx = Σ q (q·f)/|λ|,  halved until E falls,        f = −∂E/∂x

At rest in a saddle f says nothing, and the kick is the part of a fixed pattern w that lies in the
unstable directions, δx ∝ Σ_{λ<0} |λ| q (q·w): it depends neither on the sign nor on the choice of
eigenvectors that numpy returns. w is fixed in material coordinates, so a rotated RVE leaves
along the rotated direction. Which of two mirrored branches is reached is w's choice, and a
reflected RVE may choose the other.

Positions are material, x = F z, particle 0 held; forces and Hessian are by x of the others,
ordered x₁, y₁, x₂, … as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.forces import elastic_energy, fold_images
from surrofe2.plant_cell.tiles import Constants, Topology, pack, tiles_for, unpack
from surrofe2.rve.linear import copy_from
from surrofe2.rve.newton import set_jacobian
from surrofe2.rve.particle_state import local_forces, make_workspace, place
from surrofe2.rve.systems import AnyTopology, make_matrices
from surrofe2.simd import TILE, load, store


@parallel_kernel
def energies(F, z, topology, c, energy):
    """Elastic energy of every cell at z (tiles, 2, n, TILE)."""
    for t in numba.prange(z.shape[0]):
        _energy_tile(F[t], z[t], topology, c, energy[t])


@kernel
def _energy_tile(F, z, topology, c, energy):
    work, total = make_workspace(topology), np.empty((1, TILE))
    place(work, z, F, topology)
    elastic_energy(work.x, topology, c, total)
    energy[:] = total[0]


@parallel_kernel
def curvatures(F, z, topology, c, forces, slope):
    """Elastic forces and their slope of every cell at z (tiles, 2, n, TILE)."""
    for t in numba.prange(z.shape[0]):
        _curvature_tile(F[t], z[t], topology, c, forces[t], slope[t])


@kernel
def _curvature_tile(F, z, topology, c, forces, slope):
    work, matrices = make_workspace(topology), make_matrices(topology)
    place(work, z, F, topology)
    work.v[:] = 0.0
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    for i in range(1, topology.particles):
        store(load(work.f, 0, i), forces, 2 * i - 2)
        store(load(work.f, 1, i), forces, 2 * i - 1)
    still = np.zeros((2, 2, TILE))
    set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.no_columns)
    copy_from(matrices.jacobian, 2, slope)


Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

RESTING = 1e-4
"""Mean particle force below which a minimum is left to Newton's method, µN."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
LONGEST_STEP = 0.4
"""Longest displacement of a particle in one step down, µm."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
STEPS, HALVINGS = 200, 30


@dataclass(frozen=True, slots=True)
class Landscape:
    """Elastic energy of m RVEs at deformations F (m, 2, 2); `of` takes any kind of topology."""

    F: Reals
    topology: Topology
    constants: Constants

    @classmethod
    def of(cls, F: Reals, topology: AnyTopology, constants: Constants) -> Landscape:
        """With dense matrices, whatever those of the topology are: all eigenvalues are wanted."""
        dense = Topology(*(getattr(topology, name) for name in Topology._fields))
        return cls(F, dense, constants)

    def take(self, index: NDArray[np.intp]) -> Landscape:
        """That of the RVEs `index` alone."""
        return replace(self, F=self.F[index])

    def energy(self, z: Reals) -> Reals:
        """(m,) elastic energy at material positions z (m, 2, n), pJ."""
        energy = np.empty((tiles_for(len(z)), TILE))
        energies(pack(self.F), pack(z), self.topology, self.constants, energy)
        return unpack(energy, len(z))

    def slopes(self, z: Reals) -> tuple[Reals, Reals]:
        """Forces −∂E/∂x (m, 2n − 2), µN, and Hessian (m, 2n − 2, 2n − 2), µN/µm."""
        tiles, free = tiles_for(len(z)), 2 * z.shape[2] - 2
        forces, slope = np.empty((tiles, free, TILE)), np.empty((tiles, free, free, TILE))
        curvatures(pack(self.F), pack(z), self.topology, self.constants, forces, slope)
        return unpack(forces, len(z)), -unpack(slope, len(z))

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
        resting = _mean(forces) < RESTING
        minimum = resting & (eigenvalues[:, 0] > 0.0)
        found[active[minimum]] = True
        active, here = active[~minimum], here.take(np.flatnonzero(~minimum))
        if not len(active):
            break
        rest = resting[~minimum, None]
        forces, eigenvalues, modes = forces[~minimum], eigenvalues[~minimum], modes[~minimum]
        kick = _limited(_kick(here.F, eigenvalues, modes), KICK, exactly=True)
        down = _limited(_newton_step(forces, eigenvalues, modes), LONGEST_STEP)
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
    pattern = _as_flat(F @ np.stack([np.cos(angle), np.sin(2.0 * angle)]))
    along = np.einsum("mik,mi->mk", modes, pattern) * np.maximum(-eigenvalues, 0.0)
    return np.einsum("mik,mk->mi", modes, along)


def _limited(step: Reals, longest: float, exactly: bool = False) -> Reals:
    """Steps (m, 2n − 2) with the longest displacement at most (or exactly) `longest`."""
    length = np.linalg.norm(step.reshape(len(step), -1, 2), axis=2).max(axis=1)
    factor = longest / np.maximum(length, 1e-300)
    return step * (factor if exactly else np.minimum(factor, 1.0))[:, None]


def _mean(forces: Reals) -> Reals:
    lengths = np.linalg.norm(forces.reshape(len(forces), -1, 2), axis=2)
    mean: Reals = lengths.mean(axis=1)
    return mean


def _as_flat(x: Reals) -> Reals:
    return np.ascontiguousarray(x.transpose(0, 2, 1)).reshape(len(x), -1)
