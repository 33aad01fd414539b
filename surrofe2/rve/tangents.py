"""Tangents ∂P/∂F and ∂P/∂Ḟ by the implicit function theorem (not in the paper).

See docs/theory.md, tangents.
With P = −1/V₀ Σ_k f_k ⊗ z_k over local particles (eq. 54, material positions z) and J the Jacobian
of the forces that vanish at z, every change δf of forces at fixed z moves z by J F δz = −δf. What
that does to P is the same for all directions of (F, Ḟ), and is solved for once for each of the four
components (a, b), with the transposed Jacobian::

    Jᵀ λ_ab = F⁻ᵀ ∂(Σ_k f_ka z_kb)/∂z,        δP_ab = −1/V₀ (Σ_k δf_ka z_kb − λ_ab·δf)

What the velocities do is the initialisation's:

- elastic, constrained runs: v = Ḟ Z, so velocities move with z; the elastic J and δf know no v.
- slow manifold: v = ∂x_el/∂F : Ḟ whatever z is, see `equilibrium_modes`.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.force_derivatives import add_force_gradients
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.tiles import make_workspace
from surrofe2.rve.block_lu import COLUMNS, factorise, make_matrices, solve_columns
from surrofe2.rve.equilibrium_modes import (
    along,
    equilibrium_modes,
    fold_columns,
    subtract_columns,
    unit_velocities,
    velocity_slopes,
)
from surrofe2.rve.newton import set_jacobian
from surrofe2.rve.particle_state import Drive, drive_of, map_affine, place

KINDS = ("constrained-runs", "elastic", "cauchy-born")
_ELASTIC, _CAUCHY_BORN = 1, 2


@parallel_kernel
def affine_tangents(drive, z, kind, topology, c, tangents):
    """tangents (tiles, 2, 2, 8, TILE): ∂P_ab by F_xx, xy, yx, yy, Ḟ_xx, xy, yx, yy.

    z is the solution of the initialisation KINDS[kind], and drive.rate is Ḟ.
    """
    for t in numba.prange(z.shape[0]):
        _affine_tile(drive_of(drive, t), z[t], kind, topology, c, tangents[t])


@kernel
def _affine_tile(drive, z, kind, topology, c, tangents):
    F, F_dot, work = drive.F, drive.rate, make_workspace(topology)
    place(work, z, F, topology)
    map_affine(F_dot, work.z, work.v)
    tangents[:] = 0.0
    affine = affine_fields(work.z)
    by_x, by_v = stress_gradients(work, affine, topology, c)
    _add_products(by_x, affine, 0, tangents)
    _add_products(by_v, affine, 4, tangents)
    if kind != _CAUCHY_BORN:
        matrices = make_matrices(topology)
        adjoint = adjoint_load(work, by_x, by_v, drive, topology, c)
        rate = np.zeros((2, 2, TILE)) if kind == _ELASTIC else F_dot
        map_affine(rate, work.z, work.v)
        set_jacobian(work, Drive(F, rate), topology, c, matrices.matrix, matrices.columns)
        factorise(matrices.matrix, topology, False)
        solve_columns(matrices.matrix, adjoint, topology, True)
        for m in range(4 if kind == _ELASTIC else 8):
            for n in range(COLUMNS):
                total = load(tangents, n // 2, n % 2, m)
                for i in range(adjoint.shape[1]):
                    total -= load(adjoint, n, i) * load(matrices.columns, i + 2, m)
                store(total, tangents, n // 2, n % 2, m)
    tangents[:] = tangents * (-1.0 / topology.area)


@parallel_kernel
def slow_tangents(drive, z, relaxed, topology, c, tangents):
    """As `affine_tangents` for the slow manifold: z, and z_el in `relaxed`."""
    for t in numba.prange(z.shape[0]):
        _slow_tile(drive_of(drive, t), z[t], relaxed[t], topology, c, tangents[t])


@kernel
def _slow_tile(drive, z, relaxed, topology, c, tangents):
    F, F_dot = drive.F, drive.rate
    work, matrices = make_workspace(topology), make_matrices(topology)
    place(work, relaxed, F, topology)
    modes = equilibrium_modes(work, F, topology, c, matrices)
    units = unit_velocities(work.z, modes, F, topology)
    work.v[:] = along(units, F_dot)
    slopes = velocity_slopes(work, units, topology, c, matrices.matrix)
    place(work, z, F, topology)
    affine = affine_fields(work.z)
    weights = affine.copy()
    by_x, by_v = stress_gradients(work, weights, topology, c)
    still = Drive(F, np.zeros((2, 2, TILE)))
    adjoint = adjoint_load(work, by_x, by_v, still, topology, c)
    set_jacobian(work, still, topology, c, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, False)
    solve_columns(matrices.matrix, adjoint, topology, True)
    subtract_columns(adjoint, topology, weights)
    by_x, by_v = stress_gradients(work, weights, topology, c)
    tangents[:] = 0.0
    _add_products(by_x, affine, 0, tangents)
    _add_products(by_v, slopes, 0, tangents)
    _add_products(by_v, units, 4, tangents)
    tangents[:] = tangents * (-1.0 / topology.area)


@kernel
def affine_fields(z):
    """(4, 2, local, TILE): e_a z_b for (a, b) = xx, xy, yx, yy; the virial's weights, ∂x/∂F_ab."""
    fields = np.zeros((COLUMNS, 2, z.shape[1], TILE))
    for n in range(COLUMNS):
        fields[n, n // 2] = z[n % 2]
    return fields


@kernel
def stress_gradients(work, weights, topology, c):
    """(by_x, by_v) of the four sums of forces with these weights."""
    by_x, by_v = np.zeros_like(weights), np.zeros_like(weights)
    add_force_gradients(work, weights, by_x, by_v, topology, c)
    return by_x, by_v


@kernel
def adjoint_load(work, by_x, by_v, drive, topology, c):
    """(4, 2n − 2, TILE): F⁻ᵀ ∂(Σ_k f_ka z_kb)/∂z as x = F z and v = rate z + … follow.

    Forces of own particles, which the elastic initialisation leaves, are in z_kb's own slope.
    """
    F, rate, free = drive.F, drive.rate, 2 * topology.particles - 2
    load_x, load_v = np.empty((COLUMNS, free, TILE)), np.empty((COLUMNS, free, TILE))
    fold_columns(by_x, topology, load_x)
    fold_columns(by_v, topology, load_v)
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    xx, xy, yx, yy = load(F, 0, 0), load(F, 0, 1), load(F, 1, 0), load(F, 1, 1)
    per_det = 1.0 / (xx * yy - xy * yx)
    for n in range(COLUMNS):
        for i in range(0, free, 2):
            vx, vy = load(load_v, n, i), load(load_v, n, i + 1)
            gx = load(rate, 0, 0) * vx + load(rate, 1, 0) * vy
            gy = load(rate, 0, 1) * vx + load(rate, 1, 1) * vy
            force = load(work.f, n // 2, i // 2 + 1)
            if n % 2 == 0:
                gx += force
            else:
                gy += force
            store(load(load_x, n, i) + (yy * gx - yx * gy) * per_det, load_x, n, i)
            store(load(load_x, n, i + 1) + (xx * gy - xy * gx) * per_det, load_x, n, i + 1)
    return load_x


@kernel
def _add_products(gradients, fields, first, tangents):
    """tangents[a, b, first + m] += Σ_k gradients of (a, b) along field m."""
    for n in range(COLUMNS):
        for m in range(COLUMNS):
            total = load(tangents, n // 2, n % 2, first + m)
            for axis in range(2):
                for k in range(fields.shape[2]):
                    total += load(gradients, n, axis, k) * load(fields, m, axis, k)
            store(total, tangents, n // 2, n % 2, first + m)
