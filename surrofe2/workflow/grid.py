"""A parameter study: runs of a recipe with other entries, each with the surrogate that it needs."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from surrofe2.base.errors import InputError, SimulationError, quoted
from surrofe2.base.settings import unknown
from surrofe2.recipe.entries import name_of_values
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.report.grid import Grid, grid_row, write_grid_plot
from surrofe2.store.run_folder import read_run
from surrofe2.store.store import locked_folder, write_json, write_text
from surrofe2.workflow.generate import generate_data_set, wanted_count
from surrofe2.workflow.grid_tasks import GridTask, Work, run_member
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.progress import Report, Stage, no_stage
from surrofe2.workflow.train import is_trained, train_surrogate
from surrofe2.workflow.workers import Processes, results_of

GRID_FILES = ("grid.csv", "grid.json", "grid.png")
LAWS = ("rve", "cached", "table", "surrogate")
MOST_RUNS = 10_000
_LEARNT = ("cell", "cells", "rve", "range", "samples", "training", "calibration")
"""Sections that a surrogate depends on."""
_WITHOUT = {
    "rve": ("cache", "table", "samples", "training", "calibration"),
    "cached": (),
    "table": ("samples", "training", "calibration"),
    "surrogate": ("cache", "table"),
}
"""Sections that a run by a law does not depend on."""


def run_grid(
    path: str | Path,
    values: Mapping[str, Sequence[Any]],
    out: str | Path,
    *,
    laws: Sequence[str] = ("rve",),
    threads: int | None = None,
    executor: Any = None,
    fresh: bool = False,
    stage: Stage = no_stage,
) -> Grid:
    """Run a recipe with each combination of values and laws, and make a table and a picture of it.

    Each run has a folder in `out`; runs that differ in nothing they depend on are one. A surrogate
    is the recipe's where no entry that it depends on is changed, else one in `out`; what is
    missing of it is generated and trained. Beside a run by true RVEs the others of the same values
    have their error and speed-up. One that fails is a row of the table, and the others go on.

    Args:
        path: of the recipe.
        values: by dotted name of the entry, {"cell.wall_stiffness": [3000.0, 4000.0]}.
        laws: of "rve", "cached", "table" and "surrogate".
        threads: of each run; None: all, or of `Processes` an equal share.
        executor: does whole runs, see `surrofe2.workflow.workers`; None: this process.

    Raises:
        InputError: an entry or a law is unknown, or a value not what it must be; nothing was run.
    """
    path, out = Path(path).resolve(), Path(out).resolve()
    surrogates, runs = _planned(path, values, laws, out)
    if threads is None and isinstance(executor, Processes):
        threads = max(1, (os.cpu_count() or 1) // executor.workers)
    with locked_folder(out):
        learn, run = partial(_learn, threads, fresh), partial(run_member, out, threads, fresh)
        errors = _done([*surrogates.values()], learn, executor, stage, "surrogates")
        lost = {
            task.name: error
            for task in runs.values()
            for path in task.needs.values()
            if (error := errors[str(path)])
        }
        ready = [task for name, task in runs.items() if name not in lost]
        errors |= lost | _done(ready, run, executor, stage, "runs")
        stored = {name: read_run(out / name) for name in runs if not errors[name]}
        rows = [
            grid_row(
                task.values, task.law, name, stored.get(name), stored.get(task.true), errors[name]
            )
            for name, task in runs.items()
        ]
        grid = Grid(path.name, {name: tuple(each) for name, each in values.items()}, tuple(rows))
        write_text(out / GRID_FILES[0], grid.table.to_csv())
        write_json(out / GRID_FILES[1], grid.to_dict())
        write_grid_plot(out / GRID_FILES[2], grid)
    return grid


def _planned(
    path: Path, values: Mapping[str, Sequence[Any]], laws: Sequence[str], out: Path
) -> tuple[dict[str, GridTask], dict[str, GridTask]]:
    """Surrogates and runs by name, all checked; runs in the order of the values and laws."""
    count = len(laws)
    for law in laws:
        if law not in LAWS:
            raise unknown(f"--law: {quoted(law)}", law, "law", LAWS)
    for name, each in values.items():
        count *= len(each)
        if not 0 < count <= MOST_RUNS:
            raise InputError(f"{name}: {count:,} runs; a grid has 1 to {MOST_RUNS:,}")
    base = load_recipe(path)
    surrogates: dict[str, GridTask] = {}
    runs: dict[str, GridTask] = {}
    for combination in itertools.product(*values.values()):
        changes = dict(zip(values, combination, strict=True))
        recipe = load_recipe(path, changes)
        recipe.problem()
        counting = {law: _without(changes, _WITHOUT[law]) for law in LAWS}
        true = name_of_values(counting["rve"], "rve")
        for law in laws:
            made: list[GridTask] = []
            for part in recipe.parts().values() if law == "table" else ():
                part.sampling_range()
            if law in ("cached", "surrogate"):
                made = _surrogates(base, recipe, changes, out)
                surrogates |= {task.name: task for task in made}
            task = GridTask(
                name=name_of_values(counting[law], law),
                recipe=recipe,
                law=law,
                values=counting[law],
                true=true,
                needs={task.recipe.cell_name: Path(task.name) for task in made},
            )
            runs.setdefault(task.name, task)
    return surrogates, runs


def _without(changes: Mapping[str, Any], sections: Sequence[str]) -> dict[str, Any]:
    return {k: value for k, value in changes.items() if k.partition(".")[0] not in sections}


def _surrogates(
    base: Recipe, recipe: Recipe, changes: Mapping[str, Any], out: Path
) -> list[GridTask]:
    """The surrogate of each cell of a recipe, with files in `out` where it is not the base's."""
    found = []
    for name, part in recipe.parts().items():
        own = base.parts().get(name)
        is_own = own is not None and _learnt(own) == _learnt(part)
        others = tuple(f"cells.{other}." for other in recipe.cells if other != name)
        counting = {
            key: value
            for key, value in changes.items()
            if key.partition(".")[0] in _LEARNT and not key.startswith(others) and not is_own
        }
        stem = f"{name_of_values(counting) or base.path.stem}{name and '-'}{name}"
        here = os.path.relpath(out / stem, base.path.parent)
        data, trained = (part.samples.file, part.training_file) if is_own else (None, None)
        # what calibrates it is the base's problem, whatever else the grid changes
        part = load_recipe(base.path, counting).parts()[name]
        samples = replace(part.samples, file=data or f"{here}.h5")
        part = part.with_cell(samples=samples, training_file=trained or f"{here}-surrogate.h5")
        if not (is_own and part.training_path().exists()):
            part.sampling_range()
        is_own = is_own and trained is not None
        found.append(GridTask(name=str(part.training_path()), recipe=part, is_own=is_own))
    return found


def _learnt(part: Recipe) -> tuple[Any, ...]:
    """All that the surrogate of a cell depends on, but for the problem."""
    samples = replace(part.samples, file=None)
    return part.cell, part.rve, part.range, samples, part.training, part.calibration


def _done(
    tasks: Sequence[GridTask], work: Work, executor: Any, stage: Stage, what: str
) -> dict[str, str | None]:
    """What each task came to by its name, done here with a display of each, or by workers."""
    names = [task.name for task in tasks]
    if executor is None:

        def numbered(k: int) -> Stage:
            return lambda title, *of: stage(f"{k + 1}/{len(tasks)} {title}", *of)

        return {task.name: work(task, numbered(k)) for k, task in enumerate(tasks)}
    if not tasks:
        return {}
    with stage(what, len(tasks), what) as report:
        calls = ((task.name, work, (task, no_stage)) for task in tasks)
        outcomes = []
        for outcome in results_of(calls, executor):
            outcomes.append(outcome)
            report(len(outcomes), "")
    return dict(zip(names, outcomes, strict=True))


def _learn(threads: int | None, fresh: bool, task: GridTask, stage: Stage) -> str | None:
    """Data set and surrogate of a cell, where they are not there."""
    use_threads(threads)
    path, recipe = task.recipe.training_path(), task.recipe
    if task.is_own and is_trained(recipe):
        return None
    fresh = fresh and not task.is_own

    def of_it(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
        return stage(f"{what} {path.stem}", total, unit)

    try:
        with of_it("generate", wanted_count(recipe, fresh=fresh), "samples") as report:
            generate_data_set(recipe, fresh=fresh, report=report)
        train_surrogate(
            recipe, fresh=fresh, stage=lambda what, *of: stage(f"{what} {path.stem}", *of)
        )
    except (InputError, SimulationError) as error:
        return str(error)
    return None
