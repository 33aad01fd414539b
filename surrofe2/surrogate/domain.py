"""Where a surrogate may be used, and the bound of its error there.

Samples fill the box of the range, which the lookup tests. Where some have no stress, a failure
boundary keeps every one of them outside: a surface in products of the scaled inputs to degree 4,
by logistic regression of failure, moved in until every failed sample is outside, and further by
what it fell short of at failures left out in cross-validation.

The bound is quantile × local scale. The local scale s(F, Ḟ) > 0 is a sum of products of inputs that
never fall on the way out from rest, with coefficients ≥ 0. `calibration` finds it.

The risk at a point is the bound over the local tolerance, in µN/µm,

    allowed(F, Ḟ) = min(tolerance, 2 b + relative L),    L² = Σ_k (|∂P/∂x_k| x_k)²,

where b is the bound of the error at rest, and L the size of the stress that the moduli at rest
give, each of the seven inputs of `tensors` counted by itself, so that it vanishes at rest alone;
see `SurrogateLaw.with_tolerance`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, combinations_with_replacement
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import half_widths
from surrofe2.base.square_symmetry import SUM, parity
from surrofe2.base.tensors import INPUTS, check_arrays, to_inputs
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.products import STRETCH, Product, columns, monomials

COMPRESSION, NORM, NEAR, SQUARES = 8, 9, 10, 11
"""Numbers of the inputs that never fall on the way out from rest, see `all_inputs`; the squares are
the last."""
ALL_INPUTS = SQUARES + INPUTS
REACH = 3e-4
"""Mean square of the inputs, by the stress each gives, at which `NEAR` is half of what it comes to:
the error is exactly 0 at rest, grows from there with the square, and soon no more."""
_FOLDS = 5
_MARGIN = 0.5  # of the logarithm of the odds of failure, on top of what cross-validation wants
_RIDGE = 1e-4
_MOST_ITERATIONS = 100
_LARGEST_OF_RATES, _LARGEST = 2, 4  # degrees of the boundary, with rates and without


@dataclass(frozen=True, eq=False, slots=True)
class Domain:
    """The side of the failure boundary on which a surrogate answers.

    Attributes:
        scale: (7,) of the inputs, 1 and 1/µs.
        square: whether the boundary is invariant under D4.
        boundary: (k,) coefficients of `boundary_products`, whose sum is positive beyond it. Empty
            where no sample failed.
    """

    scale: Array
    square: bool
    boundary: Array

    def __post_init__(self) -> None:
        size = len(boundary_products(self.square)) if self.boundary.size else 0
        values = {"scale": self.scale, "boundary": self.boundary}
        check_arrays("domain", values, {"scale": (INPUTS,), "boundary": (size,)})


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Calibration:
    """A local scale, its quantile, and where they come from.

    Attributes:
        scale: (k,) coefficients ≥ 0 of `scale_products`, µN/µm.
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
        shapes = {"scale": (len(scale_products()),), "near": (INPUTS,)}
        check_arrays("calibration", {"scale": self.scale, "near": self.near}, shapes)
        if not (self.quantile >= 0.0 and (self.scale >= 0.0).all() and self.stress_spread > 0.0):
            raise InputError("calibration: scale, quantile and stress_spread; none may be negative")


def scaled_inputs(F: Array, F_dot: Array, scale: Array) -> Array:
    """(n, 7) scaled components of U − I and RᵀḞ."""
    return np.asarray(to_inputs(F, F_dot)[0] / scale)


def all_inputs(x: Array, near: Array) -> Array:
    """(n, 18) what products are made of: scaled inputs x (n, 7), 1, and what never falls on the way
    out from (I, 0): the square of s where it is negative (`COMPRESSION`), the mean square of all
    inputs (`NORM`), with their mean m by the shares `near`, m/(m + `REACH`) (`NEAR`), and the
    squares."""
    squares = x**2
    norm, size = squares.mean(axis=1), squares @ near
    low = np.minimum(x[:, 0], 0.0) ** 2
    return np.column_stack([x, np.ones(len(x)), low, norm, size / (size + REACH), squares])


def boundary_products(square: bool) -> list[Product]:
    """Products of inputs that tell where equilibrium is lost: 1, to degree 4 in U, 2 with A; under
    D4 only those that it leaves alone."""
    return [()] + [
        product
        for product in monomials(_LARGEST)
        if (len(product) <= _LARGEST_OF_RATES or max(product) < STRETCH)
        and (not square or parity(product) == SUM)
    ]


def scale_products() -> list[Product]:
    """Products that a local scale may be made of; the first is 1."""
    squares = range(SQUARES, ALL_INPUTS)
    return [
        (),
        (COMPRESSION,),
        (COMPRESSION, COMPRESSION),
        *((COMPRESSION, k) for k in squares),
        *((NORM,) * power for power in (1, 2, 3, 4)),
        *((k,) for k in squares),
        *combinations_with_replacement(squares, 2),
        *((i, i, j, j) for i, j in combinations(squares, 2)),  # the corners of the range
        (NEAR,),
    ]


def values_of(products: list[Product], x: Array, near: Array) -> Array:
    """(n, k) of products at scaled inputs x (n, 7)."""
    return np.column_stack(columns(all_inputs(x, near), products))


def fit_domain(samples: StressSamples, failed: tuple[Array, Array] | None = None) -> Domain:
    """The domain that keeps out samples that failed, those beyond a bifurcation, and the points of
    `failed`, F and F_dot (n, 2, 2)."""
    square, scale = samples.cell.symmetry == "D4", half_widths(samples.range)
    x = scaled_inputs(samples.F, samples.F_dot, scale)
    known = samples.status == 0
    if samples.left_bifurcation is not None:
        known &= ~samples.left_bifurcation
    beyond = x[~known]
    if failed is not None:
        beyond = np.concatenate([beyond, scaled_inputs(*failed, scale)])
    if not len(beyond):
        return Domain(scale, square, np.empty(0))
    products, none = boundary_products(square), np.zeros(INPUTS)
    good, bad = (values_of(products, each, none) for each in (x[known], beyond))
    boundary, shortfall = _logistic(good, bad), 0.0
    for fold in np.arange(_FOLDS):
        unseen = np.arange(len(bad)) % _FOLDS == fold
        if unseen.any() and not unseen.all():
            others = _logistic(good, bad[~unseen])
            edge = (bad[~unseen] @ others).min()
            shortfall = max(shortfall, edge - (bad[unseen] @ others).min())
    boundary[0] -= (bad @ boundary).min() - (shortfall + _MARGIN)  # all of `bad` is beyond it
    return Domain(scale, square, boundary)


def _logistic(good: Array, bad: Array) -> Array:
    """Coefficients (k,) by ridge logistic regression of failure, both classes (n, k) with one
    weight."""
    if not len(good):
        return np.zeros(bad.shape[1])
    from sklearn.linear_model import LogisticRegression  # a second, which runs do without

    sizes = [len(good), len(bad)]
    failed, weight = (np.repeat(of, sizes) for of in ([0, 1], [0.5 / size for size in sizes]))
    how = {"solver": "newton-cholesky", "max_iter": _MOST_ITERATIONS}
    model = LogisticRegression(C=1.0 / _RIDGE, fit_intercept=False, **how)
    model.fit(np.concatenate([good, bad]), failed, sample_weight=weight)
    return np.asarray(model.coef_[0])
