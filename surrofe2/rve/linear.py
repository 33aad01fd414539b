"""Small dense linear systems, one per lane of a tile: a (n, n, TILE), b (n, TILE).

No pivoting: near a stable equilibrium the symmetric part of the matrices is definite, and a
factorisation that is bad all the same shows as a solve that does not converge.

Eight columns are eliminated at a time, so that what is updated is read and written an eighth as
often.
"""

from __future__ import annotations

from surrofe2.compilation import kernel
from surrofe2.simd import TILE, load, spread, store

PANEL = 8


@kernel
def copy_from(source, first, target):
    """target[i, j] = source[first + i, first + j], all of target, in its precision."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            store(load(source, first + i, first + j), target, i, j)


@kernel
def factorise(a):
    """LU in place, unit lower triangle; the diagonal holds reciprocal pivots."""
    n = a.shape[0]
    for start in range(0, n, PANEL):
        end = min(start + PANEL, n)
        _factorise_panel(a, start, end, False)
        for i in range(end, n):
            _update_row(a, i, start, end)


@kernel
def factorise_symmetric(a):
    """As `factorise` where a is symmetric; elimination keeps to the upper triangle and diagonal."""
    n = a.shape[0]
    for start in range(0, n, PANEL):
        end = min(start + PANEL, n)
        _factorise_panel(a, start, end, True)
        for i in range(end, n):
            _update_row(a, i, start, i - i % PANEL)


@kernel
def is_negative_definite(a, answer):
    """answer (TILE,): whether the symmetric a, lane by lane, is; a is overwritten."""
    factorise_symmetric(a)
    for k in range(TILE):
        answer[k] = True
        for i in range(a.shape[0]):
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
def _update_row(a, i, k, first):
    """a[i, j] −= Σ_m a[i, m] a[m, j] for columns j ≥ first and the eight m of a full panel at k."""
    f0, f1, f2, f3 = load(a, i, k), load(a, i, k + 1), load(a, i, k + 2), load(a, i, k + 3)
    f4, f5, f6, f7 = load(a, i, k + 4), load(a, i, k + 5), load(a, i, k + 6), load(a, i, k + 7)
    for j in range(first, a.shape[0]):
        low = f0 * load(a, k, j) + f1 * load(a, k + 1, j)
        low += f2 * load(a, k + 2, j) + f3 * load(a, k + 3, j)
        high = f4 * load(a, k + 4, j) + f5 * load(a, k + 5, j)
        high += f6 * load(a, k + 6, j) + f7 * load(a, k + 7, j)
        store(load(a, i, j) - (low + high), a, i, j)


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
