"""`surrofe2 export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.base.errors import InputError
from surrofe2.cli.console import Fresh, done
from surrofe2.store.c_source import c_source
from surrofe2.store.store import read_bytes, write_text
from surrofe2.store.surrogates import read_surrogate


def export(
    surrogate: Annotated[
        Path, typer.Argument(metavar="SURROGATE", help="A trained surrogate (.h5).")
    ],
    to: Annotated[Literal["c"], typer.Option(help="The language.")] = "c",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file to write; default: beside SURROGATE, .c."),
    ] = None,
    fresh: Fresh = False,
) -> None:
    """Write a surrogate as C source: stress, tangents, domain and bound of the error.

    The source needs the standard library alone; its head says how to call it, and examples/umat.c
    calls it as a material routine of a finite-element program.

    Example: [bold]surrofe2 export training/bending-bar.h5 --to c[/bold]
    """
    path, text = out or surrogate.with_suffix(f".{to}"), c_source(read_surrogate(surrogate))
    if path.exists() and not fresh and read_bytes(path) != text.encode("utf-8"):
        raise InputError(f"{path}: another source is there; --fresh writes this one in its place")
    write_text(path, text)
    done(path, f"{len(text.splitlines())} lines of C, {len(text.encode()) / 1e3:.0f} kB")
