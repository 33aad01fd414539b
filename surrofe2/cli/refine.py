"""`surrofe2 refine`: run, harvest, train again, until the surrogate knows what the runs meet."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from surrofe2.cli.console import duration, keeping, progress, say, show_table
from surrofe2.cli.options import RecipeFile, Threads
from surrofe2.errors import FileError, MismatchError, SimulationError

if TYPE_CHECKING:
    from surrofe2.cli.refining import Round
    from surrofe2.recipe import Recipe
    from surrofe2.sampling import SamplingRange
    from surrofe2.stress_samples import StressSamples
    from surrofe2.surrogate import SurrogateLaw

ROUNDS = "refine.json"
SURROGATE = "surrogate.pt"
_NEW, _STARTED = "new.h5", "round.json"


def refine_surrogate(
    recipe: Recipe,
    out: Path,
    *,
    rounds: int = 6,
    resume: bool = False,
    force: bool = False,
    tell: Callable[[Round], None] = lambda row: None,
) -> list[Round]:
    """Rounds of cached run, harvest, sampling and training in a folder, until one is settled.

    The first round runs on the recipe's surrogate, which is made where it is not there. Each
    later one was trained anew on the recipe's data set and everything sampled since; where states
    left the range, the range of the surrogate is the least box that holds them too. The last
    surrogate is `out`/surrogate.pt.

    Args:
        rounds: how many at most.
        resume: keep what an interrupted call has finished.
        tell: called with each finished round.

    Raises:
        FileError: the folder has rounds and neither `resume` nor `force` is set.
        MismatchError: `resume`, and its rounds are of another recipe.
        SimulationError: the last round is not settled.
    """
    from surrofe2.io.files import write_json

    done = _open(recipe, out, resume=resume, force=force)
    for k in range(rounds):
        if k < len(done):
            row = done[k]
        else:
            row = _round(recipe, out, k)
            done.append(row)
            content = {"recipe": recipe.to_dict(), "rounds": [asdict(entry) for entry in done]}
            write_json(out / ROUNDS, content)
        tell(row)
        if row.settled:
            (out / SURROGATE).write_bytes((out / f"round-{k}" / SURROGATE).read_bytes())
            return done
    raise SimulationError(
        f"{out}: {done[-1].unknown} states still unknown after {rounds} rounds; go on with "
        f"--resume --rounds {2 * rounds}",
        partial=done,
    )


def _open(recipe: Recipe, out: Path, *, resume: bool, force: bool) -> list[Round]:
    """The finished rounds to go on from."""
    from shutil import rmtree

    from surrofe2.cli.refining import Round
    from surrofe2.io.files import read_json, reported, write_json

    begun = out / ROUNDS
    if begun.exists() and not (resume or force):
        raise FileError(f"{out}: has rounds; continue them with --resume or replace with --force")
    if begun.exists() and not force:
        stored = read_json(begun)
        if stored.get("recipe") != recipe.to_dict():
            raise MismatchError(
                f"{out}: its rounds are of another recipe than {recipe.path.name}; replace them "
                "with --force"
            )
        return [Round(**row) for row in stored["rounds"]]
    with reported(out, "written"):
        out.mkdir(parents=True, exist_ok=True)
        for folder in out.glob("round-*"):
            rmtree(folder)
        (out / SURROGATE).unlink(missing_ok=True)
    write_json(begun, {"recipe": recipe.to_dict(), "rounds": []})
    return []


def _round(recipe: Recipe, out: Path, k: int) -> Round:
    """One round; what it has finished before an interruption is kept."""
    from surrofe2.cli.refining import (
        Round,
        harvest_of,
        new_samples,
        unknown_states,
        write_new_samples,
    )
    from surrofe2.cli.run import run_study
    from surrofe2.io.files import write_json
    from surrofe2.rve import RveLaw

    begin = time.perf_counter()
    folder = out / f"round-{k}"
    folder.mkdir(exist_ok=True)
    surrogate, samples = _surrogate(recipe, out, k)
    with progress(f"round {k}: run", recipe.load.duration, "µs") as report:
        record = run_study(
            recipe,
            "cached",
            folder / "run",
            surrogate_file=folder / SURROGATE,
            resume=True,
            report=report,
        )
    spread = surrogate.stress_spread
    tolerance = _tolerance(recipe)
    harvest = harvest_of(folder / "run")
    unknown, audit = unknown_states(harvest, surrogate, tolerance * spread)
    added, wider = 0, surrogate.range
    if len(unknown) and harvest is not None:
        law = RveLaw(recipe.cell, recipe.rve)
        seed = recipe.samples.seed + k + 1
        with progress(f"round {k}: sample", 1.0, "of the samples") as report:
            wider, arrays = new_samples(
                recipe, law, harvest, unknown, surrogate.range, seed, report
            )
        write_new_samples(folder / _NEW, recipe, arrays)
        write_json(folder / _STARTED, {"range": wider.to_dict()})
        added = len(arrays[0])
    counts = record.counts
    return Round(
        round=k,
        hits=counts["hits"] / max(1, counts["hits"] + counts["fallbacks"]),
        unknown=len(unknown),
        samples=len(samples.valid.F),
        held_out=max(surrogate.errors["rms"].values()),
        audit=None if audit is None else audit / spread,
        tolerance=tolerance,
        range=surrogate.range.to_dict(),
        added=added,
        seconds=time.perf_counter() - begin,
    )


def _surrogate(recipe: Recipe, out: Path, k: int) -> tuple[SurrogateLaw, StressSamples]:
    """The surrogate that round k runs on, in its folder, and the samples behind it."""
    from surrofe2.cli.adding import with_harvests
    from surrofe2.cli.calibrate import calibrate_surrogate
    from surrofe2.io.data_sets import read_data_set
    from surrofe2.surrogate import SurrogateLaw, train

    path = out / f"round-{k}" / SURROGATE
    if k == 0:
        _make_first(recipe)
        samples = with_harvests(read_data_set(recipe.data_path()), recipe.added_paths(), recipe)
        if not path.exists():
            path.write_bytes(recipe.training_path().read_bytes())
        return SurrogateLaw.load(path), samples
    samples = with_harvests(
        read_data_set(recipe.data_path()),
        [*recipe.added_paths(), *(out / f"round-{j}" / _NEW for j in range(k))],
        recipe,
    )
    samples = replace(samples, range=_range_after(out, k - 1))
    if not path.exists():
        total = recipe.training.iterations
        with progress(f"round {k}: train", total, "iterations") as report:
            surrogate = train(
                samples,
                recipe.training,
                progress=lambda i, n, figures: report(
                    i, f"held-out error {100 * figures['held_out_rms']:.2g} %"
                ),
            )
        with progress(f"round {k}: calibrate", 1.0, "of the paths") as report:
            wider = replace(recipe, range=samples.range)
            surrogate = calibrate_surrogate(wider, surrogate, samples, report)
        surrogate.save(path)
    return SurrogateLaw.load(path), samples


def _make_first(recipe: Recipe) -> None:
    """Data set and surrogate of the recipe, where they are not there."""
    from surrofe2.cli.generate import generate_data_set
    from surrofe2.cli.train import train_surrogate

    with progress("generate", recipe.samples.count, "samples") as report:
        generate_data_set(recipe, resume=True, report=report)
    if not recipe.training_path().exists():
        train_surrogate(recipe, resume=True, stage=progress)


def _range_after(out: Path, k: int) -> SamplingRange:
    from surrofe2.io.data_set_layout import tuples_of
    from surrofe2.io.files import read_json
    from surrofe2.sampling import SamplingRange

    stored = read_json(out / f"round-{k}" / _STARTED)["range"]
    return SamplingRange(**{name: tuples_of(value) for name, value in stored.items()})


def _tolerance(recipe: Recipe) -> float:
    """Allowed error of a stress as a share of its spread."""
    return float(getattr(recipe, "cache", recipe.table).tolerance)


def refine(
    recipe: RecipeFile,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the rounds; default: out/refine-RECIPE."),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, metavar="N", help="Rounds at most.")] = 6,
    resume: Annotated[bool, typer.Option("--resume", help="Continue interrupted rounds.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the rounds in DIR.")] = False,
    threads: Threads = None,
) -> None:
    """Teach the surrogate what the recipe's own run meets.

    Runs through the cache, collects the states that the surrogate did not know well enough, asks
    RVEs there and around, trains again, and so on until a run has no unknown state and its audit
    holds. DIR receives refine.json (the table of rounds) and surrogate.pt.

    Example: [bold]surrofe2 refine data/bending-bar-triple-load.toml[/bold]

    Next: [bold]surrofe2 run RECIPE --law cached --surrogate DIR/surrogate.pt --out out/run[/bold]
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.recipe import load_recipe

    study = load_recipe(recipe)
    folder = out or Path("out") / f"refine-{recipe.stem}"
    use_threads(threads)
    begin = time.perf_counter()
    kept = f"{folder} keeps the finished rounds; continue with: surrofe2 refine {recipe} --resume"
    try:
        with keeping(kept):
            found = refine_surrogate(
                study, folder, rounds=rounds, resume=resume, force=force, tell=_tell
            )
    except SimulationError as error:
        if isinstance(error.partial, list):
            _show(error.partial)
        raise
    _show(found)
    say(
        f"{folder / SURROGATE}: settled after {len(found)} rounds, "
        f"{duration(time.perf_counter() - begin)}"
    )


def _tell(row: Round) -> None:
    say(
        f"round {row.round}: {100 * row.hits:.4g} % hits, {row.unknown} unknown states, "
        f"{row.added} samples added"
    )


def _show(rows: list[Round]) -> None:
    columns = ["round", "hits", "unknown", "samples", "held-out RMS", "audit 99 %", "time"]
    cells = [
        [
            str(row.round),
            f"{100 * row.hits:.4g} %",
            str(row.unknown),
            str(row.samples),
            f"{100 * row.held_out:.2g} %",
            "–" if row.audit is None else f"{100 * row.audit:.2g} %",
            duration(row.seconds),
        ]
        for row in rows
    ]
    show_table("Rounds", columns, cells)
