"""The symmetry group D4 of a square cell: sign flips of tensor components.

Tensors are taken as sum, difference, shear and spin, and states as the seven inputs of `tensors`.
Rotating the cell by 90° flips difference and shear, reflecting it across an axis flips shear and
spin; together the two generate D4 (a turn by 180° does nothing). So each state has four images,
and a product of inputs has the sign of one component, its parity.
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.arrays import Array, Index

SUM = 0
DIFFERENCE = 1
SHEAR = 2
SPIN = 3
COMPONENTS = ("sum", "difference", "shear", "spin")
# The component that each of the seven inputs is, of U − I and then of A.
INPUT_COMPONENTS = (SUM, DIFFERENCE, SHEAR, SUM, DIFFERENCE, SHEAR, SPIN)

_TURN = np.array([1.0, -1.0, -1.0, 1.0])  # of sum, difference, shear, spin
_REFLECTION = np.array([1.0, 1.0, -1.0, -1.0])
# Signs (4, 4) of the components of a tensor in each image; bit 0: turned, bit 1: reflected.
COMPONENT_SIGNS = np.array([np.ones(4), _TURN, _REFLECTION, _TURN * _REFLECTION])
# Signs (4, 7) of the inputs in each image.
INPUT_SIGNS = COMPONENT_SIGNS[:, INPUT_COMPONENTS]


def parity(product: tuple[int, ...]) -> int:
    """Return the component whose sign a product of inputs, by their numbers, has under D4."""
    signs = INPUT_SIGNS[:, list(product)].prod(axis=1)
    return int(np.flatnonzero((signs == COMPONENT_SIGNS.T).all(axis=1))[0])


def canonical_image(x: Array) -> Index:
    """Return the image (n,) of each state (n, 7) that has no negative difference and shear of U."""
    turned = x[:, DIFFERENCE] < 0.0
    shear = np.where(turned, -x[:, SHEAR], x[:, SHEAR])
    return turned + 2 * (shear < 0.0)
