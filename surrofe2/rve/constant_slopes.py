"""How the stress of an RVE changes with the constants of its pair laws (not in the paper).

As in `tangents`, P_ab = −1/V₀ Σ_k f_ka z_kb, and a change δf of the forces at fixed z moves z so
that they vanish again::

    δP_ab = −1/V₀ Σ_k δf_k·w_k,    w_k = e_a z_kb − λ_ab (of the owner, for an image)

δf is a central difference in the constant, exact but for rounding where a force is linear in it,
as it is in all but the smoothing length and the cut-off. Velocities are the initialisation's:

- constrained runs: v = Ḟ Z in both parts of w; elastic: forces that vanish know no v.
- slow manifold: v = ∂x_el/∂F : Ḟ changes too, with z_el and its rate y (`slow_manifold`)::

      K F δz_el = −δf_el,    K F δy = −δḟ_el (with z_el moving along),    δv = Ḟ δz_el + F δy
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.force_derivatives import elastic_forces_and_rates
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.tiles import Constants, make_workspace
from surrofe2.rve.block_lu import COLUMNS, factorise, make_matrices, solve_columns
from surrofe2.rve.equilibrium_modes import (
    along,
    equilibrium_modes,
    set_velocities,
    subtract_columns,
)
from surrofe2.rve.newton import correct, set_jacobian
from surrofe2.rve.particle_state import Drive, drive_of, map_affine, place
from surrofe2.rve.tangents import adjoint_load, affine_fields, stress_gradients
from surrofe2.simd import TILE, load, store

_ELASTIC = 1


@parallel_kernel
def affine_constant_slopes(drive, z, kind, topology, c, values, slopes):
    """slopes (tiles, m, 4, TILE): P_xx, xy, yx, yy at values[0] minus at values[1].

    z is the solution of the initialisation KINDS[kind]; values (2, m, 10): m pairs of `Constants`
    close to c. To first order.
    """
    for t in numba.prange(z.shape[0]):
        _affine_tile(drive_of(drive, t), z[t], kind, topology, c, values, slopes[t])


@kernel
def _affine_tile(drive, z, kind, topology, c, values, slopes):
    F, F_dot, work = drive.F, drive.rate, make_workspace(topology)
    place(work, z, F, topology)
    map_affine(F_dot, work.z, work.v)
    affine = affine_fields(work.z)
    moved, rate = np.zeros_like(affine), np.zeros_like(F_dot)
    if kind != _ELASTIC:
        rate[:] = F_dot
    matrices = make_matrices(topology)
    by_x, by_v = stress_gradients(work, affine, topology, c)
    adjoint = adjoint_load(work, by_x, by_v, drive, topology, c)
    map_affine(rate, work.z, work.v)
    set_jacobian(work, Drive(F, rate), topology, c, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, False)
    solve_columns(matrices.matrix, adjoint, topology, True)
    subtract_columns(adjoint, topology, moved)
    slopes[:] = 0.0
    for m in range(values.shape[1]):
        for side in range(2):
            own = constants_of(values[side, m])
            factor = (2.0 * side - 1.0) / topology.area
            map_affine(F_dot, work.z, work.v)
            local_forces(work, topology, own)
            _add_work(work.f, affine, factor, slopes[m])
            map_affine(rate, work.z, work.v)
            local_forces(work, topology, own)
            _add_work(work.f, moved, factor, slopes[m])


@parallel_kernel
def slow_constant_slopes(drive, z, relaxed, topology, c, values, slopes):
    """As `affine_constant_slopes` for the slow manifold: z, and z_el in `relaxed`."""
    for t in numba.prange(z.shape[0]):
        _slow_tile(drive_of(drive, t), z[t], relaxed[t], topology, c, values, slopes[t])


@kernel
def _slow_tile(drive, z, relaxed, topology, c, values, slopes):
    F, F_dot, count = drive.F, drive.rate, values.shape[1]
    work, matrices = make_workspace(topology), make_matrices(topology)
    place(work, relaxed, F, topology)
    y = along(equilibrium_modes(work, F, topology, c, matrices), F_dot)
    dz = np.zeros((count, 2, topology.particles, TILE))
    dy = np.zeros((count, 2, topology.particles, TILE))
    done, f_rate, change = np.zeros(TILE, np.int32), np.empty_like(work.f), np.empty_like(work.f)
    volume_rate, at, rate = np.empty_like(work.volume), np.empty_like(relaxed), np.empty_like(y)
    for m in range(count):
        change[:] = 0.0
        place(work, relaxed, F, topology)
        work.v[:] = 0.0
        for side in range(2):
            local_forces(work, topology, constants_of(values[side, m]))
            _add_scaled(change, 1.0 - 2.0 * side, work.f, change)
        fold_images(change, topology)
        correct(matrices.matrix, change, matrices.step, done, F, dz[m], topology)
        change[:] = 0.0
        for side in range(2):
            _add_scaled(relaxed, 0.5 - side, dz[m], at)
            place(work, at, F, topology)
            set_velocities(work.z, y, F, F_dot, topology, work.v)
            own = constants_of(values[side, m])
            elastic_forces_and_rates(work, f_rate, volume_rate, topology, own)
            _add_scaled(change, 1.0 - 2.0 * side, f_rate, change)
        fold_images(change, topology)
        correct(matrices.matrix, change, matrices.step, done, F, dy[m], topology)
    place(work, relaxed, F, topology)
    set_velocities(work.z, y, F, F_dot, topology, work.v)
    place(work, z, F, topology)
    weights = affine_fields(work.z)
    by_x, by_v = stress_gradients(work, weights, topology, c)
    still = Drive(F, np.zeros((2, 2, TILE)))
    adjoint = adjoint_load(work, by_x, by_v, still, topology, c)
    set_jacobian(work, still, topology, c, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, False)
    solve_columns(matrices.matrix, adjoint, topology, True)
    subtract_columns(adjoint, topology, weights)
    slopes[:] = 0.0
    for m in range(count):
        for side in range(2):
            _add_scaled(relaxed, 0.5 - side, dz[m], at)
            _add_scaled(y, 0.5 - side, dy[m], rate)
            place(work, at, F, topology)
            set_velocities(work.z, rate, F, F_dot, topology, work.v)
            place(work, z, F, topology)
            local_forces(work, topology, constants_of(values[side, m]))
            _add_work(work.f, weights, (2.0 * side - 1.0) / topology.area, slopes[m])


@kernel
def _add_scaled(a, factor, b, total):
    """total = a + factor b, (2, n, TILE) each."""
    for axis in range(2):
        for i in range(total.shape[1]):
            store(load(a, axis, i) + factor * load(b, axis, i), total, axis, i)


@kernel
def constants_of(row):
    """`Constants` from their ten values."""
    return Constants(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9])


@kernel
def _add_work(f, fields, factor, sums):
    """sums (4, TILE) += factor Σ_k f_k·field_k of each of the four fields."""
    for n in range(COLUMNS):
        total = load(sums, n)
        for axis in range(2):
            for k in range(fields.shape[2]):
                total += factor * load(f, axis, k) * load(fields, n, axis, k)
        store(total, sums, n)
