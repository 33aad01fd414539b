"""A JSON schema of recipes, by which editors complete keys, explain them and mark mistakes.

It is made of the settings that read a recipe. What only the program sees (keys that exclude each
other, names of boundaries, files) is left to `surrofe2 check`. A new recipe, of a template for each
kind of problem, names it.
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
from surrofe2.plant_cell.parameters import PRESETS
from surrofe2.problem.amplitude import KINDS, Amplitude
from surrofe2.problem.conditions import CONDITIONS
from surrofe2.problem.mesh import PARTS, Box, Part
from surrofe2.problem.problem import Point
from surrofe2.problem.rigid_bodies import SHAPES, RigidBody
from surrofe2.recipe.recipe import ALIASES, CELL_SECTIONS, SECTIONS, MeshSettings, TimeSettings
from surrofe2.store.store import check_replaceable, read_bytes, write_text

Schema = dict[str, Any]

TITLE = "Recipe of surrofe2"
TEMPLATES = {
    "bar": "the paper's bending bar",
    "strip": "a strip that is pulled and held",
    "contact": "a block between two plates",
    "mesh": "a mesh file of your own",
    "voronoi": "irregular plant cells",
    "cells": "several kinds of plant cell by region",
}
"""Of recipes, by name."""
SCHEMA = "recipe.schema.json"
_TEXT: Schema = {"type": "string"}
_BOUNDS = {
    "least": "minimum",
    "most": "maximum",
    "above": "exclusiveMinimum",
    "below": "exclusiveMaximum",
}
_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string"}


def recipe_schema() -> Schema:
    """The schema, of JSON Schema's draft 7."""
    sections = {name: _settings(kind) for name, kind in SECTIONS.items()}
    sections["cell"]["properties"]["preset"] = {"enum": [*PRESETS, *ALIASES]}
    sections["training"]["properties"]["file"] = _TEXT
    sections["macro"]["properties"]["elements"] = _value(tuple[int, int], {"least": 1})
    shared = {name: {**sections[name], "required": []} for name in CELL_SECTIONS}
    names = {"type": "array", "items": _TEXT}
    cell = _with(sections["cell"], {"regions": names, **shared})
    condition = {"anyOf": _kinds({each.kind(): each for each in CONDITIONS})}
    body = _with(_settings(RigidBody), {name: _settings(kind) for name, kind in SHAPES.items()})
    points = _value(tuple[tuple[float, float], ...], {})
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": TITLE,
        "definitions": {"amplitude": {"anyOf": [{"type": "number"}, points, *_kinds(KINDS)]}},
        **_table(
            {
                **sections,
                "cells": _named(cell),
                "mesh": _settings(MeshSettings),
                "conditions": {"anyOf": [_named(condition), {"type": "array", "items": condition}]},
                "bodies": _named(body),
                "watch": _named(_value(Point, {})),
                "time": _settings(TimeSettings),
            }
        ),
    }


def _table(properties: Schema, required: list[str] | None = None) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "required": required or [],
        "additionalProperties": False,
    }


def _named(each: Schema) -> Schema:
    """Tables under names of the user's."""
    return {"type": "object", "additionalProperties": each}


def _with(table: Schema, more: Schema) -> Schema:
    return {**table, "properties": {**table["properties"], **more}}


def _kinds(kinds: Any) -> list[Schema]:
    """The tables whose `kind` says what they are."""
    tables = []
    for name, kind in kinds.items():
        table = _with(_settings(kind), {"kind": {"enum": [name]}})
        tables.append({**table, "required": ["kind", *table["required"]]})
    return tables


def _settings(kind: Any) -> Schema:
    """The table of the fields of settings."""
    hints, properties, required = hints_of(kind), dict[str, Schema](), list[str]()
    for item in fields(kind):
        if not item.metadata:
            continue
        unit = item.metadata.get("unit", NONE)
        about = item.metadata["about"] + ("" if unit == NONE else f" ({unit})")
        value = {"description": about, **_value(hints[item.name], item.metadata)}
        if item.default is MISSING:
            required.append(item.name)
        elif isinstance(item.default, bool | int | float | str | tuple):
            value["default"] = item.default
        properties[item.name] = value
    return {"description": " ".join((kind.__doc__ or "").split()), **_table(properties, required)}


def _value(hint: Any, bounds: Any) -> Schema:
    options = get_args(hint)
    if hint is Amplitude:
        return {"$ref": "#/definitions/amplitude"}
    if hint is Box:
        return _value(tuple[float, float, float, float], {})
    if hint is Part:
        return {"anyOf": [_table({name: _value(each, {})}, [name]) for name, each in PARTS.items()]}
    if is_dataclass(hint):
        return _settings(hint)
    if get_origin(hint) is Mapping:
        return _named(_value(options[1], bounds))
    if get_origin(hint) in (Union, UnionType):
        kinds = [_value(each, bounds) for each in options if each is not NoneType]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    if get_origin(hint) is tuple:
        # a component that may be None is "free" in a recipe
        entry = _value(options[0], bounds)
        entry = (
            {"anyOf": [entry, {"enum": ["free"]}]} if NoneType in get_args(options[0]) else entry
        )
        size = (
            {} if options[-1] is Ellipsis else {k: len(options) for k in ("minItems", "maxItems")}
        )
        return {"type": "array", "items": entry, **size}
    one_of = options if get_origin(hint) is Literal else bounds.get("one_of", ())
    if one_of:
        return {"enum": [*one_of]}
    limits = {_BOUNDS[key]: bounds[key] for key in _BOUNDS if key in bounds}
    return {"type": _PLAIN[hint], **(limits if hint in (float, int) else {})}


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write the recipe of a kind, its mesh file and the schema for editors; what was written.

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
    text = (templates / f"{kind}.toml").read_text(encoding="utf-8").replace("NAME", stem)
    files = {path: f"#:schema ./{SCHEMA}\n\n{text}"}
    if kind == "mesh":
        files[path.with_suffix(".msh")] = (templates / "mesh.msh").read_text(encoding="utf-8")
    for each, text in files.items():
        if not each.exists() or read_bytes(each) == text.encode("utf-8"):
            continue
        # A recipe names its schema in the first line; a mesh of other content is somebody's own.
        is_mesh = each.suffix == ".msh"
        check_replaceable(each, "recipe that `new` wrote", "#:schema" if not is_mesh else text)
        if not fresh:
            raise InputError(f"{each}: another file is there; --fresh writes this one in its place")
    schema = path.with_name(SCHEMA)
    check_replaceable(schema, "schema of recipes", TITLE)
    files[schema] = json.dumps(recipe_schema(), indent=1, ensure_ascii=False) + "\n"
    for each, text in files.items():
        write_text(each, text)
    return list(files)
