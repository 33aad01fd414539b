"""Seven inputs, four outputs, and the square cell's group as sign flips.

Polar decomposition F = R U takes constant rotations out: σ = R S Rᵀ with S a function of the
stretch U and the rate A = RᵀḞ. Any tensor T in the plane has the components

    sum T₁₁ + T₂₂, difference T₁₁ − T₂₂, shear T₁₂ + T₂₁, spin T₂₁ − T₁₂.

Rotating the cell by 90° flips difference and shear, reflecting it across an axis flips shear and
spin; together they generate D4 (a turn by 180° does nothing). So each component has a parity, and
a product of components has the product of theirs:

    SUM        (+, +)
    DIFFERENCE (−, +)
    SHEAR      (−, −)
    SPIN       (+, −)
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.sampling import SamplingRange
from surrofe2.tensors import rotation, transpose

Array = NDArray[np.float64]

SUM, DIFFERENCE, SHEAR, SPIN = 0, 1, 2, 3
COMPONENTS = ("sum", "difference", "shear", "spin")

# U − I has no spin, so inputs are: sum, difference, shear of U − I; all four of A
INPUTS = 7
PARITY = (SUM, DIFFERENCE, SHEAR, SUM, DIFFERENCE, SHEAR, SPIN)

# bit 0: flipped by the 90° rotation; bit 1: flipped by the reflection; products add them modulo 2
_FLIPS = {SUM: 0b00, DIFFERENCE: 0b01, SHEAR: 0b11, SPIN: 0b10}
_COMPONENT = {flips: component for component, flips in _FLIPS.items()}


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
    """(inputs (n, 7), R (n, 2, 2)): components of U − I (3) and of RᵀḞ (4, in 1/µs)."""
    R = rotation(F)
    U = transpose(R) @ F
    stretch = to_components(U - np.eye(2))[:, :3]
    return np.concatenate([stretch, to_components(transpose(R) @ F_dot)], axis=1), R


def input_scale(range: SamplingRange) -> Array:
    """(7,) what the inputs are divided by; a bound of 0 gives 1."""
    low, high = range.stretch
    half_width = max(abs(low - 1.0), abs(high - 1.0))
    scale = np.array([half_width, half_width, range.shear, *[range.rate] * 4])
    return np.where(scale > 0.0, scale, 1.0)


def monomials(degree: int) -> tuple[tuple[int, ...], ...]:
    """All products of 1 to `degree` inputs, as sorted input numbers, by rising degree."""
    return tuple(
        product
        for factors in range(1, degree + 1)
        for product in combinations_with_replacement(range(INPUTS), factors)
    )


def parity(product: tuple[int, ...]) -> int:
    """The component whose sign a product of inputs shares under D4."""
    flips = 0
    for factor in product:
        flips ^= _FLIPS[PARITY[factor]]
    return _COMPONENT[flips]
