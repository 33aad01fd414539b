"""From a data set to a surrogate with a calibrated bound of its error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.costs import NOTHING, Cost, Meter
from surrofe2.errors import MismatchError
from surrofe2.io.files import START_OVER, check_same, remove
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
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.calibration import Truth
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training import TrainingState, train
from surrofe2.workflow.calibrate import (
    WantedBound,
    bound_summary,
    calibrate_surrogate,
    shaping_truths,
)
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.samples import samples_in_turn

STRESSES = ("xx", "xy", "yx", "yy")
_SHARES = "bound.shares"
_PATIENCE, _GAIN, _HELPS = 2, 0.9, 0.8
"""Rounds of a training that are to bring the bound so far down; how far twice the samples are."""
LARGE_ERROR = 0.01
"""Held-out RMS of a component, as a share of its spread, from which on training warns."""


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
    executor: Any = None,
    stage: Stage = silent,
) -> Trained:
    """Train on the recipe's data set, calibrate the bound and write the recipe's surrogate.

    The surrogate is written before its calibration too, with no bound yet.

    Args:
        fresh: start over, whatever is there.
        add: harvests to train on too, besides those that the recipe names.
        executor: makes further samples, see `generate_data_set`; None: this process.
        stage: begins the display of a stage.

    Raises:
        MismatchError: data set, surrogate or interrupted training are of other settings or data.
    """
    path, source = recipe.training_path(), recipe.data_path()
    unfinished = unfinished_training(recipe)
    harvests = [*recipe.added_paths(), *add]
    surrogate, before, begin = None, _Before(), ""
    if unfinished.exists() and not fresh:
        before, begin = _read_unfinished(unfinished)
    elif path.exists() and not fresh:
        surrogate = read_surrogate(path)
        begin = surrogate.data_fingerprint
    rounds = samples_in_turn(recipe, harvests, stage, begin, executor)
    first = next(rounds)
    samples, _ = first
    if surrogate is not None:
        _check_surrogate(recipe, surrogate, samples)
        if surrogate.is_calibrated:
            if file_lock(path).exists():  # a process was killed after its last file
                with locked_file(path):
                    pass
            bound = bound_summary(surrogate, samples)
            return Trained(path, surrogate, True, bound, samples)
    with locked_file(path):
        truths: Sequence[Truth] = ()
        if surrogate is None:
            if fresh:
                remove(unfinished)
            surrogate, samples, truths = _train(recipe, chain([first], rounds), before, stage)
            data = [read_cost(each) for each in (source, *harvests)]
            known = sum((each for each in data if each), start=NOTHING)
            spent = surrogate.cost if None in data else {"data": known, **surrogate.cost}
            surrogate = replace(surrogate, cost=spent)
            write_surrogate(surrogate, path)
            remove(unfinished)
        meter = Meter()
        with stage("calibrate", 1.0, "of the paths") as report:
            surrogate = calibrate_surrogate(recipe, surrogate, samples, report, truths)
        spent = {**surrogate.cost, "calibration": meter.cost}
        surrogate = replace(surrogate, cost=spent)
        write_surrogate(surrogate, path)
    return Trained(path, surrogate, False, bound_summary(surrogate, samples), samples)


def is_trained(recipe: Recipe) -> bool:
    """Whether the recipe's surrogate is there, whole and with its bound."""
    path = recipe.training_path()
    is_whole = path.exists() and not file_lock(path).exists()
    is_whole = is_whole and not unfinished_training(recipe).exists()
    return is_whole and read_surrogate(path).is_calibrated


def unfinished_training(recipe: Recipe) -> Path:
    """What a training leaves to go on from; where it is there, no surrogate is finished."""
    return recipe.training_path().with_suffix(".unfinished.safetensors")


@dataclass(frozen=True, slots=True)
class _Before:
    """What was done before: on the same samples by a training that was interrupted, on fewer of
    them by one that did not meet its bound.

    Attributes:
        share: of the bound wanted, that the fewer came to.
        shares: what the interrupted one came to.
    """

    state: TrainingState | None = None
    cost: Cost = NOTHING
    share: float = math.inf
    shares: tuple[float, ...] = ()


def _read_unfinished(path: Path) -> tuple[_Before, str]:
    """What an interrupted training did, and the fingerprint of its samples."""
    identity, iterations, arrays = read_training(path)
    share, *shares = arrays.pop(_SHARES, np.array([math.inf])).tolist()
    state = TrainingState(identity, iterations, arrays)
    before = _Before(state, training_cost(path), share, tuple(shares))
    return before, identity.get("data_fingerprint", "")


def _train(
    recipe: Recipe, rounds: Iterable[tuple[StressSamples, bool]], before: _Before, stage: Stage
) -> tuple[SurrogateLaw, StressSamples, Sequence[Truth]]:
    """A surrogate without a bound, its samples, and what is known already of the paths that will
    shape the bound.

    More samples are taken until the bound wanted is met, or they do not help.

    Args:
        rounds: see `samples_in_turn`.
    """
    truths: Sequence[Truth] = ()
    for samples, may_grow in rounds:
        surrogate, truths, share, cost = _trained(recipe, samples, truths, may_grow, before, stage)
        if share <= 1.0 or not helped(share, before.share):
            break
        before = _Before(cost=cost, share=share)
    reference = read_attached(recipe.data_path(), recipe.cell)
    found = replace(surrogate, reference=reference, cost={"training": cost})
    return found, samples, truths


def _trained(
    recipe: Recipe,
    samples: StressSamples,
    truths: Sequence[Truth],
    may_grow: bool,
    before: _Before,
    stage: Stage,
) -> tuple[SurrogateLaw, Sequence[Truth], float, Cost]:
    """A surrogate without a bound; the true answers by which the one wanted is asked for, and the
    share of it that was come to; what it cost with all before.

    Args:
        truths: known before; empty: they are asked for.
        may_grow: whether there can be more samples.
    """
    path, meter = unfinished_training(recipe), Meter(before.cost)
    shares = list(before.shares)

    def keep(state: TrainingState) -> None:
        arrays = {**state.arrays, _SHARES: np.array([before.share, *shares])}
        write_training(path, state.identity, state.iterations, arrays, meter.cost)

    with stage("train", recipe.training.iterations, "iterations") as report:
        truths = truths or shaping_truths(recipe, samples)
        wanted = WantedBound(recipe, samples, truths)

        def enough(surrogate: SurrogateLaw, is_hungry: bool) -> bool:
            shares.append(wanted.share_of(surrogate))
            wants_more = may_grow and is_hungry and is_stuck(shares)
            return shares[-1] <= 1.0 or (wants_more and helped(min(shares), before.share))

        try:
            surrogate = train(
                samples,
                recipe.training,
                progress=lambda i, n, figures: report(i, training_note(figures)),
                checkpoint=keep,
                resume=before.state,
                enough=enough if recipe.training.bound else None,
            )
        except MismatchError as error:
            raise MismatchError(f"{path}: {error}; {START_OVER}") from None
        share = min([*shares, wanted.share_of(surrogate)]) if may_grow else 0.0
    return surrogate, truths, share, meter.cost


def is_stuck(shares: Sequence[float]) -> bool:
    """Whether the last rounds of a training have not brought the bound down, by its shares of the
    one wanted.
    """
    return min(shares[-_PATIENCE:]) > _GAIN * min(shares[:-_PATIENCE], default=math.inf)


def helped(share: float, before: float) -> bool:
    """Whether more samples have brought the bound down, from what fewer came to."""
    return share < _HELPS * before


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
    of = "" if recipe.cell_name is None else f"{recipe.cell_section}."
    more = "state" if recipe.samples.count is None else "raise"
    return (
        f"{trained.path}: the error of {name} is {100 * rms[name]:.2g} % RMS, from "
        f"{len(trained.samples.valid.F)} usable samples: narrow {of}range to what `surrofe2 check` "
        f"proposes, {more} {of}samples.count, or let `surrofe2 refine` sample what the run meets"
    )


def training_summary(trained: Trained) -> str:
    """The largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms, worst = (max(errors[figure][name] for name in STRESSES) for figure in ("rms", "worst"))
    kept = " (already trained)" if trained.kept else ""
    found = f"{100 * rms:.2g} % RMS, {100 * worst:.2g} % worst"
    return f"held-out errors up to {found}, from {len(trained.samples.F)} samples{kept}"
