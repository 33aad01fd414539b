"""How a weighted sum of forces, Σ_k φ_k·f_k over local particles, changes with x and with v.

By pairs it is −Σ ρ·f(r, w) with ρ = φ_j − φ_i, so each pair gives (∂f/∂r)ᵀ ρ and (∂f/∂w)ᵀ ρ to i,
and their negatives to j. Through the fluid's specific volume V = 1/ρ_f there is, besides,

    ∂/∂r += −V² ∂(Σ φ·f)/∂V ∂ρ_f/∂r

Four weights φ at once, which share all but their own products; fields are (4, 2, local, TILE).
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel, pair_law
from surrofe2.plant_cell.central import central_slopes
from surrofe2.plant_cell.fluid import fluid_coefficients, fluid_volume_slopes
from surrofe2.plant_cell.forces import fluid_specific_volume
from surrofe2.plant_cell.jacobian import add_to, central_gradient
from surrofe2.plant_cell.pair_geometry import difference, pair_at
from surrofe2.plant_cell.sph_kernel import spline_bend
from surrofe2.simd import TILE, load, store

FIELDS = 4


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


@kernel
def _add_central(x, v, weights, by_x, by_v, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(x, v, i, j)
        tension, by_length, by_rate = central_slopes(pair, is_bond, c)
        xx, xy, yx, yy = central_gradient(pair, tension, by_length, by_rate)
        nx, ny = pair.nx, pair.ny
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            along = by_rate * (nx * px + ny * py)
            add_field_pair(by_x, m, i, j, xx * px + yx * py, xy * px + yy * py)
            add_field_pair(by_v, m, i, j, along * nx, along * ny)


@kernel
def _add_fluid(x, v, weights, by_x, by_v, topology, c, slope, volume):
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    fluid_specific_volume(x, topology, c, slope, volume)
    by_volume = np.zeros((FIELDS, volume.shape[0], TILE))
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(x, v, i, j)
        rx, ry, wx, wy, nx, ny = pair.rx, pair.ry, pair.wx, pair.wy, pair.nx, pair.ny
        steep, volume_i, volume_j = load(slope, k), load(volume, p), load(volume, q)
        a, b = fluid_coefficients(steep, volume_i, volume_j, c)
        bend = spline_bend(steep, pair.length, pair.inverse, h)
        da, db = fluid_coefficients(bend, volume_i, volume_j, c)
        ai, bi = fluid_volume_slopes(steep, volume_j, c)
        aj, bj = fluid_volume_slopes(steep, volume_i, c)
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            with_r, with_w = px * rx + py * ry, px * wx + py * wy
            bent = da * with_r + db * with_w
            add_field_pair(by_x, m, i, j, a * px + bent * nx, a * py + bent * ny)
            add_field_pair(by_v, m, i, j, b * px, b * py)
            add_to(by_volume, m, p, -(ai * with_r + bi * with_w))
            add_to(by_volume, m, q, -(aj * with_r + bj * with_w))
    _add_through_density(x, by_x, by_volume, topology, c, slope, volume)


@kernel
def _add_through_density(x, by_x, by_volume, topology, c, slope, volume):
    pairs, first = topology.fluid_pairs, topology.walls
    for m in range(FIELDS):
        for p in range(volume.shape[0]):
            here = load(volume, p)
            store(-here * here * load(by_volume, m, p), by_volume, m, p)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(x, i, j)
        weight = c.fluid_mass * load(slope, k)
        for m in range(FIELDS):
            both = weight * (load(by_volume, m, i - first) + load(by_volume, m, j - first))
            add_field_pair(by_x, m, i, j, -both * rx, -both * ry)


@kernel
def add_force_gradients(x, v, weights, by_x, by_v, topology, c, slope, volume):
    """Add the slopes of Σ_k φ_k·f_k with x to by_x and with v to by_v, for four φ in `weights`.

    x, v: (2, local, TILE) µm, µm/µs; weights, by_x, by_v: (4, 2, local, TILE).
    Scratch: slope (pairs, TILE), volume (fluid, TILE).
    """
    _add_central(x, v, weights, by_x, by_v, topology.bonds, True, c)
    _add_central(x, v, weights, by_x, by_v, topology.contacts, False, c)
    _add_fluid(x, v, weights, by_x, by_v, topology, c, slope, volume)
