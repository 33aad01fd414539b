"""Cubic spline smoothing kernel in two dimensions (eq. 5, σ = 10/7π), without a branch.

With q₊ = max(q, 0), both pieces of eq. (5) are W = σ/h² [(2 − s)₊³/4 − (1 − s)₊³], s = r/h.
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.lanes import pair_law

SIGMA = 10.0 / (7.0 * np.pi)


@pair_law
def spline(s, h):
    """W(s h) in 1/µm²."""
    outer = max(2.0 - s, 0.0)
    inner = max(1.0 - s, 0.0)
    return SIGMA / (h * h) * (0.25 * outer * outer * outer - inner * inner * inner)


@pair_law
def spline_slope(s, h):
    """dW/dr in 1/µm³."""
    outer = max(2.0 - s, 0.0)
    inner = max(1.0 - s, 0.0)
    return SIGMA / (h * h * h) * (3.0 * inner * inner - 0.75 * outer * outer)


@pair_law
def spline_curvature(s, h):
    """d²W/dr² in 1/µm⁴."""
    outer = max(2.0 - s, 0.0)
    inner = max(1.0 - s, 0.0)
    return SIGMA / (h * h * h * h) * (1.5 * outer - 6.0 * inner)
