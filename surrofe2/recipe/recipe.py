"""Study recipes: one TOML file that drives generate, train and run.

Each section of a recipe is the frozen dataclass of the layer it configures (`CellParameters`,
`RveSettings`, …), so names, types, defaults and bounds stand there and nowhere else; what is wrong
comes out as one `InputError` sentence.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError, quoted, shortened
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.settings import Faults, build, check_value, unknown
from surrofe2.cache.settings import CacheSettings, TableSettings
from surrofe2.macro.settings import MacroSettings, SurfaceSettings
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import FREE
from surrofe2.problem.mesh import boundary
from surrofe2.problem.problem import Problem
from surrofe2.recipe.cell_types import CellType, SampleSettings, cell_types, points_of_cells
from surrofe2.recipe.entries import with_changes
from surrofe2.recipe.problem_sections import SECTIONS as PROBLEM_SECTIONS
from surrofe2.recipe.problem_sections import StatedProblem, stated_problem
from surrofe2.rve.settings import RveSettings
from surrofe2.store.store import plain, read_text
from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
from surrofe2.tissue.settings import TissueSettings

T = TypeVar("T")

_LONGEST_NAME = 200
"""Bytes of a file's name; others that are made from it are longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything a study needs. `path` is the recipe's file, against which its files resolve.

    Attributes:
        cells: by name; that of a section [cell] is called "".
        part: name of the selected cell; None: the only one, or all of several.
        stated: the problem.
    """

    path: Path
    cells: Mapping[str, CellType]
    rve: RveSettings
    calibration: CalibrationSettings
    stated: StatedProblem
    macro: MacroSettings
    tissue: TissueSettings
    table: TableSettings
    surface: SurfaceSettings | None = None
    cache: CacheSettings = field(default_factory=CacheSettings)
    part: str | None = None

    def parts(self, name: str | None = None) -> dict[str, Recipe]:
        """The recipe for each of its cells by name, or for the selected one."""
        if name is not None and name not in {*self.cells} - {""}:
            known = [each or "[cell]" for each in self.cells]
            raise unknown(f"--cell: {quoted(name)}", name, "cell", known)
        wanted = self.part if name is None else name
        names = self.cells if wanted is None else (wanted,)
        return {each: replace(self, part=each) for each in names}

    @property
    def cell_name(self) -> str:
        """Of the selected cell, or of the only one; an InputError where there are several."""
        if self.part is None and len(self.cells) > 1:
            raise InputError(
                f"{self.path.name}: cells: {', '.join(self.cells)}; this needs a recipe with one "
                "[cell]"
            )
        return next(iter(self.cells)) if self.part is None else self.part

    @property
    def cell(self) -> CellParameters:
        """The plant cell that is selected; so all these."""
        return self.cells[self.cell_name].cell

    @property
    def range(self) -> SamplingRange | None:
        """Of (F, Ḟ), in which its stress is sampled and learnt."""
        return self.cells[self.cell_name].range

    @property
    def samples(self) -> SampleSettings:
        """How its stress is sampled."""
        return self.cells[self.cell_name].samples

    @property
    def training(self) -> TrainingSettings:
        """How its stress is learnt."""
        return self.cells[self.cell_name].training

    @property
    def training_file(self) -> str | None:
        """Of its surrogate."""
        return self.cells[self.cell_name].training_file

    def with_cell(self, **changes: Any) -> Recipe:
        """The recipe with other settings of the selected cell."""
        name = self.cell_name
        return replace(self, cells={**self.cells, name: replace(self.cells[name], **changes)})

    @property
    def fingerprint(self) -> str:
        """Of the cell, or of all cells in their order."""
        return " ".join(part.cell.fingerprint for part in self.parts().values())

    def points_of_cells(self, mesh: skfem.Mesh) -> dict[str, NDArray[np.int64]]:
        """Numbers of the points of the mesh that each cell fills; raises as the function."""
        return points_of_cells(mesh, self.cells)

    def sampling_range(self) -> SamplingRange:
        """The range of (F, Ḟ), for what cannot do without; an InputError where there is none."""
        if self.range is None:
            name = self.section("range")
            raise InputError(
                f"{self.path.name}: {name}: missing; this command needs the section [{name}] with "
                "stretch, shear and rate (1/µs)"
            )
        return self.range

    @contextmanager
    def named(self, *kinds: type[FileError | InputError]) -> Iterator[None]:
        """Errors of these kinds in what the recipe states begin with the name of its file."""
        try:
            yield
        except kinds as error:
            raise type(error)(f"{self.path.name}: {error}") from None

    def problem(self) -> Problem:
        """What a run computes, but for the surface law of [surface].

        Raises:
            FileError: the mesh file cannot be read.
            InputError: the mesh is none, or has not what the recipe names.
        """
        with self.named(FileError, InputError):
            problem = self.stated.problem(self.path.parent)
            self.points_of_cells(problem.mesh)
            if self.surface is not None and self.surface.on != FREE:
                for name in self.surface.on:
                    boundary(problem.mesh, name, "surface.on")
            return problem

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.stated.time.duration

    def data_path(self) -> Path:
        """Where the data set lies."""
        return self._path_of("samples", self.samples.file, "data set (.h5)")

    def training_path(self) -> Path:
        """Where the trained surrogate lies."""
        return self._path_of("training", self.training_file, "trained surrogate (.h5)")

    def _path_of(self, section: str, file: str | None, what: str) -> Path:
        if file is None:
            raise InputError(
                f"{self.path.name}: {self.section(section)}.file: missing; this command needs the "
                f"file of the {what}, relative to the recipe"
            )
        if "\0" in file or max(len(os.fsencode(part)) for part in file.split("/")) > _LONGEST_NAME:
            raise InputError(
                f"{self.path.name}: {self.section(section)}.file: {quoted(file)}; no file can be "
                "called so"
            )
        return Path(os.path.normpath(self.path.parent / file))

    def section(self, name: str) -> str:
        """What a section of the selected cell is called in the file."""
        return f"cells.{self.cell_name}.{name}" if self.cell_name else name

    def to_dict(self) -> dict[str, Any]:
        """The whole recipe, defaults filled in, as JSON can hold it; no absolute folder.

        Of one cell it has the sections of a [cell], whatever its name.
        """
        stated = {name: getattr(self, name) for name in _SETTINGS}
        settings = {name: asdict(each) for name, each in stated.items() if each is not None}
        if self.part is not None or "" in self.cells:
            cells = self.cells[self.cell_name].to_dict()
        else:
            cells = {"cells": {name: _entries(each) for name, each in self.cells.items()}}
        plainly: dict[str, Any] = plain(
            {"recipe": self.path.name, **cells, **settings, **self.stated.to_dict()}
        )
        return plainly


def _entries(cell: CellType) -> dict[str, Any]:
    """What a section [cells.NAME] has."""
    sections = cell.to_dict()
    return {**sections.pop("cell"), "regions": list(cell.regions), **sections}


_SETTINGS: dict[str, type] = {
    "rve": RveSettings,
    "calibration": CalibrationSettings,
    "macro": MacroSettings,
    "tissue": TissueSettings,
    "table": TableSettings,
    "surface": SurfaceSettings,
    "cache": CacheSettings,
}
SECTIONS: dict[str, type] = {
    "cell": CellParameters,
    "rve": RveSettings,
    "range": SamplingRange,
    "samples": SampleSettings,
    "training": TrainingSettings,
    "calibration": CalibrationSettings,
    "load": LoadSettings,
    **_SETTINGS,
}
"""Sections of settings by name; others state a problem, or several cells."""


_MOST = 2**24
"""Bytes of a recipe."""


def load_recipe(path: str | Path, changes: Mapping[str, Any] = MappingProxyType({})) -> Recipe:
    """Read and check a study recipe.

    Args:
        changes: values by dotted name of the entry, {"cell.wall_stiffness": 3000.0}, instead of
            those in the file.

    Raises:
        FileError: the file is not there or cannot be read.
        InputError: not TOML, an unknown or missing key, a wrong type or a value out of bounds.
    """
    path = Path(path)
    try:
        table = tomllib.loads(read_text(path, _MOST))
    except (ValueError, RecursionError) as error:  # an integer may have too many digits, too
        raise InputError(f"{path.name}: not TOML: {shortened(str(error), 150)}") from None
    try:
        return make_recipe(with_changes(table, changes), path)
    except (FileError, InputError) as error:
        named = type(error)(f"{path.name}: {error}")
        named.faults = error.faults or (error,)
        raise named from None


def make_recipe(table: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """A recipe from the nested tables of a TOML file.

    Raises:
        InputError: naming the section or key that is unknown or out of its range; its `faults`
            are all that is wrong.
    """
    faults, entries = Faults(), dict[str, Any]()
    tables = dict[str, Any]()
    known = (*SECTIONS, *PROBLEM_SECTIONS, "cells")
    for name, section in table.items():
        with faults.noted():
            if name not in known:
                raise unknown(name, name, "section", known)
            if name in SECTIONS and not isinstance(section, dict):
                raise InputError(name, f"{quoted(section)}; it must be a section [{name}]")
            tables[name] = section
    macro = dict(tables.get("macro", {}))
    given = macro.pop("elements", (4, 4))
    elements = faults.take(check_value, "macro.elements", given, tuple[int, int], {"least": 1})
    entries["stated"] = faults.take(stated_problem, tables, path.parent, elements or (4, 4))
    entries["cells"] = faults.take(cell_types, tables)
    faults.take(_check_homes, tables)
    for name, kind in _SETTINGS.items():
        if name == "macro":
            entries[name] = faults.take(build, kind, macro, name, ("elements",))
        elif name in tables or name != "surface":
            entries[name] = faults.take(build, kind, tables.get(name, {}), name)
    faults.check()
    entries["macro"] = changed(entries["macro"], frames=entries["stated"].time.frames)
    return Recipe(path=path, **entries)


def changed(settings: T, **entries: Any) -> T:
    """The settings of a section with other entries; None leaves an entry as it is."""
    wanted = {name: value for name, value in entries.items() if value is not None}
    return replace(settings, **wanted)  # type: ignore[type-var]


def _check_homes(table: Mapping[str, Any]) -> None:
    """Refuse keys of [macro] that another section of the recipe has."""
    macro, time = table.get("macro", {}), table.get("time")
    homes = {"elements": "mesh" if set(PROBLEM_SECTIONS) & table.keys() else ""}
    homes["frames"] = "time" if isinstance(time, dict) and "frames" in time else ""
    for key, home in homes.items():
        if home and key in macro:
            raise InputError(f"macro.{key}", f"{quoted(macro[key])}; it stands in [{home}]")
