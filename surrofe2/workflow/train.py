"""From a data set to a surrogate with a calibrated bound of its error."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.costs import NOTHING, Meter
from surrofe2.errors import MismatchError
from surrofe2.io.data_sets import read_data_set
from surrofe2.io.files import START_OVER, check_same, remove
from surrofe2.io.harvest import Harvest, check_harvest, read_harvest
from surrofe2.io.kept import read_attached
from surrofe2.io.lock import file_lock, locked_file
from surrofe2.io.provenance import read_cost
from surrofe2.io.surrogates import (
    read_surrogate,
    read_training,
    training_cost,
    write_surrogate,
    write_training,
)
from surrofe2.recipe import Recipe
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import TANGENTS, StressSamples
from surrofe2.surrogate.calibration import Truth
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training import TrainingState, train
from surrofe2.tensors import stress_error, stress_spread
from surrofe2.workflow import laws
from surrofe2.workflow.calibrate import (
    bound_summary,
    calibrate_surrogate,
    enough_for,
    shaping_truths,
)
from surrofe2.workflow.run_lifecycle import Stage, silent

STRESSES = ("xx", "xy", "yx", "yy")
LARGE_ERROR = 0.01
"""Held-out RMS of a component, as a share of its spread, from which on training warns."""


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained surrogate and its file; `kept`: it was already there. `bound`: a line on it."""

    path: Path
    surrogate: SurrogateLaw
    kept: bool
    bound: str


def train_surrogate(
    recipe: Recipe, *, fresh: bool = False, add: Sequence[Path] = (), stage: Stage = silent
) -> Trained:
    """Train on the recipe's data set, calibrate the bound and write the recipe's surrogate.

    The surrogate is written before its calibration too, with no bound yet.

    Args:
        fresh: start over, whatever is there.
        add: harvests to train on too, besides those that the recipe names.
        stage: begins the display of a stage.

    Raises:
        MismatchError: data set, surrogate or interrupted training are of other settings or data.
    """
    path, source = recipe.training_path(), recipe.data_path()
    samples = read_data_set(source)
    check_data(recipe, samples, source)
    samples = with_harvests(samples, [*recipe.added_paths(), *add], recipe)
    surrogate = None
    if path.exists() and not fresh and not unfinished_training(recipe).exists():
        surrogate = read_surrogate(path)
        _check_surrogate(recipe, surrogate, samples)
        if surrogate.is_calibrated:
            if file_lock(path).exists():  # a process was killed after its last file
                with locked_file(path):
                    pass
            return Trained(path, surrogate, True, bound_summary(surrogate, samples))
    with locked_file(path):
        truths: list[Truth] = []
        if surrogate is None:
            surrogate, truths = _train(recipe, samples, fresh, stage)
            data = [read_cost(each) for each in (source, *recipe.added_paths(), *add)]
            known = sum((each for each in data if each), start=NOTHING)
            spent = surrogate.cost if None in data else {"data": known, **surrogate.cost}
            surrogate = replace(surrogate, cost=spent)
            write_surrogate(surrogate, path)
            remove(unfinished_training(recipe))
        meter = Meter()
        with stage("calibrate", 1.0, "of the paths") as report:
            surrogate = calibrate_surrogate(recipe, surrogate, samples, report, truths)
        spent = {**surrogate.cost, "calibration": meter.cost}
        surrogate = replace(surrogate, cost=spent)
        write_surrogate(surrogate, path)
    return Trained(path, surrogate, False, bound_summary(surrogate, samples))


def is_trained(recipe: Recipe) -> bool:
    """Whether the recipe's surrogate is there, whole and with its bound."""
    path = recipe.training_path()
    is_whole = path.exists() and not file_lock(path).exists()
    is_whole = is_whole and not unfinished_training(recipe).exists()
    return is_whole and read_surrogate(path).is_calibrated


def unfinished_training(recipe: Recipe) -> Path:
    """What a training leaves to go on from; where it is there, no surrogate is finished."""
    return recipe.training_path().with_suffix(".unfinished.safetensors")


def _train(
    recipe: Recipe, samples: StressSamples, fresh: bool, stage: Stage
) -> tuple[SurrogateLaw, list[Truth]]:
    """A surrogate without a bound, and what is known already of the paths that will shape it."""
    unfinished = unfinished_training(recipe)
    if fresh:
        remove(unfinished)
    state, meter = None, Meter()
    if unfinished.exists():
        state, meter = TrainingState(*read_training(unfinished)), Meter(training_cost(unfinished))
    with stage("train", recipe.training.iterations, "iterations") as report:
        truths = shaping_truths(recipe, samples)
        try:
            surrogate = train(
                samples,
                recipe.training,
                progress=lambda i, n, figures: report(i, training_note(figures)),
                checkpoint=lambda state: write_training(
                    unfinished, state.identity, state.iterations, state.arrays, meter.cost
                ),
                resume=state,
                enough=enough_for(recipe, samples, truths),
            )
        except MismatchError as error:
            raise MismatchError(f"{unfinished}: {error}; {START_OVER}") from None
    reference = read_attached(recipe.data_path(), recipe.cell)
    return replace(surrogate, reference=reference, cost={"training": meter.cost}), truths


def check_data(recipe: Recipe, samples: StressSamples, source: Path) -> None:
    """Refuse a data set of another recipe.

    Raises:
        MismatchError: naming what differs.
    """
    for name, here, there in (
        ("cell", recipe.cell, samples.cell),
        ("rve.initialisation", recipe.rve.initialisation, samples.initialisation),
        ("range", recipe.sampling_range(), samples.range),
        ("samples.seed", recipe.samples.seed, samples.seed),
        ("samples.count", recipe.samples.count, len(samples.F)),
    ):
        if here != there:
            raise MismatchError(
                f"{source}: {name}: made by another recipe than {recipe.path.name}; generate it "
                "anew with `surrofe2 generate RECIPE --fresh`"
            )


def _check_surrogate(recipe: Recipe, surrogate: SurrogateLaw, samples: StressSamples) -> None:
    """Refuse to keep a surrogate of other data or settings."""
    path = recipe.training_path()
    if surrogate.data_fingerprint != samples.fingerprint:
        raise MismatchError(f"{path}: it was trained on other samples; {START_OVER}")
    here = {"training": asdict(recipe.training)}
    there = {"training": asdict(surrogate.settings)}
    if surrogate.is_calibrated and surrogate.calibration is not None:
        here["calibration"] = asdict(recipe.calibration)
        there["calibration"] = dict(surrogate.calibration.settings)
    check_same(path, here, there)


def training_note(figures: Mapping[str, float]) -> str:
    """How far a training is, for its display."""
    return f"held-out error {100 * figures['held_out_rms']:.2g} %"


def large_errors(recipe: Recipe, trained: Trained) -> str | None:
    """What to do where a component's error is so large that much will be left to RVEs."""
    rms = trained.surrogate.errors["rms"]
    name = max(STRESSES, key=lambda each: rms[each])
    if rms[name] <= LARGE_ERROR:
        return None
    samples = read_data_set(recipe.data_path())
    of = "" if recipe.cell_name is None else f"{recipe.cell_section}."
    return (
        f"{trained.path}: the error of {name} is {100 * rms[name]:.2g} % RMS, from "
        f"{len(samples.valid.F)} usable samples: narrow {of}range to what `surrofe2 range` "
        f"proposes, raise {of}samples.count, or let `surrofe2 refine` sample what the run meets"
    )


def training_summary(trained: Trained) -> str:
    """The largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms, worst = (max(errors[figure][name] for name in STRESSES) for figure in ("rms", "worst"))
    kept = " (already trained)" if trained.kept else ""
    return f"held-out errors up to {100 * rms:.2g} % RMS, {100 * worst:.2g} % worst{kept}"


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
    parts: list[dict[str, Any]] = [_arrays_of(harvest) for harvest in harvests]
    known: dict[str, Any] = _arrays_of(samples)
    if samples.P_by_F is not None:
        names += TANGENTS
        known |= {"P_by_F": samples.P_by_F, "P_by_F_dot": samples.P_by_F_dot}
        law = law or laws.true_law(recipe)
        parts = [_with_tangents(law, harvest, _spread(samples)) for harvest in harvests]
        taken = sum(len(part["status"]) for part in parts)
        left_out = sum(len(harvest.status) for harvest in harvests) - taken
        if left_out:
            log.warning(
                "%d harvested states left out: RVEs from rest answer otherwise there", left_out
            )
    arrays: dict[str, Any] = {
        name: np.concatenate([known[name], *(part[name] for part in parts)]) for name in names
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
