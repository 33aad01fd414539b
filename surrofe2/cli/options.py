"""Arguments and options that several commands have, and how lists of numbers are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.errors import InputError

AnyInitialisation = Literal["all", "cauchy-born", "elastic", "constrained-runs", "slow-manifold"]

RecipeFile = Annotated[Path, typer.Argument(metavar="RECIPE", help="The study's TOML file.")]
RunFolder = Annotated[Path, typer.Option(metavar="DIR", help="The run folder to write.")]
JsonFile = Annotated[Path | None, typer.Option(metavar="FILE", help="All numbers as JSON.")]
SurrogateFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Surrogate file; default: the recipe's."),
]
Preset = Annotated[
    Literal["printed", "water"], typer.Option(help="Fluid particles of 2.7 or 0.27 ng.")
]
Initialisation = Annotated[
    str | None, typer.Option(help="How RVEs are initialised; default: the recipe's.")
]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads; default: all cores.")
]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Start over; default: keep what is there and go on.")
]
KEPT_RUN = "{} keeps the run up to its last checkpoint"


def integers(option: str, text: str, least: int = 1) -> tuple[int, ...]:
    """Integers between commas, in their order.

    Args:
        option: whose text it is, for the message.

    Raises:
        InputError: not integers, or one of them less than `least`.
    """
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < least:
        raise InputError(f"{option}: {text!r}; it must be integers of at least {least} with commas")
    return numbers
