"""How forces change as particles move, without any matrix.

`add_elastic_forces_and_rates`: the elastic forces and their rate ḟ = Σ ∂f/∂x · v.
`add_force_slopes`: the change of all forces along any (δx, δv).

For a central pair with tension t(|r|), n = r/|r|, w = v_j − v_i, s = n·w::

    ḟ = t′ s n + (t/|r|) (w − s n)

and for the fluid, with a = m² c_s² (W′/|r|) (1/ρ_i + 1/ρ_j) of eq. (8) and ρ̇ = Σ m W′ s::

    ḟ = ȧ r + a w
"""

from __future__ import annotations

from surrofe2.compilation import kernel, pair_law
from surrofe2.plant_cell.contact import contact_elastic, contact_force, contact_slopes
from surrofe2.plant_cell.forces import add_pair, difference, fluid_specific_volume
from surrofe2.plant_cell.simd import inverse_root, load, spread, store
from surrofe2.plant_cell.sph_kernel import spline, spline_curvature, spline_slope
from surrofe2.plant_cell.wall import wall_force


@pair_law
def central_rate(tension, by_length, inverse, rate, rx, ry, wx, wy):
    """ḟ of a central pair force."""
    over = tension * inverse
    along = (by_length - over) * rate * inverse
    return along * rx + over * wx, along * ry + over * wy


@kernel
def _add_bonds(x, v, f, f_rate, bonds, c):
    for k in range(bonds.shape[0]):
        i, j = bonds[k, 0], bonds[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        tension = c.wall_stiffness * (square * inverse - c.rest_length)
        over = tension * inverse
        add_pair(f, i, j, over * rx, over * ry)
        rate = (rx * wx + ry * wy) * inverse
        gx, gy = central_rate(tension, spread(c.wall_stiffness), inverse, rate, rx, ry, wx, wy)
        add_pair(f_rate, i, j, gx, gy)


@kernel
def _add_contacts(x, v, f, f_rate, contacts, c):
    for k in range(contacts.shape[0]):
        i, j = contacts[k, 0], contacts[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        tension, by_length = contact_elastic(square * inverse, inverse, c)
        over = tension * inverse
        add_pair(f, i, j, over * rx, over * ry)
        rate = (rx * wx + ry * wy) * inverse
        gx, gy = central_rate(tension, by_length, inverse, rate, rx, ry, wx, wy)
        add_pair(f_rate, i, j, gx, gy)


@kernel
def _add_fluid(x, v, f, f_rate, topology, c, slope, volume, volume_rate):
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    own = c.fluid_mass * spline(spread(0.0), h)
    for p in range(volume.shape[0]):
        store(own, volume, p)
        store(0.0, volume_rate, p)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        s = square * inverse * (1.0 / h)
        steep = spline_slope(s, h) * inverse
        store(steep, slope, k)
        density = c.fluid_mass * spline(s, h)
        density_rate = c.fluid_mass * steep * (rx * wx + ry * wy)
        store(load(volume, p) + density, volume, p)
        store(load(volume, q) + density, volume, q)
        store(load(volume_rate, p) + density_rate, volume_rate, p)
        store(load(volume_rate, q) + density_rate, volume_rate, q)
    for p in range(volume.shape[0]):
        inverse = 1.0 / load(volume, p)
        store(inverse, volume, p)
        store(-inverse * inverse * load(volume_rate, p), volume_rate, p)
    strength = c.fluid_mass * c.fluid_mass * c.sound_speed_squared
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        steep = load(slope, k)
        volumes = strength * (load(volume, p) + load(volume, q))
        a = steep * volumes
        add_pair(f, i, j, a * rx, a * ry)
        bend = (spline_curvature(square * inverse * (1.0 / h), h) - steep) * inverse
        rate = (rx * wx + ry * wy) * inverse
        a_rate = bend * rate * volumes + steep * strength * (
            load(volume_rate, p) + load(volume_rate, q)
        )
        add_pair(f_rate, i, j, a_rate * rx + a * wx, a_rate * ry + a * wy)


@kernel
def add_elastic_forces_and_rates(x, v, f, f_rate, topology, c, slope, volume, volume_rate):
    """Add the elastic forces at x to f (µN) and their rate along v to f_rate (µN/µs).

    x, v, f, f_rate: (2, local, TILE). Scratch: slope (pairs, TILE), volume and volume_rate
    (fluid, TILE).
    """
    _add_bonds(x, v, f, f_rate, topology.bonds, c)
    _add_contacts(x, v, f, f_rate, topology.contacts, c)
    _add_fluid(x, v, f, f_rate, topology, c, slope, volume, volume_rate)


@pair_law
def central_slope(tension, by_length, by_rate, inverse, nx, ny, wx, wy, dx, dy, ux, uy):
    """Change of t n as r changes by (dx, dy) and w by (ux, uy), with s = n·w."""
    stretch = nx * dx + ny * dy
    turn_x, turn_y = (dx - nx * stretch) * inverse, (dy - ny * stretch) * inverse
    change = by_length * stretch + by_rate * (nx * ux + ny * uy + turn_x * wx + turn_y * wy)
    return change * nx + tension * turn_x, change * ny + tension * turn_y


@kernel
def _add_central_slopes(x, v, dx, dv, df, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        px, py = difference(dx, i, j)
        ux, uy = difference(dv, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        length = square * inverse
        nx, ny = rx * inverse, ry * inverse
        rate = nx * wx + ny * wy
        if is_bond:
            tension = wall_force(length, rate, c)
            by_length, by_rate = spread(c.wall_stiffness), spread(c.wall_damping)
        else:
            tension = contact_force(length, inverse, rate, c)
            by_length, by_rate = contact_slopes(length, inverse, rate, c)
        fx, fy = central_slope(tension, by_length, by_rate, inverse, nx, ny, wx, wy, px, py, ux, uy)
        add_pair(df, i, j, fx, fy)


@kernel
def _add_fluid_slopes(x, v, dx, dv, df, topology, c, slope, volume, volume_change):
    pairs, first = topology.fluid_pairs, topology.walls
    h, m = c.smoothing_length, c.fluid_mass
    fluid_specific_volume(x, topology, c, slope, volume)
    for p in range(volume.shape[0]):
        store(0.0, volume_change, p)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        rx, ry = difference(x, i, j)
        px, py = difference(dx, i, j)
        density = m * load(slope, k) * (rx * px + ry * py)
        volume_p, volume_q = load(volume, p), load(volume, q)
        store(load(volume_change, p) - volume_p * volume_p * density, volume_change, p)
        store(load(volume_change, q) - volume_q * volume_q * density, volume_change, q)
    elastic, viscous = m * m * c.sound_speed_squared, -2.0 * m * m * c.viscosity
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        px, py = difference(dx, i, j)
        ux, uy = difference(dv, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        steep = load(slope, k)
        bend = (spline_curvature(square * inverse * (1.0 / h), h) - steep) * inverse
        steep_change = bend * (rx * px + ry * py) * inverse
        volume_i, volume_j = load(volume, p), load(volume, q)
        change_i, change_j = load(volume_change, p), load(volume_change, q)
        both, product = volume_i + volume_j, volume_i * volume_j
        both_change = change_i + change_j
        product_change = change_i * volume_j + volume_i * change_j
        a, b = elastic * steep * both, viscous * steep * product
        a_change = elastic * (steep_change * both + steep * both_change)
        b_change = viscous * (steep_change * product + steep * product_change)
        fx = a_change * rx + a * px + b_change * wx + b * ux
        fy = a_change * ry + a * py + b_change * wy + b * uy
        add_pair(df, i, j, fx, fy)


@kernel
def add_force_slopes(x, v, dx, dv, df, topology, c, slope, volume, volume_change):
    """Add to df the change of all forces as x changes by dx and v by dv; each (2, local, TILE)."""
    _add_central_slopes(x, v, dx, dv, df, topology.bonds, True, c)
    _add_central_slopes(x, v, dx, dv, df, topology.contacts, False, c)
    _add_fluid_slopes(x, v, dx, dv, df, topology, c, slope, volume, volume_change)
