"""Where a surrogate may be asked: in the sampling range, short of where samples failed.

Samples fill the box of the range, which the lookup tests. Where some have no stress (no
convergence, no stable equilibrium, beyond a bifurcation), a failure boundary keeps every one of
them outside: a surface in products of the scaled inputs to degree 4, by logistic regression of
failure (`domain_fit`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.square_symmetry import SUM, parity
from surrofe2.base.tensors import INPUTS, check_arrays, to_inputs

Array = NDArray[np.float64]
Table = NDArray[np.int64]

_FACTORS = 4  # of every product in a table
_STRETCHES = (0, 1, 2)
_CUBIC, _QUARTIC = 3, 4


@dataclass(frozen=True, eq=False, slots=True)
class Domain:
    """The side of the failure boundary on which a surrogate answers.

    Attributes:
        scale: (7,) of the inputs, 1 and 1/µs.
        square: whether the boundary is invariant under D4.
        boundary: (k,) coefficients of `boundary_table`; failure lies where their sum is positive.
            Empty where no sample failed.
    """

    scale: Array
    square: bool
    boundary: Array

    def __post_init__(self) -> None:
        size = len(boundary_table(self.square)) if self.boundary.size else 0
        values = {"scale": self.scale, "boundary": self.boundary}
        check_arrays("domain", values, {"scale": (INPUTS,), "boundary": (size,)})


def scaled_inputs(F: Array, F_dot: Array, scale: Array) -> Array:
    """(n, 7) scaled components of U − I and RᵀḞ."""
    scaled: Array = to_inputs(F, F_dot)[0] / scale
    return scaled


def with_one(x: Array) -> Array:
    """(n, 8) inputs and, behind them, 1: what `boundary_table` counts in."""
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def products(rows: Array, table: Table) -> Array:
    """(n, k) Π rows[:, table[k]]; a table (k, 4) of column numbers."""
    values: Array = rows[:, table].prod(axis=2)
    return values


def boundary_table(square: bool) -> Table:
    """Products of inputs that tell where equilibrium is lost: 1, to degree 4 in U, 2 with A.

    Under D4 only those that it leaves alone.
    """
    found: list[tuple[int, ...]] = [()]
    for degree in np.arange(1, _QUARTIC + 1):
        for product in combinations_with_replacement(np.arange(INPUTS).tolist(), int(degree)):
            only_U = all(factor in _STRETCHES for factor in product)
            if (only_U or degree < _CUBIC) and (not square or parity(product) == SUM):
                found.append(product)
    return padded_table(found)


def padded_table(found: Sequence[tuple[int, ...]]) -> Table:
    """(k, 4) products of columns, filled up with the column of ones."""
    return np.array([product + (INPUTS,) * (_FACTORS - len(product)) for product in found])
