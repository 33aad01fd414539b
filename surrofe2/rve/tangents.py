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

from surrofe2.base.compilation import kernel, loop_body, pair_law, parallel_kernel
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.plant_cell.block_matrices import (
    COLUMNS,
    factorise,
    make_matrices,
    solve_columns,
)
from surrofe2.plant_cell.derivatives import add_force_gradients, add_stiffness_rates
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.pair_sums import BY_F, BY_RATE, make_workspace
from surrofe2.rve.newton import move, row_x, set_elastic_jacobian, set_jacobian
from surrofe2.rve.rve_state import SLOPES, Drive, drive_of, entries, inverse, map_affine, place

KINDS = ("constrained-runs", "elastic", "cauchy-born")
"""Initialisations with affine velocities; kernels take their numbers in this order."""
_ELASTIC = KINDS.index("elastic")
_CAUCHY_BORN = KINDS.index("cauchy-born")
REFINEMENTS = 30
"""Most directions of a refinement; tissue of apple that is crushed to 0.84 needs five."""
REFINED = 1e-12
"""Residual over the right-hand side at which refinement ends."""
GOOD_ENOUGH = 1e-8
"""Residual over the right-hand side above which there is no solution."""


@parallel_kernel
def affine_tangents(drive, z, kind, topology, constants, tangents):
    """Fill tangents (tiles, 2, 2, 8, TILE) with ∂P_ab by F_xx, xy, yx, yy, Ḟ_xx, xy, yx, yy.

    drive: F and Ḟ. z: (tiles, 2, n, TILE) solution of the initialisation KINDS[kind].
    """
    for t in numba.prange(z.shape[0]):
        _affine_tile(drive_of(drive, t), z[t], kind, topology, constants, tangents[t])


@loop_body
def _affine_tile(drive, z, kind, topology, constants, tangents):
    """Do as `affine_tangents` for one tile.

    First P changes at fixed z; then, but for Cauchy–Born, z follows, by the adjoint λ.
    """
    F = drive.F
    F_dot = drive.rate
    workspace = make_workspace(topology)
    place(workspace, z, F, topology)
    map_affine(F_dot, workspace.z, workspace.v)
    tangents[:] = 0.0
    affine = affine_fields(workspace.z)
    by_x, by_v = stress_gradients(workspace, affine, topology, constants)
    _add_products(by_x, affine, BY_F, tangents)
    _add_products(by_v, affine, BY_RATE, tangents)
    if kind != _CAUCHY_BORN:
        matrices = make_matrices(topology)
        load_of_stress = adjoint_load(workspace, by_x, by_v, drive, topology, constants)
        # elastic positions do not depend on Ḟ, so they have no slopes by it either
        rate = np.zeros((2, 2, TILE)) if kind == _ELASTIC else F_dot
        map_affine(rate, workspace.z, workspace.v)
        felt = Drive(F, rate)
        set_jacobian(workspace, felt, topology, constants, matrices.matrix, matrices.columns)
        factorise(matrices.matrix, topology, False)
        adjoint = solve_adjoint(
            matrices.matrix, load_of_stress, workspace, felt, topology, constants
        )
        for m in range(BY_RATE if kind == _ELASTIC else SLOPES):
            for n in range(COLUMNS):
                a, b = component(n)
                total = load(tangents, a, b, m)
                for i in range(adjoint.shape[1]):
                    # the first two rows of `columns` are those of the held particle
                    total -= load(adjoint, n, i) * load(matrices.columns, i + 2, m)
                store(total, tangents, a, b, m)
    tangents[:] = tangents * (-1.0 / topology.area)


@parallel_kernel
def slow_tangents(drive, z, relaxed, topology, constants, tangents):
    """Fill tangents as `affine_tangents` does, for the slow manifold.

    z, relaxed: (tiles, 2, n, TILE) its positions, and those of its elastic equilibrium, z_el.
    """
    for t in numba.prange(z.shape[0]):
        _slow_tile(drive_of(drive, t), z[t], relaxed[t], topology, constants, tangents[t])


@loop_body
def _slow_tile(drive, z, relaxed, topology, constants, tangents):
    """Do as `slow_tangents` for one tile.

    `units` are V and `slopes` ∂v/∂F at the head of this file.
    """
    F = drive.F
    F_dot = drive.rate
    workspace = make_workspace(topology)
    matrices = make_matrices(topology)
    place(workspace, relaxed, F, topology)
    modes = equilibrium_modes(workspace, F, topology, constants, matrices)
    units = unit_velocities(workspace.z, modes, F, topology)
    workspace.v[:] = along(units, F_dot)
    slopes = velocity_slopes(workspace, units, F, topology, constants, matrices.matrix)
    place(workspace, z, F, topology)
    affine = affine_fields(workspace.z)
    weights = affine.copy()
    by_x, by_v = stress_gradients(workspace, weights, topology, constants)
    # (A8): v follows F and Ḟ, but not z, so that no rate multiplies a change of z
    still = standing(F)
    load_of_stress = adjoint_load(workspace, by_x, by_v, still, topology, constants)
    set_jacobian(workspace, still, topology, constants, matrices.matrix, matrices.no_columns)
    factorise(matrices.matrix, topology, False)
    adjoint = solve_adjoint(matrices.matrix, load_of_stress, workspace, still, topology, constants)
    # weights of forces in (A11): z_kb less λ
    subtract_columns(adjoint, topology, weights)
    by_x, by_v = stress_gradients(workspace, weights, topology, constants)
    tangents[:] = 0.0
    _add_products(by_x, affine, BY_F, tangents)
    _add_products(by_v, slopes, BY_F, tangents)
    _add_products(by_v, units, BY_RATE, tangents)
    tangents[:] = tangents * (-1.0 / topology.area)


@pair_law
def component(n):
    """Return the indices (a, b) of the n-th of the components xx, xy, yx, yy."""
    return n // 2, n % 2


@kernel
def affine_fields(z):
    """Return e_a z_b for (a, b) = xx, xy, yx, yy, (4, 2, local, TILE).

    They are ∂x/∂F_ab, and the weights of forces in the virial Σ_k f_ka z_kb. z: (2, local, TILE).
    """
    fields = np.zeros((COLUMNS, 2, z.shape[1], TILE))
    for n in range(COLUMNS):
        a, b = component(n)
        fields[n, a] = z[b]
    return fields


@kernel
def stress_gradients(workspace, weights, topology, constants):
    """Return the slopes by x and by v of four weighted sums of forces.

    All are (4, 2, local, TILE); the forces are those at workspace.x and workspace.v.
    """
    by_x = np.zeros_like(weights)
    by_v = np.zeros_like(weights)
    add_force_gradients(workspace, weights, by_x, by_v, topology, constants)
    return by_x, by_v


@kernel
def adjoint_load(workspace, by_x, by_v, drive, topology, constants):
    """Return F⁻ᵀ ∂(Σ_k f_ka z_kb)/∂z, (4, 2n − 2, TILE), the load of the adjoint problem (A11).

    Positions x = F z and velocities v = rate z + … follow z. The slope by the factor z_kb is f_ka:
    forces with dashpots on, which the elastic initialisation does not bring to zero.

    by_x, by_v: (4, 2, local, TILE) slopes of the sums, as `stress_gradients` returns them.
    """
    local_forces(workspace, topology, constants)
    fold_images(workspace.f, topology)
    return _pulled_back(by_x, by_v, workspace.f, drive, topology)


@kernel
def _pulled_back(by_x, by_v, f, drive, topology):
    """Return F⁻ᵀ times the slopes by z, (4, 2n − 2, TILE), of sums whose slopes are by_x and by_v.

    The slope of component (a, b) by z_b has f_a more. f: (2, local, TILE) folded forces.
    """
    F = drive.F
    rate = drive.rate
    free = 2 * topology.particles - 2
    load_x = np.empty((COLUMNS, free, TILE))
    load_v = np.empty((COLUMNS, free, TILE))
    fold_columns(by_x, topology, load_x)
    fold_columns(by_v, topology, load_v)
    xx, xy, yx, yy = inverse(entries(F))
    for n in range(COLUMNS):
        a, b = component(n)
        for row in range(0, free, 2):
            # v follows z by the rate, and component (a, b) has f_a as its slope by z_b
            vx = load(load_v, n, row)
            vy = load(load_v, n, row + 1)
            gx = load(rate, 0, 0) * vx + load(rate, 1, 0) * vy
            gy = load(rate, 0, 1) * vx + load(rate, 1, 1) * vy
            force = load(f, a, row // 2 + 1)
            if b == 0:
                gx += force
            else:
                gy += force
            store(load(load_x, n, row) + (xx * gx + yx * gy), load_x, n, row)
            store(load(load_x, n, row + 1) + (xy * gx + yy * gy), load_x, n, row + 1)
    return load_x


@kernel
def solve_adjoint(lu, load_of_stress, workspace, drive, topology, constants):
    """Return λ (4, 2n − 2, TILE) of (A11), Jᵀ λ = load; lu is that of J at the workspace's x, v."""
    adjoint = load_of_stress.copy()
    solve_columns(lu, adjoint, topology, True)
    refine(lu, load_of_stress, adjoint, workspace, drive, topology, constants)
    return adjoint


@kernel
def refine(lu, right, solution, workspace, drive, topology, constants):
    """Correct the solution λ of Jᵀ λ = right, both (4, 2n − 2, TILE), until its residual is small.

    With a uniform fluid the matrix lacks contacts of far walls and a small part of the viscosity,
    so lu solves only approximately. Its solutions are directions of the generalised conjugate
    residual method (Eisenstat, Elman and Schultz 1983, SIAM J. Numer. Anal. 20, 345): along each,
    λ takes the step that makes the residual smallest. A lane whose residual stays large becomes
    NaN.

    The residual is carried along. Steps are no longer than it is, so that what rounding adds stays
    far below REFINED.
    """
    has_uniform_fluid = topology.pressures > 0
    if not has_uniform_fluid:
        return
    size = np.empty(TILE)
    size_of_load = np.empty(TILE)
    largest_of(right, size_of_load)
    directions = np.empty((REFINEMENTS, *right.shape))
    images = np.empty_like(directions)
    residual = right.copy()
    directions[0] = solution
    solution[:] = 0.0
    for k in range(REFINEMENTS):
        direction = directions[k]
        image = images[k]
        if k > 0:
            direction[:] = residual
            solve_columns(lu, direction, topology, True)
        image[:] = _transposed_product(direction, workspace, drive, topology, constants)
        for j in range(k):
            share = _share(image, images[j])
            _subtract(share, directions[j], direction)
            _subtract(share, images[j], image)
        share = _share(residual, image)
        _subtract(-share, direction, solution)
        _subtract(share, image, residual)
        largest_of(residual, size)
        under_way = 0
        for lane in range(TILE):
            # infinite: the lane has no solution, and no further direction gives one
            if REFINED * size_of_load[lane] < size[lane] < np.inf:
                under_way += 1
        if under_way == 0:
            break
    for lane in range(TILE):
        is_solved = size[lane] < np.inf and size[lane] <= GOOD_ENOUGH * size_of_load[lane]
        if not is_solved:
            solution[:, :, lane] = np.nan


@kernel
def _transposed_product(columns, workspace, drive, topology, constants):
    """Return Jᵀ times the columns (4, 2n − 2, TILE), with every contact and all viscosity."""
    no_force = np.zeros_like(workspace.f)
    weights = np.zeros((COLUMNS, *workspace.x.shape))
    subtract_columns(columns, topology, weights)
    by_x, by_v = stress_gradients(workspace, weights, topology, constants)
    # the weights are −columns
    return -_pulled_back(by_x, by_v, no_force, drive, topology)


@kernel
def _share(columns, direction):
    """Return Σ columns · direction / Σ direction², (4, TILE); both are (4, rows, TILE)."""
    shares = np.empty((COLUMNS, TILE))
    squares = np.empty(TILE)
    for m in range(COLUMNS):
        product = spread(0.0)
        square = spread(0.0)
        for row in range(columns.shape[1]):
            value = load(direction, m, row)
            product += load(columns, m, row) * value
            square += value * value
        store(product, shares, m)
        store(square, squares)
        for lane in range(TILE):
            # a column without load has no direction, and a share of 0
            if squares[lane] > 0.0:
                shares[m, lane] /= squares[lane]
    return shares


@kernel
def _subtract(share, direction, columns):
    """Subtract share (4, TILE) times the direction from the columns, both (4, rows, TILE)."""
    for m in range(COLUMNS):
        factor = load(share, m)
        for row in range(columns.shape[1]):
            store(load(columns, m, row) - factor * load(direction, m, row), columns, m, row)


@kernel
def largest_of(columns, largest):
    """Fill largest (TILE,) with the largest modulus in each lane of columns (4, rows, TILE).

    It is infinite where an entry is NaN.
    """
    largest[:] = 0.0
    for m in range(columns.shape[0]):
        for row in range(columns.shape[1]):
            for lane in range(TILE):
                value = abs(columns[m, row, lane])
                is_number = value == value  # NaN differs from itself
                largest[lane] = max(largest[lane], value) if is_number else np.inf


@kernel
def _add_products(gradients, fields, first, tangents):
    """Set tangents[a, b, first + m] += Σ_k gradients[(a, b), :, k] · fields[m, :, k].

    gradients, fields: (4, 2, local, TILE). first: BY_F or BY_RATE. tangents: (2, 2, 8, TILE).
    """
    for n in range(COLUMNS):
        a, b = component(n)
        for m in range(COLUMNS):
            total = load(tangents, a, b, first + m)
            for axis in range(2):
                for k in range(fields.shape[2]):
                    total += load(gradients, n, axis, k) * load(fields, m, axis, k)
            store(total, tangents, a, b, first + m)


# How the elastic equilibrium moves


@kernel
def equilibrium_modes(workspace, F, topology, constants, matrices):
    """Return the modes ∂z_el/∂F_m (4, 2, own, TILE) at workspace.z.

    The factors of K remain in matrices.matrix.
    """
    map_affine(F, workspace.z, workspace.x)
    set_elastic_jacobian(workspace, F, topology, constants, matrices.matrix, matrices.columns)
    factorise(matrices.matrix, topology, True)
    right = np.empty((COLUMNS, *matrices.step.shape))
    for m in range(COLUMNS):
        for i in range(right.shape[1]):
            store(-load(matrices.columns, i + 2, m), right, m, i)
    steps = right.copy()
    solve_columns(matrices.matrix, steps, topology, False)
    # `refine` is for Jᵀ, which is K here: without dashpots it is symmetric
    refine(matrices.matrix, right, steps, workspace, standing(F), topology, constants)
    modes = np.zeros((COLUMNS, 2, topology.particles, TILE))
    for m in range(COLUMNS):
        move(steps[m], F, modes[m])
    return modes


@kernel
def standing(F):
    """Return the `Drive` at F without motion."""
    return Drive(F, np.zeros((2, 2, TILE)))


@kernel
def along(fields, tensor):
    """Return Σ_m tensor_m fields[m], over xx, xy, yx, yy, (2, ·, TILE).

    With modes as fields (4, 2, ·, TILE) and Ḟ as tensor it is y = ∂z_el/∂F : Ḟ.
    """
    total = np.zeros(fields.shape[1:])
    for m in range(COLUMNS):
        a, b = component(m)
        factor = load(tensor, a, b)
        for axis in range(2):
            for i in range(total.shape[1]):
                store(load(total, axis, i) + factor * load(fields, m, axis, i), total, axis, i)
    return total


@kernel
def set_velocities(z, y, F, rate, topology, v):
    """Fill v (2, local, TILE) with Ḟ z + F y; an image has the y of its owner.

    z: (2, local, TILE). y: (2, own, TILE) rate of z. rate: (2, 2, TILE) Ḟ.
    """
    particles = topology.particles
    map_affine(rate, z, v)
    xx, xy, yx, yy = entries(F)
    for i in range(v.shape[1]):
        k = i if i < particles else topology.owner[i - particles]
        y_x = load(y, 0, k)
        y_y = load(y, 1, k)
        store(load(v, 0, i) + xx * y_x + xy * y_y, v, 0, i)
        store(load(v, 1, i) + yx * y_x + yy * y_y, v, 1, i)


@kernel
def unit_velocities(z, modes, F, topology):
    """Return V_m = ∂x_el/∂F_m, (4, 2, local, TILE): velocities where one entry of Ḟ is 1."""
    velocities = np.empty((COLUMNS, 2, z.shape[1], TILE))
    unit = np.zeros((COLUMNS, 2, 2, TILE))
    for m in range(COLUMNS):
        a, b = component(m)
        unit[m, a, b] = 1.0
        set_velocities(z, modes[m], F, unit[m], topology, velocities[m])
    return velocities


@kernel
def velocity_slopes(workspace, units, F, topology, constants, lu):
    """Return ∂v/∂F_m, (4, 2, local, TILE), of the velocities v = Σ Ḟ_n V_n in workspace.v.

    They are −K⁻¹ K̇ V_m at workspace.x, with K̇ the rate of K along v. units: V. lu: factors of K.
    """
    slopes = np.zeros_like(units)
    rates = np.zeros_like(units)
    add_stiffness_rates(workspace, units, rates, topology, constants)
    right = np.empty((COLUMNS, 2 * topology.particles - 2, TILE))
    fold_columns(rates, topology, right)
    steps = right.copy()
    solve_columns(lu, steps, topology, False)
    if topology.pressures > 0:
        moving = workspace.v.copy()
        workspace.v[:] = 0.0  # residuals are those of K, the Jacobian at rest
        refine(lu, right, steps, workspace, standing(F), topology, constants)
        workspace.v[:] = moving
    subtract_columns(steps, topology, slopes)
    return slopes


@kernel
def fold_columns(fields, topology, columns):
    """Fill columns (4, 2n − 2, TILE) with fields (4, 2, local, TILE), images added to their owners.

    The held particle has no rows.
    """
    particles = topology.particles
    for m in range(COLUMNS):
        for axis in range(2):
            for i in range(1, particles):
                store(load(fields, m, axis, i), columns, m, row_x(i) + axis)
            for k in range(topology.owner.shape[0]):
                i = topology.owner[k]
                is_free = i > 0
                if is_free:
                    row = row_x(i) + axis
                    value = load(columns, m, row) + load(fields, m, axis, particles + k)
                    store(value, columns, m, row)


@kernel
def subtract_columns(columns, topology, fields):
    """Subtract columns (4, 2n − 2, TILE) from fields (4, 2, local, TILE), images as owners."""
    particles = topology.particles
    for m in range(COLUMNS):
        for k in range(fields.shape[2]):
            i = k if k < particles else topology.owner[k - particles]
            is_free = i > 0
            if is_free:
                for axis in range(2):
                    value = load(fields, m, axis, k) - load(columns, m, row_x(i) + axis)
                    store(value, fields, m, axis, k)
