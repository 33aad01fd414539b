"""Fits the domain of a surrogate: every failed sample is outside, and few other samples are.

The failure boundary is a logistic regression of failure, moved in until every failed sample is
outside, and further by what it fell short of at failures left out in cross-validation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from surrofe2.base.sampling import half_widths
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.domain import Domain, boundary_table, products, scaled_inputs, with_one

Array = NDArray[np.float64]

_FOLDS = 5
_MARGIN = 0.5  # of the logarithm of the odds of failure, on top of what cross-validation wants
_RIDGE = 1e-4
_MOST_ITERATIONS = 100


def fit_domain(samples: StressSamples, failed: tuple[Array, Array] | None = None) -> Domain:
    """The domain that keeps out samples that failed and those beyond a bifurcation.

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
    boundary = _fit_boundary(good, bad, square) if len(bad) else np.empty(0)
    return Domain(scale, square, boundary)


def _fit_boundary(good: Array, bad: Array, square: bool) -> Array:
    """Coefficients (k,) of the boundary; every point of `bad` is beyond it."""
    table = boundary_table(square)
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
