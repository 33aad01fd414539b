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
Jacobian of the moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.block_matrices import (
    COLUMNS,
    has_negative_pivots,
    make_matrices,
    solve_columns,
)
from surrofe2.plant_cell.derivatives import elastic_forces_and_rates
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.pair_sums import make_workspace
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
CONTRACTION = 0.9
RATE_TOLERANCE = 10.0
"""Mean |ḟ| in µN/µs at which velocities are done, in tolerances on the mean force in µN."""


class Moving(NamedTuple):
    """Material positions, those of the elastic equilibrium, and v − L x; (tiles, 2, n, TILE)."""

    z: Array
    elastic: Array
    fluctuation: Array


@kernel
def moving_of(moving, t):
    """The `Moving` of tile t."""
    return Moving(moving.z[t], moving.elastic[t], moving.fluctuation[t])


@parallel_kernel
def follow(drive, moving, before, factors, topology, c, tolerance, answer):
    """Solve z_el, v and z in place from those at `before`; lanes in which it fails become open.

    factors (tiles,): addresses of the kept factors, which are read only.
    """
    for t in numba.prange(moving.z.shape[0]):
        _follow_tile(
            drive_of(drive, t), moving_of(moving, t), drive_of(before, t), factors[t], topology, c,
            tolerance, answer_of(answer, t),
        )  # fmt: skip


@kernel
def _follow_tile(drive, moving, at, factors, topology, c, tolerance, answer):
    z = moving.z
    elastic = moving.elastic
    work = make_workspace(topology)
    lu, slopes = kept_factors(factors, topology)
    y = np.zeros_like(z)
    relaxed = np.empty_like(z)
    still = np.zeros((2, 2, TILE))
    count = np.zeros(TILE, dtype=np.int32)
    predict(elastic, Drive(drive.F, still), Drive(at.F, still), slopes, work.z)
    add_slopes(slopes, 0, drive.rate, y)
    copy_particles(work.z, relaxed)
    predicted = prediction(relaxed, topology)
    stop = Stop(tolerance, CONTRACTION, LIMIT, z, False)
    _find_velocities(work, y, drive, lu, topology, c, stop, relaxed, count)
    give_up_aside(relaxed, predicted, c.scale * ASIDE, count)
    for axis in range(2):
        for i in range(z.shape[1]):
            offset = load(z, axis, i) - load(elastic, axis, i)
            store(load(relaxed, axis, i) + offset, work.z, axis, i)
    add_slopes(slopes, 4, change(drive.rate, at.rate), work.z)
    counts = np.minimum(count, 0)
    positions = Answer(answer.stress, answer.residual, counts, answer.stable)
    chord_loop(work, drive, False, lu, topology, c, stop, positions)
    for k in range(TILE):
        answer.iterations[k] = count[k] + counts[k] if counts[k] > 0 else OPEN
        if counts[k] > 0:
            keep_lane(work.z, k, z)
            keep_lane(relaxed, k, elastic)
    set_fluctuation(work.v, z, drive.rate, moving.fluctuation)


@kernel
def set_fluctuation(v, z, rate, fluctuation):
    """fluctuation = v − Ḟ z of own particles, v − L x."""
    for axis in range(2):
        for i in range(fluctuation.shape[1]):
            affine = load(rate, axis, 0) * load(z, 0, i) + load(rate, axis, 1) * load(z, 1, i)
            store(load(v, axis, i) - affine, fluctuation, axis, i)


@kernel
def _find_velocities(work, y, drive, lu, topology, c, stop, relaxed, count):
    """z_el into work.z and relaxed, v into work.v; count (TILE,) as `Answer.iterations`."""
    particles = topology.particles
    F = drive.F
    f_rate = np.empty_like(work.f)
    volume_rate = np.empty_like(work.volume)
    residual = np.empty((1, TILE))
    residual_rate = np.empty((1, TILE))
    before = np.full(TILE, np.inf)
    settled = np.zeros(TILE, dtype=np.int32)
    step = np.empty((2 * particles - 2, TILE))
    for evaluation in range(1, stop.limit + 1):
        place_images(work, F, topology)
        set_velocities(work.z, y, F, drive.rate, topology, work.v)
        elastic_forces_and_rates(work, f_rate, volume_rate, topology, c)
        fold_images(work.f, topology)
        fold_images(f_rate, topology)
        mean_force(work.f, particles, residual)
        mean_force(f_rate, particles, residual_rate)
        for k in range(TILE):
            # where z_el is found it stays: a pair at the cut-off must not flicker
            settled[k] = max(settled[k], np.int32(residual[0, k] <= stop.tolerance), abs(count[k]))
            residual[0, k] = max(residual[0, k], residual_rate[0, k] / RATE_TOLERANCE)
        if settle(residual, before, stop, evaluation, work.z, relaxed, count) == 0:
            return
        correct(lu, work.f, step, settled, F, work.z, topology)
        correct(lu, f_rate, step, count, F, y, topology)


@parallel_kernel
def newton_slow(drive, moving, topology, c, tolerance, answer):
    """z, v − L x and stress from z_el in lanes with iterations ≤ 0, in place."""
    for t in numba.prange(moving.z.shape[0]):
        _newton_tile(
            drive_of(drive, t), moving_of(moving, t), topology, c, tolerance, answer_of(answer, t)
        )


@kernel
def _newton_tile(drive, moving, topology, c, tolerance, answer):
    work = make_workspace(topology)
    matrices = make_matrices(topology)
    still = np.zeros((2, 2, TILE))
    beyond = np.empty_like(moving.fluctuation)
    wanted = answer.iterations <= 0
    place(work, moving.elastic, drive.F, topology)
    y = along(equilibrium_modes(work, drive.F, topology, c, matrices), drive.rate)
    set_velocities(work.z, y, drive.F, drive.rate, topology, work.v)
    stop = Stop(tolerance, np.inf, NEWTON_LIMIT, moving.z, False)
    newton_loop(work, matrices, Drive(drive.F, still), False, topology, c, stop, answer)
    set_fluctuation(work.v, work.z, drive.rate, beyond)
    for k in range(TILE):
        if wanted[k] and answer.iterations[k] > 0:
            keep_lane(work.z, k, moving.z)
            keep_lane(beyond, k, moving.fluctuation)


@parallel_kernel
def renew_slow(F, elastic, factors, wanted, topology, c, stable):
    """Check stability of every tile at z_el; write the factors of the `wanted` ones.

    factors (tiles,): addresses of their blocks.
    """
    for t in numba.prange(elastic.shape[0]):
        _renew_tile(F[t], elastic[t], factors[t], wanted[t], topology, c, stable[t])


@kernel
def _renew_tile(F, elastic, factors, wanted, topology, c, stable):
    work = make_workspace(topology)
    matrices = make_matrices(topology)
    place(work, elastic, F, topology)
    if not wanted:
        check_stable(work, matrices, F, topology, c, stable)
        return
    modes = equilibrium_modes(work, F, topology, c, matrices)
    has_negative_pivots(matrices.matrix, topology, stable)
    lu, slopes = kept_factors(factors, topology)
    keep_factors(matrices.matrix, lu)
    local_forces(work, topology, c)
    at_rest = work.f.copy()
    velocities = unit_velocities(work.z, modes, F, topology)
    steps = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(1, topology.particles):
            store(load(modes, m, 0, i), slopes, 2 * i - 2, m)
            store(load(modes, m, 1, i), slopes, 2 * i - 1, m)
        work.v[:] = velocities[m]
        local_forces(work, topology, c)
        work.f[:] = work.f - at_rest
        fold_images(work.f, topology)
        set_residual(work.f, steps[m])
    solve_columns(matrices.matrix, steps, topology, False)
    keep_slopes(steps, F, slopes, COLUMNS)
