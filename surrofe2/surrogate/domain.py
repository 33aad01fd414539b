"""Where the data are: the set of (F, Ḟ) in which a surrogate may be asked.

Not a box around the samples but what they reach, in the inputs of `tensors`, scaled to within ±1
over the sampling range:

- half-spaces ±f_i ≤ h and ±f_i ± f_j ≤ h for every pair of features, each pushed out to the
  farthest valid sample. Features are the inputs themselves, or under D4 the sums s and S, the
  moduli of the others and the products dD and gG, which tell loading from unloading: all
  invariants, for the group flips the signs of (d, g, D, G) or of (g, G, W);
- where samples failed (no convergence, no stable equilibrium): one more half-space in products
  of the inputs to degree 4, the cliff, beyond which every failed sample lies.

What lies between valid samples is taken to be valid. `calibration` finds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.square_symmetry import SUM, parity
from surrofe2.tensors import INPUTS, check_arrays, to_inputs

Array = NDArray[np.float64]
Table = NDArray[np.int64]

SUMS = (0, 3)
"""Inputs that have no sign under D4."""
_COUPLED = ((1, 4), (2, 5))
FEATURES = INPUTS + len(_COUPLED)
_FACTORS = 4  # of every product in a table
_STRETCHES = (0, 1, 2)
_CUBIC, _QUARTIC = 3, 4


@dataclass(frozen=True, eq=False, slots=True)
class Domain:
    """Half-spaces in features of (U, RᵀḞ); a point is inside where it is within all of them.

    Attributes:
        scale: (7,) of the inputs, 1 and 1/µs.
        square: whether features are invariant under D4.
        pairs: (m, 2) features of a half-space; signs: (m, 2) of each, 0 for a feature alone;
            limits: (m,) sign·feature + sign·feature ≤ limit.
        cliff: (k,) coefficients of `cliff_table`; failure lies where their sum is
            positive. Empty where no sample failed.
    """

    scale: Array
    square: bool
    pairs: Table
    signs: Array
    limits: Array
    cliff: Array

    def __post_init__(self) -> None:
        count = len(self.limits)
        shapes = {"scale": (INPUTS,), "signs": (count, 2), "limits": (count,)}
        cliff = {"cliff": (len(cliff_table(self.square)) if self.cliff.size else 0,)}
        floats = {name: values for name, values in asdict(self).items() if name in shapes | cliff}
        check_arrays("domain", floats, shapes | cliff)
        if self.pairs.shape != (count, 2) or self.pairs.dtype.kind != "i":
            raise InputError(f"domain.pairs: shape {self.pairs.shape}; it must be ({count}, 2)")
        if not ((self.pairs >= 0) & (self.pairs < FEATURES)).all():
            raise InputError("domain.pairs: beyond the features")


def features(x: Array, square: bool) -> Array:
    """(n, 9) inputs, under D4 the moduli of all but the sums, and the products dD and gG."""
    own = x.copy()
    if square:
        folded = [k for k in np.arange(INPUTS).tolist() if k not in SUMS]
        own[:, folded] = np.abs(x[:, folded])
    return np.column_stack([own, *(x[:, i] * x[:, j] for i, j in _COUPLED)])


def reach_of(values: Array, pairs: Table, signs: Array) -> Array:
    """(n, m) how far points with such features are in each direction."""
    reach: Array = (values[:, pairs] * signs).sum(axis=2)
    return reach


_NAMES = (
    *("(U₁₁ + U₂₂ − 2)", "(U₁₁ − U₂₂)", "2 U₁₂"),
    *("(A₁₁ + A₂₂)", "(A₁₁ − A₂₂)", "(A₁₂ + A₂₁)", "(A₂₁ − A₁₂)"),
    *("(U₁₁ − U₂₂)(A₁₁ − A₂₂)", "2 U₁₂ (A₁₂ + A₂₁)"),
)


def why_outside(domain: Domain, F: Array, F_dot: Array) -> str:
    """Which half-space a point (1, 2, 2) is farthest beyond, in words; A = RᵀḞ."""
    values = features(scaled_inputs(F, F_dot, domain.scale), domain.square)
    reach = reach_of(values, domain.pairs, domain.signs)[0]
    k = int((reach - domain.limits).argmax())
    if not reach[k] > domain.limits[k]:
        return "beyond where samples have no stress"
    pair = [
        f"{'−' if sign < 0.0 else '+'} {'|' * folded}{_NAMES[i]}{'|' * folded}"
        for i, sign in zip(domain.pairs[k], domain.signs[k], strict=True)
        for folded in (domain.square and i < INPUTS and i not in SUMS,)
        if sign
    ]
    return (
        f"{' '.join(pair).removeprefix('+ ')} = {reach[k]:.4g} of at most {domain.limits[k]:.4g} "
        "that samples reach, by their half widths, after the rotation is taken out, "
        f"{reach[k] - domain.limits[k]:.2g} beyond"
    )


def scaled_inputs(F: Array, F_dot: Array, scale: Array) -> Array:
    """(n, 7) scaled components of U − I and RᵀḞ."""
    scaled: Array = to_inputs(F, F_dot)[0] / scale
    return scaled


def with_one(x: Array) -> Array:
    """(n, 8) inputs and, behind them, 1: what `cliff_table` counts in."""
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def products(rows: Array, table: Table) -> Array:
    """(n, k) Π rows[:, table[k]]; a table (k, 4) of column numbers."""
    values: Array = rows[:, table].prod(axis=2)
    return values


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
    return padded_table(found)


def padded_table(found: Sequence[tuple[int, ...]]) -> Table:
    """(k, 4) products of columns, filled up with the column of ones."""
    return np.array([product + (INPUTS,) * (_FACTORS - len(product)) for product in found])
