"""`surrofe2 export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.cli.console import Fresh, print_line
from surrofe2.errors import InputError
from surrofe2.io.c_source import write_c_source
from surrofe2.io.surrogates import read_surrogate


def export(
    surrogate: Annotated[
        Path, typer.Argument(metavar="SURROGATE", help="A trained surrogate (.safetensors).")
    ],
    to: Annotated[Literal["c"], typer.Option(help="The language.")] = "c",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file to write; default: beside SURROGATE, .c."),
    ] = None,
    fresh: Fresh = False,
) -> None:
    """Write a surrogate as C source: stress, tangents, domain and bound of the error.

    The source needs the standard library alone; its head says how to call it. Examples:
    examples/umat.c calls it as a material routine of a finite-element program would.

    Example: [bold]surrofe2 export training/bending-bar.safetensors --to c[/bold]
    """
    path = out or surrogate.with_suffix(f".{to}")
    if path.exists() and not fresh:
        raise InputError(f"{path}: there already; --fresh writes it anew")
    lines = write_c_source(read_surrogate(surrogate), path)
    print_line(f"{path}: {lines} lines of C, {path.stat().st_size / 1e3:.0f} kB")
