"""From a data set to a surrogate with a calibrated bound of its error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from surrofe2.errors import MismatchError
from surrofe2.io.data_sets import read_data_set
from surrofe2.io.files import START_OVER, check_same, reported
from surrofe2.io.surrogates import (
    read_surrogate,
    read_training,
    write_surrogate,
    write_training,
)
from surrofe2.recipe import Recipe
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training import TrainingState, train
from surrofe2.workflow.calibrate import bound_summary, calibrate_surrogate
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.training_data import with_harvests

STRESSES = ("xx", "xy", "yx", "yy")


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
    _check_data(recipe, samples, source)
    samples = with_harvests(samples, [*recipe.added_paths(), *add], recipe)
    surrogate = None
    if path.exists() and not fresh:
        surrogate = read_surrogate(path)
        _check_surrogate(recipe, surrogate, samples)
        if surrogate.is_calibrated:
            return Trained(path, surrogate, True, bound_summary(surrogate, samples))
    if surrogate is None:
        with reported(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        surrogate = _train(recipe, samples, fresh, stage)
    with stage("calibrate", 1.0, "of the paths") as report:
        surrogate = calibrate_surrogate(recipe, surrogate, samples, report)
    write_surrogate(surrogate, path)
    return Trained(path, surrogate, False, bound_summary(surrogate, samples))


def _train(recipe: Recipe, samples: StressSamples, fresh: bool, stage: Stage) -> SurrogateLaw:
    """A surrogate without a bound, in the recipe's file."""
    path = recipe.training_path()
    unfinished = path.with_suffix(".unfinished.safetensors")
    if fresh:
        unfinished.unlink(missing_ok=True)
    state = TrainingState(*read_training(unfinished)) if unfinished.exists() else None
    with stage("train", recipe.training.iterations, "iterations") as report:
        try:
            surrogate = train(
                samples,
                recipe.training,
                progress=lambda i, n, figures: report(i, training_note(figures)),
                checkpoint=lambda state: write_training(
                    unfinished, state.identity, state.iterations, state.arrays
                ),
                resume=state,
            )
        except MismatchError as error:
            raise MismatchError(f"{unfinished}: {error}; {START_OVER}") from None
    write_surrogate(surrogate, path)
    unfinished.unlink(missing_ok=True)
    return surrogate


def _check_data(recipe: Recipe, samples: StressSamples, source: Path) -> None:
    for name, here, there in (
        ("cell", recipe.cell, samples.cell),
        ("rve.initialisation", recipe.rve.initialisation, samples.initialisation),
        ("range", recipe.range, samples.range),
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
    here = {"training": recipe.training.to_dict()}
    there = {"training": surrogate.settings.to_dict()}
    if surrogate.is_calibrated and surrogate.calibration is not None:
        here["calibration"] = recipe.calibration.to_dict()
        there["calibration"] = dict(surrogate.calibration.settings)
    check_same(path, here, there)


def training_note(figures: Mapping[str, float]) -> str:
    """How far a training is, for its display."""
    return f"held-out error {100 * figures['held_out_rms']:.2g} %"


def training_summary(trained: Trained) -> str:
    """The largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms, worst = (max(errors[figure][name] for name in STRESSES) for figure in ("rms", "worst"))
    kept = " (already trained)" if trained.kept else ""
    return f"held-out errors up to {100 * rms:.2g} % RMS, {100 * worst:.2g} % worst{kept}"
