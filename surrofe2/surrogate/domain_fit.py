"""Fits the domain of a surrogate: every failed sample is outside, and few other failures inside.

Its cliff is a logistic regression of failure, moved in until every failed sample is outside, and
further by what failures it had not seen fell short in cross-validation.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from surrofe2.sampling import SLACK, half_widths
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.domain import (
    FEATURES,
    SUMS,
    Domain,
    Table,
    cliff_table,
    features,
    products,
    reach_of,
    scaled_inputs,
    with_one,
)
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]

_FOLDS = 5
_MARGIN = 0.5  # of the logarithm of the odds of failure, on top of what cross-validation wants
_RIDGE = 1e-4
_MOST_ITERATIONS = 100


def fit_domain(samples: StressSamples, failed: tuple[Array, Array] | None = None) -> Domain:
    """The domain of the valid samples, without the failed ones and those beyond a bifurcation.

    Args:
        failed: F and F_dot (n, 2, 2) of more points that have no stress.
    """
    square = samples.cell.symmetry == "D4"
    scale = half_widths(samples.range)
    x = scaled_inputs(samples.F, samples.F_dot, scale)
    known = samples.status == 0
    if samples.left_bifurcation is not None:
        known &= ~samples.left_bifurcation
    good, bad = x[known], x[~known]
    if failed is not None:
        bad = np.concatenate([bad, scaled_inputs(*failed, scale)])
    pairs, signs = _directions(square)
    at_rest = np.zeros((1, INPUTS))  # σ(I, 0) = 0 is exact
    reach = reach_of(features(np.concatenate([good, at_rest]), square), pairs, signs)
    cliff = _fit_cliff(good, bad, square) if len(bad) else np.empty(0)
    return Domain(scale, square, pairs, signs, reach.max(axis=0) + SLACK, cliff)


def _directions(square: bool) -> tuple[Table, Array]:
    """Features (m, 2) and signs (m, 2) of all half-spaces."""

    def ways(feature: int) -> tuple[float, ...]:
        folded = square and feature < INPUTS and feature not in SUMS
        return (1.0,) if folded else (1.0, -1.0)

    single = [((k, k), (sign, 0.0)) for k in np.arange(FEATURES).tolist() for sign in ways(k)]
    double = [
        (pair, signs)
        for pair in combinations(np.arange(INPUTS).tolist(), 2)
        for signs in product(*map(ways, pair))
    ]
    pairs, signs = zip(*single, *double, strict=True)
    return np.array(pairs), np.array(signs)


def _fit_cliff(good: Array, bad: Array, square: bool) -> Array:
    """Coefficients (k,) of the cliff; every point of `bad` is beyond it."""
    table = cliff_table(square)
    basis_good, basis_bad = (products(with_one(x), table) for x in (good, bad))
    coefficients = _logistic(basis_good, basis_bad)
    shortfall = 0.0
    for fold in np.arange(_FOLDS):
        unseen = np.arange(len(bad)) % _FOLDS == fold
        if not unseen.any() or unseen.all():
            continue
        others = _logistic(basis_good, basis_bad[~unseen])
        edge = (basis_bad[~unseen] @ others).min()
        shortfall = max(shortfall, edge - (basis_bad[unseen] @ others).min())
    edge = (basis_bad @ coefficients).min()
    margin = shortfall + _MARGIN
    coefficients[0] -= edge - margin
    return coefficients


def _logistic(good: Array, bad: Array) -> Array:
    """Ridge logistic regression of failure, both classes with the same weight.

    good, bad: (n, k) basis functions. Returns their coefficients (k,).
    """
    basis = np.concatenate([good, bad])
    failed = np.repeat([0, 1], [len(good), len(bad)])
    if not len(good):
        return np.zeros(basis.shape[1])
    model = LogisticRegression(
        C=1.0 / _RIDGE,
        fit_intercept=False,
        solver="newton-cholesky",
        max_iter=_MOST_ITERATIONS,
    )
    weight = np.where(failed == 1, 0.5 / len(bad), 0.5 / len(good))
    coefficients: Array = model.fit(basis, failed, sample_weight=weight).coef_[0]
    return coefficients
