"""Exact tangents ∂P/∂F and ∂P/∂Ḟ by the implicit function theorem (not in the paper; model.md).

With P = 1/V₀ Σ f ⊗ Z over pairs (eq. 54, Z material distances), one direction δ of (F, Ḟ) at a
time::

    J F δz = −δf at fixed z,        δP = 1/V₀ Σ (δf ⊗ Z + f ⊗ δZ)

δf along (δx, δv) comes from `add_force_slopes`. What the velocities do is the initialisation's:

- elastic, constrained runs: v = Ḟ Z, so δv = δḞ Z + Ḟ δZ; the elastic J and δf of z know no v.
- slow manifold: v = Ḟ z_el + F y with y = ∂z_el/∂F : Ḟ, linear in Ḟ. Along F, δy follows from
  ḟ_el(x_el, v) = 0, whose change at fixed y is taken by a central difference.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.force_rates import add_elastic_forces_and_rates, add_force_slopes
from surrofe2.plant_cell.forces import fold_images
from surrofe2.plant_cell.simd import TILE, load, spread, store
from surrofe2.rve.direct import move, set_jacobian, set_residual
from surrofe2.rve.micro_state import (
    copy_particles,
    local_forces,
    make_workspace,
    map_affine,
    set_images,
)
from surrofe2.rve.slow_manifold import set_velocities
from surrofe2.rve.systems import factorise_free, make_matrices, solve

KINDS = ("constrained-runs", "elastic", "cauchy-born")
_ELASTIC, _CAUCHY_BORN = 1, 2

DIFFERENCE = 2e-6
"""Half width of the central difference along F, relative."""


@parallel_kernel
def affine_tangents(F, F_dot, z, kind, topology, c, area, tangents):
    """tangents (tiles, 2, 2, 8, TILE): ∂P_ab by F_xx, xy, yx, yy, Ḟ_xx, xy, yx, yy.

    z is the solution of the initialisation KINDS[kind].
    """
    for t in numba.prange(z.shape[0]):
        _affine_tile(F[t], F_dot[t], z[t], kind, topology, c, area, tangents[t])


@kernel
def _affine_tile(F, F_dot, z, kind, topology, c, area, tangents):
    own = topology.particles
    work, matrices = make_workspace(topology), make_matrices(topology)
    change = make_workspace(topology)
    copy_particles(z, work.z)
    set_images(work.z, topology)
    map_affine(F, work.z, work.x)
    still = np.zeros((2, 2, TILE))
    felt = still if kind == _ELASTIC else F_dot
    map_affine(felt, work.z, work.v)
    set_jacobian(work, F, felt, topology, c, matrices.jacobian, matrices.columns)
    factorise_free(matrices, topology)
    map_affine(F_dot, work.z, work.v)
    local_forces(work, topology, c)
    at_point = work.f.copy()
    dz = np.zeros((2, own, TILE))
    for m in range(8):
        dz[:] = 0.0
        if not (kind == _CAUCHY_BORN or (kind == _ELASTIC and m >= 4)):
            for i in range(2 * own - 2):
                store(-load(matrices.columns, i + 2, m), matrices.step, i)
            solve(matrices.free, matrices.step, topology)
            move(matrices.step, F, dz)
        _set_change(dz, F, work.z, m, m < 4, topology, change.x)
        _set_change(dz, F_dot, work.z, m - 4, m >= 4, topology, change.v)
        _add_stress_change(work, change, dz, at_point, topology, c, area, tangents, m)


@kernel
def _set_change(dz, A, z, m, direct, topology, change):
    """change = A δZ, plus E_m Z where `direct`; an image has the δz of its owner."""
    own = topology.particles
    xx, xy, yx, yy = load(A, 0, 0), load(A, 0, 1), load(A, 1, 0), load(A, 1, 1)
    for i in range(change.shape[1]):
        k = i if i < own else topology.owner[i - own]
        dx, dy = load(dz, 0, k), load(dz, 1, k)
        store(xx * dx + xy * dy, change, 0, i)
        store(yx * dx + yy * dy, change, 1, i)
        if direct:
            store(load(change, m // 2, i) + load(z, m % 2, i), change, m // 2, i)


@kernel
def _add_stress_change(work, change, dz, forces, topology, c, area, tangents, m):
    """tangents[:, :, m] = −1/V₀ Σ_k (δf_k ⊗ z_k + f_k ⊗ δz_k) over local particles."""
    own = topology.particles
    change.f[:] = 0.0
    add_force_slopes(
        work.x, work.v, change.x, change.v, change.f, topology, c, work.slope, work.volume,
        change.volume,
    )  # fmt: skip
    for a in range(2):
        for b in range(2):
            total = spread(0.0)
            for i in range(work.z.shape[1]):
                k = i if i < own else topology.owner[i - own]
                total -= load(change.f, a, i) * load(work.z, b, i)
                total -= load(forces, a, i) * load(dz, b, k)
            store(total * (1.0 / area), tangents, a, b, m)


@parallel_kernel
def slow_tangents(F, F_dot, z, relaxed, topology, c, area, tangents):
    """As `affine_tangents` for the slow manifold: z, and z_el in `relaxed`."""
    for t in numba.prange(z.shape[0]):
        _slow_tile(F[t], F_dot[t], z[t], relaxed[t], topology, c, area, tangents[t])


@kernel
def _slow_tile(F, F_dot, z, relaxed, topology, c, area, tangents):
    own = topology.particles
    work, matrices = make_workspace(topology), make_matrices(topology)
    at_rest, change = make_workspace(topology), make_workspace(topology)
    copy_particles(relaxed, at_rest.z)
    set_images(at_rest.z, topology)
    modes = equilibrium_modes(at_rest, F, topology, c, matrices)
    y = material_rate(modes, F_dot)
    set_velocities(at_rest.z, y, F, F_dot, topology, at_rest.v)
    bends = _velocity_slopes(at_rest, modes, y, F, F_dot, topology, c, matrices, change)
    copy_particles(z, work.z)
    set_images(work.z, topology)
    map_affine(F, work.z, work.x)
    work.v[:] = at_rest.v
    still, unit = np.zeros((2, 2, TILE)), np.zeros((2, 2, TILE))
    set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.no_columns)
    factorise_free(matrices, topology)
    local_forces(work, topology, c)
    at_point = work.f.copy()
    dz = np.zeros((2, own, TILE))
    for m in range(8):
        if m < 4:
            change.v[:] = bends[m]
        else:
            unit[:] = 0.0
            unit[(m - 4) // 2, m % 2] = 1.0
            set_velocities(at_rest.z, modes[m - 4], F, unit, topology, change.v)
        dz[:] = 0.0
        _set_change(dz, F, work.z, m, m < 4, topology, change.x)
        change.f[:] = 0.0
        add_force_slopes(
            work.x, work.v, change.x, change.v, change.f, topology, c, work.slope, work.volume,
            change.volume,
        )  # fmt: skip
        fold_images(change.f, topology)
        set_residual(change.f, matrices.step)
        solve(matrices.free, matrices.step, topology)
        move(matrices.step, F, dz)
        _set_change(dz, F, work.z, m, m < 4, topology, change.x)
        _add_stress_change(work, change, dz, at_point, topology, c, area, tangents, m)


@kernel
def equilibrium_modes(work, F, topology, c, matrices):
    """modes (4, 2, own, TILE) = ∂z_el/∂F_m; leaves the factorised elastic Jacobian behind."""
    own = topology.particles
    map_affine(F, work.z, work.x)
    work.v[:] = 0.0
    still = np.zeros((2, 2, TILE))
    set_jacobian(work, F, still, topology, c, matrices.jacobian, matrices.columns)
    factorise_free(matrices, topology)
    modes = np.zeros((4, 2, own, TILE))
    for m in range(4):
        for i in range(2 * own - 2):
            store(-load(matrices.columns, i + 2, m), matrices.step, i)
        solve(matrices.free, matrices.step, topology)
        move(matrices.step, F, modes[m])
    return modes


@kernel
def material_rate(modes, F_dot):
    """y = ∂z_el/∂F : Ḟ."""
    y = np.zeros(modes.shape[1:])
    for m in range(4):
        for axis in range(2):
            for i in range(y.shape[1]):
                part = load(modes, m, axis, i) * load(F_dot, m // 2, m % 2)
                store(load(y, axis, i) + part, y, axis, i)
    return y


@kernel
def _velocity_slopes(work, modes, y, F, F_dot, topology, c, matrices, change):
    """(4, 2, local, TILE) = ∂v/∂F_m of v = Ḟ z_el + F y, images included."""
    own = topology.particles
    slopes = np.empty((4, 2, work.x.shape[1], TILE))
    x, v = work.x.copy(), work.v.copy()
    rates = np.empty((2, 2, work.x.shape[1], TILE))
    dy = np.zeros((2, own, TILE))
    for m in range(4):
        # at fixed y: δx = F δz_el + E_m Z, δv = Ḟ δz_el + E_m y
        _set_change(modes[m], F, work.z, m, True, topology, change.x)
        _set_change(modes[m], F_dot, work.z, m, False, topology, change.v)
        for i in range(change.v.shape[1]):
            k = i if i < own else topology.owner[i - own]
            moved = load(change.v, m // 2, i) + load(y, m % 2, k)
            store(moved, change.v, m // 2, i)
        for side in range(2):
            sign = DIFFERENCE if side == 0 else -DIFFERENCE
            work.x[:] = x + sign * change.x
            work.v[:] = v + sign * change.v
            work.f[:] = 0.0
            rates[side] = 0.0
            add_elastic_forces_and_rates(
                work.x, work.v, work.f, rates[side], topology, c, work.slope, work.volume,
                change.volume,
            )  # fmt: skip
        change.f[:] = (rates[0] - rates[1]) / (2.0 * DIFFERENCE)
        fold_images(change.f, topology)
        set_residual(change.f, matrices.step)
        solve(matrices.free, matrices.step, topology)
        dy[:] = 0.0
        move(matrices.step, F, dy)
        for i in range(change.v.shape[1]):
            k = i if i < own else topology.owner[i - own]
            for axis in range(2):
                turned = load(F, axis, 0) * load(dy, 0, k) + load(F, axis, 1) * load(dy, 1, k)
                store(load(change.v, axis, i) + turned, slopes, m, axis, i)
    work.x[:] = x
    work.v[:] = v
    return slopes
