"""Small dense linear systems, one per lane of a tile: a (n, n, TILE), b (n, TILE).

No pivoting: near a stable equilibrium the symmetric part of the matrices is definite, and a
factorisation that is bad all the same shows as a solve that does not converge.

Four columns are eliminated at a time, so that what is updated is read and written a fourth as
often; two rows share what is read.
"""

from __future__ import annotations

from surrofe2.compilation import kernel
from surrofe2.plant_cell.simd import TILE, load, spread, store

PANEL = 4


@kernel
def factorise(a):
    """LU in place, unit lower triangle; the diagonal holds reciprocal pivots."""
    n = a.shape[0]
    for start in range(0, n, PANEL):
        end = min(start + PANEL, n)
        _factorise_panel(a, start, end, False)
        i = end
        while i + 1 < n:
            _update_two_rows(a, i, start, end)
            i += 2
        if i < n:
            _update_row(a, i, start, end)


@kernel
def is_negative_definite(a, answer):
    """answer (TILE,): whether the symmetric a, lane by lane, is; a is overwritten.

    Elimination keeps to the upper triangle and the blocks on the diagonal; all pivots must be
    negative.
    """
    n = a.shape[0]
    for start in range(0, n, PANEL):
        end = min(start + PANEL, n)
        _factorise_panel(a, start, end, True)
        for i in range(end, n):
            _update_row(a, i, start, i - i % PANEL)
    for k in range(TILE):
        answer[k] = True
        for i in range(n):
            if not a[i, i, k] < 0.0:
                answer[k] = False


@kernel
def _factorise_panel(a, start, end, symmetric):
    """Eliminate columns start…end−1: their pivots, the multipliers below, the rows right of them.

    With `symmetric` the multipliers below the panel come from the rows of the upper triangle.
    """
    n = a.shape[0]
    for k in range(start, end):
        pivot = 1.0 / load(a, k, k)
        store(pivot, a, k, k)
        for i in range(k + 1, end):
            factor = load(a, i, k) * pivot
            store(factor, a, i, k)
            for j in range(k + 1, n):
                store(load(a, i, j) - factor * load(a, k, j), a, i, j)
    for i in range(end, n):
        for k in range(start, end):
            value = load(a, k, i) if symmetric else load(a, i, k)
            if not symmetric:
                for m in range(start, k):
                    value -= load(a, i, m) * load(a, m, k)
            store(value * load(a, k, k), a, i, k)


@kernel
def _update_row(a, i, start, first):
    """a[i, j] −= Σ_k a[i, k] a[k, j] for columns j ≥ first and the four k of a full panel."""
    n, k = a.shape[0], start
    f0, f1, f2, f3 = load(a, i, k), load(a, i, k + 1), load(a, i, k + 2), load(a, i, k + 3)
    for j in range(first, n):
        u0, u1, u2, u3 = load(a, k, j), load(a, k + 1, j), load(a, k + 2, j), load(a, k + 3, j)
        store(load(a, i, j) - f0 * u0 - f1 * u1 - f2 * u2 - f3 * u3, a, i, j)


@kernel
def _update_two_rows(a, i, start, end):
    """`_update_row` for rows i and i + 1 and columns right of the panel."""
    n, k = a.shape[0], start
    f0, f1, f2, f3 = load(a, i, k), load(a, i, k + 1), load(a, i, k + 2), load(a, i, k + 3)
    i2 = i + 1
    g0, g1, g2, g3 = load(a, i2, k), load(a, i2, k + 1), load(a, i2, k + 2), load(a, i2, k + 3)
    for j in range(end, n):
        u0, u1, u2, u3 = load(a, k, j), load(a, k + 1, j), load(a, k + 2, j), load(a, k + 3, j)
        store(load(a, i, j) - f0 * u0 - f1 * u1 - f2 * u2 - f3 * u3, a, i, j)
        store(load(a, i2, j) - g0 * u0 - g1 * u1 - g2 * u2 - g3 * u3, a, i2, j)


@kernel
def solve_factorised(lu, b):
    """Replace b by the solution, lu as `factorise` left it, in single or double precision."""
    n = lu.shape[0]
    for i in range(n):
        store(load(b, i) - _row_times(lu, b, i, 0, i), b, i)
    for i in range(n - 1, -1, -1):
        store((load(b, i) - _row_times(lu, b, i, i + 1, n)) * load(lu, i, i), b, i)


@kernel
def _row_times(lu, b, i, first, last):
    """Σ_j lu[i, j] b[j] over first ≤ j < last, in four chains."""
    s0, s1, s2, s3 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    j = first
    while j + 3 < last:
        s0 += load(lu, i, j) * load(b, j)
        s1 += load(lu, i, j + 1) * load(b, j + 1)
        s2 += load(lu, i, j + 2) * load(b, j + 2)
        s3 += load(lu, i, j + 3) * load(b, j + 3)
        j += 4
    while j < last:
        s0 += load(lu, i, j) * load(b, j)
        j += 1
    return (s0 + s1) + (s2 + s3)
