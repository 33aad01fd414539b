"""The way down the elastic energy E of an RVE that has met the end of its branch.

Newton's, with the modulus of every eigenvalue of the Hessian H = Σ λ q qᵀ::

    δx = Σ q (q·f)/|λ|,  halved until E falls,        f = −∂E/∂x

Where H is positive definite that is H⁻¹ f, and eigenvalues need not be known. At rest in a saddle f
says nothing, and the kick is the part of a fixed pattern w that lies in the unstable directions,
δx ∝ Σ_{λ<0} |λ| q (q·w): it depends neither on the sign nor on the choice of eigenvectors that
numpy returns. w is fixed in material coordinates, so a rotated RVE leaves along the rotated
direction. Which of two mirrored branches is reached is w's choice, and a reflected RVE may choose
the other.

Forces and Hessian are by x of all particles but the held one, ordered x₁, y₁, x₂, … as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np
import scipy  # scipy.linalg is loaded where an RVE leaves its branch
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.block_pattern import make_pattern
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.tiles import Constants, Topology, make_workspace, pack, tiles_for, unpack
from surrofe2.rve.block_lu import factorise, has_negative_pivots, solve
from surrofe2.rve.newton import set_elastic_jacobian, set_residual
from surrofe2.rve.particle_state import place, stored_energy
from surrofe2.simd import TILE, load, store

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

RESTING = 1e-4
"""Mean particle force below which a minimum is left to Newton's method, µN."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
DOWN = 0.4
"""Longest displacement of a particle in one step down, µm."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
LEAST = 1e-12
"""Stiffness of a mode that counts as one, over the largest of a particle."""
STEPS, HALVINGS = 100, 30
"""Steps down to a minimum, and halvings of each, after which there is none."""


@parallel_kernel
def curvatures(F, z, topology, c, forces, slope, stiff, step):
    """Elastic forces f = −∂E/∂x (tiles, 2n − 2, TILE), µN, and their slope (tiles, size, TILE).

    stiff (tiles, TILE): whether the Hessian H is positive definite; step: H⁻¹ f, of meaning there.
    """
    for t in numba.prange(z.shape[0]):
        _curvature_tile(F[t], z[t], topology, c, forces[t], slope[t], stiff[t], step[t])


@kernel
def _curvature_tile(F, z, topology, c, forces, slope, stiff, step):
    work, no_columns = make_workspace(topology), np.empty((0, 8, TILE))
    place(work, z, F, topology)
    set_elastic_jacobian(work, F, topology, c, slope, no_columns)
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    for i in range(1, topology.particles):
        store(load(work.f, 0, i), forces, 2 * i - 2)
        store(load(work.f, 1, i), forces, 2 * i - 1)
    factors = slope.copy()
    factorise(factors, topology, True)
    has_negative_pivots(factors, topology, stiff)
    set_residual(work.f, step)
    solve(factors, step, topology)


class Slopes(NamedTuple):
    """Of m RVEs: forces f = −∂E/∂x (m, 2n − 2), µN, and their slope (tiles, (2n − 2)², TILE).

    stiff: (m,) whether the Hessian H is positive definite; newton: H⁻¹ f there, µm.
    """

    forces: Reals
    slope: Reals
    stiff: Flags
    newton: Reals

    def hessian(self, k: int) -> Reals:
        """(2n − 2, 2n − 2) the Hessian of RVE k, µN/µm."""
        free = self.forces.shape[1]
        return -self.slope[k // TILE, :, k % TILE].reshape(free, free)


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

    def slopes(self, z: Reals) -> Slopes:
        """Forces and curvatures at material positions z (m, 2, n)."""
        count, tiles, free = len(z), tiles_for(len(z)), 2 * z.shape[2] - 2
        forces, step = np.empty((2, tiles, free, TILE))
        slope, stiff = np.empty((tiles, free * free, TILE)), np.empty((tiles, TILE), dtype=np.bool_)
        F = pack(self.F)
        curvatures(F, pack(z), self.topology, self.constants, forces, slope, stiff, step)
        return Slopes(unpack(forces, count), slope, unpack(stiff, count), unpack(step, count))

    def moved(self, z: Reals, step: Reals) -> Reals:
        """z after displacements δx = step (m, 2n − 2) of all particles but the first."""
        there = z.copy()
        there[:, :, 1:] += np.linalg.solve(self.F, step.reshape(len(z), -1, 2).transpose(0, 2, 1))
        return there


def descend(
    landscape: Landscape, z: Reals, most: NDArray[np.int_] | int = STEPS
) -> tuple[Reals, Flags, NDArray[np.int_]]:
    """From z (m, 2, n) down to a minimum of E, in at most so many steps.

    Returns:
        z there, (m,) whether it is one: mean force below `RESTING`, Hessian positive definite; and
        (m,) how many steps were tried.
    """
    z, found, tried = z.copy(), np.zeros(len(z), dtype=np.bool_), np.zeros(len(z), dtype=np.int_)
    limit, energy = np.minimum(np.full(len(z), most), STEPS), landscape.energy(z)
    active = np.arange(len(z))
    while True:
        active = active[tried[active] < limit[active]]
        active = active[~paired(landscape, z, active)]
        if not len(active):
            return z, found, tried
        tried[active] += 1
        here = landscape.take(active)
        slopes = here.slopes(z[active])
        resting = _lengths(slopes.forces).mean(axis=1) < RESTING
        found[active] = resting & slopes.stiff
        step = _step(here.F, slopes, resting)
        rest = np.flatnonzero(~found[active])
        active, here, step = active[rest], here.take(rest), step[rest]
        z[active], energy[active], lower = _lower(here, z[active], step, energy[active])
        active = active[lower]


def paired(landscape: Landscape, z: Reals, index: NDArray[np.intp]) -> Flags:
    """(len(index),) whether two fluid particles of an RVE have met: SPH's pairing instability.

    The model's forces between fluid particles vanish with their distance, so such a pair is an
    equilibrium of the numbers and none of the tissue.
    """
    walls = landscape.topology.walls
    i, j = (landscape.topology.fluid_pairs - walls).T
    x = landscape.F[index] @ z[index][:, :, walls:]
    apart = x[:, :, i] - x[:, :, j]
    nearest: Reals = (apart * apart).sum(axis=1).min(axis=1, initial=np.inf)
    return nearest < PAIRED**2


def _lower(
    landscape: Landscape, z: Reals, step: Reals, before: Reals
) -> tuple[Reals, Reals, Flags]:
    """z after the step, halved until E falls below that `before`, E there; (m,) whether it does."""
    moved, energy, falls = z.copy(), before.copy(), np.zeros(len(z), dtype=np.bool_)
    open_points = np.arange(len(z))
    for _ in range(HALVINGS):
        if not len(open_points):
            break
        here = landscape.take(open_points)
        trial = here.moved(z[open_points], step[open_points])
        found = here.energy(trial)
        lower = found < before[open_points]
        done = open_points[lower]
        moved[done], energy[done], falls[done] = trial[lower], found[lower], True
        open_points = open_points[~lower]
        step = 0.5 * step
    return moved, energy, falls


def _step(F: Reals, slopes: Slopes, resting: Flags) -> Reals:
    """(m, 2n − 2) the kick out of a saddle where an RVE is `resting` in one, else Newton's step."""
    step = slopes.newton.copy()
    for k in np.flatnonzero(~slopes.stiff):
        hessian = slopes.hessian(int(k))
        unstable, modes = scipy.linalg.eigh(
            hessian, subset_by_value=(-np.inf, 0.0), driver="evr", check_finite=False
        )
        if resting[k]:
            step[k] = modes @ (-unstable * (_pattern(F[k], len(step[k])) @ modes))
            step[k] *= KICK / max(_lengths(step[k, None]).max(), 1e-300)
        else:
            step[k] = _newton_step(slopes.forces[k], hessian, unstable, modes)
    return step * np.minimum(DOWN / np.maximum(_lengths(step).max(axis=1), 1e-300), 1.0)[:, None]


def _newton_step(forces: Reals, hessian: Reals, unstable: Reals, modes: Reals) -> Reals:
    """Σ q (q·f)/|λ|, as H⁻¹ f with the sign of the unstable modes turned."""
    least = LEAST * np.abs(np.diagonal(hessian)).max()  # a particle that touches nothing stays
    step: Reals = np.linalg.solve(hessian + least * np.eye(len(forces)), forces)
    along = (forces @ modes) * (1.0 / np.maximum(-unstable, least) - 1.0 / (unstable + least))
    return step + modes @ along


def _pattern(F: Reals, free: int) -> Reals:
    """(free,) displacements that single out one of mirrored branches, whatever F (2, 2)."""
    angle = np.arange(1, free // 2 + 1) * np.sqrt(2.0)
    return (F @ np.stack([np.cos(angle), np.sin(2.0 * angle)])).T.ravel()


def _lengths(vectors: Reals) -> Reals:
    """(m, n − 1) of vectors (m, 2n − 2)."""
    pairs = vectors.reshape(len(vectors), vectors.shape[1] // 2, 2)
    lengths: Reals = np.sqrt((pairs * pairs).sum(axis=2))
    return lengths
