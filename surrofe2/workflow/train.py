"""From a data set to a surrogate with a calibrated bound of its error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from surrofe2.base.compilation import Meter
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.sampling import SamplingRange
from surrofe2.law.samples import StressSamples
from surrofe2.recipe.recipe import Recipe
from surrofe2.run.loop import Report, Stage, no_stage
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.samples import stored_count
from surrofe2.store.store import START_OVER, check_same, file_lock, locked_file, remove
from surrofe2.store.surrogates import read_surrogate, read_training, write_surrogate, write_training
from surrofe2.surrogate.calibration import Truth
from surrofe2.surrogate.settings import WISH
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.workflow import laws
from surrofe2.workflow.calibrate import (
    bound_summary,
    calibrate_surrogate,
    shaped_bound,
    shaping_truths,
)
from surrofe2.workflow.generate import (
    Generated,
    counts_of,
    generate_data_set,
    training_samples,
    wanted_count,
)

if TYPE_CHECKING:
    from surrofe2.surrogate.training import TrainingState

STRESSES = ("xx", "xy", "yx", "yy")
_BEFORE = "bound_before"
_HELPS = 0.8
"""How far twice the samples must bring the bound down, for twice as many again to be taken."""
LARGE_ERROR = 0.01
"""Held-out RMS of a component over its spread, from which on training warns."""


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained surrogate and its file; `kept`: it was already there; `bound`: lines on it;
    `samples`: that it was trained on, failed ones included."""

    path: Path
    surrogate: SurrogateLaw
    kept: bool
    bound: str
    samples: StressSamples


def train_surrogate(
    recipe: Recipe,
    *,
    fresh: bool = False,
    add: Sequence[Path] = (),
    range: SamplingRange | None = None,
    stage: Stage = no_stage,
) -> Trained:
    """Train on the recipe's data set, calibrate the bound and write the recipe's surrogate.

    As long as the bound is above the one wanted and more samples have helped, training is repeated
    on twice as many. The surrogate is written before its calibration too, with no bound yet.

    Args:
        add: harvests to train on too.
        range: of the surrogate, where it is not the recipe's.

    Raises:
        MismatchError: data set, surrogate or interrupted training are of other settings or data.
    """
    if find_spec("torch") is None:
        raise InputError("training needs PyTorch, which is not installed: pip install torch")
    path, unfinished = recipe.training_path(), unfinished_training(recipe)
    counts = counts_of(recipe)

    def take(count: int) -> StressSamples:
        samples = training_samples(recipe, count, add, stage=stage)
        return samples if range is None else replace(samples, range=range)

    surrogate, begun, fingerprint = None, _Begun(), ""
    if unfinished.exists() and not fresh:
        begun = _read_unfinished(unfinished)
        fingerprint = begun.state.identity.get("data_fingerprint", "") if begun.state else ""
    elif path.exists() and not fresh:
        surrogate = read_surrogate(path)
        fingerprint = surrogate.data_fingerprint
    number, samples = 0, take(counts[0])
    if len(counts) > 1 and fingerprint:  # it may be of more
        there = stored_count(recipe.data_path()).rows
        known = (k for k, count in enumerate(counts) if count <= there)
        number = next((k for k in known if take(counts[k]).fingerprint == fingerprint), 0)
        samples = take(counts[number])

    def trained(surrogate: SurrogateLaw, *, kept: bool) -> Trained:
        bound = bound_summary(surrogate, samples, recipe.cache.tolerance)
        return Trained(path, surrogate, kept, bound, samples)

    if surrogate is not None:
        _check_surrogate(recipe, surrogate, samples)
        if surrogate.is_calibrated and not file_lock(path).exists():
            return trained(surrogate, kept=True)
    with locked_file(path):
        if surrogate is not None and surrogate.is_calibrated:  # killed after its last file
            return trained(surrogate, kept=True)
        shaping: list[Truth] = []
        if surrogate is None:
            if fresh:
                remove(unfinished)
            while True:
                with stage("train", recipe.training.iterations, "iterations") as report:
                    if recipe.training.bound and not shaping:
                        shaping = _shaping(recipe, samples)
                    surrogate, bound, seconds = _train(recipe, samples, shaping, begun, report)
                number += 1
                if (
                    bound <= WISH * recipe.training.bound
                    or number == len(counts)
                    or bound >= _HELPS * begun.before
                ):
                    break
                begun, samples = _Begun(seconds=seconds, before=bound), take(counts[number])
            made = {**_seconds_of_data(recipe, add), "training": seconds}
            surrogate = replace(surrogate, seconds=made)
            write_surrogate(surrogate, path)
            remove(unfinished)
        meter = Meter()
        with stage("calibrate", 1.0, "of the paths") as report:
            surrogate = calibrate_surrogate(recipe, surrogate, samples, report, shaping)
        surrogate = replace(surrogate, seconds={**surrogate.seconds, "calibration": meter.seconds})
        write_surrogate(surrogate, path)
    return trained(surrogate, kept=False)


def learn(
    recipe: Recipe, *, fresh: bool = False, stage: Stage = no_stage
) -> tuple[Generated, Trained]:
    """Make the data set and the surrogate of a recipe's cell, whatever is missing of both."""
    what, count = f"generate {recipe.cell_name}".rstrip(), wanted_count(recipe, fresh=fresh)
    with stage(what, count, "samples") as report:
        data = generate_data_set(recipe, fresh=fresh, report=report)
    return data, train_surrogate(recipe, fresh=fresh, stage=stage)


def is_trained(recipe: Recipe) -> bool:
    """Whether the recipe's surrogate is there, whole and with its bound."""
    path = recipe.training_path()
    is_whole = path.exists() and not unfinished_training(recipe).exists()
    return is_whole and read_surrogate(path).is_calibrated


def unfinished_training(recipe: Recipe) -> Path:
    """What a training leaves to resume from; where it is there, no surrogate is finished."""
    return recipe.training_path().with_suffix(".unfinished.h5")


@dataclass(frozen=True, slots=True)
class _Begun:
    """What an interrupted training did, and the bound `before` it, that fewer samples gave."""

    state: TrainingState | None = None
    seconds: float = 0.0
    before: float = math.inf


def _read_unfinished(path: Path) -> _Begun:
    from surrofe2.surrogate.training import TrainingState  # torch, which runs do without

    identity, iterations, arrays = read_training(path)
    before = float(arrays.pop(_BEFORE, math.inf))
    return _Begun(TrainingState(identity, iterations, arrays), read_seconds(path) or 0.0, before)


def _seconds_of_data(recipe: Recipe, harvests: Sequence[Path]) -> dict[str, float]:
    """The seconds of the data set and the harvests; none where nobody knows those of a file."""
    seconds = [read_seconds(path) for path in (recipe.data_path(), *harvests)]
    known = [each for each in seconds if each is not None]
    return {"data": sum(known)} if len(known) == len(seconds) else {}


def _train(
    recipe: Recipe,
    samples: StressSamples,
    shaping: Sequence[Truth],
    begun: _Begun,
    report: Report,
) -> tuple[SurrogateLaw, float, float]:
    """A surrogate, its bound by the spread of stress (0: none wanted), the seconds so far."""
    path, wanted = unfinished_training(recipe), WISH * recipe.training.bound
    meter = Meter(begun.seconds)

    from surrofe2.surrogate.training import train

    def keep(state: TrainingState) -> None:
        arrays = {**state.arrays, _BEFORE: np.array(begun.before)}
        write_training(path, state.identity, state.iterations, arrays, meter.seconds)

    bounds: dict[str, float] = {}  # by the surrogate's weights

    def bound_of(surrogate: SurrogateLaw) -> float:
        weights = surrogate.network.fingerprint(surrogate.range)
        if wanted and weights not in bounds:
            bounds[weights] = shaped_bound(surrogate, samples, shaping)
        return bounds.get(weights, 0.0)

    try:
        surrogate = train(
            samples,
            recipe.training,
            progress=lambda i, n, figures: report(
                i, f"held-out error {100 * figures['held_out_rms']:.2g} %"
            ),
            checkpoint=keep,
            resume=begun.state,
            should_stop=(lambda surrogate: bound_of(surrogate) <= wanted) if wanted else None,
        )
    except MismatchError as error:
        raise MismatchError(f"{path}: {error}; {START_OVER}") from None
    return surrogate, bound_of(surrogate), meter.seconds


def _shaping(recipe: Recipe, samples: StressSamples) -> list[Truth]:
    if not recipe.calibration.walks:
        raise InputError(
            f"training.bound: {recipe.training.bound:g}; it must be 0 where calibration.walks is"
        )
    return shaping_truths(samples, laws.true_law(recipe), recipe.calibration)


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


def large_errors(recipe: Recipe, trained: Trained) -> str | None:
    """What to do where a component's error is so large that much will be left to RVEs."""
    rms = trained.surrogate.errors["rms"]
    name = max(STRESSES, key=lambda each: rms[each])
    if rms[name] <= LARGE_ERROR:
        return None
    sampled, samples = recipe.section("range"), recipe.section("samples")
    more = "state" if recipe.samples.count is None else "raise"
    return (
        f"{trained.path}: the error of {name} is {100 * rms[name]:.2g} % RMS, from "
        f"{len(trained.samples.valid.F)} usable samples: narrow {sampled} to what "
        f"`surrofe2 check` proposes, {more} {samples}.count, or let "
        "`surrofe2 refine` sample what the run meets"
    )


def training_summary(trained: Trained) -> str:
    """The largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms, worst = (max(errors[figure][name] for name in STRESSES) for figure in ("rms", "worst"))
    kept = " (already trained)" if trained.kept else ""
    found = f"{100 * rms:.2g} % RMS, {100 * worst:.2g} % worst"
    return f"held-out errors up to {found}, from {len(trained.samples.F)} samples{kept}"
