"""Sparse linear systems, one per lane of a tile, all of one `Pattern`: values (size, TILE).

As in `linear` there is no pivoting. Rows are eliminated one after the other, the two of a
particle at once, by the rows above them: eight at a time where a group has so many.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.simd import TILE, load, spread, store

PANEL = 8


@kernel
def factorise_sparse(a, pattern):
    """LU in place, unit lower triangle; the diagonal holds reciprocal pivots."""
    for g in range(pattern.width.shape[0]):
        size, width = pattern.first[g + 1] - pattern.first[g], pattern.width[g]
        for k in range(0, size, 2):
            row = pattern.start[g] + k * width
            for m in range(pattern.lower_start[g], pattern.lower_start[g + 1]):
                _eliminate(a, pattern, g, row, pattern.lower[m], -1)
            _eliminate(a, pattern, g, row, g, k)
            _pivot(a, row, width, pattern.offset[g, g] + k)


@kernel
def _eliminate(a, pattern, g, row, h, last):
    """Clear the block of columns h, up to `last` (−1: all), from the two rows at `row` of g."""
    end = pattern.first[h + 1] - pattern.first[h] if last < 0 else last
    k = 0
    while k + PANEL <= end:
        _eliminate_panel(a, pattern, g, row, h, k)
        k += PANEL
    while k < end:
        _eliminate_pair(a, pattern, g, row, h, k)
        k += 2


@kernel
def _multipliers(a, row, width, at, above, above_width, own, k, columns):
    """Multipliers of the `columns` at k of a block, in place of what they clear.

    at, own: where the block begins in the two rows at `row` and in the rows `above`.
    """
    for m in range(columns):
        line = above + (k + m) * above_width
        pivot = load(a, line + own + k + m)
        for r in range(2):
            here = row + r * width + at + k
            factor = load(a, here + m) * pivot
            store(factor, a, here + m)
            for j in range(m + 1, columns):
                store(load(a, here + j) - factor * load(a, line + own + k + j), a, here + j)


@kernel
def _eliminate_pair(a, pattern, g, row, h, k):
    width, above, above_width = pattern.width[g], pattern.start[h], pattern.width[h]
    at, own = pattern.offset[g, h], pattern.offset[h, h]
    _multipliers(a, row, width, at, above, above_width, own, k, 2)
    end = pattern.first[h + 1] - pattern.first[h]
    line = above + k * above_width
    _subtract_pair(a, row, width, at + k, line, above_width, at + k + 2, own + k + 2, end - k - 2)
    for m in range(pattern.upper_start[h], pattern.upper_start[h + 1]):
        c = pattern.upper[m]
        _subtract_pair(
            a, row, width, at + k, line, above_width, pattern.offset[g, c], pattern.offset[h, c],
            pattern.first[c + 1] - pattern.first[c],
        )  # fmt: skip


@kernel
def _eliminate_panel(a, pattern, g, row, h, k):
    width, above, above_width = pattern.width[g], pattern.start[h], pattern.width[h]
    at, own = pattern.offset[g, h], pattern.offset[h, h]
    _multipliers(a, row, width, at, above, above_width, own, k, PANEL)
    end = pattern.first[h + 1] - pattern.first[h]
    line = above + k * above_width
    _subtract_panel(
        a, row, width, at + k, line, above_width, at + k + PANEL, own + k + PANEL, end - k - PANEL
    )
    for m in range(pattern.upper_start[h], pattern.upper_start[h + 1]):
        c = pattern.upper[m]
        _subtract_panel(
            a, row, width, at + k, line, above_width, pattern.offset[g, c], pattern.offset[h, c],
            pattern.first[c + 1] - pattern.first[c],
        )  # fmt: skip


@kernel
def _subtract_pair(a, row, width, at, line, above_width, to, source, count):
    """a[row, to + j] −= Σ_m a[row, at + m] a[line m, source + j] for both rows, two m."""
    low, high = row + at, row + width + at
    f0, f1 = load(a, low), load(a, low + 1)
    g0, g1 = load(a, high), load(a, high + 1)
    for j in range(count):
        u0, u1 = load(a, line + source + j), load(a, line + above_width + source + j)
        upper, lower = row + to + j, row + width + to + j
        store(load(a, upper) - (f0 * u0 + f1 * u1), a, upper)
        store(load(a, lower) - (g0 * u0 + g1 * u1), a, lower)


@kernel
def _subtract_panel(a, row, width, at, line, above_width, to, source, count):
    """As `_subtract_pair` with eight m."""
    low, high = row + at, row + width + at
    f0, f1, f2, f3 = load(a, low), load(a, low + 1), load(a, low + 2), load(a, low + 3)
    f4, f5, f6, f7 = load(a, low + 4), load(a, low + 5), load(a, low + 6), load(a, low + 7)
    g0, g1, g2, g3 = load(a, high), load(a, high + 1), load(a, high + 2), load(a, high + 3)
    g4, g5, g6, g7 = load(a, high + 4), load(a, high + 5), load(a, high + 6), load(a, high + 7)
    l0 = line + source
    l1, l2, l3 = l0 + above_width, l0 + 2 * above_width, l0 + 3 * above_width
    l4, l5 = l0 + 4 * above_width, l0 + 5 * above_width
    l6, l7 = l0 + 6 * above_width, l0 + 7 * above_width
    for j in range(count):
        upper, lower = row + to + j, row + width + to + j
        u0, u1, u2, u3 = load(a, l0 + j), load(a, l1 + j), load(a, l2 + j), load(a, l3 + j)
        p, q = f0 * u0 + f1 * u1, g0 * u0 + g1 * u1
        p += f2 * u2 + f3 * u3
        q += g2 * u2 + g3 * u3
        u4, u5, u6, u7 = load(a, l4 + j), load(a, l5 + j), load(a, l6 + j), load(a, l7 + j)
        p += f4 * u4 + f5 * u5
        q += g4 * u4 + g5 * u5
        p += f6 * u6 + f7 * u7
        q += g6 * u6 + g7 * u7
        store(load(a, upper) - p, a, upper)
        store(load(a, lower) - q, a, lower)


@kernel
def _pivot(a, row, width, at):
    """Eliminate the two rows of a particle from each other; reciprocal pivots."""
    below = row + width
    pivot = 1.0 / load(a, row + at)
    store(pivot, a, row + at)
    factor = load(a, below + at) * pivot
    store(factor, a, below + at)
    for j in range(at + 1, width):
        store(load(a, below + j) - factor * load(a, row + j), a, below + j)
    store(1.0 / load(a, below + at + 1), a, below + at + 1)


@kernel
def has_negative_pivots(lu, pattern, answer):
    """answer (TILE,): whether all pivots are, so that a symmetric matrix is negative definite."""
    for k in range(TILE):
        answer[k] = True
    for g in range(pattern.width.shape[0]):
        for k in range(pattern.first[g + 1] - pattern.first[g]):
            at = pattern.start[g] + k * pattern.width[g] + pattern.offset[g, g] + k
            for lane in range(TILE):
                if not lu[at, lane] < 0.0:
                    answer[lane] = False


@kernel
def solve_sparse(lu, b, pattern):
    """Replace b (unknowns, TILE) by the solution, lu as `factorise_sparse` left it."""
    y = np.empty((b.shape[0], TILE))
    for i in range(b.shape[0]):
        store(load(b, i), y, pattern.unknown[i])
    groups = pattern.width.shape[0]
    for g in range(groups):
        for k in range(pattern.first[g + 1] - pattern.first[g]):
            row, here = pattern.start[g] + k * pattern.width[g], pattern.first[g]
            total = _dot(lu, row + pattern.offset[g, g], y, here, k)
            for m in range(pattern.lower_start[g], pattern.lower_start[g + 1]):
                c = pattern.lower[m]
                first = pattern.first[c]
                total += _dot(
                    lu, row + pattern.offset[g, c], y, first, pattern.first[c + 1] - first
                )
            store(load(y, here + k) - total, y, here + k)
    for g in range(groups - 1, -1, -1):
        size = pattern.first[g + 1] - pattern.first[g]
        for k in range(size - 1, -1, -1):
            row, here = pattern.start[g] + k * pattern.width[g], pattern.first[g]
            diagonal = row + pattern.offset[g, g] + k
            total = _dot(lu, diagonal + 1, y, here + k + 1, size - k - 1)
            for m in range(pattern.upper_start[g], pattern.upper_start[g + 1]):
                c = pattern.upper[m]
                first = pattern.first[c]
                total += _dot(
                    lu, row + pattern.offset[g, c], y, first, pattern.first[c + 1] - first
                )
            store((load(y, here + k) - total) * load(lu, diagonal), y, here + k)
    for i in range(b.shape[0]):
        store(load(y, pattern.unknown[i]), b, i)


@kernel
def _dot(lu, at, y, first, count):
    """Σ_j lu[at + j] y[first + j] over j < count, in four chains."""
    s0, s1, s2, s3 = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    j = 0
    while j + 3 < count:
        s0 += load(lu, at + j) * load(y, first + j)
        s1 += load(lu, at + j + 1) * load(y, first + j + 1)
        s2 += load(lu, at + j + 2) * load(y, first + j + 2)
        s3 += load(lu, at + j + 3) * load(y, first + j + 3)
        j += 4
    while j < count:
        s0 += load(lu, at + j) * load(y, first + j)
        j += 1
    return (s0 + s1) + (s2 + s3)
