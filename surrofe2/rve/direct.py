"""The fixed point of constrained runs solved directly (docs/theory.md; not in the paper).

At the fixed point of (69) to (72) v_i = L x_i and f_i(x, L x) = 0 for every particle. `chord`
corrects with a kept factorisation after a linear prediction; `newton` refactorises. With the
rate at zero both find the elastic equilibrium (65).

Kept per point, besides material positions z at (F, Ḟ): the LU factors of the force Jacobian in
single precision (they only precondition; the residual is double), and the slopes ∂z/∂(F, Ḟ)
(they only predict), both taken at the last factorisation, see `factors`::

    lu      (2n − 2, 2n − 2, TILE)     particle 0 is held; sparse: (size, TILE)
    slopes  (2n − 2, 8, TILE)          columns ∂F_xx, xy, yx, yy, ∂Ḟ_xx, xy, yx, yy
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.lanes import Constants
from surrofe2.rve.factors import Factors
from surrofe2.rve.micro_state import (
    copy_particles,
    evaluate,
    keep_lane,
    make_workspace,
    map_affine,
    set_images,
)
from surrofe2.rve.newton_steps import correct, newton_loop, predict, set_jacobian, settle
from surrofe2.rve.system_solves import solve
from surrofe2.rve.systems import (
    AnyTopology,
    check_definite,
    factorise_free,
    keep_factors,
    kept_factors,
    make_matrices,
)
from surrofe2.simd import TILE, load, store

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CHORD_LIMIT = 10
CONTRACTION = 0.5
"""`chord` gives a point up where the mean force does not fall by this factor."""

SKIP, CHECK, RENEW, SOLVE = 0, 1, 2, 3
"""What `newton` does with a tile; each does what the one before does, too."""


@parallel_kernel
def chord(F, rate, z, at_F, at_rate, factors, topology, c, area, tolerance, stress, iterations):
    """Solve from z, known at (at_F, at_rate), in place; all (tiles, …, TILE).

    factors (tiles,): addresses of the kept factors, which are read only.
    iterations (tiles, TILE): 0 where to solve, −1 where not; becomes the number of force
    evaluations used, or −1 where the point did not converge.
    """
    for t in numba.prange(z.shape[0]):
        chord_tile(
            F[t], rate[t], z[t], at_F[t], at_rate[t], factors[t], topology, c, area, tolerance,
            stress[t], iterations[t],
        )  # fmt: skip


@kernel
def chord_tile(
    F, rate, z, at_F, at_rate, factors, topology, c, area, tolerance, stress, iterations
):
    """`chord` for one tile, arrays without their first axis."""
    if iterations.max() < 0:
        return
    work, free = make_workspace(topology), 2 * topology.particles - 2
    lu, slopes = kept_factors(factors, topology)
    sigma, residual = np.empty((2, 2, TILE)), np.empty((1, TILE))
    before, step = np.full(TILE, np.inf), np.empty((free, TILE))
    predict(z, F, rate, at_F, at_rate, slopes, work.z)
    for count in range(1, CHORD_LIMIT + 1):
        evaluate(work, F, rate, topology, c, area, sigma, residual)
        left = settle(
            residual, before, CONTRACTION, tolerance, count, CHORD_LIMIT, sigma, stress, iterations
        )
        if left == 0:
            break
        correct(lu, work.f, step, iterations, F, work.z, topology)
    for k in range(TILE):
        if iterations[k] > 0:
            keep_lane(work.z, k, z)


@parallel_kernel
def newton(F, rate, z, factors, task, topology, c, area, tolerance, stress, iterations, stable):
    """What `task` (tiles,) says of each tile, in place; the rest of a skipped tile stays.

    - SOLVE: Newton with limited steps from z in the lanes with iterations ≤ 0, which becomes
      the number of force evaluations, or −1.
    - RENEW: write lu and slopes at z into the blocks whose addresses `factors` (tiles,) holds.
    - CHECK: stable (tiles, TILE), whether the elastic Hessian at z, dashpots off, is positive
      definite.
    """
    for t in numba.prange(z.shape[0]):
        newton_tile(
            F[t], rate[t], z[t], factors[t], task[t], topology, c, area, tolerance, stress[t],
            iterations[t], stable[t],
        )  # fmt: skip


def solve_tiles(kernel: Any, *arguments: Any) -> None:
    """`chord` or `newton`; a single tile without threads, which take longer to start."""
    if len(arguments[0]) > 1:
        kernel(*arguments)
    else:
        one = chord_tile if kernel is chord else newton_tile
        one(*(part[0] if isinstance(part, np.ndarray) else part for part in arguments))


def renew(
    F: Array, rate: Array, z: Array, factors: Factors, wanted: Flags, topology: AnyTopology,
    c: Constants, stable: Flags,
) -> None:  # fmt: skip
    """Check stability of every tile; write the factors of the `wanted` (tiles,) ones."""
    nothing = np.empty((len(z), 2, 2, TILE)), np.empty((len(z), TILE), dtype=np.int32)
    task = np.where(wanted, RENEW, CHECK).astype(np.int8)
    solve_tiles(newton, F, rate, z, factors.address, task, topology, c, 1.0, 0.0, *nothing, stable)


@kernel
def newton_tile(
    F, rate, z, factors, task, topology, c, area, tolerance, stress, iterations, stable
):
    """`newton` for one tile, arrays without their first axis."""
    if task == SKIP:
        return
    work, matrices = make_workspace(topology), make_matrices(topology)
    copy_particles(z, work.z)
    if task >= SOLVE:
        newton_loop(work, matrices, F, rate, True, topology, c, area, tolerance, stress, iterations)
        copy_particles(work.z, z)
    set_images(work.z, topology)
    if task >= RENEW:
        lu, slopes = kept_factors(factors, topology)
        _refactorise(work, matrices, F, rate, topology, c, lu, slopes)
    check_stable(work, matrices, F, topology, c, stable)


@kernel
def _refactorise(work, matrices, F, rate, topology, c, lu, slopes):
    """Fill lu and slopes of a tile at work.z, images set."""
    map_affine(F, work.z, work.x)
    map_affine(rate, work.z, work.v)
    set_jacobian(work, F, rate, topology, c, matrices.jacobian, matrices.columns)
    factorise_free(matrices, topology)
    keep_factors(matrices.free, lu, topology)
    step = matrices.step
    xx, xy, yx, yy = load(F, 0, 0), load(F, 0, 1), load(F, 1, 0), load(F, 1, 1)
    per_det = 1.0 / (xx * yy - xy * yx)
    for m in range(8):
        for i in range(step.shape[0]):
            store(-load(matrices.columns, i + 2, m), step, i)
        solve(matrices.free, step, topology)
        for i in range(0, step.shape[0], 2):
            dx, dy = load(step, i), load(step, i + 1)
            store((yy * dx - xy * dy) * per_det, slopes, i, m)
            store((xx * dy - yx * dx) * per_det, slopes, i + 1, m)


@kernel
def check_stable(work, matrices, F, topology, c, stable):
    """stable (TILE,): whether the elastic Hessian at work.z is positive definite."""
    map_affine(F, work.z, work.x)
    work.v[:] = 0.0
    still = np.zeros((2, 2, TILE))
    set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.no_columns)
    check_definite(matrices, topology, stable)


@parallel_kernel
def stress_at(F, rate, z, topology, c, area, stress, residual):
    """Stress and mean force (tiles, 1, TILE) at given z with affine velocities, all tiles."""
    for t in numba.prange(z.shape[0]):
        _stress_tile(F[t], rate[t], z[t], topology, c, area, stress[t], residual[t])


@kernel
def _stress_tile(F, rate, z, topology, c, area, stress, residual):
    work = make_workspace(topology)
    copy_particles(z, work.z)
    evaluate(work, F, rate, topology, c, area, stress, residual)
