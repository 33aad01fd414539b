"""`surrofe2 new`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.base.errors import InputError
from surrofe2.cli import console
from surrofe2.workflow.new_recipe import KINDS, write_recipe


def new(
    name: Annotated[Path, typer.Argument(metavar="NAME", help="Of the recipe, .toml is added.")],
    example: Annotated[
        str | None,
        typer.Option(metavar="KIND", help=f"{', '.join(KINDS)}; default: it is asked for."),
    ] = None,
    fresh: console.Fresh = False,
) -> None:
    """Write a recipe to start from, with unit and meaning of each key.

    bar is the paper's bending bar, strip one that is pulled and held, contact a block between
    two plates, mesh a mesh file of your own, voronoi irregular plant cells, cells several kinds of
    plant cell by region.

    Example: [bold]surrofe2 new press --example contact[/bold]

    Next: [bold]surrofe2 check press.toml[/bold] for the range, then generate, train and run.
    """
    kind = _asked() if example is None else example
    path = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
    first, *others = write_recipe(path, kind, fresh=fresh)
    beside = "".join(f", with {other}" for other in others)
    console.done(first, f"recipe of {KINDS[kind]}{beside}", timed=False)
    console.print_line(f"next: surrofe2 check {path}, after changes; then generate, train, run")


def _can_ask() -> bool:
    return sys.stdin.isatty() and not console.now().quiet


def _asked() -> str:
    """The kind that the user chooses by its number or name."""
    if not _can_ask():
        raise InputError(f"--example: missing; it must be one of {', '.join(KINDS)}")
    for k, (kind, about) in enumerate(KINDS.items(), 1):
        console.print_line(f"{k}  {kind:8} {about}")
    answer = str(typer.prompt("Which kind of problem", default="1"))
    return list(KINDS)[int(answer) - 1] if answer in map(str, range(1, len(KINDS) + 1)) else answer
