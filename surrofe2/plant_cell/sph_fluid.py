"""Fluid of SPH particles, eqs. (7) to (9): energy, forces and their derivatives.

The density couples all fluid of a plant cell: forces are f(r, w, V_i, V_j) with V = 1/ρ.
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.plant_cell.pair_laws import (
    fluid_coefficients,
    fluid_volume_slopes,
    spline,
    spline_bend,
    spline_slope,
)
from surrofe2.plant_cell.pair_sums import (
    FIELDS,
    add_at,
    add_field_pair,
    add_load,
    add_pair,
    add_pair_jacobian,
    add_pair_load,
    add_to,
    add_transposed,
    difference,
    field_difference,
    norm,
    pair_at,
)

STEP = 1e-6
"""Step of the central difference of K: how far the fastest particle moves to either side, in
smoothing lengths. K's curvature then makes an error of 1e-12, rounding one of 1e-9; with a longer
step more pairs would pass a knot of the spline."""


@kernel
def add_sph_forces(x, v, f, topology, constants, slope, volume):
    """Add pressure and viscous forces (eq. 8) to f (2, local, TILE), µN.

    x, v: (2, local, TILE) positions, µm, and velocities, µm/µs.
    slope, volume: scratch that is filled here, see `fluid_specific_volume`.
    """
    pairs = topology.fluid_pairs
    first = topology.walls
    fluid_specific_volume(x, topology, constants, slope, volume)
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        volume_i = load(volume, i - first)
        volume_j = load(volume, j - first)
        a, b = fluid_coefficients(load(slope, k), volume_i, volume_j, constants)
        add_pair(f, i, j, a * rx + b * wx, a * ry + b * wy)


@kernel
def fluid_specific_volume(x, topology, constants, slope, volume):
    """Fill volume (fluid, TILE) with 1/ρ of eq. (7), and slope (pairs, TILE) with W′/|r|.

    ρ_p = m Σ_q W(|x_p − x_q|) over the fluid particles q of p's plant cell, p itself included.
    """
    pairs = topology.fluid_pairs
    first = topology.walls
    h = constants.smoothing_length
    # until the last loop `volume` holds densities; each begins with the particle itself, W(0)
    by_itself = constants.fluid_mass * spline(spread(0.0), h)
    for p in range(volume.shape[0]):
        store(by_itself, volume, p)
    for k in range(pairs.shape[0]):
        p = pairs[k, 0] - first
        q = pairs[k, 1] - first
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        length, inverse = norm(rx, ry)
        s = length * (1.0 / h)
        store(spline_slope(s, h) * inverse, slope, k)
        density = constants.fluid_mass * spline(s, h)
        store(load(volume, p) + density, volume, p)
        store(load(volume, q) + density, volume, q)
    for p in range(volume.shape[0]):
        store(1.0 / load(volume, p), volume, p)


@kernel
def add_sph_energy(x, topology, constants, slope, volume, energy):
    """Add the stored energy Σ m c_s² ln ρ, pJ, to energy (1, TILE).

    slope, volume: scratch that is filled here, see `fluid_specific_volume`.
    """
    fluid_specific_volume(x, topology, constants, slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            # ln ρ = −ln V
            energy[0, lane] -= (
                constants.fluid_mass * constants.sound_speed_squared * np.log(volume[p, lane])
            )


@pair_law
def fluid_slopes(pair, steep, volume_i, volume_j, constants):
    """Return (∂f/∂r, ∂f/∂w, ∂f/∂V_i, ∂f/∂V_j) of a fluid pair whose force on i is f = a r + b w.

    With a′ and b′ by |r|, ∂f/∂r = a I + (a′ r + b′ w) ⊗ n and ∂f/∂w = b I, as (xx, xy, yx, yy) with
    V held. The slopes by V are (x, y).

    steep: W′/|r|. volume_i, volume_j: V = 1/ρ.
    """
    rx = pair.rx
    ry = pair.ry
    wx = pair.wx
    wy = pair.wy
    a, b = fluid_coefficients(steep, volume_i, volume_j, constants)
    bend = spline_bend(steep, pair.length, pair.inverse, constants.smoothing_length)
    # a and b are proportional to W′/|r|, so a′ and b′ follow from its slope in the same way
    da, db = fluid_coefficients(bend, volume_i, volume_j, constants)
    ux = da * rx + db * wx
    uy = da * ry + db * wy
    rr = (a + ux * pair.nx, ux * pair.ny, uy * pair.nx, a + uy * pair.ny)
    rw = (b, spread(0.0), spread(0.0), b)
    ai, bi = fluid_volume_slopes(steep, volume_j, constants)
    aj, bj = fluid_volume_slopes(steep, volume_i, constants)
    by_volume_i = (ai * rx + bi * wx, ai * ry + bi * wy)
    by_volume_j = (aj * rx + bj * wx, aj * ry + bj * wy)
    return rr, rw, by_volume_i, by_volume_j


@kernel
def add_sph_jacobian(workspace, L, topology, constants, matrix, columns):
    """Add the slopes of the fluid's forces to matrix and columns; see `force_jacobian`."""
    fluid_specific_volume(workspace.x, topology, constants, workspace.slope, workspace.volume)
    for cell in range(topology.fluid_start.shape[0] - 1):
        _add_cell_jacobian(cell, workspace, L, topology, constants, matrix, columns)


@kernel
def _add_cell_jacobian(cell, workspace, L, topology, constants, matrix, columns):
    """Add the slopes of the forces in one plant cell to matrix and columns.

    workspace.slope and workspace.volume are those at workspace.x already. A motion changes forces
    directly, pair by pair, and through the densities, which couples all fluid of the plant cell.
    The second part is a product, Σ_s ∂f/∂ρ_s ∂ρ_s/∂x.
    """
    pairs = topology.fluid_pairs
    first = topology.walls + topology.fluid_start[cell]
    fluid = topology.fluid_start[cell + 1] - topology.fluid_start[cell]
    block = topology.block
    stride = topology.stride
    by_density = np.zeros((2 * fluid, fluid, TILE))
    density_by_x = np.zeros((fluid, 2 * fluid, TILE))
    density_by_load = np.zeros((fluid, 4, TILE))
    for k in range(topology.fluid_pair_start[cell], topology.fluid_pair_start[cell + 1]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        p = i - first
        q = j - first
        pair = pair_at(workspace.x, workspace.v, i, j)
        steep = load(workspace.slope, k)
        volume_i = load(workspace.volume, i - topology.walls)
        volume_j = load(workspace.volume, j - topology.walls)
        rr, rw, by_volume_i, by_volume_j = fluid_slopes(pair, steep, volume_i, volume_j, constants)
        add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw)
        # ∂V/∂ρ = −V²
        by_i = -volume_i * volume_i
        by_j = -volume_j * volume_j
        add_pair_column(by_density, 2 * p, 2 * q, p, by_i * by_volume_i[0], by_i * by_volume_i[1])
        add_pair_column(by_density, 2 * p, 2 * q, q, by_j * by_volume_j[0], by_j * by_volume_j[1])
        # ∂ρ_i/∂x_j = m W′/|r| r, and the opposite by x_i; the same for ρ_j
        gx = constants.fluid_mass * steep * pair.rx
        gy = constants.fluid_mass * steep * pair.ry
        add_pair_row(density_by_x, p, 2 * p, 2 * q, gx, gy)
        add_pair_row(density_by_x, q, 2 * p, 2 * q, gx, gy)
        if columns.shape[0] > 0:
            zx, zy = difference(workspace.z, i, j)
            add_pair_load(columns, workspace.z, i, j, j, rr, rw)
            add_load(density_by_load, p, 0, gx, gy, zx, zy)
            add_load(density_by_load, q, 0, gx, gy, zx, zy)
    # the fluid of a plant cell is one group of the pattern: its block begins at its first particle
    g = topology.group[first]
    width = topology.width[g]
    column = topology.column[first]
    begin = topology.start[g] + column * width + topology.offset[g, g] + column
    add_product(by_density, density_by_x, matrix, begin, width)
    if columns.shape[0] > 0:
        # each particle has two rows of 8 columns; density does not depend on Ḟ, the last four
        rows = columns.reshape(-1, TILE)
        add_product(by_density, density_by_load, rows, 8 * 2 * first, 8)


@pair_law
def add_pair_column(array, row_i, row_j, column, gx, gy):
    """Add (gx, gy) to the two rows of i, and its opposite to those of j, in one column."""
    add_at(array, row_i, column, gx)
    add_at(array, row_i + 1, column, gy)
    add_at(array, row_j, column, -gx)
    add_at(array, row_j + 1, column, -gy)


@pair_law
def add_pair_row(array, row, column_i, column_j, gx, gy):
    """Add (gx, gy) to the two columns of j, and its opposite to those of i, in one row."""
    add_at(array, row, column_j, gx)
    add_at(array, row, column_j + 1, gy)
    add_at(array, row, column_i, -gx)
    add_at(array, row, column_i + 1, -gy)


@kernel
def add_product(A, B, values, begin, width):
    """Set values[begin + m · width + n] += Σ_s A[m, s] B[s, n].

    A: (·, ·, TILE). B: (·, even, TILE). Two columns are summed at a time, so that each entry of A
    is read half as often.
    """
    for m in range(A.shape[0]):
        row = begin + m * width
        for n in range(0, B.shape[1], 2):
            even = load(values, row + n)
            odd = load(values, row + n + 1)
            for s in range(A.shape[1]):
                factor = load(A, m, s)
                even += factor * load(B, s, n)
                odd += factor * load(B, s, n + 1)
            store(even, values, row + n)
            store(odd, values, row + n + 1)


@kernel
def add_sph_gradients(workspace, weights, by_x, by_v, topology, constants):
    """Add the slopes of Σ φ·f of the fluid to by_x and by_v; see `add_force_gradients`."""
    pairs = topology.fluid_pairs
    first = topology.walls
    slope = workspace.slope
    volume = workspace.volume
    fluid_specific_volume(workspace.x, topology, constants, slope, volume)
    by_volume = np.zeros((FIELDS, volume.shape[0], TILE))
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        p = i - first
        q = j - first
        pair = pair_at(workspace.x, workspace.v, i, j)
        steep = load(slope, k)
        volume_i = load(volume, p)
        volume_j = load(volume, q)
        rr, rw, by_volume_i, by_volume_j = fluid_slopes(pair, steep, volume_i, volume_j, constants)
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            add_transposed(by_x, m, i, j, rr, px, py)
            # ∂f/∂w is a multiple of the unit matrix
            add_field_pair(by_v, m, i, j, rw[0] * px, rw[0] * py)
            add_at(by_volume, m, p, -(by_volume_i[0] * px + by_volume_i[1] * py))
            add_at(by_volume, m, q, -(by_volume_j[0] * px + by_volume_j[1] * py))
    # from slopes by V to slopes by ρ, ∂V/∂ρ = −V², and through ∂ρ/∂x to the particles
    for m in range(FIELDS):
        for p in range(volume.shape[0]):
            V = load(volume, p)
            store(-V * V * load(by_volume, m, p), by_volume, m, p)
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        rx, ry = difference(workspace.x, i, j)
        density = constants.fluid_mass * load(slope, k)
        for m in range(FIELDS):
            both = density * (load(by_volume, m, i - first) + load(by_volume, m, j - first))
            add_field_pair(by_x, m, i, j, -both * rx, -both * ry)


@kernel
def add_sph_rates(workspace, f_rate, volume_rate, topology, constants):
    """Add pressure forces to workspace.f, and their rates along workspace.v to f_rate.

    Both are (2, local, TILE). With α = m² c_s² (W′/|r|) (V_i + V_j) of eq. (8), f = α r and ḟ = α̇
    r + α w.

    volume_rate: (fluid, TILE) scratch, V̇ = −V² ρ̇.
    """
    slope = workspace.slope
    volume = workspace.volume
    pairs = topology.fluid_pairs
    first = topology.walls
    fluid_specific_volume(workspace.x, topology, constants, slope, volume)
    # densities first: the rate of a force takes V̇ of both particles, which all pairs add to
    volume_rate[:] = 0.0
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        rx, ry = difference(workspace.x, i, j)
        wx, wy = difference(workspace.v, i, j)
        density_rate = constants.fluid_mass * load(slope, k) * (rx * wx + ry * wy)
        add_to(volume_rate, i - first, density_rate)
        add_to(volume_rate, j - first, density_rate)
    for p in range(volume_rate.shape[0]):
        V = load(volume, p)
        store(-V * V * load(volume_rate, p), volume_rate, p)
    strength = constants.fluid_mass * constants.fluid_mass * constants.sound_speed_squared
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        p = i - first
        q = j - first
        pair = pair_at(workspace.x, workspace.v, i, j)
        steep = load(slope, k)
        volumes = strength * (load(volume, p) + load(volume, q))
        a = steep * volumes
        add_pair(workspace.f, i, j, a * pair.rx, a * pair.ry)
        bend = spline_bend(steep, pair.length, pair.inverse, constants.smoothing_length)
        a_rate = bend * pair.rate * volumes + steep * strength * (
            load(volume_rate, p) + load(volume_rate, q)
        )
        gx = a_rate * pair.rx + a * pair.wx
        gy = a_rate * pair.ry + a * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def add_sph_stiffness_rates(workspace, u, f, topology, constants):
    """Add K̇ u to f for the FIELDS fields u, by central differences of K u along workspace.v.

    u, f: (FIELDS, 2, local, TILE). A difference will do here, for K of the fluid is continuous. K
    of contacts jumps at the cut-off, where pairs tend to stay, so it is differentiated exactly.
    """
    if topology.fluid_pairs.shape[0] == 0:
        return
    x = workspace.x.copy()
    v = workspace.v.copy()
    speed = np.full(TILE, 1e-300)  # not 0, by which the step would be divided
    for axis in range(2):
        for i in range(v.shape[1]):
            for k in range(TILE):
                speed[k] = max(speed[k], abs(v[axis, i, k]))
    step = STEP * constants.smoothing_length / speed
    by_x = np.empty_like(u)
    by_v = np.empty_like(u)
    workspace.v[:] = 0.0  # dashpots off, and K is symmetric: gradients of Σ u·f by x are K u
    for side in range(2):  # ahead, then behind: signs 1 and −1
        workspace.x[:] = x + (1.0 - 2.0 * side) * step * v
        by_x[:] = 0.0
        by_v[:] = 0.0
        add_sph_gradients(workspace, u, by_x, by_v, topology, constants)
        f[:] = f + by_x * ((0.5 - side) / step)
    workspace.x[:] = x
    workspace.v[:] = v
