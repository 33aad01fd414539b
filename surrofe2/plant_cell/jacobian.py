"""Exact derivatives of the particle forces, for a tile of cells at once.

With r = F Z and w = Ḟ Z for every pair (Z: material distance, images included), the force on i is
f(r, w), and with positions moved by δx at fixed (F, Ḟ), velocities follow as L δx, L = Ḟ F⁻¹::

    δf = (∂f/∂r + ∂f/∂w L) δr                        `matrix`
    δf = ∂f/∂r δF Z + ∂f/∂w δḞ Z  at fixed Z         `columns`

The fluid's density couples all fluid of a cell: δf += (∂f/∂ρ)(∂ρ/∂x) δx.

Layout, lanes last::

    matrix                           ∂f_ia/∂x_jb of own particles but the held one, see `Pattern`
    columns[2 i + a, 2 b + c, lane]  ∂f_ia/∂F_bc;    columns[2 i + a, 4 + 2 b + c, lane]: ∂/∂Ḟ_bc
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.plant_cell.forces import central_slopes, difference, fluid_specific_volume, pair_at
from surrofe2.plant_cell.pair_laws import (
    fluid_coefficients,
    fluid_volume_slopes,
    spline_bend,
)
from surrofe2.plant_cell.tiles import central_pairs


@pair_law
def central_gradient(pair, tension, by_length, by_rate):
    """∂(t n)/∂r as (xx, xy, yx, yy); ∂(t n)/∂w is by_rate n ⊗ n."""
    nx, ny = pair.nx, pair.ny
    over = tension * pair.inverse
    along = by_length - over
    ux = along * nx + by_rate * (pair.wx - pair.rate * nx) * pair.inverse
    uy = along * ny + by_rate * (pair.wy - pair.rate * ny) * pair.inverse
    return over + nx * ux, nx * uy, ny * ux, over + ny * uy


@pair_law
def add_to(array, row, value):
    """array[row] += value."""
    store(load(array, row) + value, array, row)


@pair_law
def add_at(array, row, column, value):
    """array[row, column] += value."""
    store(load(array, row, column) + value, array, row, column)


@pair_law
def add_block(matrix, block, stride, i, j, entries):
    """Add entries (xx, xy, yx, yy) at particles (i, j), unless one of them is held."""
    upper = block[i, j]
    if upper >= 0:
        lower = upper + stride[i]
        add_to(matrix, upper, entries[0])
        add_to(matrix, upper + 1, entries[1])
        add_to(matrix, lower, entries[2])
        add_to(matrix, lower + 1, entries[3])


@pair_law
def add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw):
    """Spread ∂f/∂r = rr and ∂f/∂w = rw, each (xx, xy, yx, yy), over own particles i and j."""
    lxx, lxy, lyx, lyy = load(L, 0, 0), load(L, 0, 1), load(L, 1, 0), load(L, 1, 1)
    xx = rr[0] + rw[0] * lxx + rw[1] * lyx
    xy = rr[1] + rw[0] * lxy + rw[1] * lyy
    yx = rr[2] + rw[2] * lxx + rw[3] * lyx
    yy = rr[3] + rw[2] * lxy + rw[3] * lyy
    add_block(matrix, block, stride, i, j, (xx, xy, yx, yy))
    add_block(matrix, block, stride, j, i, (xx, xy, yx, yy))
    add_block(matrix, block, stride, i, i, (-xx, -xy, -yx, -yy))
    add_block(matrix, block, stride, j, j, (-xx, -xy, -yx, -yy))


@pair_law
def add_load(columns, row, column, kx, ky, zx, zy):
    """Add (kx, ky) ⊗ (zx, zy) to four columns of a row."""
    add_at(columns, row, column, kx * zx)
    add_at(columns, row, column + 1, kx * zy)
    add_at(columns, row, column + 2, ky * zx)
    add_at(columns, row, column + 3, ky * zy)


@pair_law
def add_pair_load(columns, Z, i, j, j_own, rr, rw):
    """Spread ∂f/∂F = rr ⊗ Z and ∂f/∂Ḟ = rw ⊗ Z over own particles."""
    zx, zy = difference(Z, i, j)
    add_load(columns, 2 * i, 0, rr[0], rr[1], zx, zy)
    add_load(columns, 2 * i + 1, 0, rr[2], rr[3], zx, zy)
    add_load(columns, 2 * i, 4, rw[0], rw[1], zx, zy)
    add_load(columns, 2 * i + 1, 4, rw[2], rw[3], zx, zy)
    add_load(columns, 2 * j_own, 0, -rr[0], -rr[1], zx, zy)
    add_load(columns, 2 * j_own + 1, 0, -rr[2], -rr[3], zx, zy)
    add_load(columns, 2 * j_own, 4, -rw[0], -rw[1], zx, zy)
    add_load(columns, 2 * j_own + 1, 4, -rw[2], -rw[3], zx, zy)


@kernel
def _add_central(work, L, pairs, is_bond, topology, c, matrix, columns):
    own, owner = topology.particles, topology.owner
    block, stride = topology.block, topology.stride  # named in the loop, they would be counted
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        j_own = j if j < own else owner[j - own]
        pair = pair_at(work.x, work.v, i, j)
        tension, by_length, by_rate = central_slopes(pair, is_bond, c)
        rr = central_gradient(pair, tension, by_length, by_rate)
        nx, ny = pair.nx, pair.ny
        cross = by_rate * nx * ny
        rw = (by_rate * nx * nx, cross, cross, by_rate * ny * ny)
        add_pair_jacobian(matrix, block, stride, L, i, j_own, rr, rw)
        if columns.shape[0] > 0:
            add_pair_load(columns, work.z, i, j, j_own, rr, rw)


@kernel
def _add_fluid(cell, work, L, topology, c, matrix, columns):
    """Pressure and viscous forces of one plant cell, work.slope and work.volume given."""
    pairs, first = topology.fluid_pairs, topology.walls + topology.fluid_start[cell]
    fluid = topology.fluid_start[cell + 1] - topology.fluid_start[cell]
    h, block, stride = c.smoothing_length, topology.block, topology.stride
    by_density = np.zeros((2 * fluid, fluid, TILE))
    density_by_x = np.zeros((fluid, 2 * fluid, TILE))
    density_by_load = np.zeros((fluid, 4, TILE))
    for k in range(topology.fluid_pair_start[cell], topology.fluid_pair_start[cell + 1]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
        rx, ry, wx, wy, nx, ny = pair.rx, pair.ry, pair.wx, pair.wy, pair.nx, pair.ny
        steep, volume_i = load(work.slope, k), load(work.volume, i - topology.walls)
        volume_j = load(work.volume, j - topology.walls)
        a, b = fluid_coefficients(steep, volume_i, volume_j, c)
        bend = spline_bend(steep, pair.length, pair.inverse, h)
        da, db = fluid_coefficients(bend, volume_i, volume_j, c)
        ux, uy = da * rx + db * wx, da * ry + db * wy
        rr = (a + ux * nx, ux * ny, uy * nx, a + uy * ny)
        rw = (b, spread(0.0), spread(0.0), b)
        add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw)

        a, b = fluid_volume_slopes(steep, volume_j, c)
        gx = -volume_i * volume_i * (a * rx + b * wx)
        gy = -volume_i * volume_i * (a * ry + b * wy)
        add_pair_column(by_density, 2 * p, 2 * q, p, gx, gy)
        a, b = fluid_volume_slopes(steep, volume_i, c)
        gx = -volume_j * volume_j * (a * rx + b * wx)
        gy = -volume_j * volume_j * (a * ry + b * wy)
        add_pair_column(by_density, 2 * p, 2 * q, q, gx, gy)
        gx, gy = c.fluid_mass * steep * rx, c.fluid_mass * steep * ry
        add_pair_row(density_by_x, p, 2 * p, 2 * q, gx, gy)
        add_pair_row(density_by_x, q, 2 * p, 2 * q, gx, gy)
        if columns.shape[0] > 0:
            zx, zy = difference(work.z, i, j)
            add_pair_load(columns, work.z, i, j, j, rr, rw)
            add_load(density_by_load, p, 0, gx, gy, zx, zy)
            add_load(density_by_load, q, 0, gx, gy, zx, zy)
    g = topology.group[first]
    width, column = topology.width[g], topology.column[first]
    at = topology.start[g] + column * width + topology.offset[g, g] + column
    add_product(by_density, density_by_x, matrix, at, width)
    if columns.shape[0] > 0:
        rows = columns.reshape(-1, TILE)
        add_product(by_density, density_by_load, rows, 8 * 2 * first, 8)


@pair_law
def add_pair_column(array, row_i, row_j, column, gx, gy):
    """(gx, gy) on the rows of i, its negative on those of j."""
    add_at(array, row_i, column, gx)
    add_at(array, row_i + 1, column, gy)
    add_at(array, row_j, column, -gx)
    add_at(array, row_j + 1, column, -gy)


@pair_law
def add_pair_row(array, row, column_i, column_j, gx, gy):
    """(gx, gy) on the columns of j, its negative on those of i."""
    add_at(array, row, column_j, gx)
    add_at(array, row, column_j + 1, gy)
    add_at(array, row, column_i, -gx)
    add_at(array, row, column_i + 1, -gy)


@kernel
def add_product(left, right, values, at, width):
    """values[at + m · width + n] += Σ_s left[m, s] right[s, n], an even number of n."""
    for m in range(left.shape[0]):
        row = at + m * width
        for n in range(0, right.shape[1], 2):
            even, odd = load(values, row + n), load(values, row + n + 1)
            for s in range(left.shape[1]):
                factor = load(left, m, s)
                even += factor * load(right, s, n)
                odd += factor * load(right, s, n + 1)
            store(even, values, row + n)
            store(odd, values, row + n + 1)


@kernel
def force_jacobian(work, L, topology, c, matrix, columns):
    """Fill matrix (size, TILE) and columns (2n, 8, TILE) at local work.x, work.v, work.z.

    L: (2, 2, TILE) velocity gradient that velocities follow; zero, with v = 0, for the elastic
    Hessian, whose negative `matrix` then is. `columns` may have no rows: not wanted.
    """
    matrix[:] = 0.0
    columns[:] = 0.0
    for outer in range(2):  # one place in the machine code that is made of it
        bonds, contacts, own = central_pairs(topology, c, outer)
        _add_central(work, L, bonds, True, topology, own, matrix, columns)
        _add_central(work, L, contacts, False, topology, own, matrix, columns)
    fluid_specific_volume(work.x, topology, c, work.slope, work.volume)
    for cell in range(topology.fluid_start.shape[0] - 1):
        _add_fluid(cell, work, L, topology, c, matrix, columns)
