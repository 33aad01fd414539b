"""Exact derivatives of the particle forces, for a tile of plant cells at once.

With r = F Z and w = Ḟ Z for every pair (Z: material distance, images included), the force on i is
f(r, w), of fluid f(r, w, V_i, V_j) with V = 1/ρ, which couples all fluid of a plant cell. Each kind
of pair states its slopes once (`central_slopes`, `fluid_slopes`), tensors as (xx, xy, yx, yy), and
three passes contract them:

- `force_jacobian`, matrices, lanes last. With L = Ḟ F⁻¹ and positions moved by δx at fixed (F, Ḟ)::

      δf = (∂f/∂r + ∂f/∂w L) δr                        `matrix`, see `Pattern`
      δf = ∂f/∂r δF Z + ∂f/∂w δḞ Z  at fixed Z         `columns`
      columns[2 i + a, 2 b + c, lane]  ∂f_ia/∂F_bc;    columns[2 i + a, 4 + 2 b + c, lane]: ∂/∂Ḟ_bc

- `add_force_gradients`, transposed: slopes of weighted sums Σ_k φ_k·f_k by x and v, four φ at once.
- `elastic_forces_and_rates`, along one direction: elastic forces f and ḟ = ∂f/∂x · v.

`add_stiffness_rates` adds K̇ u, the change of the elastic stiffness K = ∂f/∂x along v, times u. For
a central pair with tension t(|r|), n = r/|r|, w = v_j − v_i, s = n·w, b = t′ − t/|r|, p = u_j − u_i
and ṅ = (w − s n)/|r|::

    K̇ p = b s/|r| p + (t″ − b/|r|) s (n·p) n + b [(n·p) ṅ + (ṅ·p) n]
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.plant_cell.forces import (
    add_pair,
    central_law,
    difference,
    fluid_specific_volume,
    pair_at,
)
from surrofe2.plant_cell.pair_laws import (
    contact_bend,
    fluid_coefficients,
    fluid_volume_slopes,
    spline_bend,
    tension,
)

FIELDS = 4
STEP = 1e-6
"""Of the fastest particle to either side, in smoothing lengths: K is then exact to 1e-12 by its
curvature, and to 1e-9 by rounding; of a longer step, more pairs pass a knot of the spline."""


@pair_law
def central_slopes(pair, is_bond, weight, c):
    """(∂f/∂r, ∂f/∂w) of a bond or contact with force t n; the second is γ n ⊗ n."""
    acting, law = central_law(pair, is_bond, weight, c)
    _, stiffness, damping, damping_slope = law
    nx, ny, by_rate = pair.nx, pair.ny, acting * damping
    over = acting * tension(law, pair.rate) * pair.inverse
    along = acting * (stiffness + damping_slope * pair.rate) - over
    ux = along * nx + by_rate * (pair.wx - pair.rate * nx) * pair.inverse
    uy = along * ny + by_rate * (pair.wy - pair.rate * ny) * pair.inverse
    cross = by_rate * nx * ny
    rr = (over + nx * ux, nx * uy, ny * ux, over + ny * uy)
    return rr, (by_rate * nx * nx, cross, cross, by_rate * ny * ny)


@pair_law
def fluid_slopes(pair, steep, volume_i, volume_j, c):
    """(∂f/∂r, ∂f/∂w, ∂f/∂V_i, ∂f/∂V_j) of a fluid pair, W′/|r| = steep, V = 1/ρ."""
    rx, ry, wx, wy = pair.rx, pair.ry, pair.wx, pair.wy
    a, b = fluid_coefficients(steep, volume_i, volume_j, c)
    bend = spline_bend(steep, pair.length, pair.inverse, c.smoothing_length)
    da, db = fluid_coefficients(bend, volume_i, volume_j, c)
    ux, uy = da * rx + db * wx, da * ry + db * wy
    rr = (a + ux * pair.nx, ux * pair.ny, uy * pair.nx, a + uy * pair.ny)
    rw = (b, spread(0.0), spread(0.0), b)
    ai, bi = fluid_volume_slopes(steep, volume_j, c)
    aj, bj = fluid_volume_slopes(steep, volume_i, c)
    at_i = (ai * rx + bi * wx, ai * ry + bi * wy)
    return rr, rw, at_i, (aj * rx + bj * wx, aj * ry + bj * wy)


@pair_law
def add_to(array, row, value):
    """array[row] += value."""
    store(load(array, row) + value, array, row)


@pair_law
def add_at(array, row, column, value):
    """array[row, column] += value."""
    store(load(array, row, column) + value, array, row, column)


# Matrices


@kernel
def force_jacobian(work, L, topology, c, matrix, columns):
    """Fill matrix (size, TILE) and columns (2n, 8, TILE) at local work.x, work.v, work.z.

    L: (2, 2, TILE) velocity gradient that velocities follow; zero, with v = 0, for the elastic
    Hessian, whose negative `matrix` then is. `columns` may have no rows: not wanted.
    """
    matrix[:] = 0.0
    columns[:] = 0.0
    for kind in range(2):  # one call, so that its machine code is made once
        pairs, weight = topology.bonds, topology.bond_weight
        if kind == 1:
            pairs, weight = topology.contacts, topology.contact_weight
        _add_central(work, L, pairs, weight, kind == 0, topology, c, matrix, columns)
    fluid_specific_volume(work.x, topology, c, work.slope, work.volume)
    for cell in range(topology.fluid_start.shape[0] - 1):
        _add_fluid(cell, work, L, topology, c, matrix, columns)


@kernel
def _add_central(work, L, pairs, weight, is_bond, topology, c, matrix, columns):
    own, owner = topology.particles, topology.owner
    # named in the loop, numba would count references to them there
    block, stride = topology.block, topology.stride
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        j_own = j if j < own else owner[j - own]
        pair = pair_at(work.x, work.v, i, j)
        rr, rw = central_slopes(pair, is_bond, weight[k], c)
        add_pair_jacobian(matrix, block, stride, L, i, j_own, rr, rw)
        if columns.shape[0] > 0:
            add_pair_load(columns, work.z, i, j, j_own, rr, rw)


@kernel
def _add_fluid(cell, work, L, topology, c, matrix, columns):
    """Pressure and viscous forces of one plant cell, work.slope and work.volume given."""
    pairs, first = topology.fluid_pairs, topology.walls + topology.fluid_start[cell]
    fluid = topology.fluid_start[cell + 1] - topology.fluid_start[cell]
    block, stride = topology.block, topology.stride
    by_density = np.zeros((2 * fluid, fluid, TILE))
    density_by_x = np.zeros((fluid, 2 * fluid, TILE))
    density_by_load = np.zeros((fluid, 4, TILE))
    for k in range(topology.fluid_pair_start[cell], topology.fluid_pair_start[cell + 1]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
        steep, volume_i = load(work.slope, k), load(work.volume, i - topology.walls)
        volume_j = load(work.volume, j - topology.walls)
        rr, rw, at_i, at_j = fluid_slopes(pair, steep, volume_i, volume_j, c)
        add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw)
        by_i, by_j = -volume_i * volume_i, -volume_j * volume_j
        add_pair_column(by_density, 2 * p, 2 * q, p, by_i * at_i[0], by_i * at_i[1])
        add_pair_column(by_density, 2 * p, 2 * q, q, by_j * at_j[0], by_j * at_j[1])
        gx, gy = c.fluid_mass * steep * pair.rx, c.fluid_mass * steep * pair.ry
        add_pair_row(density_by_x, p, 2 * p, 2 * q, gx, gy)
        add_pair_row(density_by_x, q, 2 * p, 2 * q, gx, gy)
        if columns.shape[0] > 0:
            zx, zy = difference(work.z, i, j)
            add_pair_load(columns, work.z, i, j, j, rr, rw)
            add_load(density_by_load, p, 0, gx, gy, zx, zy)
            add_load(density_by_load, q, 0, gx, gy, zx, zy)
    # the fluid of a plant cell is one group of the pattern: its block begins at its first particle
    g = topology.group[first]
    width, column = topology.width[g], topology.column[first]
    at = topology.start[g] + column * width + topology.offset[g, g] + column
    add_product(by_density, density_by_x, matrix, at, width)
    if columns.shape[0] > 0:
        rows = columns.reshape(-1, TILE)
        add_product(by_density, density_by_load, rows, 8 * 2 * first, 8)


@pair_law
def add_block(matrix, block, stride, i, j, entries):
    """Add entries (xx, xy, yx, yy) at particles (i, j), unless one is held or there is no block."""
    upper = block[i, j]
    if upper >= 0:
        lower = upper + stride[i]
        add_to(matrix, upper, entries[0])
        add_to(matrix, upper + 1, entries[1])
        add_to(matrix, lower, entries[2])
        add_to(matrix, lower + 1, entries[3])


@pair_law
def add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw):
    """Spread ∂f/∂r = rr and ∂f/∂w = rw over own particles i and j."""
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


# Transposed products


@kernel
def add_force_gradients(work, weights, by_x, by_v, topology, c):
    """Add the slopes of Σ_k φ_k·f_k with x to by_x and with v to by_v, for four φ in `weights`.

    At work.x and work.v; weights, by_x, by_v: (4, 2, local, TILE).
    """
    bonds, contacts = topology.bonds, topology.contacts
    _add_central_gradients(work, weights, by_x, by_v, bonds, topology.bond_weight, True, c)
    _add_central_gradients(work, weights, by_x, by_v, contacts, topology.contact_weight, False, c)
    _add_fluid_gradients(work, weights, by_x, by_v, topology, c)


@kernel
def _add_central_gradients(work, weights, by_x, by_v, pairs, weight, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
        rr, rw = central_slopes(pair, is_bond, weight[k], c)
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            add_transposed(by_x, m, i, j, rr, px, py)
            add_transposed(by_v, m, i, j, rw, px, py)


@kernel
def _add_fluid_gradients(work, weights, by_x, by_v, topology, c):
    pairs, first = topology.fluid_pairs, topology.walls
    slope, volume = work.slope, work.volume
    fluid_specific_volume(work.x, topology, c, slope, volume)
    by_volume = np.zeros((FIELDS, volume.shape[0], TILE))
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
        steep, volume_i, volume_j = load(slope, k), load(volume, p), load(volume, q)
        rr, rw, at_i, at_j = fluid_slopes(pair, steep, volume_i, volume_j, c)
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            add_transposed(by_x, m, i, j, rr, px, py)
            add_field_pair(by_v, m, i, j, rw[0] * px, rw[0] * py)
            add_at(by_volume, m, p, -(at_i[0] * px + at_i[1] * py))
            add_at(by_volume, m, q, -(at_j[0] * px + at_j[1] * py))
    # from slopes by V to slopes by ρ, and through ∂ρ/∂x to the particles
    for m in range(FIELDS):
        for p in range(volume.shape[0]):
            here = load(volume, p)
            store(-here * here * load(by_volume, m, p), by_volume, m, p)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(work.x, i, j)
        density = c.fluid_mass * load(slope, k)
        for m in range(FIELDS):
            both = density * (load(by_volume, m, i - first) + load(by_volume, m, j - first))
            add_field_pair(by_x, m, i, j, -both * rx, -both * ry)


@pair_law
def field_difference(fields, m, i, j):
    """Field m at j less that at i, both components."""
    dx = load(fields, m, 0, j) - load(fields, m, 0, i)
    return dx, load(fields, m, 1, j) - load(fields, m, 1, i)


@pair_law
def add_field_pair(fields, m, i, j, fx, fy):
    """(fx, fy) to field m at i, its negative at j."""
    store(load(fields, m, 0, i) + fx, fields, m, 0, i)
    store(load(fields, m, 1, i) + fy, fields, m, 1, i)
    store(load(fields, m, 0, j) - fx, fields, m, 0, j)
    store(load(fields, m, 1, j) - fy, fields, m, 1, j)


@pair_law
def add_transposed(fields, m, i, j, slopes, px, py):
    """slopesᵀ p to field m at i, its negative at j."""
    fx, fy = slopes[0] * px + slopes[2] * py, slopes[1] * px + slopes[3] * py
    add_field_pair(fields, m, i, j, fx, fy)


# Along one direction, dashpots off


@kernel
def elastic_forces_and_rates(work, f_rate, volume_rate, topology, c):
    """The elastic forces at work.x in work.f (µN), and their rate along work.v in f_rate (µN/µs).

    f_rate: (2, local, TILE), not folded either. Scratch: volume_rate (fluid, TILE).
    """
    work.f[:] = 0.0
    f_rate[:] = 0.0
    _add_central_rates(work, f_rate, topology.bonds, topology.bond_weight, True, c)
    _add_central_rates(work, f_rate, topology.contacts, topology.contact_weight, False, c)
    _add_fluid_rates(work, f_rate, volume_rate, topology, c)


@kernel
def _add_central_rates(work, f_rate, pairs, weight, is_bond, c):
    """With a = t/|r|: f = a r and ḟ = (t′ − a) s n + a w."""
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
        acting, (elastic, stiffness, _, _) = central_law(pair, is_bond, weight[k], c)
        over = acting * elastic * pair.inverse
        along = (acting * stiffness - over) * pair.rate * pair.inverse
        add_pair(work.f, i, j, over * pair.rx, over * pair.ry)
        gx, gy = along * pair.rx + over * pair.wx, along * pair.ry + over * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def _add_fluid_rates(work, f_rate, volume_rate, topology, c):
    """With α = m² c_s² (W′/|r|) (V_i + V_j) of eq. (8): f = α r and ḟ = α̇ r + α w."""
    slope, volume = work.slope, work.volume
    pairs, first = topology.fluid_pairs, topology.walls
    fluid_specific_volume(work.x, topology, c, slope, volume)
    volume_rate[:] = 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(work.x, i, j)
        wx, wy = difference(work.v, i, j)
        density_rate = c.fluid_mass * load(slope, k) * (rx * wx + ry * wy)
        add_to(volume_rate, i - first, density_rate)
        add_to(volume_rate, j - first, density_rate)
    for p in range(volume_rate.shape[0]):
        here = load(volume, p)
        store(-here * here * load(volume_rate, p), volume_rate, p)
    strength = c.fluid_mass * c.fluid_mass * c.sound_speed_squared
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
        steep = load(slope, k)
        volumes = strength * (load(volume, p) + load(volume, q))
        a = steep * volumes
        add_pair(work.f, i, j, a * pair.rx, a * pair.ry)
        bend = spline_bend(steep, pair.length, pair.inverse, c.smoothing_length)
        a_rate = bend * pair.rate * volumes + steep * strength * (
            load(volume_rate, p) + load(volume_rate, q)
        )
        gx, gy = a_rate * pair.rx + a * pair.wx, a_rate * pair.ry + a * pair.wy
        add_pair(f_rate, i, j, gx, gy)


# Rates of the elastic stiffness


@kernel
def add_stiffness_rates(work, u, f, topology, c):
    """Add K̇ u to f for four fields u, with K̇ the rate of the elastic stiffness along work.v.

    At work.x; u, f: (4, 2, local, TILE).
    """
    _add_central_stiffness_rates(work, u, f, topology.bonds, topology.bond_weight, True, c)
    _add_central_stiffness_rates(work, u, f, topology.contacts, topology.contact_weight, False, c)
    _add_fluid_stiffness_rates(work, u, f, topology, c)


@kernel
def _add_central_stiffness_rates(work, u, f, pairs, weight, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
        nx, ny, inverse, rate = pair.nx, pair.ny, pair.inverse, pair.rate
        acting, (elastic, stiffness, _, _) = central_law(pair, is_bond, weight[k], c)
        b = acting * (stiffness - elastic * inverse)
        across = b * rate * inverse
        along = -across
        if not is_bond:
            along += acting * contact_bend(inverse, c) * rate
        turn_x, turn_y = b * (pair.wx - rate * nx) * inverse, b * (pair.wy - rate * ny) * inverse
        for m in range(FIELDS):
            px, py = field_difference(u, m, i, j)
            stretch = nx * px + ny * py
            by_n = along * stretch + turn_x * px + turn_y * py
            fx = across * px + by_n * nx + stretch * turn_x
            fy = across * py + by_n * ny + stretch * turn_y
            add_field_pair(f, m, i, j, fx, fy)


@kernel
def _add_fluid_stiffness_rates(work, u, f, topology, c):
    """By central differences of K u along v, for K changes without jumps as fluid particles move.

    That of contacts jumps at the cut-off, where pairs like to stay: a difference over it is wrong.
    """
    x, v = work.x.copy(), work.v.copy()
    speed = np.full(TILE, 1e-300)
    for axis in range(2):
        for i in range(v.shape[1]):
            for k in range(TILE):
                speed[k] = max(speed[k], abs(v[axis, i, k]))
    step = STEP * c.smoothing_length / speed
    by_x, by_v = np.empty_like(u), np.empty_like(u)
    work.v[:] = 0.0  # dashpots off, and K is symmetric: gradients of Σ u·f by x are K u
    for side in range(2):
        work.x[:] = x + (1.0 - 2.0 * side) * step * v
        by_x[:], by_v[:] = 0.0, 0.0
        _add_fluid_gradients(work, u, by_x, by_v, topology, c)
        f[:] = f + by_x * ((0.5 - side) / step)
    work.x[:], work.v[:] = x, v
