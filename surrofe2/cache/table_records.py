"""Records of a table: linear models of the stress, each with its ellipsoid of accuracy.

A record says S(x) ≈ s₀ + G (x − x₀) (inputs and components as in `table_inputs`). The error of a
linear model is quadratic in the distance, so it is bounded by

    bound(x) = dᵀ C d,    d = x − x₀,

with the record's curvature C (symmetric, positive definite), and the ellipsoid of accuracy for a
tolerance is where bound ≤ tolerance. ISAT keeps M = C/tolerance (Pope 1997, section 3.2); C does
not depend on the tolerance. What a table claims is no more than this: a quadratic law through the
errors it has seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.table_inputs import OUTPUTS
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]


class Records(NamedTuple):
    """n records.

    Attributes:
        centre: (n, 7) x₀, 1 and 1/µs.
        stress: (n, 4) s₀, µN/µm.
        slope: (n, 4, 7) G = ∂s/∂x.
        curvature: (n, 7, 7) C.
        extent: (n, 7) diagonal of C⁻¹: the ellipsoid of a tolerance has half widths
            √(tolerance · extent).
    """

    centre: Array
    stress: Array
    slope: Array
    curvature: Array
    extent: Array

    def take(self, index: NDArray[np.intp]) -> Records:
        """The records `index` alone."""
        return Records(*(part[index] for part in self))

    def half_width(self, tolerance: float) -> Array:
        """(n, 7) half widths of the boxes around the ellipsoids."""
        return np.sqrt(tolerance * self.extent)


def no_records() -> Records:
    """An empty table's records."""
    return make_records(
        np.empty((0, INPUTS)),
        np.empty((0, OUTPUTS)),
        np.empty((0, OUTPUTS, INPUTS)),
        np.empty((0, INPUTS, INPUTS)),
    )


def make_records(centre: Array, stress: Array, slope: Array, curvature: Array) -> Records:
    """Records with their extents."""
    extent = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2).copy()
    return Records(centre, stress, slope, curvature, extent)


def joined(first: Records, second: Records) -> Records:
    """Records of both."""
    return Records(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


def curvature_from_slopes(slope: Array, probed: Array, step: Array, reach: Array) -> Array:
    """C (n, 7, 7) from the change of the exact slopes over a short way along each input.

    With the second derivatives H_k of the four components, the error is |½ (dᵀ H_k d)_k| in the
    Frobenius norm, which ½ dᵀ (½ Σ H_k²)^½ d follows closely (exactly where the H_k commute).

    Args:
        slope: (n, 4, 7) G at the centre.
        probed: (n, 7, 4, 7) G at x₀ + step along each input in turn.
        step: (7,) how far.
        reach: (7,) the unit in which squares of different inputs are added up.
    """
    second = (probed - slope[:, None]) / step[:, None, None]  # [n, along, k, of]
    second = np.moveaxis(second, 1, 3) * reach[:, None] * reach
    second = 0.5 * (second + np.swapaxes(second, 2, 3))
    squares = 0.5 * (second @ second).sum(axis=1)
    size, axes = np.linalg.eigh(squares)
    root = axes * np.sqrt(np.maximum(size, 0.0))[:, None] @ np.swapaxes(axes, 1, 2)
    return 0.5 * root / (reach[:, None] * reach)


def curvature_from_constant(slope: Array, tolerance: float, reach: Array) -> Array:
    """C (n, 7, 7) such that the stress changes by at most the tolerance over the ellipsoid.

    ISAT's first, conservative ellipsoid (Pope 1997, section 3.3), from the slopes alone.
    """
    curvature = 0.5 * np.swapaxes(slope, 1, 2) @ slope / tolerance
    return limited(curvature, tolerance, reach)


def limited(curvature: Array, tolerance: float, reach: Array) -> Array:
    """C with semi-axes of the ellipsoid of at most `reach` (7,) along the inputs."""
    return curvature + np.diag(tolerance / reach**2)
