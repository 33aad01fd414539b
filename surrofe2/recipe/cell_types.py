"""Cell types of a recipe: plant cells by name, and the regions of the mesh that each fills."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.settings import Faults, build, check_settings, check_table, check_value, setting
from surrofe2.macro.elements import points_by_region
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.mesh import region
from surrofe2.problem.problem import Problem
from surrofe2.surrogate.settings import TrainingSettings

T = TypeVar("T")
Index = NDArray[np.int64]

REST = "rest"
"""As a region of a cell: what no other cell fills, unless the mesh has a region of that name."""
SECTIONS = ("range", "samples", "training")
"""Sections that a cell may have; what they leave out is as in the recipe's section."""
_OWN = (("samples", "file"), ("training", "file"))
"""Files that cells cannot share."""
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
    seed: int = setting(1, "of the sequence", least=0)
    tangents: bool = setting(False, "whether ∂P/∂F and ∂P/∂Ḟ are sampled with the stress")
    file: str | None = setting(None, "of the data set, relative to the recipe")

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
    """A plant cell, the regions it fills (of [cell] none are named: all of them), and how its
    stress is sampled and learnt."""

    preset: str
    cell: CellParameters
    regions: tuple[str, ...]
    range: SamplingRange | None
    samples: SampleSettings
    training: TrainingSettings
    training_file: str | None

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
    shared = {name: table[name] for name in SECTIONS if name in table}
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
    for section, key in _OWN:
        if key in shared.get(section, {}):
            raise InputError(
                f"{section}.{key}",
                f"{quoted(shared[section][key])}; each cell has its own: give "
                f"cells.NAME.{section}.{key}",
            )
    _settings(shared, "")  # what is wrong there is reported once, of no cell
    faults = Faults()
    types = {name: faults.take(_cell_type, name, one, shared) for name, one in cells.items()}
    faults.check()
    for kind, files in (
        ("samples", {name: each.samples.file for name, each in types.items()}),
        ("training", {name: each.training_file for name, each in types.items()}),
    ):
        known: dict[str, str] = {}
        for name, file in files.items():
            first = known.setdefault(str(Path(file)), name) if file is not None else name
            if first != name:
                raise InputError(f"cells.{name}.{kind}.file", f"{quoted(file)}; that is {first}'s")
    return types


def _cell_type(name: str, entries: Any, shared: Mapping[str, Mapping[str, Any]]) -> CellType:
    """The cell of [cell], called "", or [cells.NAME]; what its sections leave out is shared."""
    where, faults = f"cells.{name}" if name else "cell", Faults()
    if name and not re.fullmatch(r"[\w-]+", name):
        raise InputError(where, f"{quoted(name)}; a name must be of letters, digits, _ and -")
    if not isinstance(entries, dict):
        raise InputError(where, f"{quoted(entries)}; it must be a section [{where}]")
    extras = ("preset", "regions", *SECTIONS) if name else ("preset",)
    constants = {key: value for key, value in entries.items() if key not in extras}
    preset = entries.get("preset", "printed")
    preset, cell = faults.take(_cell, constants, preset, where, extras) or ("", None)
    regions = faults.take(_regions, entries.get("regions", [name]), where) if name else ()
    sections = dict(shared)
    for section in SECTIONS if name else ():
        with faults.noted():
            own = entries.get(section, {})
            check_table(f"{where}.{section}", own)
            if merged := {**shared.get(section, {}), **own}:
                sections[section] = merged
    settings = faults.take(_settings, sections, f"{where}." if name else "")
    faults.check()
    return CellType(preset=preset, cell=cell, regions=regions, **settings)


def _cell(
    constants: Mapping[str, Any], preset: Any, where: str, extras: tuple[str, ...]
) -> tuple[str, Any]:
    """A preset and the plant cell that it is with other constants."""
    preset = check_value(f"{where}.preset", preset, str, {})
    preset = ALIASES.get(preset, preset)
    make = partial(CellParameters.preset, preset)
    return preset, build(make, constants, where, extras, of=CellParameters)


def _regions(stated: Any, where: str) -> tuple[str, ...]:
    regions: tuple[str, ...] = check_value(f"{where}.regions", stated, tuple[str, ...], {})
    if not regions:
        raise InputError(f"{where}.regions", "[]; it must name a region of the mesh")
    return regions


def _settings(sections: Mapping[str, Mapping[str, Any]], where: str) -> dict[str, Any]:
    """Range, samples, training and training_file that sections state."""
    training, faults = dict(sections.get("training", {})), Faults()
    file, samples = training.pop("file", None), sections.get("samples", {})
    settings = {
        "training_file": faults.take(check_value, f"{where}training.file", file, str | None, {}),
        "samples": faults.take(build, SampleSettings, samples, f"{where}samples"),
        "training": faults.take(build, TrainingSettings, training, f"{where}training", ("file",)),
        "range": None,
    }
    if "range" in sections:
        settings["range"] = faults.take(build, SamplingRange, sections["range"], f"{where}range")
    faults.check()
    return settings


def points_of_cells(mesh: skfem.Mesh, types: Mapping[str, CellType]) -> dict[str, Index]:
    """Numbers of the points that each cell fills; together the whole mesh.

    Raises:
        InputError: there is no such region, or an element is of no cell or of two.
    """
    known, filled = mesh.subdomains or {}, dict[str, Index]()
    for name, each in types.items():
        parts = [part for part in each.regions if part in known or part != REST]
        inside = [region(mesh, part, f"cells.{name}.regions") for part in parts]
        filled[name] = np.unique(np.concatenate([np.zeros(0, np.int64), *inside]))
    others = np.setdiff1d(np.arange(mesh.nelements), np.concatenate([*filled.values()]))
    for name, each in types.items():
        if _takes_rest(each, known):
            filled[name] = np.union1d(filled[name], others)
        if not filled[name].size:
            raise InputError(
                f"cells.{name}.regions", f"{REST}; the other cells fill the whole mesh"
            )
    return points_by_region(mesh.with_subdomains(filled), tuple(filled), "cells")


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

    def at(where: NDArray[np.bool_]) -> str:
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
