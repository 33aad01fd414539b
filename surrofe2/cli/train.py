"""`surrofe2 train`: from a data set to a surrogate."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from surrofe2.cli.adding import with_harvests
from surrofe2.cli.calibrate import calibrate_surrogate
from surrofe2.cli.calibrate import summary as calibration_summary
from surrofe2.cli.console import Report, duration, keeping, progress, say, show_table
from surrofe2.cli.options import RecipeFile, Threads
from surrofe2.errors import FileError, MismatchError

if TYPE_CHECKING:
    from surrofe2.recipe import Recipe
    from surrofe2.stress_samples import StressSamples
    from surrofe2.surrogate import SurrogateLaw

STRESSES = ("xx", "xy", "yx", "yy")


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained surrogate and its file; `kept`: it was already there. `bound`: a line on it."""

    path: Path
    surrogate: SurrogateLaw
    kept: bool
    bound: str


Stage = Callable[[str, float, str], AbstractContextManager[Report]]
"""What is done, how much of it and in which unit: gives a function (done, remark)."""


def _silent(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
    return nullcontext(lambda done, note: None)


def train_surrogate(
    recipe: Recipe,
    *,
    resume: bool = False,
    keep: bool = False,
    force: bool = False,
    add: Sequence[Path] = (),
    stage: Stage = _silent,
) -> Trained:
    """Train on the recipe's data set, calibrate the bound and write the recipe's surrogate.

    The surrogate is written before its calibration too, with no bound yet.

    Args:
        resume: carry an interrupted training or calibration on, where one is there.
        keep: take the surrogate that is there if it was trained and calibrated on this very data
            by these settings.
        force: replace the surrogate that is there.
        add: harvests to train on too, besides those that the recipe names.
        stage: begins the display of a stage, as `console.progress` does.

    Raises:
        FileError: the surrogate's file exists and neither `keep` nor `force` is set.
        MismatchError: the data set was made by another recipe, or the training to resume is of
            other data or settings.
    """
    from surrofe2.io.data_sets import read_data_set
    from surrofe2.io.files import refuse_existing, reported

    path, source = recipe.training_path(), recipe.data_path()
    if not (keep or force or resume):
        refuse_existing(path)
    samples = read_data_set(source)
    _check_data(recipe, samples, source)
    samples = with_harvests(samples, [*recipe.added_paths(), *add], recipe)
    surrogate = _matching(recipe, samples) if (keep or resume) and path.exists() else None
    if surrogate is not None and _is_calibrated(recipe, surrogate):
        return Trained(path, surrogate, True, calibration_summary(surrogate, samples))
    if surrogate is None:
        if not (keep or force):
            refuse_existing(path)
        with reported(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        surrogate = _train(recipe, samples, resume, stage)
    with stage("calibrate", 1.0, "of the paths") as report:
        surrogate = calibrate_surrogate(recipe, surrogate, samples, report)
    surrogate.save(path)
    return Trained(path, surrogate, False, calibration_summary(surrogate, samples))


def _matching(recipe: Recipe, samples: StressSamples) -> SurrogateLaw | None:
    """The recipe's surrogate where it was trained on these samples by these settings."""
    from surrofe2.surrogate import SurrogateLaw

    surrogate = SurrogateLaw.load(recipe.training_path())
    same_data = surrogate.data_fingerprint == samples.fingerprint
    return surrogate if same_data and surrogate.settings == recipe.training else None


def _is_calibrated(recipe: Recipe, surrogate: SurrogateLaw) -> bool:
    settings = surrogate.calibration.settings if surrogate.calibration else None
    return surrogate.is_calibrated and settings == recipe.calibration.to_dict()


def _train(recipe: Recipe, samples: StressSamples, resume: bool, stage: Stage) -> SurrogateLaw:
    """A surrogate without a bound, in the recipe's file."""
    from surrofe2.surrogate import train

    path = recipe.training_path()
    unfinished = path.with_suffix(".unfinished.pt")
    with stage("train", recipe.training.iterations, "iterations") as report:
        surrogate = train(
            samples,
            recipe.training,
            progress=lambda i, n, figures: report(i, _note(figures)),
            checkpoint=lambda state: _write_state(unfinished, state),
            resume=_read_state(unfinished) if resume and unfinished.exists() else None,
        )
    surrogate.save(path)
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
                "anew with --force"
            )


def _write_state(path: Path, state: Mapping[str, Any]) -> None:
    import torch

    from surrofe2.io.files import replacing

    with replacing(path) as partial:
        torch.save(dict(state), partial)


def _read_state(path: Path) -> dict[str, Any]:
    import torch

    try:
        state = torch.load(path, weights_only=True)
    except Exception:  # bytes from anywhere fail in torch's reader in ways it does not list
        state = None
    if not isinstance(state, dict):
        raise FileError(f"{path}: not an unfinished training; delete it and train anew")
    return state


def _note(figures: Mapping[str, float]) -> str:
    return f"held-out error {100 * figures['held_out_rms']:.2g} %"


def train(
    recipe: RecipeFile,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted training.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing surrogate.")] = False,
    add: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Harvest (harvest.h5) of a cached run to train on too; may be repeated.",
        ),
    ] = None,
    threads: Threads = None,
) -> None:
    """Fit a surrogate of the plant-cell stress to the recipe's data set.

    Shows the errors on samples that training never saw, for each stress component, relative to
    that component's standard deviation over them. Then calibrates the bound of the error that
    holds at a single point, by true RVEs along paths as the recipe's
    [bold]\\[calibration][/bold] has it.

    Example: [bold]surrofe2 train data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.recipe import load_recipe

    study = load_recipe(recipe)
    use_threads(threads)
    begin = time.perf_counter()
    kept = f"the iterations so far are kept; continue with: surrofe2 train {recipe} --resume"
    with keeping(kept):
        trained = train_surrogate(study, resume=resume, force=force, add=add or (), stage=progress)
    errors = trained.surrogate.errors
    show_table(
        f"Held-out errors, {errors['points']} samples",
        ["stress", "spread (µN/µm)", "RMS", "worst"],
        [[name, f"{errors['spread'][name]:.3g}", *_percents(errors, name)] for name in STRESSES],
    )
    say(trained.bound)
    say(f"{trained.path}: {summary(trained)}, {duration(time.perf_counter() - begin)}")


def _percents(errors: Mapping[str, Any], name: str) -> list[str]:
    return [f"{100 * errors[figure][name]:.2g} %" for figure in ("rms", "worst")]


def summary(trained: Trained) -> str:
    """The largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms, worst = (max(errors[figure][name] for name in STRESSES) for figure in ("rms", "worst"))
    kept = " (already trained)" if trained.kept else ""
    return f"held-out errors up to {100 * rms:.2g} % RMS, {100 * worst:.2g} % worst{kept}"
