"""The samples that a surrogate learns from: rows of the recipe's data set, and harvests."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import MismatchError
from surrofe2.io.data_sets import read_data_set, stored_count
from surrofe2.io.harvest import Harvest, check_harvest, read_harvest
from surrofe2.recipe import Recipe
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.tensors import stress_error, stress_spread
from surrofe2.workflow import laws
from surrofe2.workflow.generate import counts_of, generate_data_set, wanted_count
from surrofe2.workflow.run_lifecycle import Stage

log = logging.getLogger(__name__)

_CHUNK = 512
_SAME = 1e-6
"""Share of the spread of stress within which two answers are the same."""


def samples_in_turn(
    recipe: Recipe, harvests: Sequence[Path], stage: Stage, begin: str = "", executor: Any = None
) -> Iterator[tuple[StressSamples, bool]]:
    """What training takes one after the other, until it suffices, and whether there can be more:
    the first samples of the recipe's data set, then twice as many, and these harvests.

    A data set whose number of samples the recipe leaves out is gone on with where it has fewer.

    Args:
        begin: fingerprint of the samples to begin with, where training took such once.
        executor: makes further samples, see `generate_data_set`.

    Raises:
        FileError: there is no data set.
        InputError: it is not finished.
        MismatchError: it is of another recipe.
    """
    counts = counts_of(recipe)
    there = stored_count(recipe.data_path()).rows
    added: list[dict[str, Any]] | None = None

    def first(count: int) -> StressSamples:
        nonlocal added
        samples = _first(recipe, count, stage, executor)
        if added is None:
            added = _added_to(samples, harvests, recipe)
        return _joined(samples, added)

    found, samples = 0, first(counts[0])
    for k, count in enumerate(counts):
        if begin and count <= there:
            candidate = first(count) if k else samples
            if candidate.fingerprint == begin:
                found, samples = k, candidate
                break
    yield samples, counts[found] < counts[-1]
    for count in counts[found + 1 :]:
        yield first(count), count < counts[-1]


def _first(recipe: Recipe, count: int, stage: Stage, executor: Any) -> StressSamples:
    """So many samples of the recipe's data set, made where it may have more than it has."""
    path = recipe.data_path()
    there = stored_count(path)
    may_grow = there.is_open and recipe.samples.count is None
    if may_grow and not (there.is_finished and there.rows >= count):
        wanted = max(count, wanted_count(recipe))
        with stage("generate", wanted, "samples") as report:
            generate_data_set(recipe, count=wanted, executor=executor, report=report)
    samples = read_data_set(path)
    check_data(recipe, samples, path)
    return samples if len(samples.F) <= count else samples.at(np.arange(count))


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
    Where the samples have tangents, those of harvested states are solved for, by RVEs from rest;
    states whose stress they do not find again are left out.

    Args:
        law: whose tangents; default: the recipe's RVE.

    Raises:
        MismatchError: a harvest is of other cell parameters or initialisation.
    """
    return _joined(samples, _added_to(samples, paths, recipe, law))


def _added_to(
    samples: StressSamples, paths: Sequence[Path], recipe: Recipe, law: StressLaw | None = None
) -> list[dict[str, Any]]:
    """Arrays of each harvest, with tangents where the samples have them."""
    harvests = [read_harvest(path) for path in paths]
    for path, harvest in zip(paths, harvests, strict=True):
        check_harvest(path, harvest, samples.cell, samples.initialisation)
    if samples.P_by_F is None or not harvests:
        return [_arrays_of(harvest) for harvest in harvests]
    law = law or laws.true_law(recipe)
    parts = [_with_tangents(law, harvest, _spread(samples)) for harvest in harvests]
    taken = sum(len(part["status"]) for part in parts)
    left_out = sum(len(harvest.status) for harvest in harvests) - taken
    if left_out:
        log.warning("%d harvested states left out: RVEs from rest answer otherwise there", left_out)
    return parts


def _joined(samples: StressSamples, parts: Sequence[Mapping[str, Any]]) -> StressSamples:
    """The samples and, after them, these arrays."""
    if not parts:
        return samples
    known = _arrays_of(samples)
    if samples.P_by_F is not None:
        known |= {"P_by_F": samples.P_by_F, "P_by_F_dot": samples.P_by_F_dot}
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
