"""The fixed point of constrained runs solved directly (not in the paper; model.md).

At the fixed point of (69) to (72) v_i = L x_i and f_i(x, L x) = 0 for every particle. `chord`
corrects with a kept factorisation after a linear prediction; `newton` refactorises. With the
rate at zero both find the elastic equilibrium (65).

Kept per point, besides material positions z at (F, Ḟ): the LU factors of the force Jacobian in
single precision (they only precondition; the residual is double), and the slopes
∂z/∂(F, Ḟ), both taken at the last factorisation::

    lu      (tiles, 2n − 2, 2n − 2, TILE)     particle 0 is held
    slopes  (tiles, 2n − 2, 8, TILE)          columns ∂F_xx, xy, yx, yy, ∂Ḟ_xx, xy, yx, yy
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.plant_cell.jacobian import force_jacobian
from surrofe2.plant_cell.lanes import TILE, kernel, parallel_kernel
from surrofe2.rve.linear import factorise, solve_factorised
from surrofe2.rve.micro_state import evaluate, map_affine, set_images

BLOCK = 5
"""Tiles that `chord` works on at once: 40 lanes."""
CHORD_LIMIT = 10
NEWTON_LIMIT = 40
LONGEST_STEP = 0.4
"""Longest Newton step of a particle, µm; contacts stiffen over r/7."""


@parallel_kernel
def chord(F, rate, z, at_F, at_rate, lu, slopes, topology, c, area, tolerance, stress, iterations):
    """Solve from z, known at (at_F, at_rate), in place; all (tiles, …, TILE).

    iterations (tiles, TILE): force evaluations used, or −1 where the point did not converge.
    """
    tiles = z.shape[0]
    for block in numba.prange((tiles + BLOCK - 1) // BLOCK):
        first = block * BLOCK
        _chord_block(
            first, min(first + BLOCK, tiles), F, rate, z, at_F, at_rate, lu, slopes, topology, c,
            area, tolerance, stress, iterations,
        )  # fmt: skip


@kernel
def _chord_block(
    first, last, F, rate, z, at_F, at_rate, lu, slopes, topology, c, area, tolerance, stress,
    iterations,
):  # fmt: skip
    own = topology.particles
    local = own + topology.owner.shape[0]
    lanes = (last - first) * TILE
    zs, x, v, f = (
        np.empty((2, local, lanes)), np.empty((2, local, lanes)),
        np.empty((2, local, lanes)), np.empty((2, local, lanes)),
    )  # fmt: skip
    slope = np.empty((topology.fluid_pairs.shape[0], lanes))
    volume = np.empty((own - topology.walls, lanes))
    Fs, rates, sigma = np.empty((2, 2, lanes)), np.empty((2, 2, lanes)), np.empty((2, 2, lanes))
    residual, before = np.empty(lanes), np.full(lanes, np.inf)
    step = np.empty((2 * own - 2, TILE))
    for t in range(first, last):
        lane0 = (t - first) * TILE
        _gather(F[t], Fs, lane0)
        _gather(rate[t], rates, lane0)
        _predict(z[t], F[t], rate[t], at_F[t], at_rate[t], slopes[t], zs, lane0)
        iterations[t] = 0
    for count in range(1, CHORD_LIMIT + 1):
        evaluate(zs, Fs, rates, topology, c, area, x, v, f, slope, volume, sigma, residual)
        open_lanes = 0
        for t in range(first, last):
            lane0 = (t - first) * TILE
            for k in range(TILE):
                lane = lane0 + k
                if iterations[t, k] != 0:
                    continue
                if residual[lane] <= tolerance:
                    iterations[t, k] = count
                    stress[t, :, :, k] = sigma[:, :, lane]
                elif not residual[lane] < 0.5 * before[lane] or count == CHORD_LIMIT:
                    iterations[t, k] = -1
                else:
                    open_lanes += 1
                before[lane] = residual[lane]
        if open_lanes == 0:
            break
        for t in range(first, last):
            _step_chord(lu[t], f, Fs, zs, (t - first) * TILE, iterations[t], step)
    for t in range(first, last):
        lane0 = (t - first) * TILE
        for k in range(TILE):
            if iterations[t, k] > 0:
                z[t, :, :, k] = zs[:, :own, lane0 + k]


@kernel
def _gather(tensor, block, lane0):
    for a in range(2):
        for b in range(2):
            for k in range(TILE):
                block[a, b, lane0 + k] = tensor[a, b, k]


@kernel
def _predict(z, F, rate, at_F, at_rate, slopes, zs, lane0):
    """z + ∂z/∂F (F − F₀) + ∂z/∂Ḟ (Ḟ − Ḟ₀) into lanes lane0… of the block."""
    change = np.empty((8, TILE))
    for a in range(2):
        for b in range(2):
            for k in range(TILE):
                change[2 * a + b, k] = F[a, b, k] - at_F[a, b, k]
                change[4 + 2 * a + b, k] = rate[a, b, k] - at_rate[a, b, k]
    for axis in range(2):
        for k in range(TILE):
            zs[axis, 0, lane0 + k] = z[axis, 0, k]
        for i in range(1, z.shape[1]):
            for k in range(TILE):
                moved = z[axis, i, k]
                for m in range(8):
                    moved += slopes[2 * i - 2 + axis, m, k] * change[m, k]
                zs[axis, i, lane0 + k] = moved


@kernel
def _step_chord(lu, f, Fs, zs, lane0, iterations, step):
    own = step.shape[0] // 2 + 1
    for i in range(1, own):
        for axis in range(2):
            for k in range(TILE):
                step[2 * i - 2 + axis, k] = -f[axis, i, lane0 + k]
    solve_factorised(lu, step)
    for k in range(TILE):
        if iterations[k] != 0:
            step[:, k] = 0.0
    _move(step, Fs, zs, lane0)


@kernel
def _move(step, Fs, zs, lane0):
    """z += F⁻¹ δx on own particles but the held one."""
    for k in range(TILE):
        lane = lane0 + k
        a, b, d, e = Fs[0, 0, lane], Fs[0, 1, lane], Fs[1, 0, lane], Fs[1, 1, lane]
        det = a * e - b * d
        for i in range(1, step.shape[0] // 2 + 1):
            dx, dy = step[2 * i - 2, k], step[2 * i - 1, k]
            zs[0, i, lane] += (e * dx - b * dy) / det
            zs[1, i, lane] += (a * dy - d * dx) / det


@parallel_kernel
def newton(
    F, rate, z, lu, slopes, wanted, topology, c, area, tolerance, stress, iterations, stable
):
    """Newton with limited steps from z for the tiles that `wanted` (tiles,) marks, in place.

    Only lanes with iterations ≤ 0 move; iterations becomes the number of force evaluations, or
    −1. stable (tiles, TILE): whether the elastic Hessian at the solution is positive definite.
    """
    for t in numba.prange(z.shape[0]):
        if wanted[t]:
            _newton_tile(
                F[t], rate[t], z[t], lu[t], slopes[t], topology, c, area, tolerance, stress[t],
                iterations[t], stable[t],
            )  # fmt: skip


@kernel
def _newton_tile(
    F, rate, z, lu, slopes, topology, c, area, tolerance, stress, iterations, stable
):
    own = topology.particles
    local = own + topology.owner.shape[0]
    n = 2 * own
    zs, x, v, f = (
        np.empty((2, local, TILE)), np.empty((2, local, TILE)),
        np.empty((2, local, TILE)), np.empty((2, local, TILE)),
    )  # fmt: skip
    slope = np.empty((topology.fluid_pairs.shape[0], TILE))
    volume = np.empty((own - topology.walls, TILE))
    sigma, residual = np.empty((2, 2, TILE)), np.empty(TILE)
    jacobian, load = np.empty((n, n, TILE)), np.empty((n, 8, TILE))
    a, step = np.empty((n - 2, n - 2, TILE)), np.empty((n - 2, TILE))
    zs[:, :own] = z
    for k in range(TILE):
        if iterations[k] <= 0:
            iterations[k] = 0
    for count in range(1, NEWTON_LIMIT + 1):
        evaluate(zs, F, rate, topology, c, area, x, v, f, slope, volume, sigma, residual)
        open_lanes = 0
        for k in range(TILE):
            if iterations[k] != 0:
                continue
            if residual[k] <= tolerance:
                iterations[k] = count
                stress[:, :, k] = sigma[:, :, k]
            elif not residual[k] < np.inf or count == NEWTON_LIMIT:
                iterations[k] = -1
            else:
                open_lanes += 1
        if open_lanes == 0:
            break
        force_jacobian_at(zs, F, rate, x, v, topology, c, jacobian, load)
        a[:] = jacobian[2:, 2:]
        factorise(a)
        for i in range(1, own):
            for axis in range(2):
                for k in range(TILE):
                    step[2 * i - 2 + axis, k] = -f[axis, i, k]
        solve_factorised(a, step)
        _limit(step, iterations)
        _move(step, F, zs, 0)
    z[:] = zs[:, :own]
    refactorise(zs, F, rate, x, v, topology, c, jacobian, load, a, step, lu, slopes, stable)


@kernel
def _limit(step, iterations):
    for k in range(TILE):
        longest = 0.0
        for i in range(step.shape[0]):
            longest = max(longest, abs(step[i, k]))
        scale = 0.0
        if iterations[k] == 0 and longest < np.inf:
            scale = min(1.0, LONGEST_STEP / longest)
        for i in range(step.shape[0]):
            step[i, k] = scale * step[i, k] if scale > 0.0 else 0.0


@kernel
def force_jacobian_at(zs, F, rate, x, v, topology, c, jacobian, load):
    """`force_jacobian` with L = rate F⁻¹, for local z, x, v in place."""
    L = np.empty((2, 2, TILE))
    for k in range(TILE):
        det = F[0, 0, k] * F[1, 1, k] - F[0, 1, k] * F[1, 0, k]
        for i in range(2):
            L[i, 0, k] = (rate[i, 0, k] * F[1, 1, k] - rate[i, 1, k] * F[1, 0, k]) / det
            L[i, 1, k] = (rate[i, 1, k] * F[0, 0, k] - rate[i, 0, k] * F[0, 1, k]) / det
    force_jacobian(x, v, L, zs, topology, c, jacobian, load)


@kernel
def refactorise(zs, F, rate, x, v, topology, c, jacobian, load, a, step, lu, slopes, stable):
    """Fill lu, slopes and stable of a tile at local z (images set)."""
    map_affine(F, zs, x)
    map_affine(rate, zs, v)
    force_jacobian_at(zs, F, rate, x, v, topology, c, jacobian, load)
    a[:] = jacobian[2:, 2:]
    factorise(a)
    lu[:] = a
    for m in range(8):
        step[:] = -load[2:, m]
        solve_factorised(a, step)
        for k in range(TILE):
            det = F[0, 0, k] * F[1, 1, k] - F[0, 1, k] * F[1, 0, k]
            for i in range(0, step.shape[0], 2):
                dx, dy = step[i, k], step[i + 1, k]
                slopes[i, m, k] = (F[1, 1, k] * dx - F[0, 1, k] * dy) / det
                slopes[i + 1, m, k] = (F[0, 0, k] * dy - F[1, 0, k] * dx) / det
    check_stable(zs, F, x, v, topology, c, jacobian, load, a, stable)


@kernel
def check_stable(zs, F, x, v, topology, c, jacobian, load, a, stable):
    """stable (TILE,): whether the elastic Hessian, dashpots off, is positive definite."""
    zero = np.zeros((2, 2, TILE))
    map_affine(F, zs, x)
    v[:] = 0.0
    force_jacobian(x, v, zero, zs, topology, c, jacobian, load)
    a[:] = jacobian[2:, 2:]
    factorise(a)
    for k in range(TILE):
        stable[k] = True
        for i in range(a.shape[0]):
            if not a[i, i, k] < 0.0:
                stable[k] = False


@parallel_kernel
def renew(F, rate, z, lu, slopes, wanted, topology, c, stable):
    """Check stability of every tile; refill lu and slopes of the `wanted` ones."""
    own = topology.particles
    n = 2 * own
    for t in numba.prange(z.shape[0]):
        local = own + topology.owner.shape[0]
        zs, x, v = (
            np.empty((2, local, TILE)), np.empty((2, local, TILE)), np.empty((2, local, TILE)),
        )  # fmt: skip
        jacobian, load = np.empty((n, n, TILE)), np.empty((n, 8, TILE))
        a, step = np.empty((n - 2, n - 2, TILE)), np.empty((n - 2, TILE))
        zs[:, :own] = z[t]
        set_images(zs, topology)
        if wanted[t]:
            refactorise(
                zs, F[t], rate[t], x, v, topology, c, jacobian, load, a, step, lu[t], slopes[t],
                stable[t],
            )  # fmt: skip
        else:
            check_stable(zs, F[t], x, v, topology, c, jacobian, load, a, stable[t])


@parallel_kernel
def stress_at(F, rate, z, topology, c, area, stress, residual):
    """Stress and mean force at given z with affine velocities, all tiles."""
    own = topology.particles
    local = own + topology.owner.shape[0]
    for t in numba.prange(z.shape[0]):
        zs, x, v, f = (
            np.empty((2, local, TILE)), np.empty((2, local, TILE)),
            np.empty((2, local, TILE)), np.empty((2, local, TILE)),
        )  # fmt: skip
        slope = np.empty((topology.fluid_pairs.shape[0], TILE))
        volume = np.empty((own - topology.walls, TILE))
        zs[:, :own] = z[t]
        evaluate(
            zs, F[t], rate[t], topology, c, area, x, v, f, slope, volume, stress[t], residual[t]
        )
