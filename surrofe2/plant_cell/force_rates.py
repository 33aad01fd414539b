"""The elastic forces and their rate ḟ = Σ ∂f/∂x · v as particles move, without any matrix.

For a central pair with tension t(|r|), n = r/|r|, w = v_j − v_i, s = n·w::

    ḟ = t′ s n + (t/|r|) (w − s n)

and for the fluid, with a = m² c_s² (W′/|r|) (1/ρ_i + 1/ρ_j) of eq. (8) and ρ̇ = Σ m W′ s::

    ḟ = ȧ r + a w
"""

from __future__ import annotations

from surrofe2.compilation import kernel
from surrofe2.plant_cell.central import central_elastic
from surrofe2.plant_cell.pair_geometry import add_pair, pair_at
from surrofe2.plant_cell.sph_kernel import spline, spline_bend, spline_slope
from surrofe2.simd import load, spread, store


@kernel
def _add_central(x, v, f, f_rate, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(x, v, i, j)
        tension, by_length, _ = central_elastic(pair, is_bond, c)
        over = tension * pair.inverse
        along = (by_length - over) * pair.rate * pair.inverse
        add_pair(f, i, j, over * pair.rx, over * pair.ry)
        gx, gy = along * pair.rx + over * pair.wx, along * pair.ry + over * pair.wy
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
        pair = pair_at(x, v, i, j)
        s = pair.length * (1.0 / h)
        fall = spline_slope(s, h)
        store(fall * pair.inverse, slope, k)
        density = c.fluid_mass * spline(s, h)
        density_rate = c.fluid_mass * fall * pair.rate
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
        pair = pair_at(x, v, i, j)
        steep = load(slope, k)
        volumes = strength * (load(volume, p) + load(volume, q))
        a = steep * volumes
        add_pair(f, i, j, a * pair.rx, a * pair.ry)
        bend = spline_bend(steep, pair.length, pair.inverse, h)
        a_rate = bend * pair.rate * volumes + steep * strength * (
            load(volume_rate, p) + load(volume_rate, q)
        )
        gx, gy = a_rate * pair.rx + a * pair.wx, a_rate * pair.ry + a * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def add_elastic_forces_and_rates(x, v, f, f_rate, topology, c, slope, volume, volume_rate):
    """Add the elastic forces at x to f (µN) and their rate along v to f_rate (µN/µs).

    x, v, f, f_rate: (2, local, TILE). Scratch: slope (pairs, TILE), volume and volume_rate
    (fluid, TILE).
    """
    _add_central(x, v, f, f_rate, topology.bonds, True, c)
    _add_central(x, v, f, f_rate, topology.contacts, False, c)
    _add_fluid(x, v, f, f_rate, topology, c, slope, volume, volume_rate)
