"""`surrofe2 rest`."""

from __future__ import annotations

from typing import Annotated

import typer

from surrofe2.cli.console import (
    Fresh,
    Initialisation,
    RecipeFile,
    RunFolder,
    Threads,
    on_interrupt,
    print_line,
    progress,
)
from surrofe2.recipe import load_recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.rest import rest_study, rest_summary
from surrofe2.workflow.run import change_rve


def rest(
    recipe: RecipeFile,
    out: RunFolder,
    factor: Annotated[
        float, typer.Option(help="Of all loads and prescribed motions, at the end.")
    ] = 1.0,
    load_steps: Annotated[
        int, typer.Option(min=1, metavar="N", help="Load steps; halved where one fails.")
    ] = 10,
    initialisation: Initialisation = None,
    threads: Threads = None,
    fresh: Fresh = False,
) -> None:
    """Find the tissue at rest under the recipe's loads, by true FE², without time.

    The load goes on in steps, Newton's method with line search solves each. DIR receives run.json
    (configuration, costs), path.csv (factor of the load, displacement of the watched point in µm)
    and fields.xdmf for ParaView, where the factor stands for the time.

    Example: [bold]surrofe2 rest data/bending-bar.toml --out out/rest[/bold]

    Next: [bold]surrofe2 modes data/bending-bar.toml[/bold]
    """
    study = change_rve(load_recipe(recipe), initialisation)
    use_threads(threads)
    with (
        on_interrupt(f"{out} keeps the load steps up to here"),
        progress("rest", 1.0, "loads") as report,
    ):
        record = rest_study(
            study,
            out,
            factor=factor,
            load_steps=load_steps,
            fresh=fresh,
            report=report,
        )
    print_line(f"{out}: {rest_summary(record)}")
