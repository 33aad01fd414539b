"""Cubic spline smoothing kernel in two dimensions (eq. 5, σ = 10/7π), without a branch.

With q₊ = max(q, 0), both pieces of eq. (5) are W = σ/h² [(2 − s)₊³/4 − (1 − s)₊³], s = r/h.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import pair_law
from surrofe2.simd import where_less

SIGMA = 10.0 / (7.0 * np.pi)


@pair_law
def spline(s, h):
    """W in 1/µm² at s = r/h; lanes."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h) * (0.25 * outer * outer * outer - inner * inner * inner)


@pair_law
def spline_slope(s, h):
    """dW/dr in 1/µm³."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h) * (3.0 * inner * inner - 0.75 * outer * outer)


@pair_law
def spline_curvature(s, h):
    """d²W/dr² in 1/µm⁴."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h * h) * (1.5 * outer - 6.0 * inner)


@pair_law
def spline_bend(slope_over_length, length, inverse, h):
    """d(W′/|r|)/d|r| in 1/µm⁵, of W′/|r|, |r| and 1/|r|."""
    return (spline_curvature(length * (1.0 / h), h) - slope_over_length) * inverse
