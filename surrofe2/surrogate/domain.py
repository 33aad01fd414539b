"""Domain in which a surrogate may be used, and the bound of its error there.

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

# Numbers of the inputs that never fall on the way out from rest, see `all_inputs`. They follow the
# seven scaled inputs and the input that is 1.
COMPRESSION = 8
NORM = 9
NEAR = 10
SQUARES = 11
"""The first of the squared inputs, which are the last of all inputs."""
ALL_INPUTS = SQUARES + INPUTS
REACH = 3e-4
"""Mean square of the inputs, each weighted by the stress that it gives, at which `NEAR` is ½.

The error is exactly 0 at rest, grows from there with the square of the inputs, and soon grows no
more; `NEAR` has the same course."""
# Folds of the cross-validation that tells how far the boundary must be moved in.
_FOLDS = 5
# Added to what cross-validation asks for, in the logarithm of the odds of failure.
_MARGIN = 0.5
# Factor of the penalty on coefficients: without one, separable classes have no finite optimum.
_RIDGE = 1e-4
_MOST_ITERATIONS = 100
# Degrees of the boundary, without rates and with: 330 products of all seven inputs to degree 4
# would be more than a few failed samples can fix.
_LARGEST = 4
_LARGEST_OF_RATES = 2


@dataclass(frozen=True, eq=False, slots=True)
class Domain:
    """The side of the failure boundary on which a surrogate answers.

    Attributes:
        scale: (7,) half widths by which the inputs are divided, 1 and 1/µs.
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
        quantile: factor q of the bound; infinite where no bound can be given.
        alpha: greatest probability with which a new path may break the bound.
        confidence: fraction of sets of calibration paths for which alpha is kept.
        kinds: figures by kind of path: `paths` and `states` within the domain are numbers, and
            `quantile` and `confidence` are those of this kind alone.
        stress_spread: spread of the data's stress, µN/µm.
        data_fingerprint: fingerprint of the samples that were trained on.
        subject: fingerprint of the weights and the range that were calibrated.
        settings: settings of the paths, for the record.
        near: (7,) share of each squared input in the size of a state, which `NEAR` goes by.
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
    """Return the components of U − I and RᵀḞ, each divided by its `scale` (7,), as (n, 7)."""
    inputs, _ = to_inputs(F, F_dot)
    return np.asarray(inputs / scale)


def all_inputs(x: Array, near: Array) -> Array:
    """Return what the products of boundary and local scale are made of, (n, 18).

    The columns are the scaled inputs x (n, 7), 1, and what never falls on the way out from (I, 0):

    - `COMPRESSION`: the square of the sum s where s is negative;
    - `NORM`: the mean square of all inputs;
    - `NEAR`: m/(m + `REACH`), with m the mean square of the inputs weighted by `near` (7,);
    - `SQUARES` and on: the square of each input.
    """
    squares = x**2
    norm = squares.mean(axis=1)
    size = squares @ near
    compression = np.minimum(x[:, 0], 0.0) ** 2
    return np.column_stack([x, np.ones(len(x)), compression, norm, size / (size + REACH), squares])


def boundary_products(square: bool) -> list[Product]:
    """Return the products of inputs of which the failure boundary is made.

    They are 1, those to degree 4 of the inputs of U, and those to degree 2 with inputs of the rate.
    For a square plant cell only those that D4 leaves alone are taken.
    """
    products: list[Product] = [()]
    for product in monomials(_LARGEST):
        has_rate = max(product) >= STRETCH
        if has_rate and len(product) > _LARGEST_OF_RATES:
            continue
        if square and parity(product) != SUM:
            continue
        products.append(product)
    return products


def scale_products() -> list[Product]:
    """Return the products of which a local scale may be made; the first is 1, the last `NEAR`."""
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
    """Return the values (n, k) of products at scaled inputs x (n, 7); `near` as in `all_inputs`."""
    return np.column_stack(columns(all_inputs(x, near), products))


def fit_domain(samples: StressSamples, failed: tuple[Array, Array] | None = None) -> Domain:
    """Fit the domain that keeps out every failed state.

    These are the samples without a stress, those beyond a bifurcation, and the states `failed`,
    F and F_dot (n, 2, 2), which were met outside the samples.
    """
    is_square = samples.cell.symmetry == "D4"
    scale = half_widths(samples.range)
    x = scaled_inputs(samples.F, samples.F_dot, scale)
    is_known = samples.status == 0
    if samples.left_bifurcation is not None:
        is_known &= ~samples.left_bifurcation
    x_failed = x[~is_known]
    if failed is not None:
        F, F_dot = failed
        x_failed = np.concatenate([x_failed, scaled_inputs(F, F_dot, scale)])
    if not len(x_failed):
        return Domain(scale, is_square, np.empty(0))
    products = boundary_products(is_square)
    near = np.zeros(INPUTS)  # of no effect: the boundary has no product with `NEAR`
    good = values_of(products, x[is_known], near)
    bad = values_of(products, x_failed, near)
    boundary = _logistic(good, bad)
    # how far failures that a fit has not seen may lie inside the boundary of those that it has seen
    shortfall = 0.0
    for fold in np.arange(_FOLDS):
        unseen = np.arange(len(bad)) % _FOLDS == fold
        if unseen.any() and not unseen.all():
            others = _logistic(good, bad[~unseen])
            edge = (bad[~unseen] @ others).min()
            shortfall = max(shortfall, edge - (bad[unseen] @ others).min())
    # product 0 is 1, so its coefficient moves the boundary in until every failure is beyond it
    boundary[0] -= (bad @ boundary).min() - (shortfall + _MARGIN)
    return Domain(scale, is_square, boundary)


def _logistic(good: Array, bad: Array) -> Array:
    """Return coefficients (k,) of failure by ridge logistic regression.

    Each class, (n, k) values of products, has one weight in all, however many states it has.
    """
    if not len(good):
        return np.zeros(bad.shape[1])
    # imported here, for it takes a second that runs of a stored surrogate do without
    from sklearn.linear_model import LogisticRegression

    counts = [len(good), len(bad)]
    has_failed = np.repeat([0, 1], counts)
    weight = np.repeat([0.5 / count for count in counts], counts)
    model = LogisticRegression(
        C=1.0 / _RIDGE,
        fit_intercept=False,  # product 0 is the intercept
        solver="newton-cholesky",
        max_iter=_MOST_ITERATIONS,
    )
    model.fit(np.concatenate([good, bad]), has_failed, sample_weight=weight)
    return np.asarray(model.coef_[0])
