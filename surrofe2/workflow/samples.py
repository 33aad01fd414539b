"""The samples that a surrogate learns from: rows of the recipe's data set, and harvests."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.errors import MismatchError
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.tensors import stress_error, stress_spread
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import StressLaw
from surrofe2.recipe.recipe import Recipe
from surrofe2.store.samples import Harvest, check_harvest, read_data_set, read_harvest, stored_count
from surrofe2.workflow import laws
from surrofe2.workflow.generate import counts_of, generate_data_set, wanted_count
from surrofe2.workflow.progress import Stage, no_stage

log = logging.getLogger(__name__)

_CHUNK = 512
_SAME = 1e-6
"""Fraction of the spread of stress within which two stresses are the same."""


@dataclass(frozen=True, slots=True)
class SampleSource:
    """Samples of a recipe's data set and, after them, harvests.

    Attributes:
        range: of the samples, where it is not the recipe's.
    """

    recipe: Recipe
    harvests: Sequence[Path] = ()
    range: SamplingRange | None = None
    stage: Stage = no_stage

    def take(self, count: int) -> StressSamples:
        """The first `count` samples of the data set, and all of the harvests.

        A data set whose number of samples the recipe leaves out is continued where it has fewer.

        Raises:
            FileError: there is no data set.
            InputError: it is not finished.
            MismatchError: it is of another recipe.
        """
        recipe, path = self.recipe, self.recipe.data_path()
        there = stored_count(path)
        may_grow = there.is_open and recipe.samples.count is None
        if may_grow and not (there.is_finished and there.rows >= count):
            wanted = max(count, wanted_count(recipe))
            with self.stage("generate", wanted, "samples") as report:
                generate_data_set(recipe, count=wanted, report=report)
        samples = read_data_set(path)
        check_data(recipe, samples, path)
        first = samples if len(samples.F) <= count else samples.at(np.arange(count))
        found = with_harvests(first, self.harvests, recipe)
        return found if self.range is None else replace(found, range=self.range)

    def number_with(self, fingerprint: str) -> int:
        """Which of `counts_of` gives the samples of this fingerprint; the first where none does."""
        counts = counts_of(self.recipe)
        if not fingerprint or len(counts) == 1:
            return 0
        there = stored_count(self.recipe.data_path()).rows
        known = (k for k, count in enumerate(counts) if count <= there)
        return next((k for k in known if self.take(counts[k]).fingerprint == fingerprint), 0)


def check_data(recipe: Recipe, samples: StressSamples, source: Path) -> None:
    """Refuse a data set of another recipe.

    Raises:
        MismatchError: naming what differs.
    """
    stated, stored = recipe.samples.count, stored_count(source)
    for name, here, there in (
        ("cell", recipe.cell, samples.cell),
        ("rve.initialisation", recipe.rve.initialisation, samples.initialisation),
        ("range", recipe.sampling_range(), samples.range),
        ("samples.seed", recipe.samples.seed, samples.seed),
        ("samples.count", stated, None if stored.is_open else stored.rows),
    ):
        if here != there:
            raise MismatchError(
                f"{source}: {name}: made by another recipe than {recipe.path.name}; generate it "
                "anew with `surrofe2 generate RECIPE --fresh`"
            )


def with_harvests(
    samples: StressSamples, paths: Sequence[Path], recipe: Recipe, law: StressLaw | None = None
) -> StressSamples:
    """The samples and, after them, the true answers in these harvests.

    The range stays that of the samples: states beyond it are trained on, and do not widen it.
    Where the samples have tangents, those of harvested states are computed by RVEs from rest;
    states where these come to another stress are left out.

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
    parts, known = [_arrays_of(harvest) for harvest in harvests], _arrays_of(samples)
    if samples.P_by_F is not None:
        law = law or laws.true_law(recipe)
        parts = [_with_tangents(law, harvest, _spread(samples)) for harvest in harvests]
        known |= {"P_by_F": samples.P_by_F, "P_by_F_dot": samples.P_by_F_dot}
        taken = sum(len(part["status"]) for part in parts)
        left_out = sum(len(harvest.status) for harvest in harvests) - taken
        if left_out:
            log.warning("%d harvested states left out: RVEs from rest differ there", left_out)
    arrays: dict[str, Any] = {
        name: np.concatenate([values, *(part[name] for part in parts)])
        for name, values in known.items()
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
    arrays = _arrays_of(harvest) | {"P_by_F": by_F, "P_by_F_dot": by_F_dot}
    return {name: values[kept] for name, values in arrays.items()}


def _arrays_of(answers: Harvest | StressSamples) -> dict[str, Any]:
    return {
        "F": answers.F,
        "F_dot": answers.F_dot,
        "stress": answers.stress,
        "status": answers.status,
    }
