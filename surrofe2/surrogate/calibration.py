"""Calibrates the bound of a surrogate's error, by split conformal prediction over paths.

The local scale s(F, Ḟ) > 0 is fitted to errors on some paths; on n others of each kind the score
of a path is the largest error/s at its states within the domain, infinite where the RVE has
no stress there; one that never enters the domain has none. With q the ⌈(n + 1)(1 − α)⌉-th smallest
score or a larger one, the largest over the kinds,

    error_bound = 1.5 q s(F, Ḟ).

For a new path of one of the kinds, drawn independently, the probability that the error exceeds q s
at its states within the domain is at most α (Vovk, Gammerman, Shafer, *Algorithmic learning in a
random world*, 2005; Lei et al., *Distribution-free predictive inference for regression*, 2018).
Given the calibration paths, it is at most α for 95 % of the sets of them where n ≥ 299 (α = 1 %).
The factor 1.5 (`settings.MARGIN`) stands for the states in between and is no part of the guarantee.
docs/theory.md says what is not promised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.special import bdtr

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.tensors import INPUTS, stress_error, stress_spread
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.deformation_paths import Truth
from surrofe2.surrogate.domain import (
    Calibration,
    fit_domain,
    scale_products,
    scaled_inputs,
    values_of,
)
from surrofe2.surrogate.settings import CONFIDENCE, MARGIN
from surrofe2.surrogate.surrogate_law import SurrogateLaw

_LEAST_SCALE = 1e-2  # of the largest error: s soon is above this, on the way out from rest
_LEAST_AT_REST = 1e-5  # and everywhere above this
_LEAST_SIZE = 1e-3  # of a state: it does not matter how small those below are
_EXACT = 1e-13  # of the spread: errors below are rounding
_TIMES = 2  # the scale is fitted
_MOST_ADDED = 300  # states that bind the local scale, in one round
_SLACK = 1e-6  # of the largest error


def calibrate(
    law: SurrogateLaw,
    samples: StressSamples,
    shaping: Sequence[Truth],
    testing: Sequence[Truth],
    alpha: float,
    settings: Mapping[str, Any] | None = None,
) -> SurrogateLaw:
    """The surrogate with the domain of its data and a calibrated bound.

    Args:
        shaping: stresses that shape the domain (where they fail) and the local scale.
        testing: stresses along other paths, drawn independently, each kind once.
        alpha: probability that a new path breaks the bound, at most.
        settings: of the paths, to be kept for the record.

    Raises:
        InputError: no path to calibrate on.
    """
    if not any(truth.paths.count for truth in testing):
        raise InputError("calibration: no path; at least one kind needs some")
    domain = fit_domain(samples, _failures(shaping))
    law = replace(law, domain=domain, calibration=None)
    spread = stress_spread(samples.valid.stress)
    squares = (law.network.sizes_at_rest() * domain.scale) ** 2
    near = squares / squares.sum() if squares.any() else np.full(INPUTS, 1.0 / INPUTS)
    scale = _fit_scale(law, near, shaping, spread)
    kinds: dict[str, dict[str, float]] = {}
    for truth in testing:
        error, inside = errors_along(law, truth)
        x = scaled_inputs(*truth.paths.states, domain.scale)
        local = values_of(scale_products(), x, near) @ scale
        scores = truth.paths.largest(np.where(inside, error / local, 0.0))
        entering = scores[truth.paths.largest(inside.astype(float)) > 0.0]
        if not np.isfinite(conformal_quantile(entering, alpha)):
            entering = scores  # too few of them enter the domain for a quantile
        kinds[truth.paths.kind] = {
            "paths": truth.paths.count,
            "states": int(inside.sum()),
            "quantile": conformal_quantile(entering, alpha),
            "confidence": confidence(len(entering), alpha),
        }
    used = [kind for kind in kinds.values() if kind["paths"]]
    calibration = Calibration(
        scale=scale,
        quantile=MARGIN * max(kind["quantile"] for kind in used),
        alpha=alpha,
        confidence=min(kind["confidence"] for kind in used),
        kinds=kinds,
        stress_spread=spread,
        data_fingerprint=law.data_fingerprint,
        subject=law.network.fingerprint(law.range),
        settings=dict(settings or {}),
        near=near,
    )
    return replace(law, calibration=calibration)


def conformal_quantile(scores: Array, alpha: float) -> float:
    """Smallest of n scores that new ones exceed with a probability of at most alpha.

    At least the ⌈(n + 1)(1 − alpha)⌉-th smallest, for which this holds on average over sets of
    scores (infinite where n is less); and so far up that it holds for `CONFIDENCE` of such sets
    (Vovk, Conditional validity of inductive conformal predictors, 2012, proposition 2a), or the
    largest where n < log(1 − CONFIDENCE)/log(1 − alpha).
    """
    count = len(scores)
    rank = int(np.ceil((count + 1) * (1.0 - alpha) - 1e-9))
    if rank > count:
        return np.inf
    likely = bdtr(np.arange(count + 1.0), count, alpha)  # that so many or fewer are above
    above = max(int((likely <= 1.0 - CONFIDENCE).sum()) - 1, 0)
    return float(np.sort(scores)[max(rank, count - above) - 1])


def confidence(count: int, alpha: float) -> float:
    """Share of sets of so many scores whose `conformal_quantile` new ones exceed with a probability
    of at most alpha."""
    return min(CONFIDENCE, 1.0 - (1.0 - alpha) ** count)


def errors_along(law: SurrogateLaw, truth: Truth) -> tuple[Array, Flags]:
    """(error (n,) in µN/µm, whether the surrogate answers (n,)) at the states of paths.

    The error is infinite where the surrogate answers and the full model has no stress. States that
    a path does not reach are not answered.
    """
    answer, status, _ = law.lookup(*truth.paths.states)
    inside = (status == 0) & truth.reached
    error = np.full(len(answer), np.inf)
    known = inside & (truth.status == 0)
    error[known] = stress_error(answer[known], truth.stress[known])
    return error, inside


def _failures(shaping: Sequence[Truth]) -> tuple[Array, Array]:
    """F and F_dot of the first states of paths at which the full model has no stress."""
    none = np.empty((0, 2, 2))
    lost = [truth.reached & (truth.status != 0) for truth in shaping]
    states = [truth.paths.states for truth in shaping]
    F, F_dot = (
        np.concatenate([none, *(each[part][at] for each, at in zip(states, lost, strict=True))])
        for part in (0, 1)
    )
    return F, F_dot


def _fit_scale(law: SurrogateLaw, near: Array, shaping: Sequence[Truth], spread: float) -> Array:
    """Coefficients of a small scale that covers all errors.

    Linear programs: minimise the mean of s/s₀ over all kinds, subject to s ≥ error at every state,
    coefficients ≥ 0. s₀ is the size of a state at first, then the s found before, so that a few
    large errors in one corner do not widen the bound elsewhere. A third program would find the
    same.
    """
    assert law.domain is not None
    products = scale_products()
    bases, errors, before = [], [], []
    for truth in shaping:
        error, inside = errors_along(law, truth)
        kept = inside & np.isfinite(error)
        x = scaled_inputs(*truth.paths.states, law.domain.scale)[kept]
        bases.append(values_of(products, x, near))
        before.append(np.sqrt(x**2 @ near) + _LEAST_SIZE)
        errors.append(error[kept])
    largest = max((error.max(initial=0.0) for error in errors), default=0.0)
    floor = np.zeros(len(products))
    floor[0] = max(_LEAST_AT_REST * largest, _EXACT * spread)
    if largest <= floor[0]:
        return floor
    floor[-1] = _LEAST_SCALE * largest
    basis, error = np.concatenate(bases), np.concatenate(errors) / largest
    for _ in range(_TIMES):
        pairs = zip(bases, before, strict=True)
        cost = np.sum([(each / s[:, None]).mean(axis=0) for each, s in pairs if len(s)], axis=0)
        found = _smallest_cover(cost / cost.max(), basis, error, floor / largest)
        before = [each @ found for each in bases]
    return largest * found


def _smallest_cover(cost: Array, basis: Array, error: Array, least: Array) -> Array:
    """c ≥ least (k,) of smallest cost·c with basis (n, k) c ≥ error (n,).

    Only few states bind, so those that the solution violates most are added until none is left.
    """
    kept = np.argsort(error)[-_MOST_ADDED:]
    while True:
        bounds = [(low, None) for low in least]
        found = linprog(cost, -basis[kept], -error[kept], bounds=bounds, method="highs")
        if found.x is None:  # never so: basis[:, 0] is 1
            raise SimulationError(f"calibration: no local scale: {found.message}")
        coefficients = np.maximum(found.x, least)
        lacking = error - basis @ coefficients
        worst = np.argsort(lacking)[-_MOST_ADDED:]
        worst = worst[lacking[worst] > _SLACK]
        if not len(np.setdiff1d(worst, kept)):
            return coefficients
        kept = np.union1d(kept, worst)
