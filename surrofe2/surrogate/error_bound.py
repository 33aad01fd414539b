"""The calibrated bound of a surrogate's error: quantile × local scale.

The local scale s(F, Ḟ) > 0 is a sum of products of squared inputs with coefficients ≥ 0. It does
not change under rotations nor under the square cell's group D4. `calibration` finds it, and says
what the bound promises.

The risk at a point is the bound over the local tolerance, in µN/µm,

    allowed(F, Ḟ) = min(tolerance, 2 b + relative L),    L² = Σ_k (|∂P/∂x_k| x_k)²,

where b is the bound of the error at rest, and L the size of the stress that the moduli at rest
give, each of the seven inputs of `tensors` counted by itself, so that it vanishes at rest alone.
A surrogate with the exact tangents at rest has errors of second order there, which stay below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.tensors import INPUTS, check_arrays
from surrofe2.surrogate.domain import Table, padded_table, products

Array = NDArray[np.float64]

COMPRESSION, NORM, NEAR = 8, 9, 10
"""Columns of `even_rows` behind the squared inputs and 1."""
REACH = 3e-4
"""Mean square of the inputs, by the stress each gives, at which `NEAR` is half of what it comes to:
the error is exactly 0 at rest, grows from there with the square, and soon no more."""
SOLVED = 1e-8
"""Of the spread of stress: stresses of RVEs are known no more exactly."""
_AT_REST = 2.0  # times the bound there, so that a point at rest is far from the threshold


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Calibration:
    """A local scale, its quantile, and where they come from.

    Attributes:
        scale: (k,) coefficients ≥ 0 of `scale_table`, µN/µm.
        near: (7,) share of each squared input in the size of a state, which `NEAR` goes by.
        quantile: q; infinite where no bound can be given.
        alpha: probability that a new path breaks the bound, at most.
        confidence: share of sets of calibration paths for which that is so.
        kinds: by kind of path, `paths`, `states` within the domain, their own `quantile` and
            `confidence`.
        stress_spread: of the data's stress, µN/µm.
        data_fingerprint: of the samples that were trained on.
        subject: fingerprint of the weights and the range that were calibrated.
        settings: of the paths, for the record.
    """

    scale: Array
    quantile: float
    alpha: float
    confidence: float
    kinds: Mapping[str, Mapping[str, float]]
    stress_spread: float
    data_fingerprint: str
    subject: str
    settings: Mapping[str, Any]
    near: Array = field(default_factory=lambda: np.full(INPUTS, 1.0 / INPUTS))

    def __post_init__(self) -> None:
        shapes = {"scale": (len(scale_table()),), "near": (INPUTS,)}
        check_arrays("calibration", {"scale": self.scale, "near": self.near}, shapes)
        if not (self.quantile >= 0.0 and (self.scale >= 0.0).all() and self.stress_spread > 0.0):
            raise InputError("calibration: scale, quantile and stress_spread; none may be negative")


def local_scale(scale: Array, near: Array, x: Array) -> Array:
    """s (n,) in µN/µm at scaled inputs (n, 7); it never falls on the way out from (I, 0)."""
    values: Array = products(even_rows(x, near), scale_table()) @ scale
    return values


def even_rows(x: Array, near: Array) -> Array:
    """(n, 11) rows that never fall on the way out from (I, 0).

    The squares of the seven inputs, 1, the square of s where it is negative (`COMPRESSION`), the
    mean square of all inputs (`NORM`) and, with their mean m by the shares `near`, m/(m + `REACH`)
    (`NEAR`).
    """
    squares = x**2
    norm, size = squares.mean(axis=1), squares @ near
    return np.column_stack(
        [
            squares,
            np.ones(len(x)),
            np.minimum(x[:, 0], 0.0) ** 2,
            norm,
            size / (size + REACH),
        ]
    )


def scale_table() -> Table:
    """Products of `even_rows` that a local scale may be made of; the first is 1."""
    squares = np.arange(INPUTS).tolist()
    found: list[tuple[int, ...]] = [(), (COMPRESSION,), (COMPRESSION, COMPRESSION)]
    found += [(COMPRESSION, k) for k in squares]
    found += [(NORM,) * power for power in (1, 2, 3, 4)]
    found += [(k,) for k in squares]
    found += list(combinations_with_replacement(squares, 2))
    found += [(i, i, j, j) for i, j in combinations(squares, 2)]  # the corners of the range
    found += [(NEAR,)]
    return padded_table(found)


def tolerance_coefficients(
    sizes: Array, at_rest: float, spread: float, tolerance: float, relative: float
) -> Array:
    """(8,) squares of what each scaled input adds to allowed/tolerance, and what it is at rest.

    Args:
        sizes: (7,) of the stress by each scaled input, µN/µm. at_rest: bound there, µN/µm.
        tolerance: share of the spread, µN/µm; relative: share of the local stress.
    """
    most = tolerance * spread
    return np.append(
        (relative * sizes / most) ** 2, max(_AT_REST * at_rest, SOLVED * spread) / most
    )


def local_tolerance(x: Array, coefficients: Array) -> Array:
    """(n,) allowed/tolerance at scaled inputs (n, 7), at most 1."""
    share: Array = coefficients[INPUTS] + np.sqrt(x**2 @ coefficients[:INPUTS])
    return np.minimum(share, 1.0)
