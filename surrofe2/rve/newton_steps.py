"""Newton's method on material positions: the steps that all solvers of an RVE are made of.

A solver evaluates forces, asks `settle` which lanes are done, and moves the others on. In
iterations (TILE,) 0 marks a lane still under way, −1 one that was given up.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.plant_cell.jacobian import force_jacobian
from surrofe2.rve.micro_state import keep_lane, map_affine, measure, place_images
from surrofe2.rve.system_solves import solve
from surrofe2.rve.systems import factorise_free
from surrofe2.simd import TILE, load, store

NEWTON_LIMIT = 40
LONGEST_STEP = 0.4
"""Longest Newton step of a particle, µm; contacts stiffen over r/7."""


@kernel
def predict(z, F, rate, at_F, at_rate, slopes, there):
    """z + ∂z/∂F (F − F₀) + ∂z/∂Ḟ (Ḟ − Ḟ₀) into `there`."""
    f0, f1 = load(F, 0, 0) - load(at_F, 0, 0), load(F, 0, 1) - load(at_F, 0, 1)
    f2, f3 = load(F, 1, 0) - load(at_F, 1, 0), load(F, 1, 1) - load(at_F, 1, 1)
    r0, r1 = load(rate, 0, 0) - load(at_rate, 0, 0), load(rate, 0, 1) - load(at_rate, 0, 1)
    r2, r3 = load(rate, 1, 0) - load(at_rate, 1, 0), load(rate, 1, 1) - load(at_rate, 1, 1)
    for axis in range(2):
        store(load(z, axis, 0), there, axis, 0)
        for i in range(1, z.shape[1]):
            m = 2 * i - 2 + axis
            by_F = load(slopes, m, 0) * f0 + load(slopes, m, 1) * f1
            by_F += load(slopes, m, 2) * f2 + load(slopes, m, 3) * f3
            by_rate = load(slopes, m, 4) * r0 + load(slopes, m, 5) * r1
            by_rate += load(slopes, m, 6) * r2 + load(slopes, m, 7) * r3
            store(load(z, axis, i) + (by_F + by_rate), there, axis, i)


@kernel
def settle(residual, before, contraction, tolerance, count, limit, source, target, iterations):
    """How many lanes are left under way at evaluation `count`, at most `limit`.

    iterations becomes count where the residual (1, TILE) is within tolerance; there the lane of
    source goes to target. It becomes −1 where the residual is not below `contraction` times the
    one `before` (TILE,), which it then replaces.
    """
    left = 0
    for k in range(TILE):
        if iterations[k] == 0:
            if residual[0, k] <= tolerance:
                iterations[k] = count
                keep_lane(source, k, target)
            elif not residual[0, k] < contraction * before[k] or count == limit:
                iterations[k] = -1
            else:
                left += 1
            before[k] = residual[0, k]
    return left


@kernel
def correct(lu, f, step, iterations, F, z, topology):
    """z ← z − F⁻¹ J⁻¹ f in lanes under way."""
    set_residual(f, step)
    solve(lu, step, topology)
    hold(step, iterations)
    move(step, F, z)


@kernel
def set_residual(f, step):
    """step = −f of the free particles."""
    for i in range(1, step.shape[0] // 2 + 1):
        store(-load(f, 0, i), step, 2 * i - 2)
        store(-load(f, 1, i), step, 2 * i - 1)


@kernel
def hold(step, iterations):
    """No step in lanes that are done."""
    for k in range(TILE):
        if iterations[k] != 0:
            step[:, k] = 0.0


@kernel
def move(step, F, z):
    """z += F⁻¹ δx on own particles but the held one."""
    xx, xy, yx, yy = load(F, 0, 0), load(F, 0, 1), load(F, 1, 0), load(F, 1, 1)
    per_det = 1.0 / (xx * yy - xy * yx)
    for i in range(1, step.shape[0] // 2 + 1):
        dx, dy = load(step, 2 * i - 2), load(step, 2 * i - 1)
        store(load(z, 0, i) + (yy * dx - xy * dy) * per_det, z, 0, i)
        store(load(z, 1, i) + (xx * dy - yx * dx) * per_det, z, 1, i)


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
def set_jacobian(work, F, rate, topology, c, jacobian, columns):
    """`force_jacobian` at local z, x, v, with L = rate F⁻¹."""
    L = np.empty((2, 2, TILE))
    xx, xy, yx, yy = load(F, 0, 0), load(F, 0, 1), load(F, 1, 0), load(F, 1, 1)
    per_det = 1.0 / (xx * yy - xy * yx)
    for i in range(2):
        rx, ry = load(rate, i, 0), load(rate, i, 1)
        store((rx * yy - ry * yx) * per_det, L, i, 0)
        store((ry * xx - rx * xy) * per_det, L, i, 1)
    force_jacobian(work.x, work.v, L, work.z, topology, c, jacobian, columns)


@kernel
def newton_loop(
    work, matrices, F, rate, is_affine, topology, c, area, tolerance, stress, iterations
):
    """Newton's method with limited steps from work.z, in lanes with iterations ≤ 0.

    Velocities are rate z if `is_affine`, else what work.v holds; then rate is 0.
    """
    sigma, residual = np.empty((2, 2, TILE)), np.empty((1, TILE))
    before = np.empty(TILE)
    for k in range(TILE):
        before[k], iterations[k] = np.inf, max(iterations[k], 0)
    for count in range(1, NEWTON_LIMIT + 1):
        place_images(work, F, topology)
        if is_affine:
            map_affine(rate, work.z, work.v)
        measure(work, F, topology, c, area, sigma, residual)
        left = settle(
            residual, before, np.inf, tolerance, count, NEWTON_LIMIT, sigma, stress, iterations
        )
        if left == 0:
            break
        set_jacobian(work, F, rate, topology, c, matrices.jacobian, matrices.no_columns)
        factorise_free(matrices, topology)
        set_residual(work.f, matrices.step)
        solve(matrices.free, matrices.step, topology)
        limit_step(matrices.step)
        hold(matrices.step, iterations)
        move(matrices.step, F, work.z)
