"""Study recipes: one TOML file that drives generate, train and run.

Each section of a recipe is the frozen dataclass of the layer it configures (`CellParameters`,
`RveSettings`, …), so names, types, defaults and bounds stand there and nowhere else; what is wrong
comes out as one `InputError` sentence.

`[mesh] [conditions] [bodies] [watch] [time]` state a problem, `[cell]` or `[cells]` its plant cells
and how their stress is sampled and learnt. What needs the mesh itself is checked where a command
needs the problem.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np
import skfem

from surrofe2.base.arrays import Flags, Index
from surrofe2.base.errors import FileError, InputError, quoted, shortened
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.settings import (
    Faults,
    build,
    check_settings,
    check_table,
    check_value,
    setting,
    unknown,
)
from surrofe2.base.units import LENGTH, TIME, with_micro_sign
from surrofe2.cache.settings import CacheSettings, TableSettings
from surrofe2.macro.elements import make_discretisation, points_by_region
from surrofe2.macro.settings import MacroSettings, SurfaceSettings
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import FREE, BodyForce, Condition, Foundation, Pressure, Traction
from surrofe2.problem.mesh import Part, boundary, nodes_on, rectangle, region
from surrofe2.problem.problem import Point, Problem, label, sections_of
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.recipe.entries import read_toml, with_changes, with_micro_keys
from surrofe2.rve.settings import RveSettings
from surrofe2.store.meshes import load_mesh
from surrofe2.store.store import digest, plain, read_text
from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
from surrofe2.tissue.settings import TissueSettings

T = TypeVar("T")


def _without(kind: type[T], key: str) -> Callable[[str, Any], T]:
    """Reads settings from a table that has another key, too, which is read elsewhere."""

    def read(where: str, entry: Any) -> T:
        check_table(where, entry)
        others = {name: value for name, value in entry.items() if name != key}
        return build(kind, others, where, (key,))

    return read


# The problem.

PROBLEM_SECTIONS = ("mesh", "conditions", "watch", "bodies", "time")
"""Those that state a problem."""

_PLACES: dict[type, Any] = {
    BodyForce: region,
    Traction: boundary,
    Pressure: boundary,
    Foundation: boundary,
}
"""What finds where a condition acts, if it is not `nodes_on`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshSettings:
    """A rectangle [0, width] × [0, height] of equal quadrilaterals, or a file."""

    width: float | None = setting(None, "extent in x", LENGTH, above=0.0)
    height: float | None = setting(None, "extent in y", LENGTH, above=0.0)
    elements: tuple[int, int] | None = setting(None, "elements in x and in y", least=1)
    file: str | None = setting(None, "mesh file, relative to the recipe", is_file=True)
    length_unit: Literal["µm", "um", "mm", "m"] | None = setting(
        None, "unit of lengths in the file; µm"
    )
    boundaries: Mapping[str, Part] | None = setting(
        None, "parts of the plane that hold outer sides"
    )
    regions: Mapping[str, Part] | None = setting(
        None, "parts of the plane that hold elements' centres"
    )

    def __post_init__(self) -> None:
        check_settings(self, "mesh")
        numbers = {"width": self.width, "height": self.height, "elements": self.elements}
        for name, value in numbers.items():
            if self.file is None and value is None:
                raise InputError(
                    f"mesh.{name}", "missing; a rectangle or a mesh.file must be given"
                )
            if self.file is not None and value is not None:
                raise InputError(f"mesh.{name}", f"{quoted(value)}; a mesh from a file has its own")
        if self.file is None and self.length_unit is not None:
            raise InputError(
                "mesh.length_unit", f"{quoted(self.length_unit)}; it is of a mesh.file"
            )

    def mesh(self, folder: Path) -> skfem.Mesh:
        """The mesh with the boundaries and regions that it has by itself."""
        if self.file is None:
            assert self.width is not None
            assert self.height is not None
            assert self.elements is not None
            mesh = rectangle(self.width, self.height, self.elements)
        else:
            try:
                mesh = load_mesh(folder / self.file, self.length_unit or "µm")
            except InputError as error:
                raise InputError("mesh.file", str(error)) from None
        for kind, known, more in (
            ("boundaries", mesh.boundaries, self.boundaries),
            ("regions", mesh.subdomains, self.regions),
        ):
            for name in {*(known or ())} & {*(more or ())}:
                raise InputError(
                    f"mesh.{kind}.{name}", "the mesh has one of that name; take another"
                )
        return mesh

    def to_dict(self) -> dict[str, Any]:
        """The section, defaults filled in."""
        parts = {
            kind: {name: part.entry() for name, part in (stated or {}).items()}
            for kind, stated in (("boundaries", self.boundaries), ("regions", self.regions))
        }
        return asdict(self) | parts


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSettings:
    """How long, and how often results are kept."""

    duration: float = setting(250.0, "length of the run", TIME, above=0.0)
    output_interval: float | None = setting(
        None, "time between rows of results; a five-hundredth of the duration", TIME, above=0.0
    )
    frames: int | None = setting(
        None, "number of times at which whole fields are kept; as macro.frames", least=2
    )

    def __post_init__(self) -> None:
        check_settings(self, "time")
        if self.output_interval is None:
            object.__setattr__(self, "output_interval", self.duration / 500.0)
        elif self.output_interval > self.duration:
            raise InputError(
                "time.output_interval",
                f"{self.output_interval}; it must be at most the duration, {self.duration} µs",
            )


def _conditions(where: str, entry: Any) -> tuple[Condition, ...]:
    """Conditions by name, or in a list."""
    if not isinstance(entry, list | dict):
        raise InputError(where, f"{quoted(entry)}; it must be a section [{where}]")
    if isinstance(entry, dict):
        named = [(f"{where}.{name}", one, name) for name, one in entry.items()]
    else:
        named = [(f"{where}[{k}]", one, None) for k, one in enumerate(entry)]
    acting, faults = dict[str, Condition](), Faults()
    for place, one, name in named:
        with faults.noted():
            condition = Condition.read(place, one, name)
            if label(condition) in acting:
                raise InputError(
                    place, f"a second one called {label(condition)}; give it another name"
                )
            acting[label(condition)] = condition
    faults.check()
    return tuple(acting.values())


def _bodies(where: str, entry: Any) -> tuple[RigidBody, ...]:
    return tuple(check_value(where, entry, Mapping[str, RigidBody], {}).values())


# Its plant cells.

REST = "rest"
"""As a region of a cell: what no other cell fills, unless the mesh has a region of that name."""
CELL_SECTIONS = ("range", "samples", "training")
"""Sections that a cell may have; what they leave out is as in the recipe's section."""
_WITH_FILE = ("samples", "training")
"""Those with a file, which cells cannot share."""
ALIASES = {"ghysels2009": "printed", "ghysels2009-light": "water"}
"""Presets by the paper that they are of."""
FIRST_COUNT, MOST_COUNT = 512, 16384
"""Samples that training begins with, and takes at most, where a recipe leaves their number out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSettings:
    """How many samples of the range, by which seed of the low-discrepancy sequence; their file."""

    count: int | None = setting(
        None,
        f"number of samples; left out: as many as training.bound needs, {MOST_COUNT} without one",
        least=1,
    )
    seed: int = setting(1, "seed of the sequence of samples", least=0)
    tangents: bool = setting(False, "whether ∂P/∂F and ∂P/∂Ḟ are sampled with the stress")
    file: str | None = setting(None, "file of the data set, relative to the recipe", is_file=True)

    def __post_init__(self) -> None:
        check_settings(self, "samples")

    def counts(self, bound: float) -> tuple[int, ...]:
        """How many samples training takes, in turn, until its bound is met.

        Args:
            bound: that training wants, of the spread of stress; 0: none, and so the most at once.
        """
        if self.count is not None or not bound:
            return (self.count or MOST_COUNT,)
        counts = [FIRST_COUNT]
        while counts[-1] < MOST_COUNT:
            counts.append(2 * counts[-1])
        return tuple(counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellType:
    """A plant cell, whether the recipe names its fluid, the regions it fills (of [cell] none are
    named: all of them), and how its stress is sampled and learnt."""

    preset: str
    cell: CellParameters
    names_fluid: bool
    regions: tuple[str, ...]
    training_file: str | None
    range: SamplingRange | None = setting(None, "range of (F, Ḟ)")
    samples: SampleSettings = setting(SampleSettings(), "samples of the stress in it")
    training: TrainingSettings = setting(
        TrainingSettings(), "training of its surrogate", read=_without(TrainingSettings, "file")
    )

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """The sections of a recipe that state it, defaults filled in."""
        sections = {
            "cell": {"preset": self.preset, **self.cell.to_dict()},
            "samples": asdict(self.samples),
            "training": {**asdict(self.training), "file": self.training_file},
        }
        return sections if self.range is None else sections | {"range": asdict(self.range)}


def cell_types(table: Mapping[str, Any]) -> dict[str, CellType]:
    """The cell types that a recipe's tables state, by name; that of [cell] is called "".

    Raises:
        InputError: naming the entry that is not what it must be.
    """
    shared = {name: table[name] for name in CELL_SECTIONS if name in table}
    if "cells" not in table:
        return {"": _cell_type("", table.get("cell", {}), shared)}
    cells = table["cells"]
    if not isinstance(cells, dict) or not cells:
        raise InputError(
            "cells", f"{quoted(cells)}; it must have a section [cells.NAME] for each cell"
        )
    if "cell" in table:
        raise InputError(
            "cell",
            "[cell] fills the tissue with one cell, [cells.NAME] with several; leave one out",
        )
    if "mesh" not in table:
        raise InputError(
            "cells", "[cells.NAME] fill regions of a mesh; the section [mesh] is missing"
        )
    for section in _WITH_FILE:
        file = shared.get(section, {}).get("file")
        if file is not None:
            raise InputError(
                f"{section}.file",
                f"{quoted(file)}; each cell has its own: give cells.NAME.{section}.file",
            )
    build(dict, shared, "", of=CellType)  # what is wrong there is reported once, of no cell
    faults = Faults()
    types = {name: faults.take(_cell_type, name, one, shared) for name, one in cells.items()}
    faults.check()
    whose = dict[tuple[str, str], str]()
    for name, each in types.items():
        for section, file in zip(_WITH_FILE, (each.samples.file, each.training_file), strict=True):
            first = name if file is None else whose.setdefault((section, str(Path(file))), name)
            if first != name:
                raise InputError(
                    f"cells.{name}.{section}.file", f"{quoted(file)}; that is {first}'s"
                )
    return types


def _cell_type(name: str, entries: Any, shared: Mapping[str, Mapping[str, Any]]) -> CellType:
    """The cell of [cell], called "", or [cells.NAME]; what its sections leave out is shared."""
    where, faults = f"cells.{name}" if name else "cell", Faults()
    if name and not re.fullmatch(r"[\w-]+", name):
        raise InputError(where, f"{quoted(name)}; a name must be of letters, digits, _ and -")
    if not isinstance(entries, dict):
        raise InputError(where, f"{quoted(entries)}; it must be a section [{where}]")
    extras = ("preset", "regions", *CELL_SECTIONS) if name else ("preset",)
    constants = {key: value for key, value in entries.items() if key not in extras}
    preset, regions, sections, cell = "", (), dict(shared), None
    with faults.noted():
        preset = check_value(f"{where}.preset", entries.get("preset", "printed"), str, {})
        preset = ALIASES.get(preset, preset)
        make = partial(CellParameters.preset, preset)
        cell = build(make, constants, where, extras, of=CellParameters)
    with faults.noted():
        stated = entries.get("regions", [name]) if name else []
        regions = check_value(f"{where}.regions", stated, tuple[str, ...], {})
        if name and not regions:
            raise InputError(f"{where}.regions", "[]; it must name a region of the mesh")
    for section in CELL_SECTIONS if name else ():
        with faults.noted():
            own = entries.get(section, {})
            check_table(f"{where}.{section}", own)
            if merged := {**shared.get(section, {}), **own}:
                sections[section] = merged
    settings = faults.take(partial(build, dict, sections, where if name else "", of=CellType))
    file, named = sections.get("training", {}).get("file"), "training.file"
    named = f"{where}.{named}" if name else named
    file = faults.take(check_value, named, file, str | None, {"is_file": True})
    faults.check()
    return CellType(
        preset=preset,
        cell=cell,
        names_fluid="fluid" in constants,
        regions=regions,
        training_file=file,
        **settings,
    )


def _takes_rest(cell: CellType, known: Container[str]) -> bool:
    """Whether a cell fills what no other does."""
    return not cell.regions or (REST in cell.regions and REST not in known)


def kinds_of_cells(
    problem: Problem, types: Mapping[str, CellType], counts: tuple[int, int]
) -> Index:
    """(n, m) which of the types each plant cell of a full tissue is, by where its middle lies.

    Raises:
        InputError: a plant cell is of none, or of two.
    """
    known, side = problem.mesh.subdomains or {}, next(iter(types.values())).cell.cell_side
    kind = np.full(counts, -1)

    def at(where: Flags) -> str:
        x, y = side * (np.argwhere(where)[0] + 0.5)
        return f"({x:g}, {y:g}) µm"

    for k, (name, each) in enumerate(types.items()):
        for part in (part for part in each.regions if part in known):
            inside = problem.cells_inside(part, counts, side)
            twice = inside & (kind >= 0) & (kind != k)
            if twice.any():
                raise InputError(
                    f"cells.{name}.regions",
                    f"{part}; the plant cell at {at(twice)} is of another type, too",
                )
            kind[inside] = k
    for k, each in enumerate(types.values()):
        if _takes_rest(each, known):
            kind[kind < 0] = k
    if (kind < 0).any():
        raise InputError("cells", f"none fills the plant cell at {at(kind < 0)}; give it a type")
    return kind


# All of it.

_LONGEST_NAME = 200
"""Bytes of a file's name; others that are made from it are longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything a study needs. `path` is the recipe's file, against which its files resolve.

    Attributes:
        cells: by name; that of a section [cell] is called "".
        part: name of the selected cell; None: the only one, or all of several.
        is_bar: whether section [load] states the problem.
        sha256: of the mesh file.
    """

    path: Path
    cells: Mapping[str, CellType]
    mesh: MeshSettings = setting(about="the tissue")
    conditions: tuple[Condition, ...] = setting((), "what holds and loads it", read=_conditions)
    bodies: tuple[RigidBody, ...] = setting((), "that it touches", read=_bodies)
    watch: Mapping[str, Point] | None = setting(None, "points by name", LENGTH)
    time: TimeSettings = setting(TimeSettings(), "time of the run")
    rve: RveSettings = setting(RveSettings(), "how RVEs are solved")
    calibration: CalibrationSettings = setting(
        CalibrationSettings(), "paths that calibrate the error's bound"
    )
    macro: MacroSettings = setting(
        MacroSettings(), "settings of the finite elements", read=_without(MacroSettings, "elements")
    )
    tissue: TissueSettings = setting(TissueSettings(), "settings of full tissues")
    table: TableSettings = setting(TableSettings(), "table of RVE stresses")
    surface: SurfaceSettings | None = setting(None, "free sides with a law of their own")
    cache: CacheSettings = setting(CacheSettings(), "cache of RVE stresses, by a surrogate")
    part: str | None = None
    is_bar: bool = False
    sha256: str | None = None

    def parts(self, name: str | None = None) -> dict[str, Recipe]:
        """The recipe for each of its cells by name, or for the selected one."""
        name = None if name is None else with_micro_sign(name)
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

    def points_of_cells(self, mesh: skfem.Mesh) -> dict[str, Index]:
        """Numbers of the points of the mesh that each cell fills; together the whole mesh.

        Raises:
            InputError: there is no such region, or an element is of no cell or of two.
        """
        known, filled = mesh.subdomains or {}, dict[str, Index]()
        for name, each in self.cells.items():
            parts = [part for part in each.regions if part in known or part != REST]
            inside = [region(mesh, part, f"cells.{name}.regions") for part in parts]
            filled[name] = np.unique(np.concatenate([np.zeros(0, np.int64), *inside]))
        others = np.setdiff1d(np.arange(mesh.nelements), np.concatenate([*filled.values()]))
        for name, each in self.cells.items():
            if _takes_rest(each, known):
                filled[name] = np.union1d(filled[name], others)
            if not filled[name].size:
                raise InputError(
                    f"cells.{name}.regions", f"{REST}; the other cells fill the whole mesh"
                )
        return points_by_region(mesh.with_subdomains(filled), tuple(filled), "cells")

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
            problem = Problem(
                mesh=self.mesh.mesh(self.path.parent),
                conditions=self.conditions,
                bodies=self.bodies,
                duration=self.time.duration,
                output_interval=self.time.output_interval or self.time.duration,
                watched=self.watch or {},
                boundaries=self.mesh.boundaries or {},
                regions=self.mesh.regions or {},
            )
            mesh, space = problem.mesh, make_discretisation(problem.mesh)
            for condition in self.conditions:
                find = _PLACES.get(type(condition), nodes_on)
                find(mesh, condition.on, f"conditions.{label(condition)}.on")
            for body in self.bodies:
                boundary(mesh, body.on, f"bodies.{body.name}.on")
            for name, at in (self.watch or {}).items():
                try:
                    space.locate(np.array(at), f"watch.{name}")
                except InputError as error:
                    x, y = mesh.p[:, np.hypot(*(mesh.p.T - np.array(at)).T).argmin()]
                    message = f"{error}, whose nearest node is at ({x:.6g}, {y:.6g}) µm"
                    raise InputError(message) from None
            self.points_of_cells(mesh)
            if self.surface is not None and self.surface.on != FREE:
                for name in self.surface.on:
                    boundary(mesh, name, "surface.on")
            return problem

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.time.duration

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
        stated = {name: getattr(self, name) for name in _OF_ALL_CELLS}
        settings = {name: asdict(each) for name, each in stated.items() if each is not None}
        if self.part is not None or "" in self.cells:
            cells = self.cells[self.cell_name].to_dict()
        else:
            cells = {"cells": {name: _entries(each) for name, each in self.cells.items()}}
        problem = {
            "mesh": {**self.mesh.to_dict(), "sha256": self.sha256},
            **sections_of(self.conditions, self.bodies, self.watch or {}),
            "time": self.time,
        }
        plainly: dict[str, Any] = plain({"recipe": self.path.name, **cells, **settings, **problem})
        return plainly


def _entries(cell: CellType) -> dict[str, Any]:
    """What a section [cells.NAME] has."""
    sections = cell.to_dict()
    return {**sections.pop("cell"), "regions": list(cell.regions), **sections}


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
_OF_ALL_CELLS = ("rve", "calibration", "macro", "tissue", "table", "surface", "cache")

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
        table = read_toml(read_text(path, _MOST))
    except ValueError as error:  # an integer may have too many digits, too
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
    faults, tables = Faults(), dict[str, Any]()
    known = (*SECTIONS, *PROBLEM_SECTIONS, "cells")
    for name, section in with_micro_keys(table).items():
        with faults.noted():
            if name not in known:
                raise unknown(name, name, "section", known)
            if name in SECTIONS and not isinstance(section, dict):
                raise InputError(name, f"{quoted(section)}; it must be a section [{name}]")
            tables[name] = section
    stated = [name for name in PROBLEM_SECTIONS if name in tables]
    entries = {name: each for name, each in tables.items() if name in (*stated, *_OF_ALL_CELLS)}
    given: dict[str, Any] = {"path": path, "is_bar": not stated}
    macro, time = tables.get("macro", {}), tables.get("time")
    has_frames = isinstance(time, dict) and "frames" in time
    for key, home, is_there in (("elements", "mesh", stated), ("frames", "time", has_frames)):
        if is_there and key in macro:
            with faults.noted():
                raise InputError(f"macro.{key}", f"{quoted(macro[key])}; it stands in [{home}]")
    if stated:
        with faults.noted():
            if "load" in tables:
                raise InputError(
                    "load",
                    f"[load] states the paper's bar, [{stated[0]}] another problem; leave one out",
                )
            if "mesh" not in tables:
                raise InputError("mesh", f"missing; [{stated[0]}] needs the section [mesh]")
        with faults.noted():
            if not any(tables.get(name, {}) not in ({}, []) for name in ("conditions", "bodies")):
                raise InputError("conditions", "missing; something must hold or move the tissue")
    else:
        value = macro.get("elements", (4, 4))
        elements = faults.take(check_value, "macro.elements", value, tuple[int, int], {"least": 1})
        bar = faults.take(build, LoadSettings, tables.get("load", {}), "load")
        entries |= bar.sections(elements or (4, 4)) if bar else {}
    if "mesh" not in entries:
        given["mesh"] = None  # a fault that was noted says so
    given |= faults.take(partial(build, dict, entries, "", of=Recipe, **given)) or {}
    mesh = entries.get("mesh")
    if isinstance(mesh, dict) and isinstance(mesh.get("file"), str):
        with faults.noted():
            try:
                given["sha256"] = digest(path.parent / mesh["file"])
            except FileError as error:
                raise FileError(f"mesh.file: {error}") from None
    given["cells"] = faults.take(cell_types, tables)
    faults.check()
    recipe = Recipe(**given)
    return replace(recipe, macro=changed(recipe.macro, frames=recipe.time.frames))


def changed(settings: T, **entries: Any) -> T:
    """The settings of a section with other entries; None leaves an entry as it is."""
    wanted = {name: value for name, value in entries.items() if value is not None}
    return replace(settings, **wanted)  # type: ignore[type-var]
