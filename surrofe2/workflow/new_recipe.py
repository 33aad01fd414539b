"""Recipes to start from: a template for each kind of problem, with what the settings say of keys.

Templates hold names and values alone. Unit, meaning and default of a key are those of the settings,
and a line "..." stands for all keys that the section has besides, as comments.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields
from importlib import resources
from pathlib import Path
from typing import Any

from surrofe2.errors import InputError
from surrofe2.io.files import read_bytes, write_text
from surrofe2.macro.conditions import CONDITIONS
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem_sections import MeshSettings, TimeSettings
from surrofe2.recipe import SECTIONS
from surrofe2.rigid_bodies import RigidBody
from surrofe2.settings import unknown
from surrofe2.units import NONE

KINDS = {
    "bar": "the paper's bending bar",
    "strip": "a strip that is pulled and held",
    "contact": "a block between two plates",
    "mesh": "a mesh file of your own",
    "voronoi": "irregular plant cells",
    "cells": "several kinds of plant cell by region",
}
"""What there are templates for."""

_HEAD = """#
# Units: µm, µs, ng; so µN, and µN/µm for stresses of the sheet and stiffnesses. Files are relative
# to this file. What is left out keeps its default; an unknown key is an error.
"""
_COLUMN, _WIDTH = 36, 100
_NOTES = {
    "preset": "printed, water, apple or potato; any constant below can be changed",
    "kind": "of condition",
    "on": "boundary or region",
    "amplitude": "factor in time",
    "file": "is written here",
    "plane": "the body's outline, its normal points to the tissue",
}
"""Of keys that the settings do not describe."""


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write the recipe of a kind, and the mesh file that it names; what was written.

    Raises:
        InputError: there is no such kind, or another file is there, and not `fresh`.
    """
    if kind not in KINDS:
        raise InputError(unknown(f"--example: {kind!r}", kind, "kind", KINDS))
    files = {path: _commented(_template(f"{kind}.toml").replace("NAME", path.stem))}
    if kind == "mesh":
        files[path.with_suffix(".msh")] = _template("mesh.msh")
    for each, text in files.items():
        if each.exists() and not fresh and read_bytes(each) != text.encode("utf-8"):
            raise InputError(f"{each}: another file is there; --fresh writes this one in its place")
    for each, text in files.items():
        write_text(each, text)
    return list(files)


def _template(name: str) -> str:
    return (resources.files("surrofe2") / "templates" / name).read_text(encoding="utf-8")


def _commented(template: str) -> str:
    """A template with units and meanings behind its keys."""
    title, _, body = template.partition("\n\n")
    stated = tomllib.loads(body.replace("\n...\n", "\n"))
    lines, section = [title, _HEAD], ""
    for line in body.splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        key, sign, _ = line.partition(" = ")
        known = _fields_of(section, stated)
        if line == "...":
            lines += _others(known, section, stated[section])
        elif sign and not line.startswith("#"):
            lines.append(_with_note(line, _note(key, known.get(key))))
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _fields_of(section: str, stated: Mapping[str, Any]) -> dict[str, Field[Any]]:
    """The settings' fields of a section by name; none where it has names of the user's."""
    first, _, name = section.partition(".")
    kinds = {each.kind(): each for each in CONDITIONS}
    kind: Any = {"mesh": MeshSettings, "time": TimeSettings, "bodies": RigidBody}.get(first)
    if first == "mesh" and name:
        return {}
    if first == "conditions":
        kind = kinds[stated[first][name]["kind"]]
    if first in SECTIONS or first == "cells":
        kind = SECTIONS["cell" if first == "cells" else first]
    return {} if kind is None else {item.name: item for item in fields(kind)}


def _note(key: str, item: Field[Any] | None) -> str:
    """Meaning and unit of a key."""
    about, unit = _NOTES.get(key, ""), NONE
    if item is not None:
        about, unit = item.metadata.get("about") or about, item.metadata.get("unit", NONE)
    return ", ".join(each for each in (about, "" if unit == NONE else unit) if each)


def _others(
    known: Mapping[str, Field[Any]], section: str, stated: Mapping[str, Any]
) -> Iterator[str]:
    """Keys that the section does not state, by their defaults or the preset's, as comments."""
    of_preset = CellParameters.preset(stated["preset"]).to_dict() if section == "cell" else {}
    for key, item in known.items():
        value = of_preset.get(key, item.default)
        if key not in stated and value not in (MISSING, None):
            yield _with_note(f"# {key} = {_toml(value)}", _note(key, item))


def _toml(value: Any) -> str:
    """A default as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else re.sub(r"e-0", "e-", repr(value))


def _with_note(line: str, note: str) -> str:
    """The note behind the line, else above where both together are too long."""
    if not note:
        return line
    behind = f"{line.ljust(_COLUMN)} # {note}"
    return behind if len(behind) <= _WIDTH else f"# {note}\n{line}"
