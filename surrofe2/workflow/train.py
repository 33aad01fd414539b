"""From a data set to a surrogate with a calibrated bound of its error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.samples import read_reference
from surrofe2.store.store import START_OVER, check_same, file_lock, locked_file, remove
from surrofe2.store.surrogates import (
    read_surrogate,
    read_training,
    write_surrogate,
    write_training,
)
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
from surrofe2.workflow.generate import counts_of
from surrofe2.workflow.progress import Report, Stage, no_stage
from surrofe2.workflow.samples import SampleSource

if TYPE_CHECKING:
    from surrofe2.surrogate.training import TrainingState

STRESSES = ("xx", "xy", "yx", "yy")
_BOUNDS = "bounds"
_PATIENCE, _FALLS, _HELPS = 2, 0.9, 0.8
"""Rounds of a training that must bring the bound so far down; how far twice the samples must."""
LARGE_ERROR = 0.01
"""Held-out RMS of a component over its spread, from which on training warns."""


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained surrogate and its file.

    Attributes:
        kept: whether it was already there.
        bound: lines on it.
        samples: that it was trained on, failed ones included.
    """

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

    The surrogate is written before its calibration too, with no bound yet.

    Args:
        fresh: start over, whatever is there.
        add: harvests to train on too, besides those that the recipe names.
        range: of the surrogate, where it is not the recipe's.
        stage: begins the display of a stage.

    Raises:
        MismatchError: data set, surrogate or interrupted training are of other settings or data.
    """
    if find_spec("torch") is None:
        raise InputError("training needs PyTorch, which is not installed: pip install torch")
    path, unfinished = recipe.training_path(), unfinished_training(recipe)
    source = SampleSource(recipe, [*recipe.added_paths(), *add], range, stage)
    surrogate, begun, fingerprint = None, _Begun(), ""
    if unfinished.exists() and not fresh:
        begun = _read_unfinished(unfinished)
        fingerprint = begun.state.identity.get("data_fingerprint", "") if begun.state else ""
    elif path.exists() and not fresh:
        surrogate = read_surrogate(path)
        fingerprint = surrogate.data_fingerprint
    first = source.number_with(fingerprint)
    samples = source.take(counts_of(recipe)[first])

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
            surrogate, samples, shaping = _train(source, samples, first, begun, stage)
            files = recipe.data_path(), *source.harvests
            data = [read_seconds(each) for each in files]
            known = [each for each in data if each is not None]
            if len(known) == len(data):  # else nobody can say when the surrogate pays
                surrogate = replace(surrogate, seconds={"data": sum(known), **surrogate.seconds})
            write_surrogate(surrogate, path)
            remove(unfinished)
        meter = Meter()
        with stage("calibrate", 1.0, "of the paths") as report:
            shaping = shaping or shaping_truths(samples, laws.true_law(recipe), recipe.calibration)
            surrogate = calibrate_surrogate(recipe, surrogate, samples, report, shaping)
        surrogate = replace(surrogate, seconds={**surrogate.seconds, "calibration": meter.seconds})
        write_surrogate(surrogate, path)
    return trained(surrogate, kept=False)


def is_trained(recipe: Recipe) -> bool:
    """Whether the recipe's surrogate is there, whole and with its bound."""
    path = recipe.training_path()
    is_whole = path.exists() and not unfinished_training(recipe).exists()
    return is_whole and read_surrogate(path).is_calibrated


def unfinished_training(recipe: Recipe) -> Path:
    """What a training leaves to go on from; where it is there, no surrogate is finished."""
    return recipe.training_path().with_suffix(".unfinished.h5")


@dataclass(frozen=True, slots=True)
class _Begun:
    """What an interrupted training did.

    Attributes:
        before: the best bound that fewer samples gave, infinite where there were none.
        bounds: that its rounds gave so far.
    """

    state: TrainingState | None = None
    seconds: float = 0.0
    before: float = math.inf
    bounds: tuple[float, ...] = ()


def _read_unfinished(path: Path) -> _Begun:
    identity, iterations, arrays = read_training(path)
    before, *bounds = arrays.pop(_BOUNDS, np.array([math.inf])).tolist()
    from surrofe2.surrogate.training import TrainingState  # torch, which runs do without

    state = TrainingState(identity, iterations, arrays)
    return _Begun(state, read_seconds(path) or 0.0, before, tuple(bounds))


def _train(
    source: SampleSource, samples: StressSamples, number: int, begun: _Begun, stage: Stage
) -> tuple[SurrogateLaw, StressSamples, list[Truth]]:
    """A surrogate without a bound, its samples, and the stresses along the paths that shape the
    bound where training looked at them.

    Trains, and takes twice the samples as long as the bound is above the one wanted, there may be
    more samples, and more have helped so far.

    Args:
        number: of the samples among `counts_of`.
    """
    recipe, counts, shaping = source.recipe, counts_of(source.recipe), list[Truth]()
    while True:
        may_grow = number + 1 < len(counts)
        with stage("train", recipe.training.iterations, "iterations") as report:
            if recipe.training.bound and not shaping:
                shaping = _shaping(recipe, samples)
            surrogate, bound, seconds = _train_once(
                recipe, samples, shaping, may_grow, begun, report
            )
        is_met = bound <= WISH * recipe.training.bound
        if is_met or not may_grow or not has_improved(bound, begun.before):
            reference = read_reference(recipe.data_path(), recipe.cell)
            return (
                replace(surrogate, reference=reference, seconds={"training": seconds}),
                samples,
                shaping,
            )
        begun, number = _Begun(seconds=seconds, before=bound), number + 1
        samples = source.take(counts[number])


def _train_once(
    recipe: Recipe,
    samples: StressSamples,
    shaping: Sequence[Truth],
    may_grow: bool,
    begun: _Begun,
    report: Report,
) -> tuple[SurrogateLaw, float, float]:
    """A surrogate of these samples; the best bound on the way, 0 where none is wanted; the seconds.

    It ends when the bound is met, and, where there may be more samples, when these have brought it
    down from what fewer gave and do so no further.
    """
    path, wanted = unfinished_training(recipe), WISH * recipe.training.bound
    meter, bounds = Meter(begun.seconds), list(begun.bounds)

    from surrofe2.surrogate.training import train

    def keep(state: TrainingState) -> None:
        arrays = {**state.arrays, _BOUNDS: np.array([begun.before, *bounds])}
        write_training(path, state.identity, state.iterations, arrays, meter.seconds)

    def should_stop(surrogate: SurrogateLaw) -> bool:
        bounds.append(shaped_bound(surrogate, samples, shaping))
        wants_samples = has_stalled(bounds) and has_improved(min(bounds), begun.before)
        return bounds[-1] <= wanted or (may_grow and wants_samples)

    try:
        surrogate = train(
            samples,
            recipe.training,
            progress=lambda i, n, figures: report(i, training_note(figures)),
            checkpoint=keep,
            resume=begun.state,
            should_stop=should_stop if wanted else None,
        )
    except MismatchError as error:
        raise MismatchError(f"{path}: {error}; {START_OVER}") from None
    if wanted and may_grow:
        bounds.append(shaped_bound(surrogate, samples, shaping))
    return surrogate, min(bounds, default=0.0), meter.seconds


def _shaping(recipe: Recipe, samples: StressSamples) -> list[Truth]:
    if not recipe.calibration.walks:
        raise InputError(
            f"training.bound: {recipe.training.bound:g}; it must be 0 where calibration.walks is"
        )
    return shaping_truths(samples, laws.true_law(recipe), recipe.calibration)


def has_stalled(bounds: Sequence[float]) -> bool:
    """Whether the last rounds of a training have not brought the bound down."""
    return min(bounds[-_PATIENCE:]) > _FALLS * min(bounds[:-_PATIENCE], default=math.inf)


def has_improved(bound: float, before: float) -> bool:
    """Whether more samples have brought the bound down from what fewer gave."""
    return bound < _HELPS * before


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
