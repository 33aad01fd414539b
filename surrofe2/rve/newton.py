"""Newton's method on the material positions of an RVE's particles.

At the fixed point of constrained runs, (69) to (72), v_i = L x_i and f_i(x, L x) = 0 for every
particle. `chord` corrects with a kept factorisation after a linear prediction; `newton`
refactorises. With the rate at zero both find the elastic equilibrium (65).

A solver evaluates forces, asks `settle` which lanes are done, and moves the others on. How lanes
stand is in iterations (TILE,), see `rve_state`.

Kept per point, besides material positions z at (F, Ḟ): the LU factors of the force Jacobian in
single precision (they only precondition; the residual is double), and the slopes ∂z/∂(F, Ḟ)
(they only predict), both taken at the last factorisation, see `rve_state`.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.block_matrices import (
    COLUMNS,
    factorise,
    has_negative_pivots,
    make_matrices,
    solve,
    solved_columns,
)
from surrofe2.plant_cell.derivatives import force_jacobian
from surrofe2.plant_cell.neighbours import Topology
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.plant_cell.pair_sums import make_workspace
from surrofe2.rve.rve_state import (
    OPEN,
    UNDER_WAY,
    Drive,
    answer_of,
    copy_particles,
    drive_of,
    empty_answer,
    entries,
    evaluate,
    inverse,
    keep_factors,
    keep_lane,
    kept_factors,
    map_affine,
    set_images,
)

CHORD_LIMIT = 10
NEWTON_LIMIT = 40
SEEK_LIMIT = 16
CONTRACTION = 0.5
"""`chord` gives a point up where the mean force does not fall by this factor."""
LONGEST_STEP = 0.4
"""Longest Newton step of a particle, µm times `Constants.scale`; contacts stiffen over r/7."""
ASTRAY = 1.2
"""Material displacement of a particle, in the same unit, at which an equilibrium nearby is not
sought on."""
ASIDE = 0.05
"""With a uniform fluid: distance of a particle from its prediction, in the same unit, beyond which
a solution with kept factors may lie on another branch."""
PATIENCE = 6
"""From so many evaluations on the residual is to be halved by each while such is sought."""

SKIP = 0
CHECK = 1
RENEW = 2
SOLVE = 3
SEEK = 4
"""What `newton` does with a tile; each up to SOLVE does what the one before does, too."""


class Stop(NamedTuple):
    """When a lane is done, its residual, µN, within tolerance, and when it is given up.

    That is after `limit` evaluations, where the residual does not fall by the factor
    `contraction`, and, if it `seeks` an elastic equilibrium near the positions `start`, where
    `give_up` says so.
    """

    tolerance: float
    contraction: float
    limit: int
    start: Array
    seeks: bool


@kernel
def predict(z, drive, before, slopes, there):
    """z + ∂z/∂F (F − F₀) + ∂z/∂Ḟ (Ḟ − Ḟ₀) into `there`, z known at `before`."""
    copy_particles(z, there)
    add_slopes(slopes, 0, change(drive.F, before.F), there)
    add_slopes(slopes, 4, change(drive.rate, before.rate), there)


@kernel
def change(tensor, before):
    """(2, 2, TILE) tensor − before; numba compiles the expression of arrays far longer."""
    difference = np.empty((2, 2, TILE))
    for i in range(2):
        for j in range(2):
            store(load(tensor, i, j) - load(before, i, j), difference, i, j)
    return difference


@kernel
def add_slopes(slopes, first, tensor, z):
    """z += Σ_m slopes[:, first + m] tensor_m over xx, xy, yx, yy, but of the held particle."""
    xx, xy, yx, yy = entries(tensor)
    for m in range(slopes.shape[0]):
        value = load(slopes, m, first) * xx + load(slopes, m, first + 1) * xy
        value += load(slopes, m, first + 2) * yx + load(slopes, m, first + 3) * yy
        axis = m % 2
        i = m // 2 + 1
        store(load(z, axis, i) + value, z, axis, i)


@kernel
def settle(residual, before, stop, count, source, target, iterations):
    """Mark lanes that are solved or given up at evaluation `count`; return how many are not.

    iterations becomes count where the residual (1, TILE) is within tolerance; there the lane of
    source goes to target. It becomes OPEN where the residual falls too slowly, or evaluations are
    at their limit. The residual replaces the one `before` (TILE,).
    """
    open_lanes = 0
    for k in range(TILE):
        if iterations[k] == UNDER_WAY:
            if residual[0, k] <= stop.tolerance:
                iterations[k] = count
                keep_lane(source, k, target)
            elif not residual[0, k] < stop.contraction * before[k] or count == stop.limit:
                iterations[k] = OPEN
            else:
                open_lanes += 1
            before[k] = residual[0, k]
    return open_lanes


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
        if iterations[k] != UNDER_WAY:
            step[:, k] = 0.0


@kernel
def limit_step(step, longest_step):
    """Shorten each lane's step to one of a longest displacement; one not finite to nothing.

    The length of a displacement, unlike its components, is the same for a rotated RVE.
    """
    for k in range(TILE):
        longest = 0.0
        for i in range(0, step.shape[0], 2):
            square = step[i, k] * step[i, k] + step[i + 1, k] * step[i + 1, k]
            longest = max(longest, square) if square == square else np.inf
        if longest > longest_step * longest_step:
            factor = longest_step / np.sqrt(longest)
            for i in range(step.shape[0]):
                step[i, k] = factor * step[i, k] if longest < np.inf else 0.0


@kernel
def move(step, F, z):
    """z += F⁻¹ δx on own particles but the held one."""
    xx, xy, yx, yy = inverse(entries(F))
    for i in range(1, step.shape[0] // 2 + 1):
        dx = load(step, 2 * i - 2)
        dy = load(step, 2 * i - 1)
        store(load(z, 0, i) + (xx * dx + xy * dy), z, 0, i)
        store(load(z, 1, i) + (yx * dx + yy * dy), z, 1, i)


@kernel
def set_jacobian(work, drive, topology, c, matrix, columns):
    """`force_jacobian` at local z, x, v, with L = rate F⁻¹."""
    L = np.empty((2, 2, TILE))
    xx, xy, yx, yy = inverse(entries(drive.F))
    for i in range(2):
        rx = load(drive.rate, i, 0)
        ry = load(drive.rate, i, 1)
        store(rx * xx + ry * yx, L, i, 0)
        store(rx * xy + ry * yy, L, i, 1)
    force_jacobian(work, L, topology, c, matrix, columns)


@kernel
def set_elastic_jacobian(work, F, topology, c, matrix, columns):
    """The Jacobian at local z, x with dashpots off; work.v becomes zero."""
    work.v[:] = 0.0
    set_jacobian(work, Drive(F, np.zeros((2, 2, TILE))), topology, c, matrix, columns)


@kernel
def give_up(z, start, astray, count, residual, bound, iterations):
    """iterations −count where z is astray from the start, or the residual (TILE,) above bound."""
    for k in range(TILE):
        if count <= 1:
            bound[k] = residual[k]
        elif count >= PATIENCE:
            if iterations[k] == UNDER_WAY and residual[k] > bound[k]:
                iterations[k] = -count
            bound[k] *= 0.5
        if iterations[k] == UNDER_WAY:
            farthest = 0.0
            for i in range(start.shape[1]):
                dx = z[0, i, k] - start[0, i, k]
                dy = z[1, i, k] - start[1, i, k]
                farthest = max(farthest, dx * dx + dy * dy)
            if farthest > astray * astray:
                iterations[k] = -count


@kernel
def newton_loop(work, matrices, drive, is_affine, topology, c, stop, answer):
    """Newton's method with limited steps from work.z, in lanes with iterations ≤ 0.

    Velocities are rate z if `is_affine`, else what work.v holds; then the rate is 0.
    """
    sigma = np.empty((2, 2, TILE))
    residual = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    iterations = answer.iterations
    bound = np.empty(TILE)
    matrix = matrices.matrix
    for k in range(TILE):
        iterations[k] = max(iterations[k], UNDER_WAY)  # what is below it begins again
    for count in range(1, stop.limit + 1):
        evaluate(work, drive, is_affine, topology, c, sigma, residual)
        if settle(residual, before, stop, count, sigma, answer.stress, iterations) == 0:
            break
        set_jacobian(work, drive, topology, c, matrix, matrices.no_columns)
        factorise(matrix, topology, stop.seeks)
        set_residual(work.f, matrices.step)
        solve(matrix, matrices.step, topology)
        limit_step(matrices.step, c.scale * LONGEST_STEP)
        hold(matrices.step, iterations)
        move(matrices.step, drive.F, work.z)
        if stop.seeks:
            astray = c.scale * ASTRAY
            give_up(work.z, stop.start, astray, count, before, bound, iterations)


@kernel
def chord_loop(work, drive, is_affine, lu, topology, c, stop, answer):
    """As `newton_loop` with kept factors, in lanes under way."""
    sigma = np.empty((2, 2, TILE))
    residual = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    iterations = answer.iterations
    step = np.empty((2 * topology.particles - 2, TILE))
    for count in range(1, stop.limit + 1):
        evaluate(work, drive, is_affine, topology, c, sigma, residual)
        if settle(residual, before, stop, count, sigma, answer.stress, iterations) == 0:
            break
        correct(lu, work.f, step, iterations, drive.F, work.z, topology)


@kernel
def prediction(z, topology):
    """A copy of own particles' z for `give_up_aside`; of none with SPH fluid, which needs none."""
    copied = np.empty((2, topology.particles if topology.pressures > 0 else 0, TILE))
    copy_particles(z, copied)
    return copied


@kernel
def give_up_aside(z, predicted, aside, iterations):
    """Open lanes in which a particle is farther than `aside`, µm, from where it should be."""
    for k in range(TILE):
        farthest = 0.0
        for i in range(predicted.shape[1]):
            dx = z[0, i, k] - predicted[0, i, k]
            dy = z[1, i, k] - predicted[1, i, k]
            farthest = max(farthest, dx * dx + dy * dy)
        if farthest > aside * aside:
            iterations[k] = OPEN


@parallel_kernel
def chord(drive, z, before, factors, topology, c, tolerance, answer):
    """Solve in place from z (tiles, 2, n, TILE), known at `before`, in lanes under way.

    factors (tiles,): addresses of the kept factors, which are read only.
    """
    for t in numba.prange(z.shape[0]):
        _chord_tile(
            drive_of(drive, t), z[t], drive_of(before, t), factors[t], topology, c, tolerance,
            answer_of(answer, t),
        )  # fmt: skip


@kernel
def _chord_tile(drive, z, at, factors, topology, c, tolerance, answer):
    if answer.iterations.max() < 0:
        return
    work = make_workspace(topology)
    lu, slopes = kept_factors(factors, topology)
    predict(z, drive, at, slopes, work.z)
    stop = Stop(tolerance, CONTRACTION, CHORD_LIMIT, z, False)
    predicted = prediction(work.z, topology)
    chord_loop(work, drive, True, lu, topology, c, stop, answer)
    give_up_aside(work.z, predicted, c.scale * ASIDE, answer.iterations)
    for k in range(TILE):
        if answer.iterations[k] > 0:
            keep_lane(work.z, k, z)


@parallel_kernel
def newton(drive, z, factors, task, topology, c, tolerance, answer):
    """Do what `task` (tiles,) says of each tile, in place; a tile that is skipped stays as it is.

    - SOLVE: Newton with limited steps from z in the lanes with iterations ≤ 0.
    - SEEK: the same near z with dashpots off, as long as it promises to come to something, and
      CHECK where it does.
    - RENEW: write lu and slopes at z into the blocks whose addresses `factors` (tiles,) holds.
    - CHECK: whether the elastic Hessian at z, dashpots off, is positive definite.
    """
    for t in numba.prange(z.shape[0]):
        _newton_tile(
            drive_of(drive, t), z[t], factors[t], task[t], topology, c, tolerance,
            answer_of(answer, t),
        )  # fmt: skip


@kernel
def _newton_tile(drive, z, factors, task, topology, c, tolerance, answer):
    if task == SKIP:
        return
    work = make_workspace(topology)
    matrices = make_matrices(topology)
    copy_particles(z, work.z)
    if task >= SOLVE:
        limit = SEEK_LIMIT if task == SEEK else NEWTON_LIMIT
        stop = Stop(tolerance, np.inf, limit, z, task == SEEK)
        newton_loop(work, matrices, drive, True, topology, c, stop, answer)
        copy_particles(work.z, z)
        if task == SEEK and answer.iterations.max() < 0:
            return
    set_images(work.z, topology)
    if RENEW <= task <= SOLVE:
        lu, slopes = kept_factors(factors, topology)
        map_affine(drive.F, work.z, work.x)
        map_affine(drive.rate, work.z, work.v)
        set_jacobian(work, drive, topology, c, matrices.matrix, matrices.columns)
        factorise(matrices.matrix, topology, False)
        keep_factors(matrices.matrix, lu)
        for first in (0, COLUMNS):
            keep_slopes(solved_columns(matrices, first, topology), drive.F, slopes, first)
    check_stable(work, matrices, drive.F, topology, c, answer.stable)


def renew(
    drive: Drive, z: Array, address: Index, wanted: Flags, topology: Topology, c: Constants
) -> Flags:
    """Write the factors of the `wanted` (tiles,) tiles at z; (tiles, TILE) whether z is stable.

    address: (tiles,) of the blocks of the factors.
    """
    answer = empty_answer(len(z))
    task = np.where(wanted, RENEW, CHECK).astype(np.int8)
    newton(drive, z, address, task, topology, c, 0.0, answer)
    return answer.stable


@kernel
def keep_slopes(steps, F, slopes, first):
    """slopes[:, first:first + 4] = F⁻¹ steps, of four steps (4, free, TILE)."""
    xx, xy, yx, yy = inverse(entries(F))
    for m in range(COLUMNS):
        for i in range(0, steps.shape[1], 2):
            dx = load(steps, m, i)
            dy = load(steps, m, i + 1)
            store(xx * dx + xy * dy, slopes, i, first + m)
            store(yx * dx + yy * dy, slopes, i + 1, first + m)


@kernel
def check_stable(work, matrices, F, topology, c, stable):
    """stable (TILE,): whether the elastic Hessian at work.z is positive definite."""
    map_affine(F, work.z, work.x)
    set_elastic_jacobian(work, F, topology, c, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, True)
    has_negative_pivots(matrices.matrix, topology, stable)
