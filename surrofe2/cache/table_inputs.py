"""Where a table keeps its records: seven inputs with rotation and the group of the cell taken out.

S of `tensors` has the same four components as A, and |S| = √(s·s/2) is its Frobenius norm.
The group D4 of the square cell acts by signs (docs/theory.md, symmetries): a turn by 90° flips
difference and shear, a reflection flips shear and spin. So each state has four images; the one with
difference and shear of U ≥ 0 is its canonical one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.sampling import SamplingRange
from surrofe2.tensors import INPUTS, from_components, to_components, transpose

Array = NDArray[np.float64]

OUTPUTS = 4
DIFFERENCE_OF_U, SHEAR_OF_U = 1, 2

_TURN = np.array([1.0, -1.0, -1.0, 1.0])  # of sum, difference, shear, spin
_REFLECTION = np.array([1.0, 1.0, -1.0, -1.0])
OUTPUT_SIGNS = np.array([np.ones(4), _TURN, _REFLECTION, _TURN * _REFLECTION])
"""(4, 4) by which each image flips the components of a tensor; bit 0: turned, bit 1: reflected."""
INPUT_SIGNS = np.concatenate([OUTPUT_SIGNS[:, :3], OUTPUT_SIGNS], axis=1)
"""(4, 7) by which each image flips the inputs."""


def canonical_image(x: Array, symmetry: str) -> NDArray[np.intp]:
    """(n,) which image of each state is its canonical one; 0 without symmetry."""
    if symmetry != "D4":
        return np.zeros(len(x), dtype=np.intp)
    turned = x[:, DIFFERENCE_OF_U] < 0.0
    shear = np.where(turned, -x[:, SHEAR_OF_U], x[:, SHEAR_OF_U])
    return turned + 2 * (shear < 0.0)


def input_slopes(R: Array, by_F: Array, by_F_dot: Array) -> Array:
    """∂s/∂x (n, 4, 7) from ∂σ/∂F and ∂σ/∂Ḟ, (n, 2, 2, 2, 2) each.

    A change of x at fixed R changes F by R δU and Ḟ by R δA, and σ by R δS Rᵀ.
    """
    directions = from_components(np.eye(OUTPUTS))
    stretch = np.einsum("nabcd,nck,jkd->njab", by_F, R, directions[:3])
    rate = np.einsum("nabcd,nck,jkd->njab", by_F_dot, R, directions)
    turned = np.concatenate([stretch, rate], axis=1)
    slopes = to_components((transpose(R)[:, None] @ turned @ R[:, None]).reshape(-1, 2, 2))
    return np.swapaxes(slopes.reshape(-1, INPUTS, OUTPUTS), 1, 2)


def input_scale(range: SamplingRange) -> Array:
    """(7,) half the width of a range in each input; a bound of 0 gives 1."""
    low, high = range.stretch
    half_width = max(abs(low - 1.0), abs(high - 1.0))
    scale = 2.0 * np.array([half_width, half_width, range.shear, *[range.rate] * 4])
    return np.where(scale > 0.0, scale, 1.0)
