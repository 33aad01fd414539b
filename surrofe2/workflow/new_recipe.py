"""Recipes to start from: a template for each kind of problem, with all keys explained."""

from __future__ import annotations

import json
from dataclasses import Field, fields
from importlib import resources
from pathlib import Path
from typing import Any

from surrofe2.base.errors import InputError
from surrofe2.base.settings import unknown
from surrofe2.base.units import NONE
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.conditions import CONDITIONS
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.recipe.problem_sections import MeshSettings, TimeSettings
from surrofe2.recipe.recipe import SECTIONS
from surrofe2.recipe.schema import TITLE, recipe_schema
from surrofe2.store.store import read_bytes, write_text

KINDS = {
    "bar": "the paper's bending bar",
    "strip": "a strip that is pulled and held",
    "contact": "a block between two plates",
    "mesh": "a mesh file of your own",
    "voronoi": "irregular plant cells",
    "cells": "several kinds of plant cell by region",
}
"""What there are templates for."""
SCHEMA = "recipe.schema.json"
_SECTIONS = SECTIONS | {"mesh": MeshSettings, "time": TimeSettings}
_NAMED = {"cells": CellParameters, "bodies": RigidBody}
_UNITS = """
#
# Units: µm, µs, ng; so µN, and µN/µm for stresses of the sheet and stiffnesses. Files are relative
# to this file. What is left out keeps its default; an unknown key is an error.

"""
_COLUMN, _WIDTH = 36, 100
"""Characters before a comment, and of a line."""


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write the recipe of a kind, its mesh file and the schema for editors; what was written.

    The recipe names the schema, which lies beside it, in its first line, as Taplo and Even Better
    TOML read it; so it stays valid where the folder moves, and needs no network.

    Raises:
        InputError: there is no such kind, or another file is there, and not `fresh`.
    """
    if kind not in KINDS:
        raise unknown(f"--example: {kind!r}", kind, "kind", KINDS)
    text = _explained(_template(f"{kind}.toml").replace("NAME", path.stem))
    files = {path: f"#:schema ./{SCHEMA}\n\n{text}"}
    if kind == "mesh":
        files[path.with_suffix(".msh")] = _template("mesh.msh")
    for each, text in files.items():
        if each.exists() and not fresh and read_bytes(each) != text.encode("utf-8"):
            raise InputError(f"{each}: another file is there; --fresh writes this one in its place")
    schema = path.with_name(SCHEMA)
    if schema.exists() and not fresh and TITLE.encode() not in read_bytes(schema):
        raise InputError(f"{schema}: another file is there; --fresh writes a schema in its place")
    files[schema] = json.dumps(recipe_schema(), indent=1, ensure_ascii=False) + "\n"
    for each, text in files.items():
        write_text(each, text)
    return list(files)


def _template(name: str) -> str:
    return (resources.files("surrofe2") / "templates" / name).read_text(encoding="utf-8")


def _explained(template: str) -> str:
    """A template whose keys say what they are; at "# …" those that it leaves out, by defaults."""
    kind: type | None = None
    lines, given = list[str](), dict[str, Any]()
    for line in template.replace("\n\n", _UNITS, 1).splitlines():
        kind = _kind_of(line, kind)
        items = {item.name: item for item in fields(kind) if item.metadata} if kind else {}
        key, is_entry, value = line.partition(" = ")
        if line.startswith("["):
            given = {}
        if is_entry and not line.startswith("#"):
            given[key] = value
        if line == "# …":
            usual = {name: item.default for name, item in items.items()}
            if "preset" in given:
                usual = CellParameters.preset(json.loads(given["preset"])).to_dict()
            for name in items:
                if name not in given:
                    lines += _with_comment(f"# {name} = {_as_toml(usual[name])}", items[name])
        elif key in items and " # " not in line:
            lines += _with_comment(line, items[key])
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _kind_of(line: str, before: type | None) -> type | None:
    """The settings whose keys follow a line: a section's, or a condition's of its kind."""
    if line.startswith("kind = "):
        return next(each for each in CONDITIONS if f'"{each.kind()}"' in line)
    if not line.startswith("["):
        return before
    section, dot, _ = line.strip("[]").partition(".")
    return _NAMED.get(section) if dot else _SECTIONS.get(section)


def _with_comment(line: str, item: Field[Any]) -> list[str]:
    """A line with meaning and unit of its key behind it, or above where it is long."""
    about = _about(item)
    whole = f"{line:{_COLUMN}} # {about}"
    return [whole] if len(whole) <= _WIDTH else [f"# {about}", line]


def _about(item: Field[Any]) -> str:
    about, unit = item.metadata["about"], item.metadata["unit"]
    return about if unit == NONE else f"{about}, {unit}"


def _as_toml(value: Any) -> str:
    return repr(value).replace("e-0", "e-") if isinstance(value, float) else json.dumps(value)
