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
BY_F = 0
BY_RATE = 4
"""First of the four columns of slopes by the entries xx, xy, yx, yy of F, and of those by Ḟ."""


class Workspace(NamedTuple):
    """Scratch of one tile: its local particles, and its SPH fluid.

    z, x: (2, local, TILE) material and current positions, µm.
    v, f: (2, local, TILE) velocities, µm/µs, and forces, µN.
    slope: (pairs, TILE) W′/|r| of fluid pairs, 1/µm⁴.
    volume: (fluid, TILE) specific volume 1/ρ, µm²/ng.
    """

    z: Array
    x: Array
    v: Array
    f: Array
    slope: Array
    volume: Array


@kernel
def make_workspace(topology):
    """Return a `Workspace` for one tile; its arrays are not initialised."""
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
    """Geometry of a pair of particles, every field as lanes.

    r = x_j − x_i, µm, and w = v_j − v_i, µm/µs. With |r| = `length` and 1/|r| = `inverse`, the unit
    vector is n = r/|r|, and `rate` = n·w is the rate at which the pair lengthens.
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
    """Return both components of x_j − x_i; x (2, local, TILE)."""
    return load(x, 0, j) - load(x, 0, i), load(x, 1, j) - load(x, 1, i)


@pair_law
def norm(rx, ry):
    """Return |r| and 1/|r|."""
    square = rx * rx + ry * ry
    inverse = inverse_root(square)
    return square * inverse, inverse


@pair_law
def pair_at(x, v, i, j):
    """Return the `Pair` of local particles i and j; x, v (2, local, TILE).

    What a kernel does not use of it costs nothing: the compiler leaves it out.
    """
    rx, ry = difference(x, i, j)
    wx, wy = difference(v, i, j)
    length, inverse = norm(rx, ry)
    rate = (rx * wx + ry * wy) * inverse
    return Pair(rx, ry, wx, wy, rx * inverse, ry * inverse, length, inverse, rate)


@pair_law
def add_pair(f, i, j, fx, fy):
    """Add the force (fx, fy) on i and its opposite on j to f (2, local, TILE)."""
    store(load(f, 0, i) + fx, f, 0, i)
    store(load(f, 1, i) + fy, f, 1, i)
    store(load(f, 0, j) - fx, f, 0, j)
    store(load(f, 1, j) - fy, f, 1, j)


@pair_law
def add_to(array, row, value):
    """Set array[row] += value; array (rows, TILE)."""
    store(load(array, row) + value, array, row)


@pair_law
def add_at(array, row, column, value):
    """Set array[row, column] += value; array (rows, columns, TILE)."""
    store(load(array, row, column) + value, array, row, column)


# Matrices


@pair_law
def add_block(matrix, block, stride, i, j, entries):
    """Add a 2 × 2 block of entries (xx, xy, yx, yy) at particles (i, j) to matrix (size, TILE).

    Nothing is added where one of the two is held or where the pattern has no block for them.
    """
    first_row = block[i, j]
    if first_row >= 0:
        second_row = first_row + stride[i]
        add_to(matrix, first_row, entries[0])
        add_to(matrix, first_row + 1, entries[1])
        add_to(matrix, second_row, entries[2])
        add_to(matrix, second_row + 1, entries[3])


@pair_law
def add_pair_jacobian(matrix, block, stride, L, i, j, rr, rw):
    """Add K = ∂f/∂r + ∂f/∂w L of a pair to the matrix, at own particles i and j.

    f is the force on i, which falls as x_i grows and rises with x_j; that on j is its opposite.

    L: (2, 2, TILE) velocity gradient, by which w = L r.
    rr, rw: (xx, xy, yx, yy) entries of ∂f/∂r and ∂f/∂w.
    """
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
    """Add (kx, ky) ⊗ (zx, zy) to the four columns of a row from `column` on."""
    add_at(columns, row, column, kx * zx)
    add_at(columns, row, column + 1, kx * zy)
    add_at(columns, row, column + 2, ky * zx)
    add_at(columns, row, column + 3, ky * zy)


@pair_law
def add_pair_load(columns, Z, i, j, j_own, rr, rw):
    """Add ∂f/∂F = ∂f/∂r ⊗ Z and ∂f/∂Ḟ = ∂f/∂w ⊗ Z of a pair to columns (2n, 8, TILE).

    Rows 2i and 2i + 1 are the components of the force on i; j_own owns j, which may be an image.

    Z: (2, local, TILE) material positions. rr, rw: as of `add_pair_jacobian`.
    """
    zx, zy = difference(Z, i, j)
    add_load(columns, 2 * i, BY_F, rr[0], rr[1], zx, zy)
    add_load(columns, 2 * i + 1, BY_F, rr[2], rr[3], zx, zy)
    add_load(columns, 2 * i, BY_RATE, rw[0], rw[1], zx, zy)
    add_load(columns, 2 * i + 1, BY_RATE, rw[2], rw[3], zx, zy)
    add_load(columns, 2 * j_own, BY_F, -rr[0], -rr[1], zx, zy)
    add_load(columns, 2 * j_own + 1, BY_F, -rr[2], -rr[3], zx, zy)
    add_load(columns, 2 * j_own, BY_RATE, -rw[0], -rw[1], zx, zy)
    add_load(columns, 2 * j_own + 1, BY_RATE, -rw[2], -rw[3], zx, zy)


# Fields


@pair_law
def field_difference(fields, m, i, j):
    """Return both components of field m at j less those at i; fields (FIELDS, 2, local, TILE)."""
    dx = load(fields, m, 0, j) - load(fields, m, 0, i)
    return dx, load(fields, m, 1, j) - load(fields, m, 1, i)


@pair_law
def add_field_pair(fields, m, i, j, fx, fy):
    """Add (fx, fy) to field m at i and its opposite at j; fields (FIELDS, 2, local, TILE)."""
    store(load(fields, m, 0, i) + fx, fields, m, 0, i)
    store(load(fields, m, 1, i) + fy, fields, m, 1, i)
    store(load(fields, m, 0, j) - fx, fields, m, 0, j)
    store(load(fields, m, 1, j) - fy, fields, m, 1, j)


@pair_law
def add_transposed(fields, m, i, j, slopes, px, py):
    """Add Sᵀ p to field m at i and its opposite at j; `slopes` are S (xx, xy, yx, yy)."""
    fx = slopes[0] * px + slopes[2] * py
    fy = slopes[1] * px + slopes[3] * py
    add_field_pair(fields, m, i, j, fx, fy)
