"""Where the two particles of a pair are, and how they move apart: what every pair law starts from.

Particles are local ones of a tile, x and v (2, local, TILE) in µm, µm/µs.
"""

from __future__ import annotations

from typing import NamedTuple

from surrofe2.compilation import pair_law
from surrofe2.simd import inverse_root, load, store


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
