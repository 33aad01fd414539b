"""A parameter study: runs of a recipe with other entries, each with the surrogate that it needs."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from surrofe2.base.environment import cores
from surrofe2.base.errors import InputError, SimulationError, quoted
from surrofe2.base.settings import unknown
from surrofe2.recipe.entries import name_of_values
from surrofe2.recipe.recipe import PROBLEM_SECTIONS, CellName, CellStudy, Recipe, load_recipe
from surrofe2.report.chosen import Chosen
from surrofe2.report.grid import Grid, grid_row, write_grid_map, write_grid_plot
from surrofe2.report.tables import check_form
from surrofe2.run.loop import Stage, no_stage
from surrofe2.store.run_folder import read_run
from surrofe2.store.store import locked_folder, remove, write_json, write_text
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.rest import extent_of, study_by_method
from surrofe2.workflow.train import is_trained, learn
from surrofe2.workflow.workers import Processes, prepare, result_of

GRID_TABLES = ("grid.csv", "grid.json")
LAWS = ("rve", "cached", "table", "surrogate")
MOST_RUNS = 10_000  # of a grid; more are a mistake
# Sections that a surrogate depends on.
_LEARNT = ("cell", "cells", "rve", "range", "samples", "training", "calibration")
# Sections that a run by a law does not depend on.
_WITHOUT = {
    "rve": ("cache", "table", "samples", "training", "calibration"),
    "cached": (),
    "table": ("samples", "training", "calibration"),
    "surrogate": ("cache", "table"),
}


# Work that a process can be given: to make a surrogate, or a run.
Work = Callable[[Stage], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """A run of the grid.

    Attributes:
        recipe: with the values of this run.
        law: its name.
        values: those that change and that it depends on, by dotted name of the entry.
        true: name of the run of the same values by RVEs.
        needs: files of surrogates by name of the cell.
    """

    recipe: Recipe
    law: str
    values: Mapping[str, Any]
    true: str
    needs: Mapping[CellName, Path]


def run_grid(
    path: str | Path,
    values: Mapping[str, Sequence[Any]],
    out: str | Path,
    *,
    laws: Sequence[str] = ("rve",),
    quantities: Sequence[str] = (),
    threads: int | None = None,
    executor: Any = None,
    form: str = "png",
    fresh: bool = False,
    stage: Stage = no_stage,
) -> Grid:
    """Run a recipe with each combination of values and laws, and make a table and a picture of it.

    Each run has a folder in `out`; runs that differ in nothing they depend on are one. A surrogate
    is the recipe's where no entry that it depends on is changed, else one in `out`; what is
    missing of it is generated and trained. Beside a run by RVEs the others of the same values
    have their error and speed-up. One that fails is a row of the table, and the others continue.

    Args:
        path: of the recipe.
        values: by dotted name of the entry, {"cell.wall_stiffness": [3000.0, 4000.0]}.
        out: folder of the runs, the table and the pictures.
        laws: of "rve", "cached", "table" and "surrogate".
        quantities: of each run in the table and the picture, COLUMN or COLUMN:STATISTIC, see
            `report.chosen`; none: the peak of each force over its displacement.
        threads: of each run; None: all, or of `Processes` an equal share.
        executor: of processes that make surrogates and runs; None: this one does.
        form: format of the pictures, grid.png and, where two entries change, grid-map.png; of
            `PICTURE_FORMATS`.
        fresh: whether runs that are there are replaced.
        stage: reports the stages and their progress.

    Raises:
        InputError: an entry or a law is unknown, or a value not what it must be; nothing was run.
    """
    check_form(form)
    chosen = [Chosen.read(text) for text in quantities]
    prepare(executor)
    path = Path(path).resolve()
    out = Path(out).resolve()
    surrogates, runs = _planned(path, values, laws, out)
    if threads is None and isinstance(executor, Processes):
        threads = max(1, cores() // executor.workers)
    with locked_folder(out):
        learning = {
            str(study.training_path()): partial(_learn, study, is_own, threads, fresh)
            for study, is_own in surrogates
        }
        errors = _done(learning, executor, stage, "surrogates")
        for name, run in runs.items():  # a run without its surrogate fails by the surrogate's error
            failed = [errors[str(file)] for file in run.needs.values() if errors[str(file)]]
            if failed:
                errors[name] = failed[0]
        running = {
            name: partial(_run, run, out / name, threads, fresh)
            for name, run in runs.items()
            if name not in errors
        }
        errors |= _done(running, executor, stage, "runs")
        stored = {name: read_run(out / name) for name in runs if not errors[name]}
        rows = [
            grid_row(
                run.values,
                run.law,
                name,
                stored.get(name),
                stored.get(run.true),
                errors[name],
                chosen,
            )
            for name, run in runs.items()
        ]
        axes = {name: tuple(choices) for name, choices in values.items()}
        grid = Grid(path.name, axes, tuple(rows))
        table, record = GRID_TABLES
        write_text(out / table, grid.table.to_csv())
        write_json(out / record, grid.to_dict())
        write_grid_plot(out / f"grid.{form}", grid)
        grid_map = out / f"grid-map.{form}"
        if not write_grid_map(grid_map, grid):
            remove(grid_map)
    return grid


def _planned(
    path: Path, values: Mapping[str, Sequence[Any]], laws: Sequence[str], out: Path
) -> tuple[list[tuple[CellStudy, bool]], dict[str, _Run]]:
    """Plan surrogates and runs of a grid, all checked.

    Returns:
        Surrogates, each with whether it is the recipe's own; and runs by name.
    """
    count = len(laws)
    for law in laws:
        if law not in LAWS:
            raise unknown(f"--law: {quoted(law)}", law, "law", LAWS)
    for name, choices in values.items():
        count *= len(choices)
        if not 0 < count <= MOST_RUNS:
            raise InputError(f"{name}: {count:,} runs; a grid has 1 to {MOST_RUNS:,}")
    base = load_recipe(path)
    checked = list[Any]()
    surrogates: dict[Path, tuple[CellStudy, bool]] = {}
    runs: dict[str, _Run] = {}
    for combination in itertools.product(*values.values()):
        changes = dict(zip(values, combination, strict=True))
        recipe = load_recipe(path, changes)
        stated = [getattr(recipe, name) for name in (*PROBLEM_SECTIONS, "surface")]
        stated += [cell.regions for cell in recipe.cells.values()]
        if stated not in checked:  # each problem is meshed and checked once
            recipe.problem()
            checked.append(stated)
        counting = {}  # by law, the changes that its run depends on
        for law in LAWS:
            counting[law] = {
                key: value
                for key, value in changes.items()
                if key.partition(".")[0] not in _WITHOUT[law]
            }
        for law in laws:
            needs: dict[CellName, Path] = {}
            for cell, study in recipe.studies().items():
                if law == "table":
                    study.sampling_range()
                elif law in ("cached", "surrogate"):
                    known, is_own = _surrogate(base, study, changes, out)
                    needs[cell] = known.training_path()
                    surrogates[needs[cell]] = (known, is_own)
            run = _Run(
                recipe=recipe,
                law=law,
                values=counting[law],
                true=name_of_values(counting["rve"], "rve"),
                needs=needs,
            )
            runs.setdefault(name_of_values(counting[law], law), run)
    return [*surrogates.values()], runs


def _surrogate(
    base: Recipe, study: CellStudy, changes: Mapping[str, Any], out: Path
) -> tuple[CellStudy, bool]:
    """Return the study whose surrogate a run takes, and whether that is the base's.

    It is the base's where the cell learns the same there, and is then never started over; else it
    is one in `out`.
    """
    name = study.name
    suffix = "" if name is None else f"-{name}"
    original = base.studies().get(name)
    data: str | None = None
    trained: str | None = None
    if original is not None and _learnt(original) == _learnt(study):
        known = original
        stem = f"{base.path.stem}{suffix}"
        data = known.cell.samples.file
        trained = known.cell.training_file
    else:
        others = tuple(f"cells.{other}." for other in study.recipe.cells if other != name)
        counting = {
            key: value
            for key, value in changes.items()
            if key.partition(".")[0] in _LEARNT and not key.startswith(others)
        }
        # what calibrates it is the base's problem, whatever else the grid changes
        recipe = replace(
            base,
            cells={**base.cells, name: study.cell},
            rve=study.recipe.rve,
            calibration=study.recipe.calibration,
        )
        known = CellStudy(recipe, name)
        stem = f"{name_of_values(counting)}{suffix}"
    relative = os.path.relpath(out / stem, base.path.parent)
    known = known.with_cell(
        samples=replace(known.cell.samples, file=data or f"{relative}.h5"),
        training_file=trained or f"{relative}-surrogate.h5",
    )
    if trained is None or not known.training_path().exists():
        known.sampling_range()  # it is trained first, and that needs a range
    return known, trained is not None


def _learnt(study: CellStudy) -> tuple[Any, ...]:
    """Return all that the surrogate of a cell depends on, without the problem."""
    cell = study.cell
    recipe = study.recipe
    samples = replace(cell.samples, file=None)
    return cell.parameters, recipe.rve, cell.range, samples, cell.training, recipe.calibration


def _done(
    tasks: Mapping[str, Work], executor: Any, stage: Stage, what: str
) -> dict[str, str | None]:
    """Carry out tasks, here or by workers.

    Returns:
        The error message that ended each task, by its name; None of one that succeeded.
    """
    errors: dict[str, str | None] = {}
    if executor is None:
        for k, (name, work) in enumerate(tasks.items(), 1):
            place = f"{k}/{len(tasks)}"
            errors[name] = _error_of(
                work, lambda what, *of, place=place: stage(f"{place} {what}", *of)
            )
        return errors
    futures = {name: executor.submit(_error_of, work, no_stage) for name, work in tasks.items()}
    with stage(what, len(tasks), what) as report:
        for name, future in futures.items():
            errors[name] = result_of(future)
            report(len(errors), "")
    return errors


def _error_of(work: Work, stage: Stage) -> str | None:
    """Carry out a task, and return the message of its error; None where it succeeds."""
    try:
        work(stage)
    except (InputError, SimulationError) as error:
        return str(error)
    return None


def _learn(study: CellStudy, is_own: bool, threads: int | None, fresh: bool, stage: Stage) -> None:
    """Make data set and surrogate of a cell where they are not there."""
    use_threads(threads)
    if not (is_own and is_trained(study)):
        name = study.training_path().stem
        fresh = fresh and not is_own
        learn(study, fresh=fresh, stage=lambda what, *of: stage(f"{what} {name}", *of))


def _run(run: _Run, folder: Path, threads: int | None, fresh: bool, stage: Stage) -> None:
    """Make a run in its folder."""
    use_threads(threads)
    with stage(folder.name, *extent_of(run.recipe)) as report:
        study_by_method(
            run.recipe, run.law, folder, surrogates=run.needs, fresh=fresh, report=report
        )
