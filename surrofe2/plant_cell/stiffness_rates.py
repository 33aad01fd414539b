"""How the elastic stiffness K = ∂f/∂x changes as particles move along v: K̇ u, without a matrix.

K̇ u = ∂²f/∂x∂x : (u, v), with f the gradient of an energy, is symmetric in u and v. For a central
pair with tension t(|r|), a = t/|r|, b = t′ − a, p = u_j − u_i, w = v_j − v_i, s = n·w and
ṅ = (w − s n)/|r|::

    K p = a p + b (n·p) n
    K̇ p = b s/|r| p + (t″ − b/|r|) s (n·p) n + b [(n·p) ṅ + (ṅ·p) n]

and for the fluid, with f = α r, α = m² c_s² (W′/|r|) (1/ρ_i + 1/ρ_j) of eq. (8), a dot for the
change along v and δ for that along u::

    K̇ p = δα̇ r + α̇ p + δα w
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.plant_cell.central import central_elastic
from surrofe2.plant_cell.force_gradients import FIELDS, add_field_pair, field_difference
from surrofe2.plant_cell.forces import fluid_specific_volume
from surrofe2.plant_cell.jacobian import add_to
from surrofe2.plant_cell.pair_geometry import pair_at
from surrofe2.plant_cell.sph_kernel import spline_bend, spline_third
from surrofe2.simd import TILE, load, store


@kernel
def _add_central(x, v, u, f, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(x, v, i, j)
        tension, by_length, bend = central_elastic(pair, is_bond, c)
        nx, ny, inverse, rate = pair.nx, pair.ny, pair.inverse, pair.rate
        b = by_length - tension * inverse
        across = b * rate * inverse
        along = bend * rate - across
        turn_x, turn_y = b * (pair.wx - rate * nx) * inverse, b * (pair.wy - rate * ny) * inverse
        for m in range(FIELDS):
            px, py = field_difference(u, m, i, j)
            stretch = nx * px + ny * py
            by_n = along * stretch + turn_x * px + turn_y * py
            fx = across * px + by_n * nx + stretch * turn_x
            fy = across * py + by_n * ny + stretch * turn_y
            add_field_pair(f, m, i, j, fx, fy)


@kernel
def _set_volume_changes(x, v, u, topology, c, slope, volume, rate, change, both):
    """V̇ in `rate` (fluid, TILE), δV and δV̇ in `change` and `both` (4, fluid, TILE); V = 1/ρ."""
    pairs, first = topology.fluid_pairs, topology.walls
    h, mass = c.smoothing_length, c.fluid_mass
    fluid_specific_volume(x, topology, c, slope, volume)
    rate[:], change[:], both[:] = 0.0, 0.0, 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(x, v, i, j)
        rx, ry, wx, wy = pair.rx, pair.ry, pair.wx, pair.wy
        steep = load(slope, k)
        bend = spline_bend(steep, pair.length, pair.inverse, h)
        along = rx * wx + ry * wy
        density = mass * steep * along
        store(load(rate, p) + density, rate, p)
        store(load(rate, q) + density, rate, q)
        for m in range(FIELDS):
            px, py = field_difference(u, m, i, j)
            stretch = rx * px + ry * py
            density = mass * steep * stretch
            add_to(change, m, p, density)
            add_to(change, m, q, density)
            density = mass * (bend * pair.inverse * stretch * along + steep * (px * wx + py * wy))
            add_to(both, m, p, density)
            add_to(both, m, q, density)
    for p in range(volume.shape[0]):
        here = load(volume, p)
        falls = -here * here
        store(falls * load(rate, p), rate, p)
        for m in range(FIELDS):
            density = load(change, m, p)
            twice = 2.0 * here * load(rate, p) * density
            store(falls * load(both, m, p) - twice, both, m, p)
            store(falls * density, change, m, p)


@kernel
def _add_fluid(x, v, u, f, topology, c, slope, volume):
    pairs, first = topology.fluid_pairs, topology.walls
    h, strength = c.smoothing_length, c.fluid_mass * c.fluid_mass * c.sound_speed_squared
    rate = np.empty_like(volume)
    change = np.empty((FIELDS, volume.shape[0], TILE))
    both = np.empty_like(change)
    _set_volume_changes(x, v, u, topology, c, slope, volume, rate, change, both)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(x, v, i, j)
        rx, ry, wx, wy, nx, ny = pair.rx, pair.ry, pair.wx, pair.wy, pair.nx, pair.ny
        inverse, speed = pair.inverse, pair.rate
        steep = strength * load(slope, k)
        bend = strength * spline_bend(load(slope, k), pair.length, inverse, h)
        third = strength * spline_third(pair.length * (1.0 / h), h)
        bend_slope = (third - 2.0 * bend) * inverse
        volumes, volumes_rate = load(volume, p) + load(volume, q), load(rate, p) + load(rate, q)
        steep_rate = bend * speed
        a_rate = steep_rate * volumes + steep * volumes_rate
        for m in range(FIELDS):
            px, py = field_difference(u, m, i, j)
            stretch = nx * px + ny * py
            turn = (px * wx + py * wy - stretch * speed) * inverse
            volumes_change = load(change, m, p) + load(change, m, q)
            steep_change = bend * stretch
            a_change = steep_change * volumes + steep * volumes_change
            a_both = (bend_slope * stretch * speed + bend * turn) * volumes
            a_both += steep_rate * volumes_change + steep_change * volumes_rate
            a_both += steep * (load(both, m, p) + load(both, m, q))
            fx = a_both * rx + a_rate * px + a_change * wx
            fy = a_both * ry + a_rate * py + a_change * wy
            add_field_pair(f, m, i, j, fx, fy)


@kernel
def add_stiffness_rates(x, v, u, f, topology, c, slope, volume):
    """Add K̇ u to f for four fields u, with K̇ the rate of the elastic stiffness along v.

    x, v: (2, local, TILE) µm, µm/µs; u, f: (4, 2, local, TILE). Scratch: slope (pairs, TILE),
    volume (fluid, TILE).
    """
    _add_central(x, v, u, f, topology.bonds, True, c)
    _add_central(x, v, u, f, topology.contacts, False, c)
    _add_fluid(x, v, u, f, topology, c, slope, volume)
