"""A JSON schema of recipes, by which editors complete keys, explain them and mark mistakes.

It is made from the settings that read a recipe. Mistakes that only the program sees (keys that
exclude each other, names of boundaries, files) are left to `surrofe2 check`. `write_recipe` writes
a new recipe from a template for each kind of problem, which names the schema.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from importlib import resources
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from surrofe2.base.errors import InputError
from surrofe2.base.settings import hints_of, unknown
from surrofe2.base.units import NONE
from surrofe2.plant_cell.parameters import PRESETS, LivingTissue
from surrofe2.problem.amplitude import KINDS, Amplitude
from surrofe2.problem.conditions import CONDITIONS
from surrofe2.problem.mesh import PARTS, Box, Part
from surrofe2.problem.problem import Point
from surrofe2.problem.rigid_bodies import SHAPES, RigidBody
from surrofe2.recipe.recipe import ALIASES, CELL_SECTIONS, SECTIONS, MeshSettings, TimeSettings
from surrofe2.store.store import check_replaceable, read_bytes, write_text

Schema = dict[str, Any]

TITLE = "Recipe of surrofe2"
# The kinds of new recipes by name, each with what it is for.
TEMPLATES = {
    "bar": "the paper's bending bar",
    "strip": "a strip that is pulled and held",
    "contact": "a block between two plates",
    "mesh": "a mesh file of your own",
    "voronoi": "irregular plant cells",
    "cells": "several kinds of plant cell by region",
}
# Name of the schema's file, beside a recipe.
SCHEMA = "recipe.schema.json"
_TEXT: Schema = {"type": "string"}
# Bounds of a setting, see `base.settings`, and their names in a JSON schema.
_BOUNDS = {
    "least": "minimum",
    "most": "maximum",
    "above": "exclusiveMinimum",
    "below": "exclusiveMaximum",
}
# Types of entries, and their names in a JSON schema.
_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string"}


def recipe_schema() -> Schema:
    """Return the schema, of JSON Schema's draft 7."""
    sections = {name: _settings(kind) for name, kind in SECTIONS.items()}
    # entries that the recipe reads besides the settings of these sections
    measured = _settings(LivingTissue)["properties"]
    sections["cell"] = _with(sections["cell"], measured)
    sections["cell"]["properties"]["preset"] = {"enum": [*PRESETS, *ALIASES]}
    sections["training"]["properties"]["file"] = _TEXT
    sections["macro"]["properties"]["elements"] = _value(tuple[int, int], {"least": 1})
    # in [cells.NAME] these sections need nothing, since [range] and so on may have it
    cell_sections = {name: {**sections[name], "required": []} for name in CELL_SECTIONS}
    regions = {"type": "array", "items": _TEXT}
    cell = _with(sections["cell"], {"regions": regions, **cell_sections})
    condition = {"anyOf": _kinds({kind.kind(): kind for kind in CONDITIONS})}
    shapes = {name: _settings(shape) for name, shape in SHAPES.items()}
    body = _with(_settings(RigidBody), shapes)
    points = _value(tuple[tuple[float, float], ...], {})
    amplitude = {"anyOf": [{"type": "number"}, points, *_kinds(KINDS)]}
    properties = {
        **sections,
        "cells": _named(cell),
        "mesh": _settings(MeshSettings),
        "conditions": {"anyOf": [_named(condition), {"type": "array", "items": condition}]},
        "bodies": _named(body),
        "watch": _named(_value(Point, {})),
        "time": _settings(TimeSettings),
    }
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": TITLE,
        "definitions": {"amplitude": amplitude},
        **_table(properties),
    }


def _table(properties: Schema, required: list[str] | None = None) -> Schema:
    """Return the schema of a table that has these entries and no others."""
    return {
        "type": "object",
        "properties": properties,
        "required": required or [],
        "additionalProperties": False,
    }


def _named(entry: Schema) -> Schema:
    """Return the schema of a table in which users name the entries, which are all alike."""
    return {"type": "object", "additionalProperties": entry}


def _with(table: Schema, more: Schema) -> Schema:
    """Return the schema of a table with more entries."""
    return {**table, "properties": {**table["properties"], **more}}


def _kinds(kinds: Any) -> list[Schema]:
    """Return the schemas of tables of several kinds, of which the entry `kind` states one."""
    tables = []
    for name, kind in kinds.items():
        table = _with(_settings(kind), {"kind": {"enum": [name]}})
        tables.append({**table, "required": ["kind", *table["required"]]})
    return tables


def _settings(kind: Any) -> Schema:
    """Return the schema of the table that states settings, a dataclass of `setting` fields."""
    hints = hints_of(kind)
    properties: dict[str, Schema] = {}
    required: list[str] = []
    for item in fields(kind):
        if not item.metadata:  # a field that recipes do not state
            continue
        description = item.metadata["about"]
        unit = item.metadata.get("unit", NONE)
        if unit != NONE:
            description += f" ({unit})"
        value = {"description": description, **_value(hints[item.name], item.metadata)}
        if item.default is MISSING:
            required.append(item.name)
        elif isinstance(item.default, bool | int | float | str | tuple):
            value["default"] = item.default
        properties[item.name] = value
    description = " ".join((kind.__doc__ or "").split())
    return {"description": description, **_table(properties, required)}


def _value(hint: Any, bounds: Any) -> Schema:
    """Return the schema of a value.

    Args:
        hint: type of the value.
        bounds: metadata of its setting, with bounds and choices; see `base.settings.setting`.
    """
    options = get_args(hint)
    if hint is Amplitude:
        return {"$ref": "#/definitions/amplitude"}
    if hint is Box:
        return _value(tuple[float, float, float, float], {})
    if hint is Part:
        parts = [_table({name: _value(part, {})}, [name]) for name, part in PARTS.items()]
        return {"anyOf": parts}
    if is_dataclass(hint):
        return _settings(hint)
    origin = get_origin(hint)
    if origin is Mapping:
        return _named(_value(options[1], bounds))
    if origin in (Union, UnionType):
        # an entry that may be None is left out of a recipe
        kinds = [_value(option, bounds) for option in options if option is not NoneType]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    if origin is tuple:
        return _list(options, bounds)
    choices = options if origin is Literal else bounds.get("one_of", ())
    if choices:
        return {"enum": [*choices]}
    schema: Schema = {"type": _PLAIN[hint]}
    if hint in (float, int):
        for key, schema_key in _BOUNDS.items():
            if key in bounds:
                schema[schema_key] = bounds[key]
    return schema


def _list(options: tuple[Any, ...], bounds: Any) -> Schema:
    """Return the schema of a list, whose entries are alike; `options` are those of a tuple type."""
    entry = _value(options[0], bounds)
    if NoneType in get_args(options[0]):  # a component that may be None is "free" in a recipe
        entry = {"anyOf": [entry, {"enum": ["free"]}]}
    schema: Schema = {"type": "array", "items": entry}
    if options[-1] is not Ellipsis:
        schema["minItems"] = len(options)
        schema["maxItems"] = len(options)
    return schema


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write a recipe of a kind, its mesh file and the schema for editors; return their paths.

    The recipe names the schema, which lies beside it, in its first line, as Taplo and Even Better
    TOML read it; so it stays valid where the folder moves, and needs no network.

    Raises:
        InputError: there is no such kind, or another recipe is there, and not `fresh`.
        FileError: a file is there that `fresh` does not replace.
    """
    if kind not in TEMPLATES:
        raise unknown(f"--example: {kind!r}", kind, "kind", TEMPLATES)
    templates = resources.files("surrofe2") / "templates"
    stem = json.dumps(path.stem, ensure_ascii=False)[1:-1]  # as it stands in quotes, also in TOML
    recipe = (templates / f"{kind}.toml").read_text(encoding="utf-8").replace("NAME", stem)
    files = {path: f"#:schema ./{SCHEMA}\n\n{recipe}"}
    if kind == "mesh":
        files[path.with_suffix(".msh")] = (templates / "mesh.msh").read_text(encoding="utf-8")
    # All files are checked before the first is written, so a refusal leaves nothing behind.
    for file, text in files.items():
        if not file.exists() or read_bytes(file) == text.encode("utf-8"):
            continue
        # A recipe names its schema in the first line; a mesh of other content is somebody's own.
        mark = text if file.suffix == ".msh" else "#:schema"
        check_replaceable(file, "recipe that `new` wrote", mark)
        if not fresh:
            raise InputError(f"{file}: another file is there; --fresh writes this one in its place")
    schema = path.with_name(SCHEMA)
    check_replaceable(schema, "schema of recipes", TITLE)
    files[schema] = json.dumps(recipe_schema(), indent=1, ensure_ascii=False) + "\n"
    for file, text in files.items():
        write_text(file, text)
    return list(files)
