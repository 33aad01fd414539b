"""Fluid of one pressure for each plant cell: energy, forces and their derivatives.

docs/theory.md, uniform fluid. The rim of a plant cell is its wall particles, counter-clockwise, at
y_k; as local ones, so that images feel what acts on them. Their *normals* are g_k = ∂A/∂y_k, half
the way from the neighbour before to the one after, turned outwards. With L the mean velocity
gradient within the rim::

    A = ½ Σ y_k × y_(k+1)               g_k = ½ R (y_(k+1) − y_(k−1)),  R = [[0, 1], [−1, 0]]
    E = m c_s² ln(m/A) + K (A − A₀ − A₀ ln(A/A₀))
    p = −∂E/∂A = (m c_s² + K A₀)/A − K
    L = 1/A Σ v_k ⊗ g_k,  τ = µ (L + Lᵀ − tr L I),  S = p I − τ
    f_k = S g_k

Normals are linear in positions: those of velocities are the rates ġ_k. They are symmetric, too:
Σ u_k·g_k(w) = Σ w_k·g_k(u) for any two fields.

A motion changes the pressure of a plant cell by p′ Σ g_k·δy_k, which couples its whole rim. So
matrices have δp as an unknown of its own, see `block_matrices`::

    [ J₀   g  ] [δx]                      J₀: derivatives at constant pressure
    [ gᵀ −1/p′] [δp]

The mean velocity gradient does not change where velocities are affine and follow a motion, for then
L is theirs. Matrices have no term for its change elsewhere, on the slow manifold, which is of the
order of µ |L| over the stiffness. The other derivatives have it, and `solve_adjoint` corrects what
matrices lack.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.plant_cell.pair_sums import BY_RATE, FIELDS, add_block, add_to


class Fluid(NamedTuple):
    """The fluid of one plant cell, every field as lanes.

    per_area: 1/A, 1/µm².
    pressure: p, µN/µm; slope, bend: its first and second derivative by A.
    L: mean velocity gradient (xx, xy, yx, yy), 1/µs.
    stress: S (xx, xy, yy), µN/µm.
    """

    per_area: float
    pressure: float
    slope: float
    bend: float
    L: tuple[float, float, float, float]
    stress: tuple[float, float, float]


@pair_law
def normal_at(x, rim, k):
    """Return both components of the normal g_k of positions x, or of any other field.

    x: (2, local, TILE). rim: (count,) local wall particles around the plant cell.
    """
    count = rim.shape[0]
    before = rim[(k + count - 1) % count]
    after = rim[(k + 1) % count]
    gx = 0.5 * (load(x, 1, after) - load(x, 1, before))
    gy = 0.5 * (load(x, 0, before) - load(x, 0, after))
    return gx, gy


@kernel
def rim_product(u, x, rim):
    """Return (xx, xy, yx, yy) of Σ u_k ⊗ g_k(x); it is A I for u = x and A L for u = v.

    u, x: (2, local, TILE). Since Σ g_k = 0, u may count from its value at the first particle, which
    rounds less.
    """
    xx = spread(0.0)
    xy = spread(0.0)
    yx = spread(0.0)
    yy = spread(0.0)
    first_x = load(u, 0, rim[0])
    first_y = load(u, 1, rim[0])
    for k in range(rim.shape[0]):
        gx, gy = normal_at(x, rim, k)
        ux = load(u, 0, rim[k]) - first_x
        uy = load(u, 1, rim[k]) - first_y
        xx += ux * gx
        xy += ux * gy
        yx += uy * gx
        yy += uy * gy
    return xx, xy, yx, yy


@kernel
def rim_area(x, rim):
    """Return the area A within a rim at positions x (2, local, TILE), µm²."""
    xx, _, _, yy = rim_product(x, x, rim)
    return 0.5 * (xx + yy)


@pair_law
def rim_of(topology, cell):
    """Return the local indices (count,) of the wall particles around a plant cell."""
    return topology.rim[topology.rim_start[cell] : topology.rim_start[cell + 1]]


@pair_law
def twice_deviator(L, factor):
    """Return (xx, xy, yy) of factor · (L + Lᵀ − tr L I); yy is −xx. L: (xx, xy, yx, yy)."""
    xx = factor * (L[0] - L[3])
    xy = factor * (L[1] + L[2])
    return xx, xy, -xx


@kernel
def fluid_at(x, v, topology, cell, constants):
    """Return the `Fluid` of a plant cell at positions x and velocities v (2, local, TILE)."""
    rim = rim_of(topology, cell)
    per_area = 1.0 / rim_area(x, rim)
    osmotic = topology.fluid_mass[cell] * constants.sound_speed_squared
    strength = osmotic + constants.sap_modulus * topology.rest_area[cell]
    pressure = strength * per_area - constants.sap_modulus
    slope = -strength * per_area * per_area
    xx, xy, yx, yy = rim_product(v, x, rim)
    L = (xx * per_area, xy * per_area, yx * per_area, yy * per_area)
    txx, txy, tyy = twice_deviator(L, constants.viscosity)
    stress = (pressure - txx, -txy, pressure - tyy)
    return Fluid(per_area, pressure, slope, -2.0 * slope * per_area, L, stress)


@pair_law
def add_vector(f, i, fx, fy):
    """Add (fx, fy) to f (2, local, TILE) at particle i."""
    add_to(f[0], i, fx)
    add_to(f[1], i, fy)


@kernel
def add_uniform_forces(x, v, f, topology, constants):
    """Add pressure and viscous forces S g_k to f (2, local, TILE), µN."""
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        xx, xy, yy = fluid_at(x, v, topology, cell, constants).stress
        for k in range(rim.shape[0]):
            gx, gy = normal_at(x, rim, k)
            add_vector(f, rim[k], xx * gx + xy * gy, xy * gx + yy * gy)


@kernel
def add_uniform_energy(x, topology, constants, energy):
    """Add the stored energy, pJ, to energy (1, TILE)."""
    area = np.empty((1, TILE))
    for cell in range(topology.rim_start.shape[0] - 1):
        store(rim_area(x, rim_of(topology, cell)), area, 0)
        mass = topology.fluid_mass[cell]
        rest = topology.rest_area[cell]
        osmotic = mass * constants.sound_speed_squared
        for lane in range(TILE):
            A = area[0, lane]
            energy[0, lane] += osmotic * np.log(mass / A)
            energy[0, lane] += constants.sap_modulus * (A - rest - rest * np.log(A / rest))


@kernel
def add_uniform_jacobian(workspace, topology, constants, matrix, columns):
    """Add the slopes of the fluid's forces to matrix and columns; see `force_jacobian`.

    The change of pressure δp is an unknown of its own, as at the head of this file.
    """
    particles = topology.particles
    owner = topology.owner
    block = topology.block
    stride = topology.stride
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        unknown = particles + cell
        fluid = fluid_at(workspace.x, workspace.v, topology, cell, constants)
        xx, xy, yy = fluid.stress
        # slopes of the force S g_k by the neighbour after, ½ S R, and by the one before
        by_after = (-0.5 * xy, 0.5 * xx, -0.5 * yy, 0.5 * xy)
        by_before = (-by_after[0], -by_after[1], -by_after[2], -by_after[3])
        # δp lies like a particle, whose second unknown is idle: its equation is −1 · it = 0
        add_block(matrix, block, stride, unknown, unknown, (-1.0 / fluid.slope, 0.0, 0.0, -1.0))
        for k in range(rim.shape[0]):
            gx, gy = normal_at(workspace.x, rim, k)
            i = rim[k]
            j = rim[(k + 1) % rim.shape[0]]
            # matrices have own particles alone: images move as their owners do
            i = i if i < particles else owner[i - particles]
            j = j if j < particles else owner[j - particles]
            add_block(matrix, block, stride, i, j, by_after)
            add_block(matrix, block, stride, j, i, by_before)
            add_block(matrix, block, stride, i, unknown, (gx, 0.0, gy, 0.0))
            add_block(matrix, block, stride, unknown, i, (gx, gy, 0.0, 0.0))
    if columns.shape[0] > 0 and topology.rim.shape[0] > 0:
        _add_columns(workspace, topology, constants, columns)


@kernel
def _add_columns(workspace, topology, constants, columns):
    """Add ∂f/∂F_bc and ∂f/∂Ḟ_bc to columns (2n, 8, TILE).

    A change of F_bc moves positions by e_b z_c, one of Ḟ_bc changes velocities so. Columns are
    those by F_xx, xy, yx, yy, then those by Ḟ.
    """
    particles = topology.particles
    still = np.zeros_like(workspace.x)
    change = np.empty_like(workspace.x)
    moving = np.empty_like(workspace.x)
    for m in range(columns.shape[1]):
        b = m % 4 // 2
        along = m % 2
        moving[:] = 0.0
        moving[b] = workspace.z[along]
        change[:] = 0.0
        if m < BY_RATE:
            _add_change(workspace.x, workspace.v, moving, still, topology, constants, change)
        else:
            _add_change(workspace.x, workspace.v, still, moving, topology, constants, change)
        for k in range(change.shape[1]):
            i = k if k < particles else topology.owner[k - particles]
            store(load(columns, 2 * i, m) + load(change, 0, k), columns, 2 * i, m)
            store(load(columns, 2 * i + 1, m) + load(change, 1, k), columns, 2 * i + 1, m)


@kernel
def _add_change(x, v, dx, dv, topology, constants, change):
    """Add to change (2, local, TILE) how forces change with positions by dx, velocities by dv.

    δf_k = (δp I − δτ) g_k + S g_k(dx), with δ(A L) = Σ dv_k ⊗ g_k + Σ v_k ⊗ g_k(dx) in δτ.
    """
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        fluid = fluid_at(x, v, topology, cell, constants)
        xx, xy, yy = fluid.stress
        by_dx = rim_product(dx, x, rim)
        by_dv = rim_product(dv, x, rim)
        # δ(A L) has a part by the normals that turn with dx
        turned = rim_product(v, dx, rim)
        area = by_dx[0] + by_dx[3]
        dxx = by_dv[0] + turned[0] - fluid.L[0] * area
        dxy = by_dv[1] + turned[1] - fluid.L[1] * area
        dyx = by_dv[2] + turned[2] - fluid.L[2] * area
        dyy = by_dv[3] + turned[3] - fluid.L[3] * area
        txx, txy, tyy = twice_deviator((dxx, dxy, dyx, dyy), constants.viscosity * fluid.per_area)
        pressure = fluid.slope * area
        for k in range(rim.shape[0]):
            gx, gy = normal_at(x, rim, k)
            hx, hy = normal_at(dx, rim, k)
            fx = (pressure - txx) * gx - txy * gy + xx * hx + xy * hy
            fy = (pressure - tyy) * gy - txy * gx + xy * hx + yy * hy
            add_vector(change, rim[k], fx, fy)


@kernel
def add_uniform_gradients(workspace, weights, by_x, by_v, topology, constants):
    """Add the slopes of Σ φ·f of the fluid to by_x and by_v; see `add_force_gradients`.

    With Φ = Σ φ_k ⊗ g_k and T = µ (Φ + Φᵀ − tr Φ I)::

        by v_k: −1/A T g_k
        by y_k: (p′ tr Φ + 1/A L:T) g_k + 1/A T ġ_k + Ŝ g_k(φ),   Ŝ = R S Rᵀ
    """
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        fluid = fluid_at(workspace.x, workspace.v, topology, cell, constants)
        sxx, sxy, syy = fluid.stress
        L = fluid.L
        per_area = fluid.per_area
        for m in range(FIELDS):
            field = weights[m]
            to_x = by_x[m]
            to_v = by_v[m]
            product = rim_product(field, workspace.x, rim)
            txx, txy, tyy = twice_deviator(product, constants.viscosity * per_area)
            along = fluid.slope * (product[0] + product[3])
            along += txx * L[0] + txy * (L[1] + L[2]) + tyy * L[3]
            for k in range(rim.shape[0]):
                gx, gy = normal_at(workspace.x, rim, k)
                hx, hy = normal_at(workspace.v, rim, k)
                nx, ny = normal_at(field, rim, k)
                # Ŝ is [[Syy, −Sxy], [−Sxy, Sxx]]
                fx = along * gx + txx * hx + txy * hy + syy * nx - sxy * ny
                fy = along * gy + txy * hx + tyy * hy + sxx * ny - sxy * nx
                add_vector(to_x, rim[k], fx, fy)
                add_vector(to_v, rim[k], -(txx * gx + txy * gy), -(txy * gx + tyy * gy))


@kernel
def add_uniform_rates(workspace, f_rate, topology, constants):
    """Add elastic forces f = p g_k to workspace.f and ḟ = p′ Ȧ g_k + p ġ_k to f_rate.

    Both are (2, local, TILE); rates are those along workspace.v.
    """
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        fluid = fluid_at(workspace.x, workspace.v, topology, cell, constants)
        pressure = fluid.pressure
        rate = fluid.slope * _trace(rim_product(workspace.v, workspace.x, rim))
        for k in range(rim.shape[0]):
            gx, gy = normal_at(workspace.x, rim, k)
            hx, hy = normal_at(workspace.v, rim, k)
            add_vector(workspace.f, rim[k], pressure * gx, pressure * gy)
            add_vector(f_rate, rim[k], rate * gx + pressure * hx, rate * gy + pressure * hy)


@kernel
def add_uniform_stiffness_rates(workspace, u, f, topology, constants):
    """Add K̇ u to f for the FIELDS fields u; u, f (FIELDS, 2, local, TILE).

    It is the rate along workspace.v of K u_k = p′ (g·u) g_k + p g_k(u), with g·u = Σ g_k·u_k.
    """
    for cell in range(topology.rim_start.shape[0] - 1):
        rim = rim_of(topology, cell)
        fluid = fluid_at(workspace.x, workspace.v, topology, cell, constants)
        slope = fluid.slope
        area_rate = _trace(rim_product(workspace.v, workspace.x, rim))
        for m in range(FIELDS):
            field = u[m]
            target = f[m]
            across = _trace(rim_product(field, workspace.x, rim))
            along = fluid.bend * area_rate * across
            along += slope * _trace(rim_product(field, workspace.v, rim))
            for k in range(rim.shape[0]):
                gx, gy = normal_at(workspace.x, rim, k)
                hx, hy = normal_at(workspace.v, rim, k)
                nx, ny = normal_at(field, rim, k)
                fx = along * gx + slope * (across * hx + area_rate * nx)
                fy = along * gy + slope * (across * hy + area_rate * ny)
                add_vector(target, rim[k], fx, fy)


@pair_law
def _trace(tensor):
    """Return the trace of a tensor (xx, xy, yx, yy)."""
    return tensor[0] + tensor[3]
