"""Settings of the training of a surrogate, and of the calibration of its error's bound."""

from __future__ import annotations

import math
from dataclasses import dataclass

from surrofe2.base.errors import InputError
from surrofe2.base.settings import check_settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Shape of the surrogate and effort of its training, by full-batch L-BFGS."""

    hidden: tuple[int, ...] = setting(
        (24, 24), "tanh units in each hidden layer", least=1, most=1024
    )
    tangent_weight: float = setting(
        0.1,
        "weight of the squared error of tangents in the loss, where samples have them",
        least=0.0,
    )
    baseline_degree: int = setting(3, "degree of the polynomial; 0: none", least=0, most=5)
    held_out: float = setting(
        0.1, "fraction of the samples on which errors are measured", above=0.0, below=1.0
    )
    iterations: int = setting(1000, "most iterations of L-BFGS", least=0, most=1_000_000)
    bound: float = setting(
        0.0,
        "bound of the error over the spread of stress at which training ends; 0: none",
        least=0.0,
    )
    history: int = setting(
        100, "pairs of steps and gradients that L-BFGS keeps", least=1, most=10_000
    )
    checkpoint_interval: int = setting(
        100, "iterations between two checkpoints", least=1, most=1_000_000
    )
    seed: int = setting(0, "seed of initial weights and held-out samples", least=0, most=2**63 - 1)

    def __post_init__(self) -> None:
        check_settings(self, "training")
        if not self.hidden:
            raise InputError("training.hidden", "[]; it must be a list of at least one size")


# The constants of calibration; `cache.trust` has those of audits.
MARGIN = 1.5
"""Factor of the bound beyond what conformal prediction gives.

It is an engineering margin and no part of the guarantee: paths are looked at in a few states, and a
search for the worst state accepted at a tolerance (validation/worst_answer.py) finds errors of up
to 1.3 times the bound without it, none above the bound with it."""
CONFIDENCE = 0.95
"""Fraction of calibration sets whose bound is to hold on a fraction 1 − alpha of new paths."""
SHAPING_WALKS = 1.0
"""Walks that shape the local scale, for each walk that calibrates it."""
SHAPING_RUNS = 1.0 / 3.0
"""Runs that shape the local scale, for each run that calibrates it; fewer, for runs take long."""
CORNERS = 0.25
"""Probability that a walk ends in a corner of the range."""
SMALL = 0.25
"""Probability that all of a walk is near rest."""
RUN_ELEMENTS = 2
"""Elements of a rectangle in each direction, in runs that make paths."""
RUN_POINTS = 20
"""Integration points of a run that together make one path."""
WISH = 0.75
"""Fraction of the bound wanted that the shaping paths must come to.

It is below 1 because the paths that calibrate differ from those that shape."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Number and kind of the paths along which RVEs compute the stress.

    As many walks again, and a third as many runs, shape the local scale, which the paths counted
    here then calibrate. Each kind that is used needs at least 1/alpha − 1 paths; with log(0.05)/
    log(1 − alpha) of them, 299 at 1 %, the bound holds with 95 % confidence.
    """

    walks: int = setting(300, "random walks through the sampling range, from rest", least=0)
    runs: int = setting(300, "short runs of the recipe's problem under varied loads", least=0)
    length: int = setting(24, "states taken along a walk; along a run a third as many", least=2)
    alpha: float = setting(
        0.01, "probability that a new path breaks the bound, at most", above=0.0, below=1.0
    )
    seed: int = setting(2, "seed of the paths", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "calibration")
        # with fewer paths no score is a (1 − alpha) quantile, see `conformal_quantile`
        needed = math.ceil((1.0 / self.alpha - 1.0) * (1.0 - 1e-9))  # 1e-9: rounding of 1/alpha
        for name, count in (("walks", self.walks), ("runs", self.runs)):
            if 0 < count < needed:
                raise InputError(
                    f"calibration.{name}",
                    f"{count}; it must be 0 or at least {needed}, "
                    f"1/alpha − 1, for an alpha of {self.alpha:g}",
                )
