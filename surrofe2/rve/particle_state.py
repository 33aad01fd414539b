"""Particles of RVEs that follow (F, Ḟ): positions, forces, residual, stress.

Unknowns are material positions z, so that x = F z moves along with F, and velocities v = Ḟ z are
affine: v = L x. z of particle 0, a wall corner, stays at the origin.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, pair_law, parallel_kernel
from surrofe2.base.simd import TILE, load, root, spread, store
from surrofe2.plant_cell.forces import elastic_energy, fold_images, local_forces
from surrofe2.plant_cell.tiles import Constants, Topology, make_workspace, pack, tiles_for, unpack

Array = NDArray[np.float64]

LONGEST_STEP = 0.4
"""Longest Newton step of a particle, µm; contacts stiffen over r/7."""
ASTRAY = 1.2
"""Material displacement of a particle, µm, at which an equilibrium nearby is not sought on."""
PATIENCE = 6
"""From so many evaluations on the residual is to be halved by each while such is sought."""


class Drive(NamedTuple):
    """F and Ḟ (the rate that particles feel) of all tiles, (tiles, 2, 2, TILE)."""

    F: Array
    rate: Array


class Answer(NamedTuple):
    """What a solver says of all tiles.

    stress: (tiles, 2, 2, TILE) µN/µm. residual: (tiles, 1, TILE) mean force, µN.
    iterations: (tiles, TILE) evaluations of forces used; 0: to be solved, −1: not converged.
    stable: (tiles, TILE) whether the elastic Hessian is positive definite.
    """

    stress: Array
    residual: Array
    iterations: NDArray[np.int32]
    stable: NDArray[np.bool_]


def empty_answer(tiles: int) -> Answer:
    """Nothing solved, no stress, and all stable."""
    return Answer(
        stress=np.full((tiles, 2, 2, TILE), np.nan),
        residual=np.empty((tiles, 1, TILE)),
        iterations=np.zeros((tiles, TILE), dtype=np.int32),
        stable=np.ones((tiles, TILE), dtype=np.bool_),
    )


@kernel
def drive_of(drive, t):
    """The `Drive` of tile t."""
    return Drive(drive.F[t], drive.rate[t])


@kernel
def answer_of(answer, t):
    """The `Answer` of tile t."""
    return Answer(answer.stress[t], answer.residual[t], answer.iterations[t], answer.stable[t])


@kernel
def copy_particles(source, target):
    """Copy as many particles as both (2, …, TILE) have."""
    for axis in range(2):
        for i in range(min(source.shape[1], target.shape[1])):
            store(load(source, axis, i), target, axis, i)


@kernel
def keep_lane(source, k, target):
    """Copy lane k of an array with three axes to one that may be shorter along the second."""
    for a in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[a, i, k] = source[a, i, k]


@kernel
def limit_step(step):
    """Shorten the step of each lane to LONGEST_STEP; a step that is not finite to nothing."""
    for k in range(TILE):
        longest = 0.0
        for i in range(step.shape[0]):
            longest = max(longest, abs(step[i, k])) if step[i, k] == step[i, k] else np.inf
        if longest > LONGEST_STEP:
            factor = LONGEST_STEP / longest
            for i in range(step.shape[0]):
                step[i, k] = factor * step[i, k] if longest < np.inf else 0.0


@kernel
def give_up(z, start, count, residual, bound, iterations):
    """iterations −count where z is `ASTRAY` from the start, or the residual (TILE,) above bound."""
    for k in range(TILE):
        if count <= 1:
            bound[k] = residual[k]
        elif count >= PATIENCE:
            if iterations[k] == 0 and residual[k] > bound[k]:
                iterations[k] = -count
            bound[k] *= 0.5
        if iterations[k] == 0:
            farthest = 0.0
            for i in range(start.shape[1]):
                dx, dy = z[0, i, k] - start[0, i, k], z[1, i, k] - start[1, i, k]
                farthest = max(farthest, dx * dx + dy * dy)
            if farthest > ASTRAY * ASTRAY:
                iterations[k] = -count


@kernel
def set_images(z, topology):
    """Fill the image part of local material positions from its own part."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        for axis in range(2):
            store(load(z, axis, i) + topology.image_offset[k, axis], z, axis, own + k)


@pair_law
def entries(tensor):
    """(xx, xy, yx, yy) of a tensor (2, 2, TILE)."""
    return load(tensor, 0, 0), load(tensor, 0, 1), load(tensor, 1, 0), load(tensor, 1, 1)


@pair_law
def inverse(of):
    """The entries of the inverse of a tensor with the entries `of`."""
    xx, xy, yx, yy = of
    per_det = 1.0 / (xx * yy - xy * yx)
    return yy * per_det, -xy * per_det, -yx * per_det, xx * per_det


@kernel
def map_affine(F, z, x):
    """x = F z; F (2, 2, TILE), z and x (2, local, TILE)."""
    xx, xy, yx, yy = entries(F)
    for i in range(z.shape[1]):
        zx, zy = load(z, 0, i), load(z, 1, i)
        store(xx * zx + xy * zy, x, 0, i)
        store(yx * zx + yy * zy, x, 1, i)


@kernel
def place_images(work, F, topology):
    """Images of the own particles in work.z, and x = F z of all."""
    set_images(work.z, topology)
    map_affine(F, work.z, work.x)


@kernel
def place(work, z, F, topology):
    """Material positions z of own particles, their images, and x = F z of all."""
    copy_particles(z, work.z)
    place_images(work, F, topology)


@kernel
def cauchy_stress(x, f, F, area, stress):
    """Virial stress (eq. 57b) from unfolded local forces: σ = −1/V Σ_k f_k ⊗ x_k, µN/µm.

    Every pair adds f and −f to its two local particles, so the sum over pairs of f ⊗ r is minus
    the sum over local particles of force ⊗ position. V = det F times the reference area.
    """
    xx, xy, yx, yy = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for k in range(x.shape[1]):
        px, py = load(x, 0, k), load(x, 1, k)
        fx, fy = load(f, 0, k), load(f, 1, k)
        xx -= fx * px
        xy -= fx * py
        yx -= fy * px
        yy -= fy * py
    fxx, fxy, fyx, fyy = entries(F)
    per_volume = 1.0 / (area * (fxx * fyy - fxy * fyx))
    store(xx * per_volume, stress, 0, 0)
    store(xy * per_volume, stress, 0, 1)
    store(yx * per_volume, stress, 1, 0)
    store(yy * per_volume, stress, 1, 1)


@kernel
def mean_force(f, own, residual):
    """residual (1, TILE): mean over own particles of the folded force's magnitude, µN."""
    total = spread(0.0)
    for i in range(own):
        fx, fy = load(f, 0, i), load(f, 1, i)
        total += root(fx * fx + fy * fy)
    store(total * (1.0 / own), residual, 0)


@kernel
def measure(work, F, topology, c, stress, residual):
    """Forces (folded), stress and mean force at work.x and work.v."""
    local_forces(work, topology, c)
    cauchy_stress(work.x, work.f, F, topology.area, stress)
    fold_images(work.f, topology)
    mean_force(work.f, topology.particles, residual)


@kernel
def evaluate(work, drive, is_affine, topology, c, stress, residual):
    """`measure` at work.z with velocities v = rate z if `is_affine`, else those in work.v."""
    place_images(work, drive.F, topology)
    if is_affine:
        map_affine(drive.rate, work.z, work.v)
    measure(work, drive.F, topology, c, stress, residual)


@parallel_kernel
def stress_at(drive, z, topology, c, answer):
    """Stress and mean force at given z with affine velocities, all tiles."""
    for t in numba.prange(z.shape[0]):
        _stress_tile(drive_of(drive, t), z[t], topology, c, answer_of(answer, t))


@kernel
def _stress_tile(drive, z, topology, c, answer):
    work = make_workspace(topology)
    copy_particles(z, work.z)
    evaluate(work, drive, True, topology, c, answer.stress, answer.residual)


def stored_energy(F: Array, z: Array, topology: Topology, c: Constants) -> Array:
    """(m,) elastic energy at F (m, 2, 2) and material positions z (m, 2, n), pJ."""
    energy = np.empty((tiles_for(len(z)), 1, TILE))
    energies(pack(F), pack(z), topology, c, energy)
    return unpack(energy, len(z))[:, 0]


@parallel_kernel
def energies(F, z, topology, c, energy):
    """Elastic energy (tiles, 1, TILE) of every cell at z (tiles, 2, n, TILE), pJ."""
    for t in numba.prange(z.shape[0]):
        _energy_tile(F[t], z[t], topology, c, energy[t])


@kernel
def _energy_tile(F, z, topology, c, energy):
    work = make_workspace(topology)
    place(work, z, F, topology)
    elastic_energy(work.x, topology, c, energy)
