"""`surrofe2 sweep`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.compare import ratio
from surrofe2.cli.console import on_interrupt, print_line, progress, show_table
from surrofe2.cli.options import Fresh, RecipeFile, SurrogateFile, Threads
from surrofe2.recipe import load_recipe
from surrofe2.report.tolerance_sweep import Sweep
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
    _show(result)
    print_line(f"{out}: {' and '.join(SWEEP_FILES)} written")


def _show(sweep: Sweep) -> None:
    """The figures of a sweep as a table."""
    columns = [
        "allowed",
        "stress",
        "above",
        "displaced",
        "hits",
        "speed-up",
        "steps",
    ]
    rows = [
        [
            f"{100 * row.tolerance:g} %",
            "–" if row.error_99 is None else f"{100 * row.error_99:.2g} %",
            f"{row.violations} of {row.audited}",
            f"{100 * row.displacement_error:.2g} %",
            f"{100 * row.hits:.3g} %",
            ratio(row.speed_up) + (" (off)" if row.off else ""),
            f"{100 * row.right_hand_sides:.4g} %",
        ]
        for row in sweep.rows
    ]
    show_table(f"Against true FE² of {sweep.true_wall_time:.3g} s", columns, rows)
    print_line(
        "allowed: tolerance; stress: error of 99 % of the audited answers, and how many were above "
        "the tolerance; displaced: largest error of displacement; steps: right-hand sides"
    )
