"""`surrofe2 demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.cli.study import KEPT, show_study
from surrofe2.recipe import load_recipe
from surrofe2.workflow.demo import demo_recipe, run_demo
from surrofe2.workflow.study import REPORT


def demo(
    recipe: Annotated[
        Path | None,
        typer.Option(
            "--recipe",
            metavar="RECIPE",
            help="The study's TOML file; default: data/bending-bar.toml in a clone, else one that "
            "is written to DIR.",
        ),
    ] = None,
    out: console.OutFolder = Path("out/demo"),
    fresh: console.Fresh = False,
) -> None:
    """The bending bar by true and by cached FE²: data set, training, runs, comparison.

    As [bold]surrofe2 study[/bold] with the recipe's bar, and with the same on 16 × 16 elements over
    100 µs. Takes a few minutes on two cores.

    Example: [bold]surrofe2 demo --out out/demo[/bold]
    """
    stated = load_recipe(recipe or demo_recipe(out))
    with console.on_interrupt(KEPT), console.stages() as stage:
        found = run_demo(stated, out, fresh=fresh, stage=stage, tell=console.print_line)
    for title, bar in found:
        show_study(bar, title)
    console.print_line(
        "wall time and speed-up: of the runs alone, both warm; imports and warm-up before them, "
        "data set and training are not in them"
    )
    console.done(out / REPORT, "data set, surrogate and two bars")
