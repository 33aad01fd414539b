"""Adding to the particles' Jacobian where it is stored dense, (2n, 2n, TILE), or sparse, `Blocks`.

The same kernels fill both; numba picks by the type of the matrix.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from surrofe2.compilation import OPTIONS, kernel
from surrofe2.simd import load, store


class Blocks(NamedTuple):
    """Sparse matrix of one tile: values (size, TILE), and where they belong (a `Pattern`)."""

    values: NDArray[np.float64]
    pattern: Any


def clear(jacobian: Any) -> None:
    """Set all entries to zero."""
    raise NotImplementedError("for kernels")


def add_block(jacobian: Any, i: Any, j: Any, xx: Any, xy: Any, yx: Any, yy: Any) -> None:
    """Add a 2 × 2 block at particles (i, j)."""
    raise NotImplementedError("for kernels")


def add_fluid_product(left: Any, right: Any, jacobian: Any, first: Any) -> None:
    """Add left @ right to the block of a plant cell's fluid, whose first particle is `first`."""
    raise NotImplementedError("for kernels")


def _is_dense(jacobian: Any) -> bool:
    return isinstance(jacobian, types.Array)


@overload(clear, jit_options=OPTIONS)
def _clear(jacobian):
    def dense(jacobian):
        jacobian[:] = 0.0

    def sparse(jacobian):
        jacobian.values[:] = 0.0

    return dense if _is_dense(jacobian) else sparse


@overload(add_block, jit_options=OPTIONS)
def _add_block(jacobian, i, j, xx, xy, yx, yy):
    def dense(jacobian, i, j, xx, xy, yx, yy):
        row, column = 2 * i, 2 * j
        store(load(jacobian, row, column) + xx, jacobian, row, column)
        store(load(jacobian, row, column + 1) + xy, jacobian, row, column + 1)
        store(load(jacobian, row + 1, column) + yx, jacobian, row + 1, column)
        store(load(jacobian, row + 1, column + 1) + yy, jacobian, row + 1, column + 1)

    def sparse(jacobian, i, j, xx, xy, yx, yy):
        values, pattern = jacobian.values, jacobian.pattern
        g, h = pattern.group[i], pattern.group[j]
        if g >= 0 and h >= 0:
            at = pattern.row_start[i] + pattern.offset[g, h] + 2 * pattern.place[j]
            below = at + pattern.width[g]
            store(load(values, at) + xx, values, at)
            store(load(values, at + 1) + xy, values, at + 1)
            store(load(values, below) + yx, values, below)
            store(load(values, below + 1) + yy, values, below + 1)

    return dense if _is_dense(jacobian) else sparse


@overload(add_fluid_product, jit_options=OPTIONS)
def _add_fluid_product(left, right, jacobian, first):
    def dense(left, right, jacobian, first):
        add_product(left, right, jacobian, 2 * first, 2 * first)

    def sparse(left, right, jacobian, first):
        values, pattern = jacobian.values, jacobian.pattern
        g = pattern.group[first]
        begin = pattern.row_start[first] + pattern.offset[g, g] + 2 * pattern.place[first]
        for m in range(left.shape[0]):
            line = begin + m * pattern.width[g]
            for n in range(0, right.shape[1], 2):
                even, odd = load(values, line + n), load(values, line + n + 1)
                for s in range(left.shape[1]):
                    factor = load(left, m, s)
                    even += factor * load(right, s, n)
                    odd += factor * load(right, s, n + 1)
                store(even, values, line + n)
                store(odd, values, line + n + 1)

    return dense if _is_dense(jacobian) else sparse


@kernel
def add_product(left, right, total, row, column):
    """total[row:, column:] += left @ right, lane by lane; two columns at a time, an even number."""
    for m in range(left.shape[0]):
        for n in range(0, right.shape[1], 2):
            even = load(total, row + m, column + n)
            odd = load(total, row + m, column + n + 1)
            for s in range(left.shape[1]):
                factor = load(left, m, s)
                even += factor * load(right, s, n)
                odd += factor * load(right, s, n + 1)
            store(even, total, row + m, column + n)
            store(odd, total, row + m, column + n + 1)
