"""The elastic energy of RVEs over particle positions: what a stable equilibrium is a minimum of.

Positions are material, x = F z, particle 0 held; forces and their slope are by x of the others,
ordered x₁, y₁, x₂, … as everywhere::

    energy     (tiles, TILE)                  pJ
    forces     (tiles, 2n − 2, TILE)          −∂E/∂x, µN
    slope      (tiles, 2n − 2, 2n − 2, TILE)  of the forces, −∂²E/∂x², µN/µm
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.forces import elastic_energy, fold_images
from surrofe2.rve.linear import copy_from
from surrofe2.rve.micro_state import local_forces, make_workspace, place
from surrofe2.rve.newton_steps import set_jacobian
from surrofe2.rve.systems import make_matrices
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
