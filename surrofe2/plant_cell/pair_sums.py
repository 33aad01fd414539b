"""Particles of a tile, pairs of them, and sums over pairs.

Kernels work on local particles, own ones first, then images: x, v, f are (2, local, TILE) in µm,
µm/µs, µN. What a term of the forces adds to matrices, loads and fields is added here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, inverse_root, load, store

FIELDS = 4
"""Fields that are handled at once, such as the weights of four components of the stress."""


class Workspace(NamedTuple):
    """Scratch of one tile: local material positions z, x, v, f (2, local, TILE), and its fluid.

    slope: (pairs, TILE) W′/|r| of fluid pairs; volume: (fluid, TILE) 1/ρ.
    """

    z: Array
    x: Array
    v: Array
    f: Array
    slope: Array
    volume: Array


@kernel
def make_workspace(topology):
    """Uninitialised scratch for one tile."""
    local = topology.particles + topology.owner.shape[0]
    return Workspace(
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((topology.fluid_pairs.shape[0], TILE)),
        np.empty((topology.particles - topology.walls, TILE)),
    )


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
def add_to(array, row, value):
    """array[row] += value."""
    store(load(array, row) + value, array, row)


@pair_law
def add_at(array, row, column, value):
    """array[row, column] += value."""
    store(load(array, row, column) + value, array, row, column)


# Matrices


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
    lxx = load(L, 0, 0)
    lxy = load(L, 0, 1)
    lyx = load(L, 1, 0)
    lyy = load(L, 1, 1)
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


# Fields


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
    fx = slopes[0] * px + slopes[2] * py
    fy = slopes[1] * px + slopes[3] * py
    add_field_pair(fields, m, i, j, fx, fy)
