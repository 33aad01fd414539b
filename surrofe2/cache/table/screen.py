"""Which records of a table may hold any of eight points, or an image of them.

Multiplied out, the bound (x − x₀)ᵀ C (x − x₀) of a record is a polynomial of degree 2 in x. An
image flips the sign of each of its 36 monomials as it flips one component of a tensor, the parity
of the monomial; so sums over the monomials of each parity give the bounds at all four images.

Rounding is that of numbers as large as x₀ᵀ C x₀: good enough to tell which records come into
question, not for the bound itself.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import load, spread, store
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, parity
from surrofe2.base.tensors import INPUTS
from surrofe2.cache.table.records import Records

Array = NDArray[np.float64]


def _parity(pair: tuple[int, int]) -> int:
    return parity(tuple(k for k in pair if k < INPUTS))


_PAIRS = np.array(sorted(combinations_with_replacement(range(INPUTS + 1), 2), key=_parity))
PRODUCTS = len(_PAIRS)
_ENDS = tuple(
    int(sum(_parity(pair) <= component for pair in _PAIRS.tolist()))
    for component in range(len(COMPONENT_SIGNS))
)
_SUM, _DIFFERENCE, _SHEAR, _SPIN = _ENDS


def make_screen(records: Records, count: int) -> Array:
    """(count, `PRODUCTS`) coefficients of the bounds of the first `count` records."""
    screen = np.empty((count, PRODUCTS))
    _fill(records.centre, records.curvature, screen)
    return screen


@kernel
def _fill(centre, curvature, screen):  # type: ignore[no-untyped-def]
    for k in range(screen.shape[0]):
        for m in range(PRODUCTS):
            i, j = _PAIRS[m, 0], _PAIRS[m, 1]
            if j < INPUTS:
                screen[k, m] = curvature[k, i, j] if i == j else 2.0 * curvature[k, i, j]
            elif i < INPUTS:
                screen[k, m] = -2.0 * _pull(i, k, centre, curvature)
            else:
                total = 0.0
                for n in range(INPUTS):
                    total += centre[k, n] * _pull(n, k, centre, curvature)
                screen[k, m] = total


@kernel
def _pull(i, k, centre, curvature):  # type: ignore[no-untyped-def]
    """Component i of C x₀ of record k."""
    total = 0.0
    for j in range(INPUTS):
        total += curvature[k, i, j] * centre[k, j]
    return total


@kernel
def fill_products(x, products):  # type: ignore[no-untyped-def]
    """The monomials (`PRODUCTS`, TILE) at inputs x (8, TILE), the last of which are ones."""
    for m in range(PRODUCTS):
        store(load(x, _PAIRS[m, 0]) * load(x, _PAIRS[m, 1]), products, m)


@kernel
def fill_bounds(screen, k, products, bounds):  # type: ignore[no-untyped-def]
    """The bounds (4, TILE) of record k at the images of eight points."""
    a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for m in range(_SUM):
        a += screen[k, m] * load(products, m)
    for m in range(_SUM, _DIFFERENCE):
        b += screen[k, m] * load(products, m)
    for m in range(_DIFFERENCE, _SHEAR):
        c += screen[k, m] * load(products, m)
    for m in range(_SHEAR, _SPIN):
        d += screen[k, m] * load(products, m)
    store((a + d) + (b + c), bounds, 0)  # as COMPONENT_SIGNS has it
    store((a + d) - (b + c), bounds, 1)
    store((a - d) + (b - c), bounds, 2)
    store((a - d) - (b - c), bounds, 3)
