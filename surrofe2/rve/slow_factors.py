"""What the slow manifold keeps at an elastic equilibrium: its stability, factors and slopes.

`lu` of the elastic Jacobian at z_el, and in `slopes` first ∂z_el/∂F, then ∂(z − z_el)/∂Ḟ, four
columns each; `slow_manifold.follow` predicts and corrects with them.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.forces import fold_images
from surrofe2.rve.direct import check_stable
from surrofe2.rve.micro_state import local_forces, make_workspace, place
from surrofe2.rve.newton_steps import move, set_jacobian, set_residual
from surrofe2.rve.slow_manifold import set_velocities
from surrofe2.rve.system_solves import solve
from surrofe2.rve.systems import (
    check_pivots,
    factorise_free,
    keep_factors,
    kept_factors,
    make_matrices,
)
from surrofe2.simd import TILE, load, store


@parallel_kernel
def renew_slow(F, elastic, factors, wanted, topology, c, stable):
    """Check stability of every tile at z_el; write the factors of the `wanted` ones.

    factors (tiles,): addresses of their blocks.
    """
    for t in numba.prange(elastic.shape[0]):
        _renew_tile(F[t], elastic[t], factors[t], wanted[t], topology, c, stable[t])


@kernel
def _renew_tile(F, elastic, factors, wanted, topology, c, stable):
    own = topology.particles
    work, matrices = make_workspace(topology), make_matrices(topology)
    place(work, elastic, F, topology)
    if not wanted:
        check_stable(work, matrices, F, topology, c, stable)
        return
    work.v[:] = 0.0
    still = np.zeros((2, 2, TILE))
    set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.columns)
    factorise_free(matrices, topology)
    lu, slopes = kept_factors(factors, topology)
    keep_factors(matrices.free, lu, topology)
    check_pivots(matrices.free, topology, stable)
    local_forces(work, topology, c)
    at_rest = work.f.copy()
    y, unit = np.empty((2, own, TILE)), np.zeros((2, 2, TILE))
    for m in range(4):
        for i in range(2 * own - 2):
            store(-load(matrices.columns, i + 2, m), matrices.step, i)
        solve(matrices.free, matrices.step, topology)
        y[:] = 0.0
        move(matrices.step, F, y)
        _keep(y, slopes, m)
        unit[:] = 0.0
        unit[m // 2, m % 2] = 1.0
        set_velocities(work.z, y, F, unit, topology, work.v)
        local_forces(work, topology, c)
        work.f[:] = work.f - at_rest
        fold_images(work.f, topology)
        set_residual(work.f, matrices.step)
        solve(matrices.free, matrices.step, topology)
        y[:] = 0.0
        move(matrices.step, F, y)
        _keep(y, slopes, 4 + m)


@kernel
def _keep(y, slopes, column):
    for i in range(1, y.shape[1]):
        store(load(y, 0, i), slopes, 2 * i - 2, column)
        store(load(y, 1, i), slopes, 2 * i - 1, column)
