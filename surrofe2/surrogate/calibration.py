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

# Floors of the local scale s, as fractions of the largest error. They keep a region in which the
# calibration paths happened to have no error from getting a bound of zero.
_LEAST_SCALE = 1e-2  # coefficient of the product `NEAR`, which is 0 at rest and soon close to 1
_LEAST_AT_REST = 1e-5  # coefficient of the product 1
# Rounding alone makes errors of this fraction of the spread of stress, so s is never below it.
_EXACT = 1e-13
# Added to the size of a state in the first program's cost, which divides by the size.
_LEAST_SIZE = 1e-3
# The second program weighs errors by the first one's scale; a third would change nothing more.
_PROGRAMS = 2
# Violated states that are added to a linear program in one round. Few bind in the end, so a program
# over all states at once would take much longer.
_MOST_ADDED = 300
# A state counts as violated beyond this fraction of the largest error; HiGHS keeps to 1e-7.
_SLACK = 1e-6


def calibrate(
    law: SurrogateLaw,
    samples: StressSamples,
    shaping: Sequence[Truth],
    testing: Sequence[Truth],
    alpha: float,
    settings: Mapping[str, Any] | None = None,
) -> SurrogateLaw:
    """Return the surrogate with the domain of its data and a calibrated bound.

    Args:
        law: the trained surrogate; a domain and a calibration that it has are replaced.
        samples: the data that it was trained on.
        shaping: stresses that shape the domain (where they fail) and the local scale.
        testing: stresses along other paths, drawn independently, each kind once.
        alpha: greatest probability with which a new path may break the bound.
        settings: settings of the paths, which are kept for the record.

    Raises:
        InputError: no path to calibrate on.
    """
    if not any(truth.paths.count for truth in testing):
        raise InputError("calibration: no path; at least one kind needs some")
    domain = fit_domain(samples, _failures(shaping))
    law = replace(law, domain=domain, calibration=None)
    spread = stress_spread(samples.valid.stress)
    squares = (law.network.sizes_at_rest() * domain.scale) ** 2
    if squares.any():
        near = squares / squares.sum()
    else:  # a network without a baseline has no slopes at rest, so all inputs count alike
        near = np.full(INPUTS, 1.0 / INPUTS)
    scale = _fit_scale(law, near, shaping, spread)
    figures_by_kind = {
        truth.paths.kind: _figures_of_kind(law, truth, scale, near, alpha) for truth in testing
    }
    used = [figures for figures in figures_by_kind.values() if figures["paths"]]
    calibration = Calibration(
        scale=scale,
        # the bound must hold for each kind of path, so the worst kind decides
        quantile=MARGIN * max(figures["quantile"] for figures in used),
        alpha=alpha,
        confidence=min(figures["confidence"] for figures in used),
        kinds=figures_by_kind,
        stress_spread=spread,
        data_fingerprint=law.data_fingerprint,
        subject=law.network.fingerprint(law.range),
        settings=dict(settings or {}),
        near=near,
    )
    return replace(law, calibration=calibration)


def _figures_of_kind(
    law: SurrogateLaw, truth: Truth, scale: Array, near: Array, alpha: float
) -> dict[str, float]:
    """Return what a `Calibration` records of one kind of path, with the quantile of its scores.

    Args:
        scale: (k,) coefficients of the local scale, µN/µm.
        near: (7,) share of each squared input in the size of a state.
    """
    assert law.domain is not None
    error, inside = errors_along(law, truth)
    x = scaled_inputs(*truth.paths.states, law.domain.scale)
    local_scale = values_of(scale_products(), x, near) @ scale
    scores = truth.paths.largest(np.where(inside, error / local_scale, 0.0))
    enters = truth.paths.largest(inside.astype(float)) > 0.0
    entering = scores[enters]
    if not np.isfinite(conformal_quantile(entering, alpha)):
        entering = scores  # too few of them enter the domain for a quantile
    return {
        "paths": truth.paths.count,
        "states": int(inside.sum()),
        "quantile": conformal_quantile(entering, alpha),
        "confidence": confidence(len(entering), alpha),
    }


def conformal_quantile(scores: Array, alpha: float) -> float:
    """Return the smallest of n scores that new ones exceed with a probability of at most alpha.

    It is at least the ⌈(n + 1)(1 − alpha)⌉-th smallest, for which this holds on average over sets
    of scores (infinite where n is less); and so far up that it holds for `CONFIDENCE` of such sets
    (Vovk, Conditional validity of inductive conformal predictors, 2012, proposition 2a), or the
    largest where n < log(1 − CONFIDENCE)/log(1 − alpha).
    """
    count = len(scores)
    # 1e-9 takes rounding off: (n + 1)(1 − alpha) may be a whole number that rounds up
    rank = int(np.ceil((count + 1) * (1.0 - alpha) - 1e-9))
    if rank > count:
        return np.inf
    # entry j is the probability that j or fewer of n scores lie above the true quantile
    at_most_above = bdtr(np.arange(count + 1.0), count, alpha)
    above = max(int((at_most_above <= 1.0 - CONFIDENCE).sum()) - 1, 0)
    return float(np.sort(scores)[max(rank, count - above) - 1])


def confidence(count: int, alpha: float) -> float:
    """Return the fraction of sets of `count` scores for which the promise holds.

    The promise is that new scores exceed the set's `conformal_quantile` with a probability of at
    most alpha.
    """
    return min(CONFIDENCE, 1.0 - (1.0 - alpha) ** count)


def errors_along(law: SurrogateLaw, truth: Truth) -> tuple[Array, Flags]:
    """Return (error (n,) in µN/µm, whether the surrogate answers (n,)) at the states of paths.

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
    """Return F and F_dot (n, 2, 2) of the first states of paths without a stress by the RVE."""
    no_state = np.empty((0, 2, 2))
    deformations = [no_state]
    rates = [no_state]
    for truth in shaping:
        is_lost = truth.reached & (truth.status != 0)
        F, F_dot = truth.paths.states
        deformations.append(F[is_lost])
        rates.append(F_dot[is_lost])
    return np.concatenate(deformations), np.concatenate(rates)


def _fit_scale(law: SurrogateLaw, near: Array, shaping: Sequence[Truth], spread: float) -> Array:
    """Return the coefficients (k,) of a small local scale that covers all errors, µN/µm.

    Each linear program minimises the mean of s/s₀ over all kinds, subject to s ≥ error at every
    state and coefficients ≥ 0. s₀ is the size of a state in the first program and the s of the
    first in the second, so that a few large errors in one corner do not widen the bound elsewhere.

    Args:
        near: (7,) share of each squared input in the size of a state.
        spread: spread of the data's stress, µN/µm.
    """
    assert law.domain is not None
    products = scale_products()
    bases = []
    errors = []
    reference_scales = []  # s₀ at the states of each kind
    for truth in shaping:
        error, inside = errors_along(law, truth)
        covered = inside & np.isfinite(error)
        x = scaled_inputs(*truth.paths.states, law.domain.scale)[covered]
        bases.append(values_of(products, x, near))
        errors.append(error[covered])
        reference_scales.append(np.sqrt(x**2 @ near) + _LEAST_SIZE)
    largest = max((error.max(initial=0.0) for error in errors), default=0.0)
    floor = np.zeros(len(products))
    floor[0] = max(_LEAST_AT_REST * largest, _EXACT * spread)
    if largest <= floor[0]:
        return floor
    floor[-1] = _LEAST_SCALE * largest
    all_bases = np.concatenate(bases)
    # the programs are solved with errors of order 1, for the tolerances of HiGHS are absolute
    relative_errors = np.concatenate(errors) / largest
    for _ in range(_PROGRAMS):
        means = [
            (basis / s[:, None]).mean(axis=0)
            for basis, s in zip(bases, reference_scales, strict=True)
            if len(s)
        ]
        cost = np.sum(means, axis=0)
        coefficients = _smallest_cover(
            cost / cost.max(), all_bases, relative_errors, floor / largest
        )
        reference_scales = [basis @ coefficients for basis in bases]
    return largest * coefficients


def _smallest_cover(cost: Array, basis: Array, error: Array, least: Array) -> Array:
    """Return c ≥ least (k,) of smallest cost·c with basis (n, k) c ≥ error (n,).

    Only few states bind: the program starts with the largest errors, and the states that its
    solution violates most are added until there is no new one.
    """
    binding = np.argsort(error)[-_MOST_ADDED:]
    bounds = [(low, None) for low in least]
    while True:
        result = linprog(cost, -basis[binding], -error[binding], bounds=bounds, method="highs")
        if result.x is None:  # never so: basis[:, 0] is 1
            raise SimulationError(f"calibration: no local scale: {result.message}")
        coefficients = np.maximum(result.x, least)
        lacking = error - basis @ coefficients
        worst = np.argsort(lacking)[-_MOST_ADDED:]
        violated = worst[lacking[worst] > _SLACK]
        if not len(np.setdiff1d(violated, binding)):
            return coefficients
        binding = np.union1d(binding, violated)
