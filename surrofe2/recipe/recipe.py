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

from surrofe2.base.arrays import Array, Flags, Index
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
from surrofe2.macro.settings import MacroSettings, RestSettings, SurfaceSettings
from surrofe2.plant_cell.measurements import MEASUREMENTS, living_cell, overruled
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import FREE, BodyForce, Condition, Foundation, Pressure, Traction
from surrofe2.problem.mesh import Part, boundary, nodes_on, rectangle, region
from surrofe2.problem.problem import Point, Problem, label, sections_of
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.recipe.entries import read_toml, toml_text, with_changes, with_micro_keys
from surrofe2.rve.settings import RveSettings
from surrofe2.store.labelled_image import LINE
from surrofe2.store.meshes import load_mesh
from surrofe2.store.run_folder import INPUT, RECIPE
from surrofe2.store.store import digest, plain, read_text
from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
from surrofe2.tissue.settings import TissueSettings

T = TypeVar("T")


def _without(kind: type[T], key: str) -> Callable[[str, Any], T]:
    """Make a reader of settings whose table has one more key, which is read elsewhere."""

    def read(where: str, entry: Any) -> T:
        """Read the settings at this place, without the further key."""
        check_table(where, entry)
        others = {name: value for name, value in entry.items() if name != key}
        return build(kind, others, where, (key,))  # the key counts as known in messages

    return read


# The problem.

# Sections that state a problem.
PROBLEM_SECTIONS = ("mesh", "conditions", "watch", "bodies", "time")

# The function that looks up where a condition acts; of conditions that are not here, `nodes_on`.
_PLACES: dict[type, Any] = {
    BodyForce: region,
    Traction: boundary,
    Pressure: boundary,
    Foundation: boundary,
}


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
        """Make or read the mesh, with the boundaries and regions that it has by itself.

        Args:
            folder: the recipe's folder, against which a file resolves.

        Raises:
            FileError: the mesh file cannot be read.
            InputError: it is no mesh, or has a name already that the recipe uses for a part.
        """
        if self.file is None:
            # `__post_init__` has checked these
            assert self.width is not None
            assert self.height is not None
            assert self.elements is not None
            mesh = rectangle(self.width, self.height, self.elements)
        else:
            try:
                mesh = load_mesh(folder / self.file, self.length_unit or "µm")
            except InputError as error:
                raise InputError("mesh.file", str(error)) from None
        for kind, known, stated in (
            ("boundaries", mesh.boundaries, self.boundaries),
            ("regions", mesh.subdomains, self.regions),
        ):
            for name in stated or {}:
                if name in (known or {}):
                    raise InputError(
                        f"mesh.{kind}.{name}", "the mesh has one of that name; take another"
                    )
        return mesh

    def to_dict(self) -> dict[str, Any]:
        """Return the section, with defaults filled in."""
        # a part of the plane writes its own entry, where `asdict` would lose its kind
        section = asdict(self)
        section["boundaries"] = {
            name: part.entry() for name, part in (self.boundaries or {}).items()
        }
        section["regions"] = {name: part.entry() for name, part in (self.regions or {}).items()}
        return section


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageSettings:
    """A labelled image, whose outlines are the walls of a full tissue."""

    file: str = setting(
        about="TIFF, PNG or NPY with a number for each cell, relative to the recipe", is_file=True
    )
    pixel: float = setting(about="side of a pixel", unit=LENGTH, above=0.0)
    line: int = setting(LINE, "most pixels across a line between cells", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "image")


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSettings:
    """Length of a run, and how often results are kept."""

    duration: float = setting(250.0, "length of the run", TIME, above=0.0)
    output_interval: float | None = setting(
        None, "time between rows of results; a five-hundredth of the duration", TIME, above=0.0
    )
    output_times: tuple[float, ...] | None = setting(
        None, "times of rows of results, instead of an interval", TIME, above=0.0
    )
    outputs_per_decade: int | None = setting(
        None,
        "rows in each decade of time, at equal ratios, from output_interval on",
        least=1,
        most=1000,
    )
    frames: int | None = setting(
        None, "number of times at which whole fields are kept; as macro.frames", least=2
    )

    def __post_init__(self) -> None:
        check_settings(self, "time")
        if self.output_times is not None:
            self._check_output_times(self.output_times)
        elif self.output_interval is None:
            # the way to change a frozen dataclass while it is made
            object.__setattr__(self, "output_interval", self.duration / 500.0)
        elif self.output_interval > self.duration:
            raise InputError(
                "time.output_interval",
                f"{self.output_interval}; it must be at most the duration, {self.duration} µs",
            )

    def _check_output_times(self, times: tuple[float, ...]) -> None:
        """Check that times of rows increase within the duration, and that nothing else states them.

        Raises:
            InputError: naming the entry that is not so.
        """
        for name in ("output_interval", "outputs_per_decade"):
            if getattr(self, name) is not None:
                raise InputError(f"time.{name}", "not with output_times; leave one out")
        steps = np.diff([0.0, *times])  # the first time must be positive, too
        if not (steps.size and (steps > 0.0).all() and times[-1] <= self.duration):
            raise InputError(
                "time.output_times",
                f"{quoted(list(times))}; they must increase, up to at most the duration, "
                f"{self.duration} µs",
            )

    @property
    def times(self) -> tuple[float, ...] | None:
        """Times of rows of results, µs; None where they are multiples of the interval."""
        if self.outputs_per_decade is None or self.output_interval is None:
            return self.output_times
        if self.output_interval == self.duration:
            return (self.duration,)
        decades = np.log10(self.duration / self.output_interval)
        # a whole number of rows: the last one is at the end, and ratios are nearly those asked for
        count = max(1, round(decades * self.outputs_per_decade))
        return tuple(np.geomspace(self.output_interval, self.duration, count + 1).tolist())


def _conditions(where: str, entry: Any) -> tuple[Condition, ...]:
    """Read conditions, which stand by name in [conditions.NAME] or in a list [[conditions]]."""
    if not isinstance(entry, list | dict):
        raise InputError(where, f"{quoted(entry)}; it must be a section [{where}]")
    stated: list[tuple[str, Any, str | None]]  # place in the recipe, table, name
    if isinstance(entry, dict):
        stated = [(f"{where}.{name}", table, name) for name, table in entry.items()]
    else:
        stated = [(f"{where}[{k}]", table, None) for k, table in enumerate(entry)]
    conditions: dict[str, Condition] = {}
    faults = Faults()
    for place, table, name in stated:
        with faults.noted():
            condition = Condition.read(place, table, name)
            if label(condition) in conditions:
                raise InputError(
                    place, f"a second one called {label(condition)}; give it another name"
                )
            conditions[label(condition)] = condition
    faults.check()
    return tuple(conditions.values())


def _bodies(where: str, entry: Any) -> tuple[RigidBody, ...]:
    """Read the rigid bodies of [bodies.NAME]."""
    return tuple(check_value(where, entry, Mapping[str, RigidBody], {}).values())


# Its plant cells.

# Name of a plant cell, that of its section [cells.NAME]; None: the one of [cell], which fills the
# tissue and needs no name.
CellName = str | None
# Region that a cell names to fill what no other cell fills. A region of the mesh by that name comes
# before this meaning.
REST = "rest"
# Sections that a cell may have; keys that they leave out are those of the recipe's section.
CELL_SECTIONS = ("range", "samples", "training")
# Of these, the sections with a file, which cells cannot share.
_WITH_FILE = ("samples", "training")
# Further names of presets: the paper from which each comes.
ALIASES = {"ghysels2009": "printed", "ghysels2009-light": "water"}
# Samples that training begins with, and takes at most, where a recipe leaves their number out.
FIRST_COUNT = 512
MOST_COUNT = 16384


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSettings:
    """Number of samples of the range, the seed of the low-discrepancy sequence, and their file."""

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
        """Return the numbers of samples that training takes, in turn, until its bound is met.

        Args:
            bound: bound of the error that training is to reach, as a fraction of the spread of
                stress. Without one (0) training takes the largest number at once.
        """
        if self.count is not None:
            return (self.count,)
        if not bound:
            return (MOST_COUNT,)
        counts = [FIRST_COUNT]
        while counts[-1] < MOST_COUNT:
            counts.append(2 * counts[-1])  # a Sobol sequence is balanced at powers of 2
        return tuple(counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellType:
    """A plant cell of a recipe, with how its stress is sampled and learnt.

    Attributes:
        preset: name of the preset of its parameters.
        parameters: the constants of its walls, contacts and fluid, and how cells are arranged.
        names_fluid: whether the recipe names its fluid, and does not leave it to the preset.
        overruled: constants in the recipe that are not taken, each with the measurement beside it
            that determines it.
        regions: regions of the mesh that it fills; empty for [cell], which fills all of them.
        training_file: file of its surrogate, relative to the recipe.
        range: range of (F, Ḟ) in which its stress is sampled and learnt.
    """

    preset: str
    parameters: CellParameters
    names_fluid: bool
    overruled: Mapping[str, str]
    regions: tuple[str, ...]
    training_file: str | None
    range: SamplingRange | None = setting(None, "range of (F, Ḟ)")
    samples: SampleSettings = setting(SampleSettings(), "samples of the stress in it")
    training: TrainingSettings = setting(
        TrainingSettings(), "training of its surrogate", read=_without(TrainingSettings, "file")
    )

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the sections of a recipe that state this cell, with defaults filled in."""
        sections = {
            "cell": {"preset": self.preset, **self.parameters.to_dict()},
            "samples": asdict(self.samples),
            "training": {**asdict(self.training), "file": self.training_file},
        }
        if self.range is not None:
            sections["range"] = asdict(self.range)
        return sections


def cell_types(table: Mapping[str, Any]) -> dict[CellName, CellType]:
    """Read the cell types that a recipe's tables state, by name.

    Raises:
        InputError: naming the entry that is not what it must be.
    """
    shared = {name: table[name] for name in CELL_SECTIONS if name in table}
    if "cells" not in table:
        return {None: _cell_type(None, table.get("cell", {}), shared)}
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
    build(dict, shared, "", of=CellType)  # reports faults there once, instead of for each cell
    faults = Faults()
    types = {name: faults.take(_cell_type, name, entry, shared) for name, entry in cells.items()}
    faults.check()
    _check_files_differ(types)
    return types


def _check_files_differ(types: Mapping[CellName, CellType]) -> None:
    """Reject a file of samples or of a surrogate that two cells name: one would overwrite it."""
    owners: dict[tuple[str, str], CellName] = {}  # name of the cell, by section and file
    for name, cell in types.items():
        files = (cell.samples.file, cell.training_file)
        for section, file in zip(_WITH_FILE, files, strict=True):
            if file is None:
                continue
            # `Path` makes "./a.h5" and "a.h5" the same
            owner = owners.setdefault((section, str(Path(file))), name)
            if owner != name:
                raise InputError(
                    f"cells.{name}.{section}.file", f"{quoted(file)}; that is {owner}'s"
                )


def _cell_type(name: CellName, entries: Any, shared: Mapping[str, Mapping[str, Any]]) -> CellType:
    """Read the cell of [cell], which has no name, or of [cells.NAME].

    Args:
        name: NAME, or None.
        entries: the table of that section.
        shared: the recipe's sections of `CELL_SECTIONS`, for keys that the cell's leave out.

    Raises:
        InputError: its `faults` are all faults of the cell.
    """
    is_named = name is not None
    where = f"cells.{name}" if is_named else "cell"
    if name is not None and not re.fullmatch(r"[\w-]+", name):
        raise InputError(where, f"{quoted(name)}; a name must be of letters, digits, _ and -")
    if not isinstance(entries, dict):
        raise InputError(where, f"{quoted(entries)}; it must be a section [{where}]")
    other_keys = ("preset", "regions", *CELL_SECTIONS) if is_named else ("preset",)
    parameters = {key: value for key, value in entries.items() if key not in other_keys}
    # Faults are noted and reading continues, so that a recipe's faults are reported together. The
    # values here stand where a fault is noted; `faults.check` raises before they are used.
    faults = Faults()
    preset = ""
    cell: Any = None
    regions: tuple[str, ...] = ()
    with faults.noted():
        preset = check_value(f"{where}.preset", entries.get("preset", "printed"), str, {})
        preset = ALIASES.get(preset, preset)
        make = partial(living_cell, preset)
        # measurements are checked where the constants are translated
        measured = {key: value for key, value in parameters.items() if key in MEASUREMENTS}
        constants = {key: value for key, value in parameters.items() if key not in MEASUREMENTS}
        known = (*other_keys, *MEASUREMENTS)
        cell = build(make, constants, where, known, of=CellParameters, **measured)
    if is_named:
        with faults.noted():
            stated = entries.get("regions", [name])  # by default the region of its own name
            regions = check_value(f"{where}.regions", stated, tuple[str, ...], {})
            if not regions:
                raise InputError(f"{where}.regions", "[]; it must name a region of the mesh")
    sections = dict(shared)
    if is_named:
        for section in CELL_SECTIONS:
            with faults.noted():
                table = entries.get(section, {})
                check_table(f"{where}.{section}", table)
                merged = {**shared.get(section, {}), **table}
                if merged:
                    sections[section] = merged
    prefix = where if is_named else ""
    settings = faults.take(partial(build, dict, sections, prefix, of=CellType))
    file_entry = f"{where}.training.file" if is_named else "training.file"
    stated_file = sections.get("training", {}).get("file")
    training_file = faults.take(check_value, file_entry, stated_file, str | None, {"is_file": True})
    faults.check()
    return CellType(
        preset=preset,
        parameters=cell,
        names_fluid="fluid" in parameters,
        overruled=overruled(parameters),
        regions=regions,
        training_file=training_file,
        **settings,
    )


def _takes_rest(cell: CellType, known: Container[str]) -> bool:
    """Return whether a cell fills what no other does; `known` are the regions of the mesh."""
    return not cell.regions or (REST in cell.regions and REST not in known)


def kinds_of_cells(problem: Problem, types: Mapping[CellName, CellType], middles: Array) -> Index:
    """Return the number (n,) of the type of each plant cell of a full tissue.

    Args:
        problem: the problem, with the regions that the types fill.
        types: the types of plant cell by name.
        middles: (n, 2) middles of the tissue's plant cells, µm.

    Raises:
        InputError: a plant cell is of none, or of two.
    """
    known = problem.mesh.subdomains or {}
    kind = np.full(len(middles), -1)  # of no type yet

    def first_place(where: Flags) -> str:
        """Write the place of the first of the cells that are flagged, for a message."""
        x, y = middles[where][0]
        return f"({x:g}, {y:g}) µm"

    for k, (name, cell) in enumerate(types.items()):
        for part in cell.regions:
            if part not in known:  # "rest", which is filled below
                continue
            inside = problem.cells_inside(part, middles)
            twice = inside & (kind >= 0) & (kind != k)
            if twice.any():
                raise InputError(
                    f"cells.{name}.regions",
                    f"{part}; the plant cell at {first_place(twice)} is of another type, too",
                )
            kind[inside] = k
    for k, cell in enumerate(types.values()):
        if _takes_rest(cell, known):
            kind[kind < 0] = k
    if (kind < 0).any():
        place = first_place(kind < 0)
        raise InputError("cells", f"none fills the plant cell at {place}; give it a type")
    return kind


# All of it.

# Longest name of a file, bytes. File systems allow 255, and names made from this one are longer.
_LONGEST_NAME = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """The content of a recipe: everything that a study needs.

    Fields that are not listed here are sections, described at their settings.

    Attributes:
        path: the recipe's file, against which its files resolve.
        cells: plant cells by name; that of a section [cell] has the name None.
        is_bar: whether section [load] states the problem.
        sha256: digest of the mesh file; None without one.
        image_sha256: digest of the image file; None without one.
    """

    path: Path
    cells: Mapping[CellName, CellType]
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
    image: ImageSettings | None = setting(None, "outlines of the cells of a full tissue")
    rest: RestSettings | None = setting(None, "load steps to rest, instead of a run in time")
    surface: SurfaceSettings | None = setting(None, "free sides with a law of their own")
    cache: CacheSettings = setting(CacheSettings(), "cache of RVE stresses, by a surrogate")
    is_bar: bool = False
    sha256: str | None = None
    image_sha256: str | None = None

    def study(self) -> CellStudy:
        """Return the study of the only plant cell.

        Raises:
            InputError: there are several.
        """
        if len(self.cells) > 1:
            names = ", ".join(str(name) for name in self.cells)
            raise InputError(
                f"{self.path.name}: cells: {names}; this needs a recipe with one [cell]"
            )
        return CellStudy(self, next(iter(self.cells)))

    def studies(self, name: str | None = None) -> dict[CellName, CellStudy]:
        """Return the studies of all plant cells by name, or of the one that is named.

        Raises:
            InputError: there is no cell of that name; the cell of [cell] has none.
        """
        if name is None:
            return {cell_name: CellStudy(self, cell_name) for cell_name in self.cells}
        name = with_micro_sign(name)
        if name not in self.cells:
            known = [cell_name or "[cell]" for cell_name in self.cells]
            raise unknown(f"--cell: {quoted(name)}", name, "cell", known)
        return {name: CellStudy(self, name)}

    @property
    def fingerprint(self) -> str:
        """The fingerprints of the parameters of all cells, in their order."""
        return " ".join(cell.parameters.fingerprint for cell in self.cells.values())

    def points_of_cells(self, mesh: skfem.Mesh) -> dict[str, Index]:
        """Return the numbers of the points of the mesh that each cell of [cells.NAME] fills.

        Together the cells fill the whole mesh. The cell of [cell] needs no such numbers: it fills
        every point, and the dictionary is empty.

        Raises:
            InputError: there is no such region, or an element is of no cell or of two.
        """
        regions = mesh.subdomains or {}
        named = {name: cell for name, cell in self.cells.items() if name is not None}
        if not named:
            return {}
        elements_of: dict[str, Index] = {}
        for name, cell in named.items():
            # an empty array, so that the cell of "rest" alone can be concatenated, too
            members = [np.zeros(0, np.int64)]
            for part in cell.regions:
                is_remainder = part == REST and part not in regions
                if not is_remainder:
                    members.append(region(mesh, part, f"cells.{name}.regions"))
            elements_of[name] = np.unique(np.concatenate(members))
        filled = np.concatenate([*elements_of.values()])
        remainder = np.setdiff1d(np.arange(mesh.nelements), filled)
        for name, cell in named.items():
            if _takes_rest(cell, regions):
                elements_of[name] = np.union1d(elements_of[name], remainder)
            if not elements_of[name].size:
                raise InputError(
                    f"cells.{name}.regions", f"{REST}; the other cells fill the whole mesh"
                )
        return points_by_region(mesh.with_subdomains(elements_of), tuple(elements_of), "cells")

    @contextmanager
    def named(self, *kinds: type[FileError | InputError]) -> Iterator[None]:
        """Let errors of these kinds in a block begin with the name of the recipe's file."""
        try:
            yield
        except kinds as error:
            raise type(error)(f"{self.path.name}: {error}") from None

    def problem(self) -> Problem:
        """Make the problem that a run computes, without the surface law of [surface].

        Raises:
            FileError: the mesh file cannot be read.
            InputError: it is no mesh, or the mesh lacks a place that the recipe names.
        """
        with self.named(FileError, InputError):
            problem = Problem(
                mesh=self.mesh.mesh(self.path.parent),
                conditions=self.conditions,
                bodies=self.bodies,
                duration=self.time.duration,
                output_interval=self.time.output_interval or self.time.duration,
                times=self.time.times,
                watched=self.watch or {},
                boundaries=self.mesh.boundaries or {},
                regions=self.mesh.regions or {},
            )
            self._check_places(problem.mesh)
            return problem

    def _check_places(self, mesh: skfem.Mesh) -> None:
        """Check that the mesh has every place that the recipe names.

        Raises:
            InputError: naming the entry whose place is not there.
        """
        for condition in self.conditions:
            find = _PLACES.get(type(condition), nodes_on)
            find(mesh, condition.on, f"conditions.{label(condition)}.on")
        for body in self.bodies:
            boundary(mesh, body.on, f"bodies.{body.name}.on")
        space = make_discretisation(mesh)
        for name, point in (self.watch or {}).items():
            try:
                space.locate(np.array(point), f"watch.{name}")
            except InputError as error:
                # a point outside the mesh: the nearest node says where the mesh is
                offset = mesh.p.T - np.array(point)
                x, y = mesh.p[:, np.hypot(offset[:, 0], offset[:, 1]).argmin()]
                message = f"{error}, whose nearest node is at ({x:.6g}, {y:.6g}) µm"
                raise InputError(message) from None
        self.points_of_cells(mesh)
        if self.surface is not None and self.surface.on != FREE:
            for name in self.surface.on:
                boundary(mesh, name, "surface.on")

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.time.duration

    def to_dict(self) -> dict[str, Any]:
        """Return the whole recipe, with defaults filled in, as JSON can hold it.

        It has no absolute folder.
        """
        return self.entries_with(self._sections_of_cells())

    def entries_with(self, of_cells: Mapping[str, Any]) -> dict[str, Any]:
        """Return the recipe as JSON can hold it, with these sections for its cells."""
        entries = {"recipe": self.path.name, **of_cells, **self._shared_sections()}
        entries["mesh"]["sha256"] = self.sha256
        if self.image is not None:
            entries["image"]["sha256"] = self.image_sha256
        recipe: dict[str, Any] = plain(entries)
        return recipe

    def to_toml(
        self,
        mesh_file: str | None,
        surrogates: Mapping[CellName, str],
        image_file: str | None = None,
    ) -> str:
        """Return the text of a recipe that states the same, with defaults filled in.

        Args:
            mesh_file: name of the mesh file beside the text; None: the mesh is by numbers.
            surrogates: names of surrogate files beside the text, by name of the cell.
            image_file: name of the image file beside the text; None: there is none.
        """
        of_cells = self._sections_of_cells()
        for name in self.cells:
            sections = of_cells if name is None else of_cells["cells"][name]
            sections["samples"]["file"] = None
            sections["training"]["file"] = surrogates.get(name)
        shared = self._shared_sections()
        shared["mesh"]["file"] = mesh_file
        if self.image is not None:
            shared["image"]["file"] = image_file
        shared["time"]["frames"] = None  # it stands in [macro]
        return toml_text({**of_cells, **shared})

    def _sections_of_cells(self) -> dict[str, Any]:
        """Return the sections that state the plant cells, with defaults filled in."""
        only = self.cells.get(None)
        if only is not None:
            return only.to_dict()
        return {"cells": {name: _entries(cell) for name, cell in self.cells.items()}}

    def _shared_sections(self) -> dict[str, Any]:
        """Return the sections that all plant cells share, with defaults filled in."""
        entries: dict[str, Any] = {}
        for name in _OF_ALL_CELLS:
            settings = getattr(self, name)
            if settings is not None:
                entries[name] = asdict(settings)
        entries["mesh"] = self.mesh.to_dict()
        entries |= sections_of(self.conditions, self.bodies, self.watch or {})
        entries["time"] = asdict(self.time)
        return entries


@dataclass(frozen=True, slots=True)
class CellStudy:
    """One plant cell of a recipe: the commands that sample and learn its stress take it.

    Attributes:
        recipe: the recipe, with what all of its cells share: RVEs, calibration, problem.
        name: name of the cell.
    """

    recipe: Recipe
    name: CellName

    @property
    def cell(self) -> CellType:
        """The plant cell, with its range, samples and training."""
        return self.recipe.cells[self.name]

    def with_cell(self, **changes: Any) -> CellStudy:
        """Return the study with other entries of its `CellType`, in its recipe too."""
        cells = {**self.recipe.cells, self.name: replace(self.cell, **changes)}
        return replace(self, recipe=replace(self.recipe, cells=cells))

    def title(self, what: str) -> str:
        """Return the words for a piece of work, with the cell's name where it has one."""
        return what if self.name is None else f"{what} {self.name}"

    def section(self, name: str) -> str:
        """Return the name that a section of the cell has in the recipe."""
        return name if self.name is None else f"cells.{self.name}.{name}"

    def sampling_range(self) -> SamplingRange:
        """Return the range of (F, Ḟ), for commands that need one.

        Raises:
            InputError: the recipe states none.
        """
        if self.cell.range is None:
            name = self.section("range")
            raise InputError(
                f"{self.recipe.path.name}: {name}: missing; this command needs the section "
                f"[{name}] with stretch, shear and rate (1/µs)"
            )
        return self.cell.range

    def data_path(self) -> Path:
        """Return the path of the cell's data set."""
        return self._path_of("samples", self.cell.samples.file, "data set (.h5)")

    def training_path(self) -> Path:
        """Return the path of the cell's surrogate."""
        return self._path_of("training", self.cell.training_file, "trained surrogate (.h5)")

    def _path_of(self, section: str, file: str | None, content: str) -> Path:
        """Return the path of a file of the recipe.

        Args:
            section: section that states the file.
            content: words for its content, in errors.

        Raises:
            InputError: the section states no file, or a name that no file can have.
        """
        entry = f"{self.recipe.path.name}: {self.section(section)}.file"
        if file is None:
            raise InputError(
                f"{entry}: missing; this command needs the file of the {content}, relative to the "
                "recipe"
            )
        longest = max(len(os.fsencode(part)) for part in file.split("/"))
        if "\0" in file or longest > _LONGEST_NAME:
            raise InputError(f"{entry}: {quoted(file)}; no file can be called so")
        return Path(os.path.normpath(self.recipe.path.parent / file))

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe of this cell alone, with the sections of a [cell], as JSON can hold."""
        return self.recipe.entries_with(self.cell.to_dict())


def _entries(cell: CellType) -> dict[str, Any]:
    """Return the entries of a section [cells.NAME]."""
    sections = cell.to_dict()
    return {**sections.pop("cell"), "regions": list(cell.regions), **sections}


# Sections of settings by name; others state a problem, or several cells.
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
    "image": ImageSettings,
    "table": TableSettings,
    "rest": RestSettings,
    "surface": SurfaceSettings,
    "cache": CacheSettings,
}
# Sections that all cells of a recipe share.
_OF_ALL_CELLS = (
    "rve", "calibration", "macro", "tissue", "image", "table", "rest", "surface", "cache",
)  # fmt: skip

# Largest size of a recipe, bytes: a larger file is another one, taken by mistake.
_MOST_BYTES = 2**24


def load_recipe(path: str | Path, changes: Mapping[str, Any] = MappingProxyType({})) -> Recipe:
    """Read and check a study recipe.

    Args:
        changes: values by dotted name of the entry, {"cell.wall_stiffness": 3000.0}, that replace
            those in the file.

    Raises:
        FileError: the file is not there or cannot be read.
        InputError: not TOML, an unknown or missing key, a wrong type or a value out of bounds.

    Examples:
        The paper's bar, of the repository, with softer walls:

        >>> from surrofe2 import load_recipe
        >>> recipe = load_recipe("data/bending-bar.toml", {"cell.wall_stiffness": 3000.0})
        >>> recipe.study().cell.parameters.wall_stiffness  # µN/µm
        3000.0
        >>> recipe.problem().duration  # µs
        250.0
    """
    path = Path(path)
    if path.is_dir():
        of_run = path / INPUT / RECIPE
        hint = f", such as {of_run}; `surrofe2 run` repeats the run" if of_run.exists() else ""
        raise FileError(f"{path}: a folder; a recipe is a TOML file{hint}")
    try:
        table = read_toml(read_text(path, _MOST_BYTES))
    except ValueError as error:  # an integer may have too many digits, too
        raise InputError(f"{path.name}: not TOML: {shortened(str(error), 150)}") from None
    try:
        return make_recipe(with_changes(table, changes), path)
    except (FileError, InputError) as error:
        named = type(error)(f"{path.name}: {error}")
        named.faults = error.faults or (error,)
        raise named from None


def make_recipe(table: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """Make a recipe from the nested tables of a TOML file.

    Sections are read one after another. A fault is noted and reading continues, so that all faults
    are reported together.

    Args:
        path: file of the recipe, against which its files resolve.

    Raises:
        InputError: naming the section or key that is unknown or out of its range; its `faults`
            are all faults of the recipe.
    """
    faults = Faults()
    tables = _known_sections(table, faults)
    problem_sections = [name for name in PROBLEM_SECTIONS if name in tables]
    macro = tables.get("macro", {})
    _check_homes(tables, problem_sections, faults)
    entries = {
        name: section
        for name, section in tables.items()
        if name in problem_sections or name in _OF_ALL_CELLS
    }
    if problem_sections:
        _check_problem(tables, problem_sections[0], faults)
    else:  # [load], or nothing at all, states the paper's bar
        value = macro.get("elements", (4, 4))
        elements = faults.take(check_value, "macro.elements", value, tuple[int, int], {"least": 1})
        bar = faults.take(build, LoadSettings, tables.get("load", {}), "load")
        if bar:
            entries |= bar.sections(elements or (4, 4))
    settings: dict[str, Any] = {"path": path, "is_bar": not problem_sections}
    if "mesh" not in entries:
        settings["mesh"] = None  # a fault that was noted says so
    settings |= faults.take(partial(build, dict, entries, "", of=Recipe, **settings)) or {}
    for name, key in (("mesh", "sha256"), ("image", "image_sha256")):
        section = entries.get(name)
        if isinstance(section, dict) and isinstance(section.get("file"), str):
            with faults.noted():
                try:
                    settings[key] = digest(path.parent / section["file"])
                except FileError as error:
                    raise FileError(f"{name}.file: {error}") from None
    settings["cells"] = faults.take(cell_types, tables)
    faults.check()
    recipe = Recipe(**settings)
    # time.frames takes the place of macro.frames where it is stated
    return replace(recipe, macro=changed(recipe.macro, frames=recipe.time.frames))


def _known_sections(table: Mapping[str, Any], faults: Faults) -> dict[str, Any]:
    """Return the sections that a recipe may have; note others, and values that are no table."""
    known = (*SECTIONS, *PROBLEM_SECTIONS, "cells")
    sections: dict[str, Any] = {}
    for name, section in with_micro_keys(table).items():
        with faults.noted():
            if name not in known:
                raise unknown(name, name, "section", known)
            if name in SECTIONS and not isinstance(section, dict):
                raise InputError(name, f"{quoted(section)}; it must be a section [{name}]")
            sections[name] = section
    return sections


def _check_homes(tables: Mapping[str, Any], problem_sections: list[str], faults: Faults) -> None:
    """Note entries of [macro] that another section of this recipe states, and should."""
    macro = tables.get("macro", {})
    time = tables.get("time")
    if problem_sections and "elements" in macro:
        with faults.noted():
            raise InputError("macro.elements", f"{quoted(macro['elements'])}; it stands in [mesh]")
    if isinstance(time, dict) and "frames" in time and "frames" in macro:
        with faults.noted():
            raise InputError("macro.frames", f"{quoted(macro['frames'])}; it stands in [time]")


def _check_problem(tables: Mapping[str, Any], first: str, faults: Faults) -> None:
    """Note where the sections of a problem, of which `first` is one, are not enough or too many."""
    with faults.noted():
        if "load" in tables:
            raise InputError(
                "load",
                f"[load] states the paper's bar, [{first}] another problem; leave one out",
            )
        if "mesh" not in tables:
            raise InputError("mesh", f"missing; [{first}] needs the section [mesh]")
    with faults.noted():
        is_empty = [tables.get(name, {}) in ({}, []) for name in ("conditions", "bodies")]
        if all(is_empty):
            raise InputError("conditions", "missing; something must hold or move the tissue")


def changed(settings: T, **entries: Any) -> T:
    """Return settings with other entries; None leaves an entry as it is."""
    stated = {name: value for name, value in entries.items() if value is not None}
    return replace(settings, **stated)  # type: ignore[type-var]
