"""What domain and bound are functions of: (U, A) in scaled components, and products of them.

With F = R U and A = RᵀḞ the seven inputs are sum s, difference d and shear g of U − I and sum S,
difference D, shear G and spin W of A, see `tensors`; here each is scaled to within ±1 over the
sampling range. They do not change under a superposed constant rotation; what the square cell's
group D4 does to them is flip the signs of (d, g, D, G) or of (g, G, W), so moduli and products of
even parity are exact invariants.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange
from surrofe2.square_symmetry import SUM, parity
from surrofe2.surrogate.features import input_scale
from surrofe2.tensors import INPUTS, to_inputs

Array = NDArray[np.float64]
Table = NDArray[np.int64]

FACTORS = 4  # of every product in a table
COMPRESSION = 8
NORM = 9
_STRETCHES = (0, 1, 2)
_CUBIC, _QUARTIC = 3, 4


def has_square_symmetry(cell: CellParameters) -> bool:
    """Whether the unit cell has the square's group D4; an irregular one has none."""
    return cell.symmetry == "D4"


def feature_scale(range: SamplingRange) -> Array:
    """(7,) what the inputs are divided by to be within ±1: sums and differences of two entries."""
    scale: Array = 2.0 * input_scale(range)
    return scale


def scaled_inputs(F: Array, F_dot: Array, scale: Array) -> Array:
    """(n, 7) scaled components of U − I and RᵀḞ."""
    scaled: Array = to_inputs(F, F_dot)[0] / scale
    return scaled


def sum_of_products(rows: Array, table: Table, coefficients: Array) -> Array:
    """(n,) Σ c_k Π rows[:, table[k]]."""
    values: Array = products(rows, table) @ coefficients
    return values


def products(rows: Array, table: Table) -> Array:
    """(n, k) Π rows[:, table[k]]; a table (k, 4) of column numbers."""
    values: Array = rows[:, table].prod(axis=2)
    return values


def with_one(x: Array) -> Array:
    """(n, 8) inputs and, behind them, 1: what tables of `cliff_table` count in."""
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def cliff_table(square: bool) -> Table:
    """Products of inputs that tell where equilibrium is lost: 1, to degree 4 in U, 2 with A.

    Under D4 only those that it leaves alone.
    """
    found: list[tuple[int, ...]] = [()]
    for degree in np.arange(1, _QUARTIC + 1):
        for product in combinations_with_replacement(np.arange(INPUTS).tolist(), int(degree)):
            only_U = all(factor in _STRETCHES for factor in product)
            if (only_U or degree < _CUBIC) and (not square or parity(product) == SUM):
                found.append(product)
    return _table(found, INPUTS)


def even_rows(x: Array) -> Array:
    """(n, 10) rows that never fall on the way out from (I, 0).

    The squares of the seven inputs, 1, the square of s where it is negative (`COMPRESSION`) and
    the mean square of all inputs (`NORM`).
    """
    squares = x**2
    return np.column_stack(
        [
            squares,
            np.ones(len(x)),
            np.minimum(x[:, 0], 0.0) ** 2,
            squares.mean(axis=1),
        ]
    )


def scale_table() -> Table:
    """Products of `even_rows` that a local scale may be made of; the first is 1."""
    one = INPUTS
    squares = np.arange(INPUTS).tolist()
    found: list[tuple[int, ...]] = [(), (COMPRESSION,), (COMPRESSION, COMPRESSION)]
    found += [(COMPRESSION, k) for k in squares]
    found += [(NORM,) * power for power in (1, 2, 3, 4)]
    found += [(k,) for k in squares]
    found += list(combinations_with_replacement(squares, 2))
    return _table(found, one)


def _table(found: Sequence[tuple[int, ...]], one: int) -> Table:
    return np.array([product + (one,) * (FACTORS - len(product)) for product in found])
