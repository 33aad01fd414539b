"""Tangents ∂P/∂F and ∂P/∂Ḟ by the implicit function theorem (not in the paper).

See docs/theory.md, tangents (A11), (A12). With P = −1/V₀ Σ_k f_k ⊗ z_k over local particles (eq.
54), one adjoint solve for each component (a, b) serves all directions of (F, Ḟ)::

    Jᵀ λ_ab = F⁻ᵀ ∂(Σ_k f_ka z_kb)/∂z,        δP_ab = −1/V₀ (Σ_k δf_ka z_kb − λ_ab·δf)

Velocities are v = Ḟ Z for elastic (whose J and δf know no v) and constrained runs, and
v = ∂x_el/∂F : Ḟ for the slow manifold. With K the elastic Jacobian and V_m = ∂x_el/∂F_m, which
reaches over images with the affine part E_m Z::

    K F ∂z_el/∂F_m = −(∂f_el/∂F_m at fixed z),      K V_m = 0
    K ∂V_n/∂F_m = −K̇ V_m,                           K̇: change of K along V_n

Columns m are F_xx, xy, yx, yy.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.block_matrices import (
    COLUMNS,
    factorise,
    make_matrices,
    solve_columns,
)
from surrofe2.plant_cell.derivatives import add_force_gradients, add_stiffness_rates
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.pair_sums import make_workspace
from surrofe2.rve.newton import move, set_elastic_jacobian, set_jacobian
from surrofe2.rve.rve_state import Drive, drive_of, entries, inverse, map_affine, place

KINDS = ("constrained-runs", "elastic", "cauchy-born")
_ELASTIC = 1
_CAUCHY_BORN = 2
REFINEMENTS = 30
"""Of a solution, at most; each adds three digits or more but where tissue is crushed."""
REFINED = 1e-12
GOOD_ENOUGH = 1e-8
"""Residual over the right-hand side that ends refinement, and above which there is no solution."""


@parallel_kernel
def affine_tangents(drive, z, kind, topology, c, tangents):
    """tangents (tiles, 2, 2, 8, TILE): ∂P_ab by F_xx, xy, yx, yy, Ḟ_xx, xy, yx, yy.

    z is the solution of the initialisation KINDS[kind], and drive.rate is Ḟ.
    """
    for t in numba.prange(z.shape[0]):
        _affine_tile(drive_of(drive, t), z[t], kind, topology, c, tangents[t])


@kernel
def _affine_tile(drive, z, kind, topology, c, tangents):
    F = drive.F
    F_dot = drive.rate
    work = make_workspace(topology)
    place(work, z, F, topology)
    map_affine(F_dot, work.z, work.v)
    tangents[:] = 0.0
    affine = affine_fields(work.z)
    by_x, by_v = stress_gradients(work, affine, topology, c)
    _add_products(by_x, affine, 0, tangents)
    _add_products(by_v, affine, 4, tangents)
    if kind != _CAUCHY_BORN:
        matrices = make_matrices(topology)
        load_of_stress = adjoint_load(work, by_x, by_v, drive, topology, c)
        rate = np.zeros((2, 2, TILE)) if kind == _ELASTIC else F_dot
        map_affine(rate, work.z, work.v)
        felt = Drive(F, rate)
        set_jacobian(work, felt, topology, c, matrices.matrix, matrices.columns)
        factorise(matrices.matrix, topology, False)
        adjoint = solve_adjoint(matrices.matrix, load_of_stress, work, felt, topology, c)
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
    F = drive.F
    F_dot = drive.rate
    work = make_workspace(topology)
    matrices = make_matrices(topology)
    place(work, relaxed, F, topology)
    modes = equilibrium_modes(work, F, topology, c, matrices)
    units = unit_velocities(work.z, modes, F, topology)
    work.v[:] = along(units, F_dot)
    slopes = velocity_slopes(work, units, F, topology, c, matrices.matrix)
    place(work, z, F, topology)
    affine = affine_fields(work.z)
    weights = affine.copy()
    by_x, by_v = stress_gradients(work, weights, topology, c)
    still = standing(F)
    load_of_stress = adjoint_load(work, by_x, by_v, still, topology, c)
    set_jacobian(work, still, topology, c, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, False)
    adjoint = solve_adjoint(matrices.matrix, load_of_stress, work, still, topology, c)
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
    by_x = np.zeros_like(weights)
    by_v = np.zeros_like(weights)
    add_force_gradients(work, weights, by_x, by_v, topology, c)
    return by_x, by_v


@kernel
def adjoint_load(work, by_x, by_v, drive, topology, c):
    """(4, 2n − 2, TILE): F⁻ᵀ ∂(Σ_k f_ka z_kb)/∂z as x = F z and v = rate z + … follow.

    Forces of own particles, which the elastic initialisation leaves, are in z_kb's own slope.
    """
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    return _pulled_back(by_x, by_v, work.f, drive, topology)


@kernel
def _pulled_back(by_x, by_v, f, drive, topology):
    """(4, 2n − 2, TILE): F⁻ᵀ times slopes by z, f_a more in those of component (a, b) by z_b."""
    F = drive.F
    rate = drive.rate
    free = 2 * topology.particles - 2
    load_x = np.empty((COLUMNS, free, TILE))
    load_v = np.empty((COLUMNS, free, TILE))
    fold_columns(by_x, topology, load_x)
    fold_columns(by_v, topology, load_v)
    xx, xy, yx, yy = inverse(entries(F))
    for n in range(COLUMNS):
        for i in range(0, free, 2):
            vx = load(load_v, n, i)
            vy = load(load_v, n, i + 1)
            gx = load(rate, 0, 0) * vx + load(rate, 1, 0) * vy
            gy = load(rate, 0, 1) * vx + load(rate, 1, 1) * vy
            force = load(f, n // 2, i // 2 + 1)
            if n % 2 == 0:
                gx += force
            else:
                gy += force
            store(load(load_x, n, i) + (xx * gx + yx * gy), load_x, n, i)
            store(load(load_x, n, i + 1) + (xy * gx + yy * gy), load_x, n, i + 1)
    return load_x


@kernel
def solve_adjoint(lu, load_of_stress, work, drive, topology, c):
    """λ (4, 2n − 2, TILE) of (A11), Jᵀ λ = load, with lu of J at work.x and work.v."""
    adjoint = load_of_stress.copy()
    solve_columns(lu, adjoint, topology, True)
    refine(lu, load_of_stress, adjoint, work, drive, topology, c)
    return adjoint


@kernel
def refine(lu, right, solution, work, drive, topology, c):
    """Correct a solution of Jᵀ λ = right (4, 2n − 2, TILE) until its residual is small.

    With a uniform fluid J lacks contacts of far walls and a small part of the viscosity. Products
    of λ lack nothing. A lane whose residual stays large becomes NaN.
    """
    if topology.pressures == 0:
        return
    no_force = np.zeros_like(work.f)
    size = np.empty(TILE)
    whole = np.empty(TILE)
    before = np.full(TILE, np.inf)
    largest_of(right, whole)
    for _ in range(REFINEMENTS):
        weights = np.zeros((COLUMNS, *work.x.shape))
        subtract_columns(solution, topology, weights)
        by_x, by_v = stress_gradients(work, weights, topology, c)
        residual = right + _pulled_back(by_x, by_v, no_force, drive, topology)
        largest_of(residual, size)
        open_lanes = 0
        for k in range(TILE):
            if size[k] > REFINED * whole[k] and size[k] < 0.5 * before[k]:
                open_lanes += 1
            before[k] = size[k]
        if open_lanes == 0:
            break
        solve_columns(lu, residual, topology, True)
        solution += residual
    for k in range(TILE):
        if not before[k] <= GOOD_ENOUGH * whole[k]:
            solution[:, :, k] = np.nan


@kernel
def largest_of(columns, largest):
    """largest (TILE,): the largest modulus in each lane of columns (4, rows, TILE)."""
    largest[:] = 0.0
    for m in range(columns.shape[0]):
        for i in range(columns.shape[1]):
            for k in range(TILE):
                value = abs(columns[m, i, k])
                largest[k] = max(largest[k], value) if value == value else np.inf


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


# How the elastic equilibrium moves


@kernel
def equilibrium_modes(work, F, topology, c, matrices):
    """modes (4, 2, own, TILE) = ∂z_el/∂F_m; leaves the factorised elastic Jacobian behind."""
    map_affine(F, work.z, work.x)
    set_elastic_jacobian(work, F, topology, c, matrices.matrix, matrices.columns)
    factorise(matrices.matrix, topology, True)
    right = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(right.shape[1]):
            store(-load(matrices.columns, i + 2, m), right, m, i)
    steps = right.copy()
    solve_columns(matrices.matrix, steps, topology, False)
    refine(matrices.matrix, right, steps, work, standing(F), topology, c)
    modes = np.zeros((COLUMNS, 2, topology.particles, TILE))
    for m in range(COLUMNS):
        move(steps[m], F, modes[m])
    return modes


@kernel
def standing(F):
    """The `Drive` without motion at F."""
    return Drive(F, np.zeros((2, 2, TILE)))


@kernel
def along(fields, tensor):
    """Σ_m tensor_m fields[m] over xx, xy, yx, yy: of modes and Ḟ, y = ∂z_el/∂F : Ḟ."""
    total = np.zeros(fields.shape[1:])
    for m in range(COLUMNS):
        factor = load(tensor, m // 2, m % 2)
        for axis in range(2):
            for i in range(total.shape[1]):
                store(load(total, axis, i) + factor * load(fields, m, axis, i), total, axis, i)
    return total


@kernel
def set_velocities(z, y, F, rate, topology, v):
    """v = Ḟ z + F y for local particles; an image has the y of its owner."""
    particles = topology.particles
    map_affine(rate, z, v)
    xx, xy, yx, yy = entries(F)
    for i in range(v.shape[1]):
        k = i if i < particles else topology.owner[i - particles]
        yi = load(y, 0, k)
        yj = load(y, 1, k)
        store(load(v, 0, i) + xx * yi + xy * yj, v, 0, i)
        store(load(v, 1, i) + yx * yi + yy * yj, v, 1, i)


@kernel
def unit_velocities(z, modes, F, topology):
    """V (4, 2, local, TILE) = ∂x_el/∂F_m, images included."""
    velocities = np.empty((COLUMNS, 2, z.shape[1], TILE))
    unit = np.zeros((COLUMNS, 2, 2, TILE))
    for m in range(COLUMNS):
        unit[m, m // 2, m % 2] = 1.0
        set_velocities(z, modes[m], F, unit[m], topology, velocities[m])
    return velocities


@kernel
def velocity_slopes(work, units, F, topology, c, lu):
    """(4, 2, local, TILE) = ∂v/∂F_m at work.x of v = Σ Ḟ_n V_n in work.v; lu of K."""
    slopes = np.zeros_like(units)
    rates = np.zeros_like(units)
    add_stiffness_rates(work, units, rates, topology, c)
    right = np.empty((COLUMNS, 2 * topology.particles - 2, TILE))
    fold_columns(rates, topology, right)
    steps = right.copy()
    solve_columns(lu, steps, topology, False)
    if topology.pressures > 0:
        moving = work.v.copy()
        work.v[:] = 0.0  # K is the Jacobian of the forces at rest
        refine(lu, right, steps, work, standing(F), topology, c)
        work.v[:] = moving
    subtract_columns(steps, topology, slopes)
    return slopes


@kernel
def fold_columns(fields, topology, columns):
    """columns (4, 2n − 2, TILE): fields (4, 2, local, TILE) with what images feel, unless held."""
    particles = topology.particles
    for m in range(COLUMNS):
        for axis in range(2):
            for i in range(1, particles):
                store(load(fields, m, axis, i), columns, m, 2 * i - 2 + axis)
            for k in range(topology.owner.shape[0]):
                i = topology.owner[k]
                if i > 0:
                    row = 2 * i - 2 + axis
                    value = load(columns, m, row) + load(fields, m, axis, particles + k)
                    store(value, columns, m, row)


@kernel
def subtract_columns(columns, topology, fields):
    """fields −= columns of own particles, and for images those of their owners."""
    particles = topology.particles
    for m in range(COLUMNS):
        for k in range(fields.shape[2]):
            i = k if k < particles else topology.owner[k - particles]
            if i > 0:
                for axis in range(2):
                    value = load(fields, m, axis, k) - load(columns, m, 2 * i - 2 + axis)
                    store(value, fields, m, axis, k)
