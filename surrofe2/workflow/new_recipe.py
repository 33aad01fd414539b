"""Recipes to start from: a template for each kind of problem, with all keys explained."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from surrofe2.errors import InputError
from surrofe2.settings import unknown
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


def write_recipe(path: Path, kind: str, *, fresh: bool = False) -> list[Path]:
    """Write the recipe of a kind, and the mesh file that it names; what was written.

    Raises:
        InputError: there is no such kind, or another file is there, and not `fresh`.
    """
    if kind not in KINDS:
        raise InputError(unknown(f"--example: {kind!r}", kind, "kind", KINDS))
    files = {path: _template(f"{kind}.toml").replace("NAME", path.stem)}
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
