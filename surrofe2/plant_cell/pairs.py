"""Pairs of particles: where the two are, how they move apart, and the force along their line.

Particles are local ones of a tile, x and v (2, local, TILE) in µm, µm/µs. A central pair is a bond
between wall neighbours (eq. 1) or a contact (eq. 2); `is_bond` is the same for all pairs of a list.
Tension t > 0 pulls the two together; the force on i is t n, n = r/|r|.
"""

from __future__ import annotations

from typing import NamedTuple

from surrofe2.compilation import pair_law
from surrofe2.plant_cell.contact import (
    contact_bend,
    contact_elastic,
    contact_energy,
    contact_force,
    contact_slopes,
)
from surrofe2.plant_cell.wall import wall_energy, wall_force
from surrofe2.simd import inverse_root, load, spread, store


class Pair(NamedTuple):
    """r = x_j − x_i and w = v_j − v_i, lanes each.

    length is |r|, inverse 1/|r|, (nx, ny) = r/|r|, rate n·w.
    """

    rx: float
    ry: float
    wx: float
    wy: float
    nx: float
    ny: float
    length: float
    inverse: float
    rate: float


@pair_law
def difference(x, i, j):
    """x_j − x_i, both components."""
    return load(x, 0, j) - load(x, 0, i), load(x, 1, j) - load(x, 1, i)


@pair_law
def norm(rx, ry):
    """(|r|, 1/|r|)."""
    square = rx * rx + ry * ry
    inverse = inverse_root(square)
    return square * inverse, inverse


@pair_law
def pair_at(x, v, i, j):
    """The `Pair` of particles i and j; what a kernel does not use of it costs nothing."""
    rx, ry = difference(x, i, j)
    wx, wy = difference(v, i, j)
    length, inverse = norm(rx, ry)
    rate = (rx * wx + ry * wy) * inverse
    return Pair(rx, ry, wx, wy, rx * inverse, ry * inverse, length, inverse, rate)


@pair_law
def add_pair(f, i, j, fx, fy):
    """f on i, −f on j."""
    store(load(f, 0, i) + fx, f, 0, i)
    store(load(f, 1, i) + fy, f, 1, i)
    store(load(f, 0, j) - fx, f, 0, j)
    store(load(f, 1, j) - fy, f, 1, j)


@pair_law
def central_tension(pair, is_bond, c):
    """t(|r|, n·w), µN."""
    if is_bond:
        tension = wall_force(pair.length, pair.rate, c)
    else:
        tension = contact_force(pair.length, pair.inverse, pair.rate, c)
    return tension


@pair_law
def central_slopes(pair, is_bond, c):
    """(t, ∂t/∂|r|, ∂t/∂(n·w))."""
    tension = central_tension(pair, is_bond, c)
    if is_bond:
        by_length, by_rate = spread(c.wall_stiffness), spread(c.wall_damping)
    else:
        by_length, by_rate = contact_slopes(pair.length, pair.inverse, pair.rate, c)
    return tension, by_length, by_rate


@pair_law
def central_elastic(pair, is_bond, c):
    """(t, t′, t″) by |r|, dashpots off."""
    if is_bond:
        tension = wall_force(pair.length, 0.0, c)
        slope, bend = spread(c.wall_stiffness), spread(0.0)
    else:
        tension, slope = contact_elastic(pair.length, pair.inverse, c)
        bend = contact_bend(pair.length, pair.inverse, c)
    return tension, slope, bend


@pair_law
def central_energy(length, inverse, is_bond, c):
    """Stored energy, pJ."""
    if is_bond:
        energy = wall_energy(length, c)
    else:
        energy = contact_energy(length, inverse, c)
    return energy
