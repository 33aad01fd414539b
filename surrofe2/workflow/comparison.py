"""Runs against each other: two or more folders, and a sweep over tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from surrofe2.errors import InputError, quoted
from surrofe2.io.files import is_there, write_json
from surrofe2.io.lock import locked_folder
from surrofe2.io.run_folder import file_fingerprint, read_run
from surrofe2.recipe import Recipe
from surrofe2.report.comparison import Comparison, write_comparison_plot
from surrofe2.report.comparison import compare as compare_stored
from surrofe2.report.sweep import Sweep, make_sweep, write_sweep_plot
from surrofe2.workflow.cell_fields import recipes_of
from surrofe2.workflow.cell_laws import NO_FILES
from surrofe2.workflow.laws import kept_reference
from surrofe2.workflow.run import run_study
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.surfaces import missing_sentence

COMPARISON_FILES = ("comparison.json", "comparison.png")
SWEEP_FILES = ("sweep.json", "sweep.png")


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`."""
    out = Path(out)
    runs = [read_run(folder) for folder in folders]
    result = compare_stored(runs)
    of = {run.folder.name: file_fingerprint(run.folder / "run.json") for run in runs}
    path = out / COMPARISON_FILES[0]
    if fresh or not is_there(path, {"of": of}):
        with locked_folder(out):
            write_comparison_plot(out / COMPARISON_FILES[1], result, runs)
            write_json(path, {**result.to_dict(), "of": of})
    return result


def missing_notes(folders: Sequence[str | Path]) -> list[str]:
    """What FE² without a surface law is expected to miss, beside a full tissue."""
    records = [read_run(folder).record for folder in folders]
    if all(record.law != "tissue" for record in records):
        return []
    found = []
    for folder, record in zip(folders, records, strict=True):
        with suppress(InputError):  # a law without plant cells
            for recipe in recipes_of(record).values():
                sentence = missing_sentence(record, recipe, partial(kept_reference, recipe))
                found += [] if sentence is None else [f"{Path(folder).name}: {sentence}"]
    return found


def run_sweep(
    recipe: Recipe,
    out: Path,
    tolerances: Sequence[float],
    *,
    surrogates: Mapping[str, Path] = NO_FILES,
    fresh: bool = False,
    stage: Stage = silent,
) -> Sweep:
    """True FE² and a cached run at each tolerance, each in a folder of its own, and their sweep.

    Args:
        surrogates: as of `run_study`.
    """
    names = ["rve", *(f"tolerance-{each:g}" for each in tolerances)]
    caches = [replace(recipe.cache, tolerance=each) for each in tolerances]
    studies = [recipe, *(replace(recipe, cache=cache) for cache in caches)]
    with locked_folder(out):
        for k, (name, study) in enumerate(zip(names, studies, strict=True)):
            with stage(f"{k + 1}/{len(names)} {name}", study.duration, "µs") as report:
                run_study(
                    study,
                    "cached" if k else "rve",
                    out / name,
                    surrogates=surrogates,
                    fresh=fresh,
                    report=report,
                )
        reference, *runs = (read_run(out / name) for name in names)
        sweep = make_sweep(reference, runs)
        write_json(out / SWEEP_FILES[0], sweep.to_dict())
        write_sweep_plot(out / SWEEP_FILES[1], sweep)
    return sweep


def parse_tolerances(text: str) -> tuple[float, ...]:
    """Numbers between commas, falling, each once.

    Raises:
        InputError: something between them is no number.
    """
    try:
        numbers = {float(part) for part in text.split(",")}
    except ValueError:
        raise InputError(
            f"--tolerances: {quoted(text)}; they must be numbers between commas"
        ) from None
    return tuple(sorted(numbers, reverse=True))
