"""Seven inputs, four outputs, and the square cell's group as sign flips.

Inputs and components are those of `polar_inputs`. Rotating the cell by 90° flips difference and
shear, reflecting it across an axis flips shear and spin; together they generate D4 (a turn by 180°
does nothing). So each component has a parity, and a product of components has the product of
theirs:

    SUM        (+, +)
    DIFFERENCE (−, +)
    SHEAR      (−, −)
    SPIN       (+, −)
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.polar_inputs import INPUTS
from surrofe2.sampling import SamplingRange

Array = NDArray[np.float64]

SUM, DIFFERENCE, SHEAR, SPIN = 0, 1, 2, 3
COMPONENTS = ("sum", "difference", "shear", "spin")

PARITY = (SUM, DIFFERENCE, SHEAR, SUM, DIFFERENCE, SHEAR, SPIN)

# bit 0: flipped by the 90° rotation; bit 1: flipped by the reflection; products add them modulo 2
_FLIPS = {SUM: 0b00, DIFFERENCE: 0b01, SHEAR: 0b11, SPIN: 0b10}
_COMPONENT = {flips: component for component, flips in _FLIPS.items()}


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
