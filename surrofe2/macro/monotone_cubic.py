"""The integral of a monotone cubic through samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def integral_of_monotone_cubic(x: Array, y: Array, t: Array) -> Array:
    """Integral from x[0] to t of the cubic by Fritsch and Butland through (x, y), NaN beyond x.

    That of scipy's PchipInterpolator, whose import takes a third of a cached run.
    """
    h, rise = np.diff(x), np.diff(y)
    slope = rise / h
    d = np.zeros(len(x))
    if len(x) == 2:
        d[:] = slope
    else:
        before, after = slope[:-1], slope[1:]
        alike = before * after > 0.0
        w = np.stack([2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]])[:, alike]
        d[1:-1][alike] = w.sum(axis=0) / (w[0] / before[alike] + w[1] / after[alike])
        d[0] = _end_slope(h[0], h[1], slope[0], slope[1])
        d[-1] = _end_slope(h[-1], h[-2], slope[-1], slope[-2])
    whole = h * (y[:-1] + y[1:]) / 2.0 + h**2 * (d[:-1] - d[1:]) / 12.0
    sums = np.concatenate([[0.0], np.cumsum(whole)])
    k = np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(h) - 1)
    s = (t - x[k]) / h[k]
    values = y[k] * (s - s**3 + s**4 / 2.0) + y[k + 1] * (s**3 - s**4 / 2.0)
    slopes = d[k] * (s**2 / 2.0 - 2.0 * s**3 / 3.0 + s**4 / 4.0)
    slopes += d[k + 1] * (s**4 / 4.0 - s**3 / 3.0)
    inside = (t >= x[0]) & (t <= x[-1])
    return np.where(inside, sums[k] + h[k] * (values + h[k] * slopes), np.nan)


def _end_slope(h: float, next_h: float, slope: float, next_slope: float) -> float:
    """Slope of a parabola through the last three points, kept monotone."""
    d = ((2.0 * h + next_h) * slope - h * next_slope) / (h + next_h)
    if d * slope <= 0.0:
        return 0.0
    return 3.0 * slope if slope * next_slope < 0.0 and abs(d) > 3.0 * abs(slope) else d
