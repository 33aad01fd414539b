"""`surrofe2 sweep`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import (
    Fresh,
    RecipeFile,
    SurrogateFile,
    Threads,
    on_interrupt,
    print_line,
    progress,
    show_table,
)
from surrofe2.recipe import load_recipe
from surrofe2.workflow.comparison import SWEEP_FILES, parse_tolerances, run_sweep
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.run import change_cache


def sweep(
    recipe: RecipeFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the runs and the picture.")],
    tolerances: Annotated[
        str, typer.Option(metavar="X,…", help="Stress tolerances, shares of the spread of stress.")
    ] = "1e-1,3e-2,1e-2,3e-3,1e-3,3e-4,1e-4",
    audit: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Share of answers audited; default: the recipe's."),
    ] = None,
    surrogate: SurrogateFile = None,
    threads: Threads = None,
    fresh: Fresh = False,
) -> None:
    """Run the load case at several stress tolerances: what a tolerance buys.

    DIR receives a run folder for true FE² and for each tolerance, sweep.json and sweep.png: error
    of stress and displacement, hits and speed-up over tolerance.

    Example: [bold]surrofe2 sweep data/bending-bar.toml --out out/sweep[/bold]
    """
    study = change_cache(load_recipe(recipe), None, audit)
    numbers = parse_tolerances(tolerances)
    use_threads(threads)
    with on_interrupt(f"{out} keeps what is finished"):
        result = run_sweep(
            study,
            out,
            numbers,
            surrogate_file=surrogate,
            fresh=fresh,
            stage=progress,
        )
    show_table(f"Against true FE² of {result.true_wall_time:.3g} s", *result.table.for_people())
    print_line(
        "stress error: what 99 % of the audited answers keep, and how many were above the "
        "tolerance; right-hand sides: of those of true FE²"
    )
    print_line(f"{out}: {' and '.join(SWEEP_FILES)} written")
