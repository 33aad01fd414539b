"""Study recipes: one TOML file that drives generate, train, run and demo.

Each section of a recipe is the frozen dataclass of the layer it configures (`CellParameters`,
`RveSettings`, …), so names, defaults and bounds stand there and nowhere else. pydantic adds
strict types and forbids unknown keys; what is wrong comes out as one `InputError` sentence.
"""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.table_settings import TableSettings
from surrofe2.errors import FileError, InputError
from surrofe2.io.files import plain
from surrofe2.load_case import LoadCase
from surrofe2.macro.settings import MacroSettings
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve.settings import RveSettings
from surrofe2.sampling import SamplingRange
from surrofe2.surrogate.calibration_settings import CalibrationSettings
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.tissue.settings import TissueSettings
from surrofe2.units import NONE

T = TypeVar("T")
_STRICT = ConfigDict(strict=True, extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSettings:
    """How many samples of the range, by which seed of the low-discrepancy sequence.

    `tangents`: whether ∂P/∂F and ∂P/∂Ḟ are sampled with the stress.
    """

    count: int = 16384
    seed: int = 1
    tangents: bool = False

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"samples.count: {self.count}; it must be at least 1")
        if self.seed < 0:
            raise InputError(f"samples.seed: {self.seed}; it must be at least 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything a study needs. `path` is the recipe's file, against which its files resolve."""

    path: Path
    preset: str
    cell: CellParameters
    rve: RveSettings
    range: SamplingRange
    samples: SampleSettings
    training: TrainingSettings
    calibration: CalibrationSettings
    load: LoadCase
    macro: MacroSettings
    tissue: TissueSettings
    table: TableSettings
    cache: CacheSettings = field(default_factory=CacheSettings)
    data_file: str | None = None
    training_file: str | None = None
    added_files: tuple[str, ...] = ()

    def data_path(self) -> Path:
        """Where the data set lies."""
        return self._path_of("samples", self.data_file, "data set (.h5)")

    def training_path(self) -> Path:
        """Where the trained surrogate lies."""
        return self._path_of("training", self.training_file, "trained surrogate (.pt)")

    def added_paths(self) -> tuple[Path, ...]:
        """Harvests that training takes in besides the data set."""
        return tuple(Path(os.path.normpath(self.path.parent / name)) for name in self.added_files)

    def _path_of(self, section: str, file: str | None, what: str) -> Path:
        if file is None:
            raise InputError(
                f"{self.path.name}: {section}.file: missing; this command needs the file of the "
                f"{what}, relative to the recipe"
            )
        return Path(os.path.normpath(self.path.parent / file))

    def to_dict(self) -> dict[str, Any]:
        """The whole recipe, defaults filled in, as JSON can hold it; no absolute folder."""
        names = (
            "rve", "range", "samples", "training", "calibration", "load", "macro", "tissue",
            "table", "cache",
        )  # fmt: skip
        sections = {name: asdict(getattr(self, name)) for name in names}
        sections["cell"] = {"preset": self.preset, **self.cell.to_dict()}
        sections["samples"]["file"] = self.data_file
        sections["samples"]["add"] = self.added_files
        sections["training"]["file"] = self.training_file
        plainly: dict[str, Any] = plain({"recipe": self.path.name, **sections})
        return plainly


SECTIONS: dict[str, type] = {
    "cell": CellParameters,
    "rve": RveSettings,
    "range": SamplingRange,
    "samples": SampleSettings,
    "training": TrainingSettings,
    "calibration": CalibrationSettings,
    "load": LoadCase,
    "macro": MacroSettings,
    "tissue": TissueSettings,
    "table": TableSettings,
    "cache": CacheSettings,
}
_EXTRA_KEYS: dict[str, dict[str, Any]] = {
    "cell": {"preset": (str, "printed")},
    "samples": {"file": (str, None), "add": (tuple[str, ...], ())},
    "training": {"file": (str, None)},
}


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
        if name not in SECTIONS:
            raise InputError(_unknown(name, name, "section", SECTIONS))
        if not isinstance(section, dict):
            raise InputError(f"{name}: {section!r}; it must be a section [{name}]")
    given = {name: _checked(name, table.get(name, {})) for name in SECTIONS}
    preset = given["cell"].pop("preset", "printed")
    added = given["samples"].pop("add", ())
    files = {name: given[name].pop("file", None) for name in ("samples", "training")}
    return Recipe(
        path=path,
        preset=preset,
        cell=CellParameters.preset(preset, **given["cell"]),
        rve=_make(RveSettings, "rve", given),
        range=_make(SamplingRange, "range", given),
        samples=_make(SampleSettings, "samples", given),
        training=_make(TrainingSettings, "training", given),
        calibration=_make(CalibrationSettings, "calibration", given),
        load=_make(LoadCase, "load", given),
        macro=_make(MacroSettings, "macro", given),
        tissue=_make(TissueSettings, "tissue", given),
        table=_make(TableSettings, "table", given),
        cache=_make(CacheSettings, "cache", given),
        data_file=files["samples"],
        training_file=files["training"],
        added_files=added,
    )


def _make(kind: type[T], section: str, given: Mapping[str, dict[str, Any]]) -> T:
    """The dataclass of a section; its own bounds are checked by its constructor."""
    try:
        return kind(**given[section])
    except InputError as error:
        named = str(error).startswith(f"{section}.")
        raise InputError(str(error) if named else f"{section}: {error}") from None


def _checked(section: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The given keys of a section with their types checked; TOML arrays become tuples."""
    model = _model_of(section)
    try:
        checked = model.model_validate({key: _frozen(value) for key, value in table.items()})
    except ValidationError as error:
        raise InputError(_sentence(section, model, error)) from None
    return {key: getattr(checked, key) for key in checked.model_fields_set}


def _model_of(section: str) -> type[BaseModel]:
    """The pydantic model with the keys and types of a section's dataclass."""
    kind = SECTIONS[section]
    hints = get_type_hints(kind, include_extras=True)
    keys: dict[str, Any] = {item.name: (hints[item.name], _default(item)) for item in fields(kind)}
    return create_model(section, __config__=_STRICT, **keys, **_EXTRA_KEYS.get(section, {}))


def _default(item: Field[Any]) -> Any:
    """`...` (required) where the dataclass has none; else a placeholder, which is never read."""
    required = item.default is MISSING and item.default_factory is MISSING
    return ... if required else None


def _frozen(value: Any) -> Any:
    return tuple(_frozen(entry) for entry in value) if isinstance(value, list) else value


_ALLOWED = {
    "float_type": "a number",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
}


def _sentence(section: str, model: type[BaseModel], error: ValidationError) -> str:
    """The first of pydantic's findings as field, value and what is allowed; unknown keys lead."""
    findings = error.errors(include_url=False)
    finding = next((f for f in findings if f["type"] == "extra_forbidden"), findings[0])
    kind, place, value = finding["type"], finding["loc"], finding["input"]
    key = str(place[0])
    if kind == "extra_forbidden":
        return _unknown(f"{section}.{key}", key, "key", model.model_fields)
    unit = _unit(section, key)
    if kind == "missing" and len(place) == 1:
        return f"{section}.{key}: missing; it must be given{unit}"
    entries = get_args(model.model_fields[key].annotation)
    if kind == "literal_error":
        allowed = "one of " + ", ".join(str(choice) for choice in entries)
    elif kind in ("missing", "too_long", "tuple_type"):
        many = f" of {len(entries)}" if entries and entries[-1] is not Ellipsis else ""
        allowed, place = f"a list{many}", place[:1] if kind == "missing" else place
    else:
        allowed = _ALLOWED.get(kind) or finding["msg"].removeprefix("Input should be ")
    index = "".join(f"[{i}]" for i in place[1:] if isinstance(i, int))
    shown = list(value) if isinstance(value, tuple) else value
    return f"{section}.{key}{index}: {shown!r}; it must be {allowed}{unit}"


def _unit(section: str, key: str) -> str:
    """The unit of a field, in brackets, where its dataclass states one."""
    units = {item.name: item.metadata.get("unit", NONE) for item in fields(SECTIONS[section])}
    unit = units.get(key, NONE)
    return "" if unit == NONE else f" ({unit})"


def _unknown(name: str, key: str, what: str, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{name}: unknown {what}; {hint}known are {', '.join(sorted(known))}"


__all__ = ["SECTIONS", "Recipe", "SampleSettings", "load_recipe", "make_recipe"]
