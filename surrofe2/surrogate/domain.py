"""Where the data are: the set of (F, Ḟ) in which a surrogate may be asked.

Not a box around the samples but what they reach, in the scaled inputs of `trust_features`:

- half-spaces ±f_i ≤ h and ±f_i ± f_j ≤ h for every pair of features, each pushed out to the
  farthest valid sample. Features are the inputs themselves, or under D4 the sums s and S, the
  moduli of the others and the products dD and gG, which tell loading from unloading;
- where samples failed (no convergence, no stable equilibrium): one more half-space in products
  of the inputs to degree 4 (logistic regression of failure), moved in until every failed sample
  is outside, and further by what failures it had not seen fell short in cross-validation.

So every failed sample is outside, and few failures that are not among the samples are inside.
What lies between valid samples is taken to be valid.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.sampling import SLACK
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.trust_features import (
    Table,
    cliff_table,
    feature_scale,
    has_square_symmetry,
    products,
    scaled_inputs,
    sum_of_products,
    with_one,
)
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SUMS = (0, 3)
_COUPLED = ((1, 4), (2, 5))
FEATURES = INPUTS + len(_COUPLED)
_FOLDS = 5
_MARGIN = 0.5  # of the logarithm of the odds of failure, on top of what cross-validation wants
_RIDGE = 1e-4
_NEWTON_STEPS = 30
_CONVERGED = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Domain:
    """Half-spaces in features of (U, RᵀḞ); a point is inside where it is within all of them.

    Attributes:
        scale: (7,) of the inputs, 1 and 1/µs.
        square: whether features are invariant under D4.
        pairs: (m, 2) features of a half-space; signs: (m, 2) of each, 0 for a feature alone;
            limits: (m,) sign·feature + sign·feature ≤ limit.
        cliff: (k,) coefficients of `trust_features.cliff_table`; failure lies where their sum is
            positive. Empty where no sample failed.
    """

    scale: Array
    square: bool
    pairs: Table
    signs: Array
    limits: Array
    cliff: Array

    def contains(self, F: Array, F_dot: Array) -> Bools:
        """(n,) whether points (n, 2, 2) are inside; False where anything is NaN."""
        with np.errstate(all="ignore"):
            return self.holds(scaled_inputs(F, F_dot, self.scale))

    def holds(self, x: Array) -> Bools:
        """The same for scaled inputs (n, 7)."""
        reach = _reach(features(x, self.square), self.pairs, self.signs)
        inside: Bools = np.asarray((reach <= self.limits).all(axis=1))
        if len(self.cliff):
            inside &= cliff_height(x, self.square, self.cliff) <= 0.0
        return inside

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for files."""
        return {
            key: value if isinstance(value, bool) else np.asarray(value).tolist()
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Domain:
        """What `to_dict` gave; a ValueError, KeyError or TypeError where it is damaged."""
        pairs = np.array(content["pairs"], dtype=np.int64).reshape(-1, 2)
        if pairs.size and not 0 <= pairs.min() <= pairs.max() < FEATURES:
            raise ValueError("domain: pairs beyond the features")
        signs = np.array(content["signs"], dtype=np.float64).reshape(len(pairs), 2)
        if not np.isin(signs, (-1.0, 0.0, 1.0)).all():
            raise ValueError("domain: signs that are not -1, 0 or 1")
        square = bool(content["square"])
        cliff = np.array(content["cliff"], dtype=np.float64)
        if len(cliff) not in (0, len(cliff_table(square))):
            raise ValueError("domain: cliff of another length")
        return cls(
            scale=np.array(content["scale"], dtype=np.float64).reshape(INPUTS),
            square=square,
            pairs=pairs,
            signs=signs,
            limits=np.array(content["limits"], dtype=np.float64).reshape(len(pairs)),
            cliff=cliff,
        )


def fit_domain(samples: StressSamples, failed: tuple[Array, Array] | None = None) -> Domain:
    """The domain of the valid samples, without the failed ones and those beyond a bifurcation.

    Args:
        failed: F and F_dot (n, 2, 2) of more points that have no stress.
    """
    square = has_square_symmetry(samples.cell)
    scale = feature_scale(samples.range)
    x = scaled_inputs(samples.F, samples.F_dot, scale)
    known = samples.status == 0
    if samples.left_bifurcation is not None:
        known &= ~samples.left_bifurcation
    good, bad = x[known], x[~known]
    if failed is not None:
        bad = np.concatenate([bad, scaled_inputs(*failed, scale)])
    pairs, signs = _directions(square)
    at_rest = np.zeros((1, INPUTS))  # σ(I, 0) = 0 is exact
    reach = _reach(features(np.concatenate([good, at_rest]), square), pairs, signs)
    cliff = _fit_cliff(good, bad, square) if len(bad) else np.empty(0)
    return Domain(scale, square, pairs, signs, reach.max(axis=0) + SLACK, cliff)


def features(x: Array, square: bool) -> Array:
    """(n, 9) inputs, under D4 the moduli of all but the sums, and the products dD and gG."""
    own = x.copy()
    if square:
        folded = [k for k in np.arange(INPUTS).tolist() if k not in _SUMS]
        own[:, folded] = np.abs(x[:, folded])
    return np.column_stack([own, *(x[:, i] * x[:, j] for i, j in _COUPLED)])


def cliff_height(x: Array, square: bool, cliff: Array) -> Array:
    """(n,) positive beyond the cliff, where RVEs are taken to fail."""
    return sum_of_products(with_one(x), cliff_table(square), cliff)


def _directions(square: bool) -> tuple[Table, Array]:
    """Features (m, 2) and signs (m, 2) of all half-spaces."""

    def ways(feature: int) -> tuple[float, ...]:
        folded = square and feature < INPUTS and feature not in _SUMS
        return (1.0,) if folded else (1.0, -1.0)

    single = [((k, k), (sign, 0.0)) for k in np.arange(FEATURES).tolist() for sign in ways(k)]
    double = [
        (pair, signs)
        for pair in combinations(np.arange(INPUTS).tolist(), 2)
        for signs in product(*map(ways, pair))
    ]
    pairs, signs = zip(*single, *double, strict=True)
    return np.array(pairs), np.array(signs)


def _reach(values: Array, pairs: Table, signs: Array) -> Array:
    """(n, m) how far points are in each direction."""
    reach: Array = (values[:, pairs] * signs).sum(axis=2)
    return reach


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
    """Ridge logistic regression of failure, both classes with the same weight, by Newton.

    good, bad: (n, k) basis functions. Returns their coefficients (k,).
    """
    basis = np.concatenate([good, bad])
    label = np.repeat([-1.0, 1.0], [len(good), len(bad)])
    weight = np.repeat([0.5 / max(len(good), 1), 0.5 / len(bad)], [len(good), len(bad)])
    coefficients = np.zeros(basis.shape[1])
    for _ in np.arange(_NEWTON_STEPS):
        doubt = 1.0 / (1.0 + np.exp(np.clip(label * (basis @ coefficients), -30.0, 30.0)))
        gradient = _RIDGE * coefficients - basis.T @ (weight * doubt * label)
        curvature = (basis * (weight * doubt * (1.0 - doubt))[:, None]).T @ basis
        curvature[np.diag_indices_from(curvature)] += _RIDGE
        step = np.linalg.solve(curvature, gradient)
        coefficients = coefficients - step
        if np.abs(step).max() <= _CONVERGED * np.abs(coefficients).max():
            break
    return coefficients
