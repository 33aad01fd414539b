"""A run or rest repeated from the inputs in its folder, and compared with what is stored there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import FileError, InputError
from surrofe2.base.units import number
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.run.loop import Report
from surrofe2.run.views import Series
from surrofe2.store.run_folder import (
    INPUT,
    RunRecord,
    StoredRun,
    check_inputs,
    of_cell,
    read_record,
    read_run,
)
from surrofe2.workflow.inputs import SURROGATE, TABLES
from surrofe2.workflow.rest import rest_study, study_by_method
from surrofe2.workflow.tissue import run_tissue


@dataclass(frozen=True, slots=True)
class Stored:
    """A run that can be repeated.

    Attributes:
        folder: folder of the run.
        record: record of the run.
        recipe: recipe as the run took it.
    """

    folder: Path
    record: RunRecord
    recipe: Recipe


def stored_run(folder: Path) -> Stored:
    """Read a finished run and the recipe from which it can be repeated.

    Raises:
        FileError: it is no finished run, or an input is missing, damaged or changed.
    """
    record = read_record(folder)
    if record.status != "finished":
        raise FileError(
            f"{folder}: the run is {record.status}, and only a finished one is repeated; its "
            "command resumes it"
        )
    return Stored(folder, record, load_recipe(check_inputs(folder, record)))


def repeat_run(stored: Stored, out: Path, *, fresh: bool, report: Report) -> RunRecord:
    """Repeat a run by its law and its inputs in another folder, whose run is like any other.

    Raises:
        InputError: the other folder is that of the run itself.
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    folder = stored.folder
    recipe = stored.recipe
    record = stored.record
    if out.resolve() == folder.resolve():
        raise InputError(f"--out: {out}; that is the run to be repeated; write elsewhere")
    if record.law == "tissue":
        return run_tissue(recipe, out, fresh=fresh, report=report)
    surrogates = {
        name: folder / INPUT / of_cell(SURROGATE, name)
        for name in recipe.cells
        if of_cell(SURROGATE, name) in record.inputs
    }
    options: dict[str, Any] = {
        "surrogates": surrogates,
        "tables": sorted((folder / INPUT).glob(TABLES)),
        "fresh": fresh,
        "report": report,
    }
    if record.recipe.get("rest", {}).get("correct"):
        return rest_study(recipe, out, record.law, correct=True, **options)
    return study_by_method(recipe, record.law, out, **options)


@dataclass(frozen=True, slots=True, kw_only=True)
class Repetition:
    """Two runs of one recipe, side by side.

    Attributes:
        columns: number of columns that both have.
        same: number of columns that are the same to the bit.
        name: name of the column that differs most; its unit is `unit`.
        largest: largest difference in it.
        relative: the same, relative to the largest value of any column of its kind.
        surroundings: versions, processor and threads that differ, by name: stored and now.
    """

    columns: int
    same: int
    name: str
    unit: str
    largest: float
    relative: float
    surroundings: Mapping[str, tuple[str, str]]

    @property
    def sentence(self) -> str:
        """The largest difference, and what may be its reason."""
        if self.same == self.columns:
            return f"repeated: all {self.columns} columns are the same to the bit"
        text = (
            f"repeated: largest difference {number(self.largest, 2)} {self.unit} in {self.name}, "
            f"{self.relative:.1e} of the largest value of its kind; {self.same} of "
            f"{self.columns} columns are the same to the bit"
        )
        if self.surroundings:
            differences = self.surroundings.items()
            others = [f"{name} {then}, now {now}" for name, (then, now) in differences]
            text += f"; stored by {', '.join(others)}"
        return text


def compared_runs(stored: StoredRun, again: StoredRun) -> Repetition:
    """Compare all columns of two runs of one recipe.

    Where their times or load factors differ, as by another number of steps, values of the repeated
    run are interpolated.
    """
    before = stored.series()
    after = again.series()
    names = [name for name in before if name in after]
    scales: dict[str, float] = {}  # largest value by kind of column
    for series in before.values():
        largest = _largest(series.values)
        scales[series.group] = max(scales.get(series.group, 0.0), largest)
    same = 0
    worst = ("", 0.0, 0.0)  # name, difference, relative difference
    for name in names:
        values = _at_times_of(stored, again, after[name])
        same += np.array_equal(before[name].values, after[name].values)
        largest = _largest(values - before[name].values)
        scale = scales[before[name].group]
        relative = largest / scale if scale else largest
        if not worst[0] or relative > worst[2]:
            worst = (name, largest, relative)
    name, largest, relative = worst
    return Repetition(
        columns=len(names),
        same=same,
        name=name,
        unit=before[name].unit,
        largest=largest,
        relative=relative,
        surroundings=_made_otherwise(stored.record, again.record),
    )


def _at_times_of(stored: StoredRun, again: StoredRun, series: Series) -> Array:
    """Return a column of the repeated run at the times of the stored one."""
    if np.array_equal(stored.curve.t, again.curve.t):
        return series.values
    # the factor of a rest may fall
    order = np.argsort(again.curve.t)
    return np.interp(stored.curve.t, again.curve.t[order], series.values[order])


def _largest(values: Array) -> float:
    """Return the largest absolute value; 0 where there is none."""
    return float(abs(values).max(initial=0.0))


def _made_otherwise(before: RunRecord, after: RunRecord) -> dict[str, tuple[str, str]]:
    """Return what made two runs otherwise: versions, processor, threads; by name, then and now."""
    then = {"surrofe2": before.package_version, "threads": str(before.threads), **before.platform}
    now = {"surrofe2": after.package_version, "threads": str(after.threads), **after.platform}
    names = [name for name in then if then[name] != now.get(name, "none")]
    return {name: (then[name], now.get(name, "none")) for name in names}


def repetition(stored: Stored, out: Path) -> Repetition:
    """Read a run and its repetition, and compare them."""
    return compared_runs(read_run(stored.folder), read_run(out))
