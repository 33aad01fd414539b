"""Four right-hand sides at once with dense factors of `linear`: b (4, n, TILE).

The factors are far larger than the columns and are read once for all of them.
"""

from __future__ import annotations

from surrofe2.compilation import kernel
from surrofe2.simd import load, store

COLUMNS = 4


@kernel
def solve_four(lu, b):
    """Replace each column of b by the solution, lu as `factorise` left it."""
    n = lu.shape[0]
    for i in range(n):
        _subtract_row(lu, b, i, 0, i)
    for i in range(n - 1, -1, -1):
        _subtract_row(lu, b, i, i + 1, n)
        pivot = load(lu, i, i)
        for m in range(COLUMNS):
            store(load(b, m, i) * pivot, b, m, i)


@kernel
def _subtract_row(lu, b, i, first, last):
    """b[:, i] −= Σ_j lu[i, j] b[:, j] over first ≤ j < last."""
    s0, s1, s2, s3 = load(b, 0, i), load(b, 1, i), load(b, 2, i), load(b, 3, i)
    for j in range(first, last):
        factor = load(lu, i, j)
        s0 -= factor * load(b, 0, j)
        s1 -= factor * load(b, 1, j)
        s2 -= factor * load(b, 2, j)
        s3 -= factor * load(b, 3, j)
    store(s0, b, 0, i)
    store(s1, b, 1, i)
    store(s2, b, 2, i)
    store(s3, b, 3, i)


@kernel
def solve_four_transposed(lu, b):
    """As `solve_four` with the transposed matrix."""
    n = lu.shape[0]
    for k in range(n):
        pivot = load(lu, k, k)
        for m in range(COLUMNS):
            store(load(b, m, k) * pivot, b, m, k)
        _subtract_column(lu, b, k, k + 1, n)
    for k in range(n - 1, 0, -1):
        _subtract_column(lu, b, k, 0, k)


@kernel
def _subtract_column(lu, b, k, first, last):
    """b[:, j] −= lu[k, j] b[:, k] for first ≤ j < last."""
    s0, s1, s2, s3 = load(b, 0, k), load(b, 1, k), load(b, 2, k), load(b, 3, k)
    for j in range(first, last):
        factor = load(lu, k, j)
        store(load(b, 0, j) - factor * s0, b, 0, j)
        store(load(b, 1, j) - factor * s1, b, 1, j)
        store(load(b, 2, j) - factor * s2, b, 2, j)
        store(load(b, 3, j) - factor * s3, b, 3, j)
