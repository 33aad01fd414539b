"""Newton's method on the material positions of an RVE's particles.

At the fixed point of constrained runs, (69) to (72), v_i = L x_i and f_i(x, L x) = 0 for every
particle. `chord` corrects with a kept factorisation after a linear prediction; `newton`
refactorises. With the rate at zero both find the elastic equilibrium (65).

A solver evaluates forces, marks the lanes that are done (`settle`), and moves particles of the
others. The state of each lane is a number in `iterations` (TILE,), see `rve_state`: UNDER_WAY,
n > 0 once n evaluations of forces have solved it, negative if they have not.

Kept per point, besides material positions z at (F, Ḟ): the LU factors of the force Jacobian in
single precision (they only precondition; the residual is double), and the slopes ∂z/∂(F, Ḟ)
(they only predict), both taken at the last factorisation, see `rve_state`.

Arguments that most kernels here share: F (2, 2, TILE); `drive`, F and Ḟ; z (2, n, TILE) material
positions, µm; `workspace`, a `Workspace`; `topology`, a `Topology`; `constants` of the pair laws;
`answer`, which is filled. A step (2n − 2, TILE) has the displacements x₁, y₁, x₂, … of all
particles but particle 0, which is held; `row_x(i)` is where those of particle i begin.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import kernel, loop_body, pair_law, parallel_kernel
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
from surrofe2.plant_cell.pair_sums import BY_F, BY_RATE, make_workspace
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
"""Most evaluations of forces of `chord`, of `newton`, and of its search for an equilibrium. A warm
solve takes 4 to 8. A search that fails is tried again by a shorter step, so it may end early."""
CONTRACTION = 0.5
"""`chord` gives a point up where the mean force does not fall by this factor in one iteration."""
LONGEST_STEP = 0.4
"""Longest Newton step of a particle, µm times `Constants.scale`: in longer steps contacts stiffen
too much, whose stiffness is r⁻⁷."""
ASTRAY = 1.2
"""Material displacement of a particle, in the same unit, at which a search for an equilibrium
nearby is given up: a little more than `continuation.JUMP`, beyond which it would be refused."""
ASIDE = 0.05
"""Distance of a particle from its prediction, in the same unit, beyond which a solution with kept
factors may lie on another branch. It is looked at with a uniform fluid alone."""
PATIENCE = 6
"""Evaluations after which a search must halve the residual by each further one."""

# Tasks of `newton` for a tile, see there. Each up to SOLVE includes the one before.
SKIP = 0
CHECK = 1
RENEW = 2
SOLVE = 3
SEEK = 4


class Stop(NamedTuple):
    """Criteria by which a lane counts as solved, or is given up.

    tolerance: residual up to which it is solved, µN.
    contraction: factor by which the residual must fall in each iteration; else it is given up.
    limit: most evaluations of forces.
    start: (2, n, TILE) positions near which an equilibrium is sought; read if `seeks`.
    seeks: whether an elastic equilibrium is sought, which `give_up` may end.
    """

    tolerance: float
    contraction: float
    limit: int
    start: Array
    seeks: bool


@pair_law
def row_x(i):
    """Return the row of particle i > 0 in a step; its y component is in the next row."""
    return 2 * i - 2


@kernel
def predict(z, drive, before, slopes, predicted):
    """Fill predicted (2, ≥ n, TILE) with z + ∂z/∂F (F − F₀) + ∂z/∂Ḟ (Ḟ − Ḟ₀).

    before: the `Drive` F₀ and Ḟ₀ at which z is known. slopes: (2n − 2, 8, TILE).
    """
    copy_particles(z, predicted)
    add_slopes(slopes, BY_F, change(drive.F, before.F), predicted)
    add_slopes(slopes, BY_RATE, change(drive.rate, before.rate), predicted)


@kernel
def change(tensor, before):
    """Return tensor − before, (2, 2, TILE).

    Written out, as numba takes far longer to compile the expression of arrays.
    """
    difference = np.empty((2, 2, TILE))
    for i in range(2):
        for j in range(2):
            store(load(tensor, i, j) - load(before, i, j), difference, i, j)
    return difference


@kernel
def add_slopes(slopes, first, tensor, z):
    """Add Σ_m slopes[:, first + m] tensor_m, over xx, xy, yx, yy, to z of all but particle 0.

    slopes: (2n − 2, 8, TILE). first: BY_F or BY_RATE. tensor: (2, 2, TILE).
    """
    xx, xy, yx, yy = entries(tensor)
    for row in range(slopes.shape[0]):
        value = load(slopes, row, first) * xx + load(slopes, row, first + 1) * xy
        value += load(slopes, row, first + 2) * yx + load(slopes, row, first + 3) * yy
        axis = row % 2
        i = row // 2 + 1
        store(load(z, axis, i) + value, z, axis, i)


@kernel
def settle(residual, before, stop, count, source, target, iterations):
    """Mark lanes that are solved or given up at evaluation `count`; return how many are neither.

    - Where the residual (1, TILE) is within tolerance, iterations becomes count, and the lane of
      source, the stress for instance, is copied to target.
    - Where it has not fallen by the factor `stop.contraction` since `before` (TILE,), is NaN, or
      `stop.limit` is reached, iterations becomes OPEN.

    The residual replaces the one `before`.
    """
    under_way = 0
    for lane in range(TILE):
        if iterations[lane] == UNDER_WAY:
            has_fallen = residual[0, lane] < stop.contraction * before[lane]  # False for NaN
            if residual[0, lane] <= stop.tolerance:
                iterations[lane] = count
                keep_lane(source, lane, target)
            elif not has_fallen or count == stop.limit:
                iterations[lane] = OPEN
            else:
                under_way += 1
            before[lane] = residual[0, lane]
    return under_way


@kernel
def correct(lu, f, step, iterations, F, z, topology):
    """Set z ← z − F⁻¹ J⁻¹ f in lanes under way; lu (size, TILE) factors of J, f (2, n, TILE)."""
    set_residual(f, step)
    solve(lu, step, topology)
    hold(step, iterations)
    move(step, F, z)


@kernel
def set_residual(f, step):
    """Fill step with −f of all particles but the held one."""
    for i in range(1, step.shape[0] // 2 + 1):
        store(-load(f, 0, i), step, row_x(i))
        store(-load(f, 1, i), step, row_x(i) + 1)


@kernel
def hold(step, iterations):
    """Set the step to zero in lanes that are done, which must stay as they are."""
    for lane in range(TILE):
        if iterations[lane] != UNDER_WAY:
            step[:, lane] = 0.0


@kernel
def limit_step(step, longest_step):
    """Shorten the step of each lane so that no displacement is longer than `longest_step`, µm.

    A step that is not finite becomes zero. The length of a displacement, unlike its components, is
    the same for a rotated RVE.
    """
    for lane in range(TILE):
        longest = 0.0  # square of the longest displacement; infinite if one is NaN
        for row in range(0, step.shape[0], 2):
            square = step[row, lane] * step[row, lane] + step[row + 1, lane] * step[row + 1, lane]
            is_number = square == square  # NaN differs from itself
            longest = max(longest, square) if is_number else np.inf
        if longest > longest_step * longest_step:
            factor = longest_step / np.sqrt(longest)
            for row in range(step.shape[0]):
                step[row, lane] = factor * step[row, lane] if longest < np.inf else 0.0


@kernel
def move(step, F, z):
    """Add F⁻¹ δx to z of all own particles but particle 0; δx is the step."""
    xx, xy, yx, yy = inverse(entries(F))
    for i in range(1, step.shape[0] // 2 + 1):
        dx = load(step, row_x(i))
        dy = load(step, row_x(i) + 1)
        store(load(z, 0, i) + (xx * dx + xy * dy), z, 0, i)
        store(load(z, 1, i) + (yx * dx + yy * dy), z, 1, i)


@kernel
def set_jacobian(workspace, drive, topology, constants, matrix, columns):
    """Fill matrix and columns as `force_jacobian` does, with L = Ḟ F⁻¹; Ḟ is drive.rate."""
    L = np.empty((2, 2, TILE))
    xx, xy, yx, yy = inverse(entries(drive.F))
    for a in range(2):
        rate_x = load(drive.rate, a, 0)
        rate_y = load(drive.rate, a, 1)
        store(rate_x * xx + rate_y * yx, L, a, 0)
        store(rate_x * xy + rate_y * yy, L, a, 1)
    force_jacobian(workspace, L, topology, constants, matrix, columns)


@kernel
def set_elastic_jacobian(workspace, F, topology, constants, matrix, columns):
    """Fill matrix and columns with dashpots off: `set_jacobian` without motion.

    workspace.v becomes zero.
    """
    workspace.v[:] = 0.0
    set_jacobian(workspace, Drive(F, np.zeros((2, 2, TILE))), topology, constants, matrix, columns)


@kernel
def give_up(z, start, astray, count, residual, bound, iterations):
    """End searches that will not find an equilibrium nearby: iterations becomes −count there.

    That is where a particle is farther than `astray`, µm, from the start (2, n, TILE), or the
    residual (TILE,) is above a bound (TILE,): that of the first evaluation, halved by each one from
    PATIENCE on.
    """
    for lane in range(TILE):
        if count <= 1:
            bound[lane] = residual[lane]
        elif count >= PATIENCE:
            if iterations[lane] == UNDER_WAY and residual[lane] > bound[lane]:
                iterations[lane] = -count
            bound[lane] *= 0.5
        if iterations[lane] == UNDER_WAY:
            farthest = 0.0
            for i in range(start.shape[1]):
                dx = z[0, i, lane] - start[0, i, lane]
                dy = z[1, i, lane] - start[1, i, lane]
                farthest = max(farthest, dx * dx + dy * dy)
            if farthest > astray * astray:
                iterations[lane] = -count


@kernel
def newton_loop(workspace, matrices, drive, is_affine, topology, constants, stop, answer):
    """Solve f = 0 by Newton's method with limited steps, in lanes with iterations ≤ 0.

    It begins at workspace.z. Velocities are drive.rate z if `is_affine`. Otherwise they are fixed,
    those in workspace.v, and drive.rate is 0.

    workspace.z and answer are filled; matrices is scratch.
    """
    sigma = np.empty((2, 2, TILE))
    residual = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    iterations = answer.iterations
    bound = np.empty(TILE)  # `give_up` sets it at the first evaluation
    matrix = matrices.matrix
    for lane in range(TILE):
        iterations[lane] = max(iterations[lane], UNDER_WAY)  # OPEN or given up: begins again
    for count in range(1, stop.limit + 1):
        evaluate(workspace, drive, is_affine, topology, constants, sigma, residual)
        if settle(residual, before, stop, count, sigma, answer.stress, iterations) == 0:
            break
        set_jacobian(workspace, drive, topology, constants, matrix, matrices.no_columns)
        # what is sought is elastic: without dashpots the Jacobian is symmetric
        factorise(matrix, topology, stop.seeks)
        set_residual(workspace.f, matrices.step)
        solve(matrix, matrices.step, topology)
        limit_step(matrices.step, constants.scale * LONGEST_STEP)
        hold(matrices.step, iterations)
        move(matrices.step, drive.F, workspace.z)
        if stop.seeks:
            astray = constants.scale * ASTRAY
            # `settle` has put the residuals of this evaluation into `before`
            give_up(workspace.z, stop.start, astray, count, before, bound, iterations)


@kernel
def chord_loop(workspace, drive, is_affine, lu, topology, constants, stop, answer):
    """Solve f = 0 as `newton_loop` does, but with kept factors lu, in lanes under way."""
    sigma = np.empty((2, 2, TILE))
    residual = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    iterations = answer.iterations
    step = np.empty((2 * topology.particles - 2, TILE))
    for count in range(1, stop.limit + 1):
        evaluate(workspace, drive, is_affine, topology, constants, sigma, residual)
        if settle(residual, before, stop, count, sigma, answer.stress, iterations) == 0:
            break
        # steps are not limited: one that is too long does not halve the residual, which ends the
        # lane
        correct(lu, workspace.f, step, iterations, drive.F, workspace.z, topology)


@kernel
def prediction(z, topology):
    """Copy z of the own particles for `give_up_aside`.

    With SPH fluid, which needs no such check, no particle is copied.
    """
    has_uniform_fluid = topology.pressures > 0
    copied = np.empty((2, topology.particles if has_uniform_fluid else 0, TILE))
    copy_particles(z, copied)
    return copied


@kernel
def give_up_aside(z, predicted, aside, iterations):
    """Set lanes to OPEN in which a particle is farther than `aside`, µm, from its prediction."""
    for lane in range(TILE):
        farthest = 0.0
        for i in range(predicted.shape[1]):
            dx = z[0, i, lane] - predicted[0, i, lane]
            dy = z[1, i, lane] - predicted[1, i, lane]
            farthest = max(farthest, dx * dx + dy * dy)
        if farthest > aside * aside:
            iterations[lane] = OPEN


@parallel_kernel
def chord(drive, z, before, factors, topology, constants, tolerance, answer):
    """Solve f = 0 with kept factors, from z extrapolated, in lanes under way; z is replaced.

    drive: F and Ḟ of all tiles.
    z: (tiles, 2, n, TILE), known at the `Drive` before.
    factors: (tiles,) addresses of the kept factors, which are read only.
    answer: stress and iterations are filled.
    """
    for t in numba.prange(z.shape[0]):
        _chord_tile(
            drive_of(drive, t), z[t], drive_of(before, t), factors[t], topology, constants,
            tolerance, answer_of(answer, t),
        )  # fmt: skip


@loop_body
def _chord_tile(drive, z, before, factors, topology, constants, tolerance, answer):
    """Do as `chord` for one tile."""
    # `solve` has marked all lanes: they are too far off for these factors
    if answer.iterations.max() < 0:
        return
    workspace = make_workspace(topology)
    lu, slopes = kept_factors(factors, topology)
    predict(z, drive, before, slopes, workspace.z)
    stop = Stop(tolerance, CONTRACTION, CHORD_LIMIT, start=z, seeks=False)
    predicted = prediction(workspace.z, topology)
    chord_loop(workspace, drive, True, lu, topology, constants, stop, answer)
    give_up_aside(workspace.z, predicted, constants.scale * ASIDE, answer.iterations)
    for lane in range(TILE):
        if answer.iterations[lane] > 0:
            keep_lane(workspace.z, lane, z)


@parallel_kernel
def newton(drive, z, factors, task, topology, constants, tolerance, answer):
    """Do the `task` (tiles,) of each tile, in place.

    - SKIP: leave the tile as it is.
    - CHECK: set answer.stable to whether the elastic Hessian at z is positive definite.
    - RENEW: write lu and slopes at z into the blocks whose addresses `factors` (tiles,) holds; then
      CHECK.
    - SOLVE: solve f = 0 by Newton's method with limited steps from z, in lanes with iterations ≤ 0;
      then RENEW and CHECK there.
    - SEEK: search for an elastic equilibrium near z as SOLVE does, until `give_up` ends it, and
      CHECK if any lane finds one. The rates of `drive` must be 0.

    drive, z: as of `chord`. tolerance: mean force at which a lane is solved, µN.
    """
    for t in numba.prange(z.shape[0]):
        _newton_tile(
            drive_of(drive, t), z[t], factors[t], task[t], topology, constants, tolerance,
            answer_of(answer, t),
        )  # fmt: skip


@loop_body
def _newton_tile(drive, z, factors, task, topology, constants, tolerance, answer):
    """Do as `newton` for one tile."""
    if task == SKIP:
        return
    workspace = make_workspace(topology)
    matrices = make_matrices(topology)
    copy_particles(z, workspace.z)
    if task >= SOLVE:
        limit = SEEK_LIMIT if task == SEEK else NEWTON_LIMIT
        # the residual may rise on the way, as steps are limited
        stop = Stop(tolerance, np.inf, limit, start=z, seeks=task == SEEK)
        newton_loop(workspace, matrices, drive, True, topology, constants, stop, answer)
        copy_particles(workspace.z, z)
        if task == SEEK and answer.iterations.max() < 0:
            return
    set_images(workspace.z, topology)
    if RENEW <= task <= SOLVE:
        lu, slopes = kept_factors(factors, topology)
        map_affine(drive.F, workspace.z, workspace.x)
        map_affine(drive.rate, workspace.z, workspace.v)
        set_jacobian(workspace, drive, topology, constants, matrices.matrix, matrices.columns)
        factorise(matrices.matrix, topology, False)
        keep_factors(matrices.matrix, lu)
        for first in (BY_F, BY_RATE):
            keep_slopes(solved_columns(matrices, first, topology), drive.F, slopes, first)
    # the factors are kept by now, so that the Hessian may take their place
    check_stable(workspace, matrices, drive.F, topology, constants, answer.stable)


def renew(
    drive: Drive, z: Array, address: Index, wanted: Flags, topology: Topology, constants: Constants
) -> Flags:
    """Write the factors of the `wanted` (tiles,) tiles at z (tiles, 2, n, TILE).

    address: (tiles,) addresses of the blocks that the factors are written to.

    Returns:
        (tiles, TILE) whether z is stable, of all tiles.
    """
    answer = empty_answer(len(z))
    task = np.where(wanted, RENEW, CHECK).astype(np.int8)
    newton(drive, z, address, task, topology, constants, 0.0, answer)
    return answer.stable


@kernel
def keep_slopes(steps, F, slopes, first):
    """Set slopes[:, first + m] = F⁻¹ steps[m] for four steps (COLUMNS, 2n − 2, TILE).

    Slopes of positions x become those of material positions z. first: BY_F or BY_RATE.
    """
    xx, xy, yx, yy = inverse(entries(F))
    for m in range(COLUMNS):
        for row in range(0, steps.shape[1], 2):
            dx = load(steps, m, row)
            dy = load(steps, m, row + 1)
            store(xx * dx + xy * dy, slopes, row, first + m)
            store(yx * dx + yy * dy, slopes, row + 1, first + m)


@kernel
def check_stable(workspace, matrices, F, topology, constants, stable):
    """Fill stable (TILE,) with whether the elastic Hessian at workspace.z is positive definite."""
    map_affine(F, workspace.z, workspace.x)
    set_elastic_jacobian(workspace, F, topology, constants, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, True)
    has_negative_pivots(matrices.matrix, topology, stable)
