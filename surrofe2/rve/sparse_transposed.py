"""The transposed system with factors of `sparse_linear`."""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.simd import TILE, load, store


@kernel
def solve_sparse_transposed(lu, b, pattern):
    """Replace b (unknowns, TILE) by the solution of Aᵀ, lu as `factorise_sparse` left it."""
    y = np.empty((b.shape[0], TILE))
    for i in range(b.shape[0]):
        store(load(b, i), y, pattern.unknown[i])
    groups = pattern.width.shape[0]
    for g in range(groups):
        size = pattern.first[g + 1] - pattern.first[g]
        for k in range(size):
            row, here = pattern.start[g] + k * pattern.width[g], pattern.first[g] + k
            diagonal = row + pattern.offset[g, g] + k
            store(load(y, here) * load(lu, diagonal), y, here)
            _subtract(lu, diagonal + 1, y, here, here + 1, size - k - 1)
            for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
                _subtract_block(lu, row, y, here, pattern, g, pattern.upper[m])
    for g in range(groups - 1, -1, -1):
        for k in range(pattern.first[g + 1] - pattern.first[g] - 1, -1, -1):
            row, here = pattern.start[g] + k * pattern.width[g], pattern.first[g] + k
            _subtract(lu, row + pattern.offset[g, g], y, here, pattern.first[g], k)
            for m in range(pattern.lower_start[g], pattern.lower_start[g + 1]):
                _subtract_block(lu, row, y, here, pattern, g, pattern.lower[m])
    for i in range(b.shape[0]):
        store(load(y, pattern.unknown[i]), b, i)


@kernel
def _subtract_block(lu, row, y, here, pattern, g, c):
    """`_subtract` for the columns of group c in a row of group g."""
    first = pattern.first[c]
    _subtract(lu, row + pattern.offset[g, c], y, here, first, pattern.first[c + 1] - first)


@kernel
def _subtract(lu, at, y, here, first, count):
    """y[first + j] −= lu[at + j] y[here] for j < count."""
    value = load(y, here)
    for j in range(count):
        store(load(y, first + j) - load(lu, at + j) * value, y, first + j)
