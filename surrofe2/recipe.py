"""Study recipes: one TOML file that drives generate, train, run and demo.

Each section of a recipe is the frozen dataclass of the layer it configures (`CellParameters`,
`RveSettings`, …), so names, types, defaults and bounds stand there and nowhere else; what is wrong
comes out as one `InputError` sentence.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from surrofe2.cache.settings import CacheSettings, TableSettings
from surrofe2.errors import FileError, InputError
from surrofe2.io.files import plain
from surrofe2.load_case import LoadCase
from surrofe2.macro.problem import Problem, bar
from surrofe2.macro.settings import MacroSettings
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem_sections import SECTIONS as PROBLEM_SECTIONS
from surrofe2.problem_sections import StatedProblem, stated_problem
from surrofe2.rve.settings import RveSettings
from surrofe2.sampling import SamplingRange
from surrofe2.settings import check_settings, check_value, from_table, hints_of, setting, unknown
from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
from surrofe2.tissue.settings import TissueSettings

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSettings:
    """How many samples of the range, by which seed of the low-discrepancy sequence; their file."""

    count: int = setting(16384, "number of samples", least=1)
    seed: int = setting(1, "of the sequence", least=0)
    tangents: bool = setting(False, "whether ∂P/∂F and ∂P/∂Ḟ are sampled with the stress")
    file: str | None = setting(None, "of the data set, relative to the recipe")
    add: tuple[str, ...] = setting((), "harvests that training takes in besides the data set")

    def __post_init__(self) -> None:
        check_settings(self, "samples")


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything a study needs. `path` is the recipe's file, against which its files resolve.

    Attributes:
        load: the paper's bar; None where the recipe states another problem.
        stated: that problem.
    """

    path: Path
    preset: str
    cell: CellParameters
    rve: RveSettings
    range: SamplingRange | None = None
    samples: SampleSettings
    training: TrainingSettings
    calibration: CalibrationSettings
    load: LoadCase | None
    macro: MacroSettings
    tissue: TissueSettings
    table: TableSettings
    cache: CacheSettings = field(default_factory=CacheSettings)
    training_file: str | None = None
    stated: StatedProblem | None = None

    def sampling_range(self) -> SamplingRange:
        """The range of (F, Ḟ), for what cannot do without.

        Raises:
            InputError: the recipe has none.
        """
        if self.range is None:
            raise InputError(
                f"{self.path.name}: range: missing; this command needs the section [range] with "
                "stretch, shear and rate (1/µs)"
            )
        return self.range

    def problem(self) -> Problem:
        """What a run computes.

        Raises:
            FileError: the mesh file cannot be read.
            InputError: the mesh is none, or has not what the recipe names.
        """
        if self.stated is None:
            return bar(self.bar_load(), self.macro.elements)
        try:
            return self.stated.problem(self.path.parent)
        except InputError as error:
            raise InputError(f"{self.path.name}: {error}") from None

    def bar_load(self) -> LoadCase:
        """The load of the paper's bar, for what computes no other problem.

        Raises:
            InputError: the recipe states another problem.
        """
        if self.load is None:
            raise InputError(
                f"{self.path.name}: load: missing; this command needs the bar of a section [load]"
            )
        return self.load

    @property
    def duration(self) -> float:
        """Length of the run, µs."""
        return self.bar_load().duration if self.stated is None else self.stated.time.duration

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
        if file is None:
            raise InputError(
                f"{self.path.name}: {section}.file: missing; this command needs the file of the "
                f"{what}, relative to the recipe"
            )
        return Path(os.path.normpath(self.path.parent / file))

    def to_dict(self) -> dict[str, Any]:
        """The whole recipe, defaults filled in, as JSON can hold it; no absolute folder."""
        entries = asdict(replace(self, stated=None))
        sections = {name: entries[name] for name in SECTIONS if entries[name] is not None}
        sections["cell"] = {"preset": self.preset, **self.cell.to_dict()}
        sections["training"]["file"] = self.training_file
        if self.stated is not None:
            sections |= self.stated.to_dict()
        plainly: dict[str, Any] = plain({"recipe": self.path.name, **sections})
        return plainly


SECTIONS: dict[str, type] = {
    name: kind
    for name, hint in hints_of(Recipe).items()
    for kind in (get_args(hint) or (hint,))
    if isinstance(kind, type) and is_dataclass(kind) and kind is not StatedProblem
}
"""The fields of a recipe that are settings, by name."""
_NOT_NEEDED = ("range",)
"""Sections that a recipe may do without; each other one has a default for all it must have."""
_EXTRA_KEYS: dict[str, tuple[str, Any, Any]] = {
    "cell": ("preset", str, "printed"),
    "training": ("file", str | None, None),
}
"""Keys besides the fields of the sections: name, type and default."""


def load_recipe(path: str | Path) -> Recipe:
    """Read and check a study recipe.

    Raises:
        FileError: the file is not there or cannot be read.
        InputError: not TOML, an unknown or missing key, a wrong type or a value out of bounds.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path.name}: not TOML: {error}") from None
    try:
        return make_recipe(table, path)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def make_recipe(table: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """A recipe from the nested tables of a TOML file.

    Raises:
        InputError: naming the section or key that is unknown or out of its range.
    """
    for name, section in table.items():
        if name not in (*SECTIONS, *PROBLEM_SECTIONS):
            raise InputError(unknown(name, name, "section", (*SECTIONS, *PROBLEM_SECTIONS)))
        if name in SECTIONS and not isinstance(section, dict):
            raise InputError(f"{name}: {section!r}; it must be a section [{name}]")
    stated = _stated(table, path.parent)
    given = {name: dict(table.get(name, {})) for name in SECTIONS}
    extras: dict[str, Any] = {}
    for section, (key, kind, default) in _EXTRA_KEYS.items():
        value = given[section].pop(key, default)
        extras[section] = check_value(f"{section}.{key}", value, kind, {})
    made: dict[str, Any] = {
        name: from_table(name, kind, given[name], _EXTRA_KEYS.get(name, ())[:1])
        for name, kind in SECTIONS.items()
        if name in table or name not in _NOT_NEEDED
    }
    preset = extras["cell"]
    made["cell"] = CellParameters.preset(preset, **given["cell"])
    if stated is not None:
        made["load"], frames = None, stated.time.frames
        wanted = {"elements": stated.mesh.elements, "frames": frames}
        made["macro"] = changed(made["macro"], **wanted)
    return Recipe(path=path, preset=preset, training_file=extras["training"], stated=stated, **made)


def changed(settings: T, **given: Any) -> T:
    """The settings of a section with other entries; None leaves an entry as it is."""
    wanted = {name: value for name, value in given.items() if value is not None}
    return replace(settings, **wanted)  # type: ignore[type-var]


def _stated(table: Mapping[str, Any], folder: Path) -> StatedProblem | None:
    """The problem that a recipe states; None where it is the bar of [load]."""
    sections = [name for name in PROBLEM_SECTIONS if name in table]
    if not sections:
        return None
    if "load" in table:
        raise InputError(
            f"load: [load] states the paper's bar, [{sections[0]}] another problem; leave one out"
        )
    for key in ("elements", "frames"):
        if key in table.get("macro", {}) and (key == "elements" or key in table.get("time", {})):
            home = "mesh" if key == "elements" else "time"
            raise InputError(f"macro.{key}: {table['macro'][key]!r}; it stands in [{home}]")
    return stated_problem(table, folder)
