"""Writes docs/recipe.md: every section and key of a recipe, from the settings themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from surrofe2.base.settings import allowed_numbers, hints_of
from surrofe2.base.units import NONE
from surrofe2.plant_cell.measurements import DETERMINED
from surrofe2.plant_cell.parameters import CellParameters, LivingTissue
from surrofe2.problem.amplitude import KINDS, Amplitude, Constant
from surrofe2.problem.conditions import CONDITIONS, Condition
from surrofe2.problem.mesh import NodeAt
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody
from surrofe2.recipe.recipe import SECTIONS, MeshSettings, TimeSettings

PAGE = Path(__file__).parent / "recipe.md"
HEAD = """# Keys of a recipe

A recipe is a TOML file. Every key is optional unless its default reads *required*; a key that is
not listed is an error. Files are relative to the recipe. The [how-to
guides](howto/index.md) show how the sections work together; `data/` and `examples/` have recipes
to start from.

Written by `python docs/recipe_reference.py` from the settings of the package; do not edit.
"""
CELL_NOTE = (
    "`preset` is `printed` (default; also `ghysels2009`), `water` (also `ghysels2009-light`), "
    "`apple` or `potato`; every other key replaces a "
    "constant of the preset, so the default of a key is the preset's. The defaults below are those "
    "of `printed`. `[cells.NAME]` states several plant cells, each with `regions`, a list of the "
    "mesh's regions that it fills, and with sections `range`, `samples` and `training` of its own."
)
MEASUREMENT_NOTE = (
    'Beside `preset = "apple"` or `"potato"` the section takes measurements, from which the '
    "constants follow ([translation](cells.md#translation)). A measurement wins over a constant "
    "that it determines; a measurement that is left out is the preset's."
)
NOTES = {
    "cell": CELL_NOTE,
    "training": "`file` names the surrogate's file.",
    "range": "The section is needed by `generate`, `train`, `refine` and runs by `--law cached` or "
    "`table`. It must hold what a run meets; `surrofe2 check` proposes it.",
    "load": "The paper's bar. A recipe has either this section or `[mesh]` and its companions.",
    "macro": "`elements`, two integers, `[4, 4]` by default, are those of the bar of [load] in x "
    "and in y.",
    "image": "`surrofe2 tissue` alone takes it ([from an image](howto/cell.md#the-cells-themselves"
    ")).",
    "rest": "A recipe with this section is solved at rest by load steps, not in time.",
    "surface": "Without the section free sides have no law of their own.",
}
MESH_NOTE = (
    "`[mesh.boundaries]` and `[mesh.regions]` name parts of the plane: `NAME = { box = [x0, y0, "
    "x1, y1] }`, `{ half_plane = { through = [x, y], normal = [x, y] } }` or `{ circle = { centre "
    "= [x, y], radius = r } }`, in µm. A rectangle has the boundaries `left`, `right`, `bottom` "
    "and `top`; a file has its groups."
)
CONDITION_NOTE = (
    "`[conditions.NAME]` with `kind`, or a list `[[conditions]]`. Kinds of amplitude stand below. "
    "The node at a point is `on = { point = [x, y] }`, µm."
)
BODY_NOTE = (
    "`[bodies.NAME]` with exactly one outline, `plane`, `circle` or `corner`; its displacement "
    "follows the amplitude."
)


def page() -> str:
    """All of docs/recipe.md."""
    parts = [HEAD]
    for name, kind in SECTIONS.items():
        parts += [f"## [{name}]", _first_line(kind), NOTES.get(name, ""), _table(kind)]
        if kind is CellParameters:
            parts += [MEASUREMENT_NOTE, _measurements()]
    parts += ["## [mesh]", _first_line(MeshSettings), MESH_NOTE, _table(MeshSettings)]
    parts += ["## [conditions]", CONDITION_NOTE]
    for condition in CONDITIONS:
        parts += [f"### {condition.kind()}", _first_line(condition)]
        parts.append(_table(condition))
    parts += ["### Amplitudes", "What a load or a motion is multiplied by, in time."]
    for name, kind in KINDS.items():
        parts += [f"#### {name}", _first_line(kind), _table(kind)]
    parts += ["## [bodies]", BODY_NOTE, _table(RigidBody)]
    for shape in (Plane, Circle, Corner):
        parts += [f"### {shape.__name__.lower()}", _first_line(shape), _table(shape)]
    watch = "`NAME = [x, y]`, points in µm whose displacement is written to history.csv."
    parts += ["## [watch]", watch]
    parts += ["## [time]", _first_line(TimeSettings), _table(TimeSettings)]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _first_line(kind: type) -> str:
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def _table(kind: type) -> str:
    hints = hints_of(kind)
    rows = [
        f"| `{item.name}` | {_allowed(hints[item.name], item.metadata)} | {_default(item)} "
        f"| {_unit(item)} | {item.metadata['about'].replace('|', chr(92) + '|')} |"
        for item in _items(kind)
    ]
    if not rows:
        return ""
    head = "| key | allowed | default | unit | meaning |", "|---|---|---|---|---|"
    return "\n".join([*head, *rows])


def _measurements() -> str:
    """The table of what is measured, with the constants that each determines."""
    rows = [
        f"| `{item.name}` | {item.metadata['unit']} | {item.metadata['about']} "
        f"| {', '.join(f'`{each}`' for each in DETERMINED[item.name])} |"
        for item in fields(LivingTissue)
    ]
    head = "| key | unit | meaning | determines |", "|---|---|---|---|"
    return "\n".join([*head, *rows])


def _items(kind: type) -> Iterator[Field[Any]]:
    """Fields that a recipe may state; the name of a condition or body is its section's."""
    for item in fields(kind):  # type: ignore[arg-type]
        named = issubclass(kind, Condition | RigidBody) and item.name == "name"
        if item.metadata and not named:
            yield item


def _unit(item: Field[Any]) -> str:
    unit = item.metadata.get("unit", NONE)
    return "" if unit == NONE else unit


def _default(item: Field[Any]) -> str:
    if item.default is MISSING:
        return "*required*"
    if item.default is None:
        return ""
    if isinstance(item.default, Constant):
        return f"`{item.default.value}`"
    value = list(item.default) if isinstance(item.default, tuple) else item.default
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"`{text}`" if not isinstance(value, str) else f'`"{text}"`'


def _allowed(hint: Any, bounds: Any) -> str:
    options = get_args(hint)
    if hint is Amplitude:
        return "number, list, table"
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(_allowed(each, bounds) for each in options if each is not NoneType)
    if get_origin(hint) is Mapping:
        return "table"
    if get_origin(hint) is tuple:
        many = "list" if options[-1] is Ellipsis else f"list of {len(options)}"
        return f"{many}: {_allowed(options[0], bounds)}"
    one_of = options if get_origin(hint) is Literal else bounds.get("one_of", ())
    if one_of:
        return ", ".join(f'`"{each}"`' for each in one_of)
    if hint in (float, int):
        words = allowed_numbers(hint, bounds).removesuffix(" and finite")
        plain = {"finite": "number", "an integer a number": "integer"}
        return plain.get(words, words)
    words_of = {bool: "`true`, `false`", str: "text", NodeAt: "`{ point = [x, y] }`"}
    return words_of.get(hint, str(hint))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
