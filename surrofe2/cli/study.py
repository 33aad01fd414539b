"""`surrofe2 study`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.base.errors import InputError
from surrofe2.cli import console
from surrofe2.cli.compare import show_comparison
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.run import cache_notes
from surrofe2.workflow.study import run_recipe

KEPT = "finished steps, the samples and iterations so far and the run's last checkpoint are kept"


def study(
    recipe: console.RecipeFile,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the runs; default: out/study-RECIPE."),
    ] = None,
    law: Annotated[
        Literal["cached", "table"],
        typer.Option(
            metavar="LAW",
            help="Beside full FE²: cached, by the surrogate; or table, which needs no training.",
        ),
    ] = "cached",
    true: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A full run to compare with; then none is made."),
    ] = None,
    without_true: Annotated[
        bool, typer.Option("--without-true", help="No full run, so nothing to compare with.")
    ] = False,
    fresh: console.Fresh = False,
    threads: console.Threads = None,
) -> None:
    """All of a recipe: data set, training, full run, cached run, comparison.

    Runs every missing step, and resumes one that was interrupted. DIR receives a run folder
    for each law, [bold]rve[/bold] and [bold]cached[/bold], [bold]comparison[/bold], and all of it
    on one page, report.html; data set and surrogate are the recipe's.

    Example: [bold]surrofe2 study data/bending-bar.toml[/bold]

    Before a long one: [bold]surrofe2 check data/bending-bar.toml[/bold]
    """
    if true is not None and without_true:
        raise InputError("--true: not with --without-true; leave one of them out")
    stated = open_study(recipe, threads)
    folder = out or Path("out") / f"study-{recipe.stem}"
    with console.on_interrupt(KEPT), console.stages() as stage:
        records, comparison = run_recipe(
            stated,
            folder,
            (law,) if true is not None or without_true else ("rve", law),
            true,
            fresh=fresh,
            stage=stage,
            tell=console.print_line,
        )
    if comparison is not None:
        show_comparison(comparison)
    notes = (note for record in records for note in cache_notes(record))
    console.show_notes(note for note in notes if note[1] or comparison is None)
    console.done(folder, "all steps done")
