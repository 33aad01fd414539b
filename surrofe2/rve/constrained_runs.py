"""Constrained runs as the paper iterates them: Euler step, then rescaling (eqs. 69 to 72).

Under periodic boundaries the three corners are images of one particle, so they move alike but
for the lattice: after the step the lattice is (F + Δt Ḟ) A₀, hence P = F (F + Δt Ḟ)⁻¹ in (70)
and Q = 0 in (71), and the corner is shifted back to the origin at rest.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.plant_cell.forces import fold_images
from surrofe2.plant_cell.lanes import TILE, kernel, parallel_kernel
from surrofe2.rve.micro_state import cauchy_stress, local_forces, mean_force


@parallel_kernel
def iterate(F, rate, x, v, mass, topology, c, area, dt, stop, limit, stress, residual, iterations):
    """Iterate x, v (tiles, 2, own, TILE) in place until the mean force is below `stop` (µN).

    iterations (tiles, TILE): Euler steps taken, or −1 where `limit` was reached.
    """
    for t in numba.prange(x.shape[0]):
        _iterate_tile(
            F[t], rate[t], x[t], v[t], mass, topology, c, area, dt, stop, limit, stress[t],
            residual[t], iterations[t],
        )  # fmt: skip


@kernel
def _iterate_tile(
    F, rate, x_own, v_own, mass, topology, c, area, dt, stop, limit, stress, residual, iterations
):
    own = topology.particles
    local = own + topology.owner.shape[0]
    x, v, f = np.empty((2, local, TILE)), np.empty((2, local, TILE)), np.empty((2, local, TILE))
    slope = np.empty((topology.fluid_pairs.shape[0], TILE))
    volume = np.empty((own - topology.walls, TILE))
    sigma, mean = np.empty((2, 2, TILE)), np.empty(TILE)
    rescale = _rescaling(F, rate, dt)
    x[:, :own] = x_own
    v[:, :own] = v_own
    done = np.zeros(TILE, dtype=np.bool_)
    for count in range(limit + 1):
        _set_moving_images(F, rate, x, v, topology)
        local_forces(x, v, topology, c, f, slope, volume)
        cauchy_stress(x, f, F, area, sigma)
        fold_images(f, topology)
        mean_force(f, own, mean)
        open_lanes = 0
        for k in range(TILE):
            if done[k]:
                continue
            if mean[k] < stop or not mean[k] < np.inf or count == limit:
                done[k] = True
                iterations[k] = count if mean[k] < stop else -1
                residual[k] = mean[k]
                stress[:, :, k] = sigma[:, :, k]
                x_own[:, :, k] = x[:, :own, k]
                v_own[:, :, k] = v[:, :own, k]
            else:
                open_lanes += 1
        if open_lanes == 0:
            break
        _euler_step(x, v, f, mass, rescale, own, dt)


@kernel
def _rescaling(F, rate, dt):
    """P = F (F + Δt Ḟ)⁻¹ (eq. 70), (2, 2, TILE)."""
    P = np.empty((2, 2, TILE))
    for k in range(TILE):
        a, b = F[0, 0, k] + dt * rate[0, 0, k], F[0, 1, k] + dt * rate[0, 1, k]
        d, e = F[1, 0, k] + dt * rate[1, 0, k], F[1, 1, k] + dt * rate[1, 1, k]
        det = a * e - b * d
        for i in range(2):
            P[i, 0, k] = (F[i, 0, k] * e - F[i, 1, k] * d) / det
            P[i, 1, k] = (F[i, 1, k] * a - F[i, 0, k] * b) / det
    return P


@kernel
def _set_moving_images(F, rate, x, v, topology):
    own = topology.particles
    for m in range(topology.owner.shape[0]):
        i = topology.owner[m]
        sx, sy = topology.image_offset[m, 0], topology.image_offset[m, 1]
        for axis in range(2):
            for k in range(TILE):
                x[axis, own + m, k] = x[axis, i, k] + F[axis, 0, k] * sx + F[axis, 1, k] * sy
                v[axis, own + m, k] = v[axis, i, k] + rate[axis, 0, k] * sx + rate[axis, 1, k] * sy


@kernel
def _euler_step(x, v, f, mass, P, own, dt):
    """(69), then (72): x ← P (x̂ − x̂₁), v ← v̂ − v̂₁."""
    for i in range(own - 1, -1, -1):  # the corner, particle 0, last: the others need it
        for k in range(TILE):
            hx = x[0, i, k] + dt * v[0, i, k] - x[0, 0, k] - dt * v[0, 0, k]
            hy = x[1, i, k] + dt * v[1, i, k] - x[1, 0, k] - dt * v[1, 0, k]
            for axis in range(2):
                v[axis, i, k] += dt * (f[axis, i, k] / mass[i] - f[axis, 0, k] / mass[0])
            x[0, i, k] = P[0, 0, k] * hx + P[0, 1, k] * hy
            x[1, i, k] = P[1, 0, k] * hx + P[1, 1, k] * hy
    v[:, 0] = 0.0
