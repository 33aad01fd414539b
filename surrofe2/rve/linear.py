"""Small dense linear systems, one per lane of a tile: a (n, n, TILE), b (n, TILE).

No pivoting: near a stable equilibrium the symmetric part of the matrices is definite, and a
factorisation that is bad all the same shows as a solve that does not converge.
"""

from __future__ import annotations

from surrofe2.plant_cell.lanes import TILE, kernel

_PANEL = 4


@kernel
def factorise(a):
    """LU in place, unit lower triangle; the diagonal holds reciprocal pivots."""
    n = a.shape[0]
    for start in range(0, n, _PANEL):
        end = min(start + _PANEL, n)
        _factorise_panel(a, start, end)
        if end - start == _PANEL:
            k = start
            for i in range(end, n):
                for j in range(end, n):
                    for lane in range(TILE):
                        a[i, j, lane] -= (
                            a[i, k, lane] * a[k, j, lane]
                            + a[i, k + 1, lane] * a[k + 1, j, lane]
                            + a[i, k + 2, lane] * a[k + 2, j, lane]
                            + a[i, k + 3, lane] * a[k + 3, j, lane]
                        )


@kernel
def _factorise_panel(a, start, end):
    n = a.shape[0]
    for k in range(start, end):
        for lane in range(TILE):
            a[k, k, lane] = 1.0 / a[k, k, lane]
        for i in range(k + 1, n):
            for lane in range(TILE):
                a[i, k, lane] *= a[k, k, lane]
            for j in range(k + 1, n if i < end else end):
                for lane in range(TILE):
                    a[i, j, lane] -= a[i, k, lane] * a[k, j, lane]


@kernel
def solve_factorised(lu, b):
    """Replace b by the solution, lu as `factorise` left it (any precision)."""
    n = lu.shape[0]
    for i in range(n):
        for j in range(i):
            for lane in range(TILE):
                b[i, lane] -= lu[i, j, lane] * b[j, lane]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            for lane in range(TILE):
                b[i, lane] -= lu[i, j, lane] * b[j, lane]
        for lane in range(TILE):
            b[i, lane] *= lu[i, i, lane]
