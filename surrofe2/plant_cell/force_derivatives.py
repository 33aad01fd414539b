"""Derivatives of particle forces along given directions, without a matrix.

- `add_force_gradients`: how a weighted sum of forces Σ_k φ_k·f_k changes with x and with v.
- `elastic_forces_and_rates`: elastic forces f and ḟ = ∂f/∂x · v.
- `add_stiffness_rates`: K̇ u, the change of the elastic stiffness K = ∂f/∂x along v, times u.

By pairs Σ_k φ_k·f_k is −Σ ρ·f(r, w) with ρ = φ_j − φ_i, so each pair gives (∂f/∂r)ᵀ ρ and
(∂f/∂w)ᵀ ρ to i, and their negatives to j. Through the fluid's specific volume V = 1/ρ_f there
is, besides, ∂/∂r += −V² ∂(Σ φ·f)/∂V ∂ρ_f/∂r.

For a central pair with tension t(|r|), n = r/|r|, w = v_j − v_i, s = n·w, a = t/|r|, b = t′ − a,
p = u_j − u_i and ṅ = (w − s n)/|r|::

    ḟ = b s n + a w
    K̇ p = b s/|r| p + (t″ − b/|r|) s (n·p) n + b [(n·p) ṅ + (ṅ·p) n]

and for the fluid, with f = α r, α = m² c_s² (W′/|r|) (1/ρ_i + 1/ρ_j) of eq. (8), a dot for the
change along v::

    ḟ = α̇ r + α w

Gradients and stiffness rates take four fields at once, (4, 2, local, TILE), which share all but
their own products.
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.forces import (
    add_pair,
    central_elastic,
    central_slopes,
    difference,
    fluid_specific_volume,
    pair_at,
)
from surrofe2.plant_cell.jacobian import add_at, central_gradient
from surrofe2.plant_cell.pair_laws import (
    fluid_coefficients,
    fluid_volume_slopes,
    spline_bend,
)
from surrofe2.plant_cell.tiles import outer_constants

FIELDS = 4
STEP = 1e-6
"""Of the fastest particle to either side, in smoothing lengths: K is then exact to 1e-12 by its
curvature, and to 1e-9 by rounding; of a longer step, more pairs pass a knot of the spline."""


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
def _add_central_gradients(work, weights, by_x, by_v, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
        tension, by_length, by_rate = central_slopes(pair, is_bond, c)
        xx, xy, yx, yy = central_gradient(pair, tension, by_length, by_rate)
        nx, ny = pair.nx, pair.ny
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            along = by_rate * (nx * px + ny * py)
            add_field_pair(by_x, m, i, j, xx * px + yx * py, xy * px + yy * py)
            add_field_pair(by_v, m, i, j, along * nx, along * ny)


@kernel
def _add_fluid_gradients(work, weights, by_x, by_v, topology, c):
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    slope, volume = work.slope, work.volume
    fluid_specific_volume(work.x, topology, c, slope, volume)
    by_volume = np.zeros((FIELDS, volume.shape[0], TILE))
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
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
            add_at(by_volume, m, p, -(ai * with_r + bi * with_w))
            add_at(by_volume, m, q, -(aj * with_r + bj * with_w))
    _add_through_density(work, by_x, by_volume, topology, c)


@kernel
def _add_through_density(work, by_x, by_volume, topology, c):
    pairs, first = topology.fluid_pairs, topology.walls
    slope, volume = work.slope, work.volume
    for m in range(FIELDS):
        for p in range(volume.shape[0]):
            here = load(volume, p)
            store(-here * here * load(by_volume, m, p), by_volume, m, p)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(work.x, i, j)
        weight = c.fluid_mass * load(slope, k)
        for m in range(FIELDS):
            both = weight * (load(by_volume, m, i - first) + load(by_volume, m, j - first))
            add_field_pair(by_x, m, i, j, -both * rx, -both * ry)


@kernel
def add_force_gradients(work, weights, by_x, by_v, topology, c):
    """Add the slopes of Σ_k φ_k·f_k with x to by_x and with v to by_v, for four φ in `weights`.

    At work.x and work.v; weights, by_x, by_v: (4, 2, local, TILE).
    """
    _add_central_gradients(work, weights, by_x, by_v, topology.bonds, True, c)
    _add_central_gradients(work, weights, by_x, by_v, topology.contacts, False, c)
    outer = outer_constants(topology, c)
    _add_central_gradients(work, weights, by_x, by_v, topology.outer_bonds, True, outer)
    _add_central_gradients(work, weights, by_x, by_v, topology.outer_contacts, False, outer)
    _add_fluid_gradients(work, weights, by_x, by_v, topology, c)


@kernel
def _add_central_rates(work, f_rate, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
        tension, by_length, _ = central_elastic(pair, is_bond, c)
        over = tension * pair.inverse
        along = (by_length - over) * pair.rate * pair.inverse
        add_pair(work.f, i, j, over * pair.rx, over * pair.ry)
        gx, gy = along * pair.rx + over * pair.wx, along * pair.ry + over * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def _set_volumes(work, topology, c, rate):
    """work.slope, work.volume V = 1/ρ and its rate V̇ (fluid, TILE) along work.v."""
    pairs, first = topology.fluid_pairs, topology.walls
    fluid_specific_volume(work.x, topology, c, work.slope, work.volume)
    rate[:] = 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(work.x, i, j)
        wx, wy = difference(work.v, i, j)
        density_rate = c.fluid_mass * load(work.slope, k) * (rx * wx + ry * wy)
        store(load(rate, i - first) + density_rate, rate, i - first)
        store(load(rate, j - first) + density_rate, rate, j - first)
    for p in range(rate.shape[0]):
        here = load(work.volume, p)
        store(-here * here * load(rate, p), rate, p)


@kernel
def _add_fluid_rates(work, f_rate, volume_rate, topology, c):
    slope, volume = work.slope, work.volume
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    _set_volumes(work, topology, c, volume_rate)
    strength = c.fluid_mass * c.fluid_mass * c.sound_speed_squared
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        pair = pair_at(work.x, work.v, i, j)
        steep = load(slope, k)
        volumes = strength * (load(volume, p) + load(volume, q))
        a = steep * volumes
        add_pair(work.f, i, j, a * pair.rx, a * pair.ry)
        bend = spline_bend(steep, pair.length, pair.inverse, h)
        a_rate = bend * pair.rate * volumes + steep * strength * (
            load(volume_rate, p) + load(volume_rate, q)
        )
        gx, gy = a_rate * pair.rx + a * pair.wx, a_rate * pair.ry + a * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def elastic_forces_and_rates(work, f_rate, volume_rate, topology, c):
    """The elastic forces at work.x in work.f (µN), and their rate along work.v in f_rate (µN/µs).

    f_rate: (2, local, TILE), not folded either. Scratch: volume_rate (fluid, TILE).
    """
    work.f[:] = 0.0
    f_rate[:] = 0.0
    _add_central_rates(work, f_rate, topology.bonds, True, c)
    _add_central_rates(work, f_rate, topology.contacts, False, c)
    outer = outer_constants(topology, c)
    _add_central_rates(work, f_rate, topology.outer_bonds, True, outer)
    _add_central_rates(work, f_rate, topology.outer_contacts, False, outer)
    _add_fluid_rates(work, f_rate, volume_rate, topology, c)


@kernel
def _add_central_stiffness_rates(work, u, f, pairs, is_bond, c):
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(work.x, work.v, i, j)
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


@kernel
def add_stiffness_rates(work, u, f, topology, c):
    """Add K̇ u to f for four fields u, with K̇ the rate of the elastic stiffness along work.v.

    At work.x; u, f: (4, 2, local, TILE).
    """
    _add_central_stiffness_rates(work, u, f, topology.bonds, True, c)
    _add_central_stiffness_rates(work, u, f, topology.contacts, False, c)
    outer = outer_constants(topology, c)
    _add_central_stiffness_rates(work, u, f, topology.outer_bonds, True, outer)
    _add_central_stiffness_rates(work, u, f, topology.outer_contacts, False, outer)
    _add_fluid_stiffness_rates(work, u, f, topology, c)
