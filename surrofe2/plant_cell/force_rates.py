"""The elastic forces and their rate ḟ = Σ ∂f/∂x · v as particles move, without any matrix.

For a central pair with tension t(|r|), n = r/|r|, w = v_j − v_i, s = n·w::

    ḟ = t′ s n + (t/|r|) (w − s n)

and for the fluid, with a = m² c_s² (W′/|r|) (1/ρ_i + 1/ρ_j) of eq. (8) and ρ̇ = Σ m W′ s::

    ḟ = ȧ r + a w
"""

from __future__ import annotations

from surrofe2.compilation import kernel, pair_law
from surrofe2.plant_cell.contact import contact_elastic
from surrofe2.plant_cell.forces import add_pair, difference
from surrofe2.plant_cell.simd import inverse_root, load, spread, store
from surrofe2.plant_cell.sph_kernel import spline, spline_curvature, spline_slope


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
