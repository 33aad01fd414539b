"""`surrofe2 rest`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.recipe import changed
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.rest import rest_study, rest_summary
from surrofe2.workflow.surfaces import surface_notes


def rest(
    recipe: console.RecipeFile,
    out: console.OutFolder,
    factor: Annotated[
        float, typer.Option(help="Of all loads and prescribed motions, at the end.")
    ] = 1.0,
    load_steps: Annotated[
        int, typer.Option(min=1, metavar="N", help="Load steps; halved where one fails.")
    ] = 10,
    initialisation: console.Initialisation = None,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Find the tissue at rest under the recipe's loads, by true FE², without time.

    The load goes on in steps, Newton's method with line search solves each. DIR receives run.json
    (configuration, costs), path.csv (factor of the load, displacement of the watched point in µm),
    history.csv and energies.csv (forces and works over the factor) and fields.xdmf for ParaView,
    where the factor stands for the time.

    Example: [bold]surrofe2 rest data/bending-bar.toml --out out/rest[/bold]

    Next: [bold]surrofe2 modes data/bending-bar.toml[/bold]
    """
    study = open_study(recipe, threads)
    study = replace(study, rve=changed(study.rve, initialisation=initialisation))
    kept, begun = f"{out} keeps the load steps up to here", (out / "run.json",)
    with console.working("rest", 1.0, "loads", kept, begun) as report:
        record = rest_study(
            study, out, factor=factor, load_steps=load_steps, fresh=fresh, report=report
        )
    console.done(out, rest_summary(record), timed=False)
    for sentence, is_warning in surface_notes(record):
        (console.print_warning if is_warning else console.print_line)(sentence)
