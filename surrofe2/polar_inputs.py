"""What a stress law without rotations depends on: seven inputs from (F, Ḟ).

With F = R U and A = RᵀḞ the stress is σ = R S Rᵀ, S a function of

    x = (sum, difference, shear of U − I;  sum, difference, shear, spin of A)

where sum is T₁₁ + T₂₂, difference T₁₁ − T₂₂, shear T₁₂ + T₂₁ and spin T₂₁ − T₁₂.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.tensors import rotation, transpose

Array = NDArray[np.float64]

INPUTS = 7


def to_components(T: Array) -> Array:
    """(n, 4) sum, difference, shear and spin of T (n, 2, 2)."""
    xx, xy, yx, yy = T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1]
    return np.stack([xx + yy, xx - yy, xy + yx, yx - xy], axis=1)


def from_components(components: Array) -> Array:
    """T (n, 2, 2) from its sum, difference, shear and spin (n, 4)."""
    total, difference, shear, spin = components.T
    T = np.stack([total + difference, shear - spin, shear + spin, total - difference], axis=1)
    return 0.5 * T.reshape(-1, 2, 2)


def to_inputs(F: Array, F_dot: Array) -> tuple[Array, Array]:
    """(x (n, 7), R (n, 2, 2)) of F and Ḟ, rates in 1/µs."""
    R = rotation(F)
    stretch = to_components(transpose(R) @ F - np.eye(2))[:, :3]
    return np.concatenate([stretch, to_components(transpose(R) @ F_dot)], axis=1), R


def from_inputs(x: Array, R: Array) -> tuple[Array, Array]:
    """F = R U and Ḟ = R A, (n, 2, 2) each; inverse of `to_inputs`."""
    stretch = np.concatenate([x[:, :3], np.zeros((len(x), 1))], axis=1)
    return R @ (np.eye(2) + from_components(stretch)), R @ from_components(x[:, 3:])
