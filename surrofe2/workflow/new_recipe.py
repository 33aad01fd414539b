"""Recipes to start from: a template for each kind of problem, with all keys explained."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

from surrofe2.base.errors import InputError
from surrofe2.base.settings import unknown
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


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write the recipe of a kind, its mesh file and the schema for editors; what was written.

    The recipe names the schema, which lies beside it, in its first line, as Taplo and Even Better
    TOML read it; so it stays valid where the folder moves, and needs no network.

    Raises:
        InputError: there is no such kind, or another file is there, and not `fresh`.
    """
    if kind not in KINDS:
        raise unknown(f"--example: {kind!r}", kind, "kind", KINDS)
    text = _template(f"{kind}.toml").replace("NAME", path.stem)
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
