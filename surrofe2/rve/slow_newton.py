"""Slow-manifold positions by Newton's method, where a kept factorisation does not get there.

Near a bifurcation one mode of the cell is soft: the viscous forces move the particles far along
it, and the elastic Jacobian at z_el, which `slow_manifold.follow` keeps, misleads. Here the
velocities v = Ḟ z_el + F y follow from one exact solve, y = ∂z_el/∂F : Ḟ, and f(F z, v) = 0 is
solved with the Jacobian of the moment.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.forces import fold_images
from surrofe2.plant_cell.simd import TILE, load, store
from surrofe2.rve.direct import (
    NEWTON_LIMIT,
    hold,
    limit_step,
    move,
    set_jacobian,
    set_residual,
)
from surrofe2.rve.elastic_modes import equilibrium_modes, material_rate
from surrofe2.rve.micro_state import (
    cauchy_stress,
    copy_particles,
    keep_lane,
    local_forces,
    make_workspace,
    map_affine,
    mean_force,
    set_images,
)
from surrofe2.rve.slow_manifold import set_velocities
from surrofe2.rve.systems import factorise_free, make_matrices, solve


@parallel_kernel
def newton_slow(
    F, rate, z, elastic, fluctuation, topology, c, area, tolerance, stress, iterations
):  # fmt: skip
    """z, v − L x and stress from z_el in lanes with iterations ≤ 0, in place; (tiles, …, TILE).

    iterations becomes the number of force evaluations there, or −1.
    """
    for t in numba.prange(z.shape[0]):
        _newton_tile(
            F[t], rate[t], z[t], elastic[t], fluctuation[t], topology, c, area, tolerance,
            stress[t], iterations[t],
        )  # fmt: skip


@kernel
def _newton_tile(
    F, rate, z, elastic, fluctuation, topology, c, area, tolerance, stress, iterations
):  # fmt: skip
    own = topology.particles
    work, matrices = make_workspace(topology), make_matrices(topology)
    sigma, residual = np.empty((2, 2, TILE)), np.empty((1, TILE))
    still = np.zeros((2, 2, TILE))
    wanted = iterations <= 0
    for k in range(TILE):
        iterations[k] = 0 if wanted[k] else iterations[k]
    copy_particles(elastic, work.z)
    set_images(work.z, topology)
    y = material_rate(equilibrium_modes(work, F, topology, c, matrices), rate)
    set_velocities(work.z, y, F, rate, topology, work.v)
    for count in range(1, NEWTON_LIMIT + 1):
        set_images(work.z, topology)
        map_affine(F, work.z, work.x)
        local_forces(work, topology, c)
        cauchy_stress(work.x, work.f, F, area, sigma)
        fold_images(work.f, topology)
        mean_force(work.f, own, residual)
        left = 0
        for k in range(TILE):
            if iterations[k] == 0:
                if residual[0, k] <= tolerance:
                    iterations[k] = count
                    keep_lane(sigma, k, stress)
                elif not residual[0, k] < np.inf or count == NEWTON_LIMIT:
                    iterations[k] = -1
                else:
                    left += 1
        if left == 0:
            break
        set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.no_columns)
        factorise_free(matrices, topology)
        set_residual(work.f, matrices.step)
        solve(matrices.free, matrices.step, topology)
        limit_step(matrices.step)
        hold(matrices.step, iterations)
        move(matrices.step, F, work.z)
    _keep(work, rate, wanted, iterations, z, fluctuation)


@kernel
def _keep(work, rate, wanted, iterations, z, fluctuation):
    affine = np.empty_like(work.v)
    map_affine(rate, work.z, affine)
    for axis in range(2):
        for i in range(z.shape[1]):
            store(load(work.v, axis, i) - load(affine, axis, i), affine, axis, i)
    for k in range(TILE):
        if wanted[k] and iterations[k] > 0:
            keep_lane(work.z, k, z)
            keep_lane(affine, k, fluctuation)
