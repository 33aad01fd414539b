"""The samples that a surrogate is trained on: a data set, and true answers of runs after it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.io.harvest import Harvest, check_harvest, read_harvest
from surrofe2.recipe import Recipe
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.tensors import stress_error, stress_spread
from surrofe2.workflow import laws

log = logging.getLogger(__name__)

_CHUNK = 512
_SAME = 1e-6
"""Share of the spread of stress within which two answers are the same."""


def with_harvests(
    samples: StressSamples, paths: Sequence[Path], recipe: Recipe, law: StressLaw | None = None
) -> StressSamples:
    """The samples and, after them, the true answers in these harvests.

    The range stays that of the samples: states beyond it are trained on, and do not widen it.
    Where the samples have tangents, those of harvested states are solved for, by RVEs from rest;
    states whose stress they do not find again are left out.

    Args:
        law: whose tangents; default: the recipe's RVE.

    Raises:
        MismatchError: a harvest is of other cell parameters or initialisation.
    """
    harvests = [read_harvest(path) for path in paths]
    for path, harvest in zip(paths, harvests, strict=True):
        check_harvest(path, harvest, samples.cell, samples.initialisation)
    if not harvests:
        return samples
    names = ["F", "F_dot", "stress", "status"]
    parts = [{name: getattr(harvest, name) for name in names} for harvest in harvests]
    if samples.P_by_F is not None:
        names += ["P_by_F", "P_by_F_dot"]
        law = law or laws.true_law(recipe)
        parts = [_with_tangents(law, harvest, _spread(samples)) for harvest in harvests]
        known = sum(len(part["status"]) for part in parts)
        left_out = sum(len(harvest.status) for harvest in harvests) - known
        if left_out:
            log.warning(
                "%d harvested states left out: RVEs from rest answer otherwise there", left_out
            )
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(samples, name), *(part[name] for part in parts)])
        for name in names
    }
    left = samples.left_bifurcation
    if left is not None:  # harvests have no answers from beyond a bifurcation
        arrays["left_bifurcation"] = np.pad(left, (0, len(arrays["status"]) - len(left)))
    return replace(samples, **arrays)


def _spread(samples: StressSamples) -> float:
    return stress_spread(samples.stress[samples.status == 0])


def _with_tangents(law: StressLaw, harvest: Harvest, spread: float) -> dict[str, Any]:
    """Arrays of harvested states with tangents: those that failed, and those that the law, from
    rest, answers alike.
    """
    by_F, by_F_dot = np.full((2, len(harvest.status), 2, 2, 2, 2), np.nan)
    kept = harvest.status != 0
    valid = np.flatnonzero(~kept)
    for first in range(0, len(valid), _CHUNK):
        rows = valid[first : first + _CHUNK]
        answer: Any = law.respond(harvest.F[rows], harvest.F_dot[rows], tangents=True)
        wrong = stress_error(answer.stress, harvest.stress[rows])
        kept[rows] = (answer.status == 0) & (wrong <= _SAME * spread)
        by_F[rows], by_F_dot[rows] = answer.tangents.P_by_F, answer.tangents.P_by_F_dot
    arrays = {name: getattr(harvest, name) for name in ("F", "F_dot", "stress", "status")}
    arrays |= {"P_by_F": by_F, "P_by_F_dot": by_F_dot}
    return {name: values[kept] for name, values in arrays.items()}
