"""Second-order tensors in the plane, points first: arrays of shape (n, 2, 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def det(F: Array) -> Array:
    """(n,) determinants."""
    return F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]


def transpose(F: Array) -> Array:
    """(n, 2, 2) transposes."""
    return np.swapaxes(F, -1, -2)


def rotation(F: Array) -> Array:
    """R of the polar decomposition F = R U, for det F > 0.

    In the plane its angle has the tangent (F₂₁ − F₁₂)/(F₁₁ + F₂₂).
    """
    cosine = F[:, 0, 0] + F[:, 1, 1]
    sine = F[:, 1, 0] - F[:, 0, 1]
    length = np.sqrt(cosine**2 + sine**2)
    R = np.empty_like(F)
    R[:, 0, 0] = R[:, 1, 1] = cosine / length
    R[:, 1, 0] = sine / length
    R[:, 0, 1] = -R[:, 1, 0]
    return R
