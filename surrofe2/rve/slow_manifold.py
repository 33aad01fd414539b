"""Slow-manifold initialisation (not in the paper; docs/theory.md, slow manifold).

The microscopic run does not have affine velocities: the relaxed fluctuation moves as F moves. With
x_el(F) the elastic equilibrium (65), take as velocities v = ∂x_el/∂F : Ḟ, and then the positions
at which the forces vanish with them, f(x, v) = 0. What is left is of second order in time.

In material positions, x_el = F z_el and v = Ḟ z_el + F y with y = ∂z_el/∂F : Ḟ. Both z_el and y
solve with the elastic Jacobian, and v is exact when the elastic forces stay zero along it,
ḟ_el(x_el, v) = 0: so a kept factorisation corrects them, and y is not biased by its age::

    z_el ← z_el − F⁻¹ J⁻¹ f_el,    y ← y − F⁻¹ J⁻¹ ḟ_el,    then    z ← z − F⁻¹ J⁻¹ f(F z, v)

Kept per point: `lu` of the elastic Jacobian at z_el, and in `slopes` first ∂z_el/∂F, then
∂(z − z_el)/∂Ḟ, four columns each.

Near a bifurcation one mode of the cell is soft: the viscous forces move the particles far along
it, and the kept Jacobian misleads. There `newton_slow` finds y by one exact solve, and z with the
current Jacobian.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, loop_body, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.block_matrices import (
    COLUMNS,
    has_negative_pivots,
    make_matrices,
    solve_columns,
)
from surrofe2.plant_cell.derivatives import elastic_forces_and_rates
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.pair_sums import BY_F, BY_RATE, make_workspace
from surrofe2.rve.newton import (
    ASIDE,
    NEWTON_LIMIT,
    Stop,
    add_slopes,
    change,
    check_stable,
    chord_loop,
    correct,
    give_up_aside,
    keep_slopes,
    newton_loop,
    predict,
    prediction,
    row_x,
    set_residual,
    settle,
)
from surrofe2.rve.rve_state import (
    OPEN,
    Answer,
    Drive,
    answer_of,
    copy_particles,
    drive_of,
    keep_factors,
    keep_lane,
    kept_factors,
    mean_force,
    place,
    place_images,
)
from surrofe2.rve.tangents import along, equilibrium_modes, set_velocities, unit_velocities

LIMIT = 40
"""Most evaluations of forces for z_el and y, and again for z; a warm solve takes 8 to 15 in all."""
CONTRACTION = 0.9
"""Factor by which the mean force must fall in each iteration, or the lane is given up: weaker than
that of `newton.chord`, since velocities settle slowly where a pair sits at the cut-off."""
RATE_TOLERANCE = 10.0
"""Mean |ḟ| at which velocities are solved, µN/µs, over the mean force for positions, µN."""


class Moving(NamedTuple):
    """Particles on the slow manifold, all arrays (tiles, 2, n, TILE), or of one tile.

    z: material positions, µm. elastic: those of the elastic equilibrium, z_el, µm.
    fluctuation: v − L x, µm/µs.
    """

    z: Array
    elastic: Array
    fluctuation: Array


@kernel
def moving_of(moving, t):
    """Return the `Moving` of tile t; its arrays are views."""
    return Moving(moving.z[t], moving.elastic[t], moving.fluctuation[t])


@parallel_kernel
def follow(drive, moving, before, factors, topology, constants, tolerance, answer):
    """Solve for z_el, v and z with kept factors, from the `moving` at the `Drive` before, in place.

    Lanes in which it fails become OPEN.

    factors: (tiles,) addresses of the kept factors, which are read only.
    tolerance: mean force at which a lane is solved, µN.
    """
    for t in numba.prange(moving.z.shape[0]):
        _follow_tile(
            drive_of(drive, t), moving_of(moving, t), drive_of(before, t), factors[t], topology,
            constants, tolerance, answer_of(answer, t),
        )  # fmt: skip


@loop_body
def _follow_tile(drive, moving, before, factors, topology, constants, tolerance, answer):
    """Do as `follow` for one tile."""
    z = moving.z
    elastic = moving.elastic
    workspace = make_workspace(topology)
    lu, slopes = kept_factors(factors, topology)
    y = np.zeros_like(z)
    relaxed = np.empty_like(z)
    still = np.zeros((2, 2, TILE))
    # First z_el and y: states of the lanes for this solve alone, begun UNDER_WAY.
    velocity_iterations = np.zeros(TILE, dtype=np.int32)
    predict(elastic, Drive(drive.F, still), Drive(before.F, still), slopes, workspace.z)
    add_slopes(slopes, BY_F, drive.rate, y)
    copy_particles(workspace.z, relaxed)
    predicted = prediction(relaxed, topology)
    stop = Stop(tolerance, CONTRACTION, LIMIT, start=z, seeks=False)
    _solve_velocities(
        workspace, y, drive, lu, topology, constants, stop, relaxed, velocity_iterations
    )
    give_up_aside(relaxed, predicted, constants.scale * ASIDE, velocity_iterations)
    # Then z, from where it was beside z_el.
    for axis in range(2):
        for i in range(z.shape[1]):
            offset = load(z, axis, i) - load(elastic, axis, i)
            store(load(relaxed, axis, i) + offset, workspace.z, axis, i)
    add_slopes(slopes, BY_RATE, change(drive.rate, before.rate), workspace.z)
    # UNDER_WAY where velocities are solved; lanes in which they are not stay negative
    iterations = np.minimum(velocity_iterations, 0)
    positions = Answer(answer.stress, answer.residual, iterations, answer.stable)
    chord_loop(workspace, drive, False, lu, topology, constants, stop, positions)
    for lane in range(TILE):
        is_solved = iterations[lane] > 0
        answer.iterations[lane] = (
            velocity_iterations[lane] + iterations[lane] if is_solved else OPEN
        )
        if is_solved:
            keep_lane(workspace.z, lane, z)
            keep_lane(relaxed, lane, elastic)
    set_fluctuation(workspace.v, z, drive.rate, moving.fluctuation)


@kernel
def set_fluctuation(v, z, rate, fluctuation):
    """Fill fluctuation (2, n, TILE) with v − Ḟ z of own particles, which is v − L x."""
    for axis in range(2):
        for i in range(fluctuation.shape[1]):
            affine = load(rate, axis, 0) * load(z, 0, i) + load(rate, axis, 1) * load(z, 1, i)
            store(load(v, axis, i) - affine, fluctuation, axis, i)


@kernel
def _solve_velocities(workspace, y, drive, lu, topology, constants, stop, relaxed, iterations):
    """Solve f_el = 0 and ḟ_el = 0 for z_el and y with kept factors lu.

    z_el goes to workspace.z and relaxed (2, n, TILE), the velocities v to workspace.v. y (2, n,
    TILE) is corrected in place. iterations: (TILE,) as of `Answer`.
    """
    particles = topology.particles
    F = drive.F
    f_rate = np.empty_like(workspace.f)
    volume_rate = np.empty_like(workspace.volume)
    residual = np.empty((1, TILE))
    residual_rate = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    # not 0 in lanes whose z_el is solved: `correct` holds these as it holds lanes that are done
    has_equilibrium = np.zeros(TILE, dtype=np.int32)
    step = np.empty((2 * particles - 2, TILE))
    for evaluation in range(1, stop.limit + 1):
        place_images(workspace, F, topology)
        set_velocities(workspace.z, y, F, drive.rate, topology, workspace.v)
        elastic_forces_and_rates(workspace, f_rate, volume_rate, topology, constants)
        fold_images(workspace.f, topology)
        fold_images(f_rate, topology)
        mean_force(workspace.f, particles, residual)
        mean_force(f_rate, particles, residual_rate)
        for lane in range(TILE):
            # Once solved, z_el stays: a pair at the cut-off would flicker, and y with it.
            is_within = np.int32(residual[0, lane] <= stop.tolerance)
            has_equilibrium[lane] = max(has_equilibrium[lane], is_within, abs(iterations[lane]))
            # one residual for both, so that a lane is solved where both are
            residual[0, lane] = max(residual[0, lane], residual_rate[0, lane] / RATE_TOLERANCE)
        if settle(residual, before, stop, evaluation, workspace.z, relaxed, iterations) == 0:
            return
        correct(lu, workspace.f, step, has_equilibrium, F, workspace.z, topology)
        correct(lu, f_rate, step, iterations, F, y, topology)


@parallel_kernel
def newton_slow(drive, moving, topology, constants, tolerance, answer):
    """Solve for z, v − L x and stress by Newton's method, in place, in lanes with iterations ≤ 0.

    moving.elastic is z_el, from which it begins; moving.z and moving.fluctuation are replaced.
    """
    for t in numba.prange(moving.z.shape[0]):
        _newton_tile(
            drive_of(drive, t),
            moving_of(moving, t),
            topology,
            constants,
            tolerance,
            answer_of(answer, t),
        )


@loop_body
def _newton_tile(drive, moving, topology, constants, tolerance, answer):
    """Do as `newton_slow` for one tile."""
    workspace = make_workspace(topology)
    matrices = make_matrices(topology)
    still = np.zeros((2, 2, TILE))
    fluctuation = np.empty_like(moving.fluctuation)
    wanted = answer.iterations <= 0
    place(workspace, moving.elastic, drive.F, topology)
    y = along(equilibrium_modes(workspace, drive.F, topology, constants, matrices), drive.rate)
    set_velocities(workspace.z, y, drive.F, drive.rate, topology, workspace.v)
    stop = Stop(tolerance, np.inf, NEWTON_LIMIT, start=moving.z, seeks=False)
    newton_loop(
        workspace, matrices, Drive(drive.F, still), False, topology, constants, stop, answer
    )
    set_fluctuation(workspace.v, workspace.z, drive.rate, fluctuation)
    for lane in range(TILE):
        if wanted[lane] and answer.iterations[lane] > 0:
            keep_lane(workspace.z, lane, moving.z)
            keep_lane(fluctuation, lane, moving.fluctuation)


@parallel_kernel
def renew_slow(F, elastic, factors, wanted, topology, constants, stable):
    """Fill stable (tiles, TILE) with whether z_el is, and write the factors of the `wanted` tiles.

    F: (tiles, 2, 2, TILE). elastic: (tiles, 2, n, TILE) z_el. wanted: (tiles,).
    factors: (tiles,) addresses of the blocks that factors and slopes are written to.
    """
    for t in numba.prange(elastic.shape[0]):
        _renew_tile(F[t], elastic[t], factors[t], wanted[t], topology, constants, stable[t])


@loop_body
def _renew_tile(F, elastic, factors, wanted, topology, constants, stable):
    """Do as `renew_slow` for one tile.

    Slopes by F are ∂z_el/∂F. Those by Ḟ are by its entries one after the other: with V_m as
    velocities forces change by f(x_el, V_m) − f(x_el, 0), and z moves by −F⁻¹ K⁻¹ times that.
    """
    workspace = make_workspace(topology)
    matrices = make_matrices(topology)
    place(workspace, elastic, F, topology)
    if not wanted:
        check_stable(workspace, matrices, F, topology, constants, stable)
        return
    modes = equilibrium_modes(workspace, F, topology, constants, matrices)
    has_negative_pivots(matrices.matrix, topology, stable)
    lu, slopes = kept_factors(factors, topology)
    keep_factors(matrices.matrix, lu)
    local_forces(workspace, topology, constants)
    at_rest = workspace.f.copy()
    velocities = unit_velocities(workspace.z, modes, F, topology)
    steps = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(1, topology.particles):
            store(load(modes, m, 0, i), slopes, row_x(i), m)
            store(load(modes, m, 1, i), slopes, row_x(i) + 1, m)
        workspace.v[:] = velocities[m]
        local_forces(workspace, topology, constants)
        workspace.f[:] = workspace.f - at_rest
        fold_images(workspace.f, topology)
        set_residual(workspace.f, steps[m])
    solve_columns(matrices.matrix, steps, topology, False)
    keep_slopes(steps, F, slopes, BY_RATE)
