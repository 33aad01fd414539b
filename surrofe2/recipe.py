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

from surrofe2.cache.settings import CacheSettings, TableSettings
from surrofe2.cell_types import CellType, SampleSettings, cell_types, points_of_cells
from surrofe2.errors import FileError, InputError, quoted, shortened
from surrofe2.macro.settings import MacroSettings, SurfaceSettings
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import FREE
from surrofe2.problem.mesh import boundary
from surrofe2.problem.problem import Problem
from surrofe2.problem_sections import SECTIONS as PROBLEM_SECTIONS
from surrofe2.problem_sections import StatedProblem, stated_problem
from surrofe2.recipe_entries import with_changes
from surrofe2.rve.settings import RveSettings
from surrofe2.sampling import SamplingRange
from surrofe2.settings import check_value, from_table, unknown
from surrofe2.store.store import plain
from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
from surrofe2.tissue.settings import TissueSettings

T = TypeVar("T")

_LONGEST_NAME = 200
"""Bytes of a file's name; others that are made from it are longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything a study needs. `path` is the recipe's file, against which its files resolve.

    Attributes:
        stated: the problem.
        types: cells by name, of a recipe with [cells.NAME]; its `cell` is the first of them.
        cell_name: whose the recipe is, where it is a part of one with several: its `siblings`,
            itself among them.
    """

    path: Path
    preset: str
    cell: CellParameters
    rve: RveSettings
    range: SamplingRange | None = None
    samples: SampleSettings
    training: TrainingSettings
    calibration: CalibrationSettings
    stated: StatedProblem
    macro: MacroSettings
    tissue: TissueSettings
    table: TableSettings
    surface: SurfaceSettings | None = None
    cache: CacheSettings = field(default_factory=CacheSettings)
    training_file: str | None = None
    types: Mapping[str, CellType] = field(default_factory=dict)
    cell_name: str | None = None
    siblings: Mapping[str, CellType] = field(default_factory=dict)

    def parts(self, name: str | None = None) -> dict[str, Recipe]:
        """A recipe of one cell for each of [cells.NAME]; of a recipe with [cell], itself by "".

        Args:
            name: of the only cell wanted.

        Raises:
            InputError: there is no cell of that name.
        """
        if name is not None and name not in self.types:
            raise InputError(
                unknown(f"--cell: {quoted(name)}", name, "cell", self.types or ("[cell]",))
            )
        names = self.types if name is None else (name,)
        return {each: self._part(each) for each in names} if names else {"": self}

    def _part(self, name: str) -> Recipe:
        each = self.types[name]
        return replace(
            self,
            preset=each.preset,
            cell=each.cell,
            range=each.range,
            samples=each.samples,
            training=each.training,
            training_file=each.training_file,
            types={},
            cell_name=name,
            siblings=self.types,
        )

    def whole(self) -> Recipe:
        """The recipe that this is a part of; itself where it is of no other."""
        if not self.siblings:
            return self
        return replace(self, types=self.siblings, siblings={}, cell_name=None)

    def check_one_cell(self) -> None:
        """Refuse a recipe of several cells where one is meant.

        Raises:
            InputError: it has several.
        """
        if self.types:
            raise InputError(
                f"{self.path.name}: cells: {', '.join(self.types)}; this needs a recipe with one "
                "[cell]"
            )

    @property
    def fingerprint(self) -> str:
        """Of the cell, or of all cells in their order."""
        return " ".join(part.cell.fingerprint for part in self.parts().values())

    @property
    def cell_section(self) -> str:
        """Where the cell stands in the file."""
        return "cell" if self.cell_name is None else f"cells.{self.cell_name}"

    def points_of_cells(self, mesh: skfem.Mesh) -> dict[str, NDArray[np.int64]]:
        """Numbers of the points of the mesh that each of several cells fills.

        Raises:
            InputError: there is no such region, or an element is of no cell or of two.
        """
        return points_of_cells(mesh, self.types)

    def sampling_range(self) -> SamplingRange:
        """The range of (F, Ḟ), for what cannot do without.

        Raises:
            InputError: the recipe has none.
        """
        if self.range is None:
            name = self._own("range")
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
            if self.types:
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
        return self._path_of("training", self.training_file, "trained surrogate (.safetensors)")

    def added_paths(self) -> tuple[Path, ...]:
        """Harvests that training takes in besides the data set."""
        return tuple(Path(os.path.normpath(self.path.parent / name)) for name in self.samples.add)

    def _path_of(self, section: str, file: str | None, what: str) -> Path:
        self.check_one_cell()
        if file is None:
            raise InputError(
                f"{self.path.name}: {self._own(section)}.file: missing; this command needs the "
                f"file of the {what}, relative to the recipe"
            )
        if "\0" in file or max(len(os.fsencode(part)) for part in file.split("/")) > _LONGEST_NAME:
            raise InputError(
                f"{self.path.name}: {self._own(section)}.file: {quoted(file)}; no file can be "
                "called so"
            )
        return Path(os.path.normpath(self.path.parent / file))

    def _own(self, section: str) -> str:
        """Where the section of the cell stands in the file."""
        return section if self.cell_name is None else f"{self.cell_section}.{section}"

    def to_dict(self) -> dict[str, Any]:
        """The whole recipe, defaults filled in, as JSON can hold it; no absolute folder."""
        entries = asdict(replace(self, types={}, siblings={}))
        sections = {name: entries[name] for name in SECTIONS if entries.get(name) is not None}
        sections["cell"] = {"preset": self.preset, **self.cell.to_dict()}
        sections["training"]["file"] = self.training_file
        if self.types:
            del sections["cell"]
            sections["cells"] = {name: each.to_dict() for name, each in self.types.items()}
        plainly: dict[str, Any] = plain(
            {"recipe": self.path.name, **sections, **self.stated.to_dict()}
        )
        return plainly


SECTIONS: dict[str, type] = {
    "cell": CellParameters,
    "rve": RveSettings,
    "range": SamplingRange,
    "samples": SampleSettings,
    "training": TrainingSettings,
    "calibration": CalibrationSettings,
    "load": LoadSettings,
    "macro": MacroSettings,
    "tissue": TissueSettings,
    "table": TableSettings,
    "surface": SurfaceSettings,
    "cache": CacheSettings,
}
"""Sections of settings by name; others state a problem, or several cells."""
_NOT_NEEDED = ("range", "surface")
"""Sections that a recipe may do without; each other one has a default for all it must have."""
_EXTRA_KEYS: dict[str, tuple[str, Any, Any, dict[str, Any]]] = {
    "cell": ("preset", str, "printed", {}),
    "training": ("file", str | None, None, {}),
    "macro": ("elements", tuple[int, int], (4, 4), {"least": 1}),
}
"""Keys besides the fields of the sections: name, type, default and bounds."""


def load_recipe(path: str | Path, changes: Mapping[str, Any] = MappingProxyType({})) -> Recipe:
    """Read and check a study recipe.

    Args:
        changes: values by dotted name of the entry, {"cell.wall_stiffness": 3000.0}, in the place
            of those in the file.

    Raises:
        FileError: the file is not there or cannot be read.
        InputError: not TOML, an unknown or missing key, a wrong type or a value out of bounds.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # an integer may have too many digits, too
        raise InputError(f"{path.name}: not TOML: {shortened(str(error), 150)}") from None
    try:
        return make_recipe(with_changes(table, changes), path)
    except (FileError, InputError) as error:
        raise type(error)(f"{path.name}: {error}") from None


def make_recipe(table: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """A recipe from the nested tables of a TOML file.

    Raises:
        InputError: naming the section or key that is unknown or out of its range.
    """
    for name, section in table.items():
        known = (*SECTIONS, *PROBLEM_SECTIONS, "cells")
        if name not in known:
            raise InputError(unknown(name, name, "section", known))
        if name in SECTIONS and not isinstance(section, dict):
            raise InputError(f"{name}: {quoted(section)}; it must be a section [{name}]")
    given = {name: dict(table.get(name, {})) for name in SECTIONS}
    extras: dict[str, Any] = {}
    for section, (key, kind, default, bounds) in _EXTRA_KEYS.items():
        value = given[section].pop(key, default)
        extras[section] = check_value(f"{section}.{key}", value, kind, bounds)
    stated, types = stated_problem(table, path.parent, extras["macro"]), cell_types(table)
    _check_homes(table)
    made: dict[str, Any] = {
        name: from_table(name, kind, given[name], _EXTRA_KEYS.get(name, ())[:1])
        for name, kind in SECTIONS.items()
        if name != "load" and (name in table or name not in _NOT_NEEDED)
    }
    preset = extras["cell"]
    made["cell"] = CellParameters.preset(preset, **given["cell"])
    if types:
        first = next(iter(types.values()))
        preset, made["cell"], made["types"] = first.preset, first.cell, types
    made["macro"] = changed(made["macro"], frames=stated.time.frames)
    return Recipe(path=path, preset=preset, training_file=extras["training"], stated=stated, **made)


def changed(settings: T, **given: Any) -> T:
    """The settings of a section with other entries; None leaves an entry as it is."""
    wanted = {name: value for name, value in given.items() if value is not None}
    return replace(settings, **wanted)  # type: ignore[type-var]


def _check_homes(table: Mapping[str, Any]) -> None:
    """Refuse keys of [macro] that another section of the recipe has."""
    homes = {"elements": "mesh" if set(PROBLEM_SECTIONS) & table.keys() else ""}
    homes["frames"] = "time" if "frames" in table.get("time", {}) else ""
    for key, home in homes.items():
        if home and key in table.get("macro", {}):
            raise InputError(f"macro.{key}: {quoted(table['macro'][key])}; it stands in [{home}]")
