"""`surrofe2 grid`: a parameter study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from surrofe2.base.errors import InputError, SimulationError, quoted
from surrofe2.cli import console
from surrofe2.recipe.entries import listed_values
from surrofe2.workflow.grid import GRID_FILES, run_grid
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.workers import executor_of


def grid(
    recipe: console.RecipeFile,
    entries: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="KEY=VALUES",
            help="An entry of the recipe and its values: A,B,… or FIRST:LAST:COUNT, at equal "
            "ratios FIRST:LAST:COUNT:log; may be repeated.",
        ),
    ],
    law: Annotated[
        str, typer.Option(metavar="LAW,…", help="Of rve, cached, table and surrogate.")
    ] = "rve",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the runs; default: out/grid-RECIPE."),
    ] = None,
    workers: console.Workers = 0,
    scheduler: console.Scheduler = None,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Run the recipe with all combinations of values: a parameter study.

    Each combination runs by each law, with data set and surrogate of its own where what these
    depend on changes. With [bold]--law rve,cached[/bold] the table has the errors and the speed-up
    of the cache. DIR receives a run folder for each, grid.csv, grid.json and grid.png.

    Example: [bold]surrofe2 grid data/bending-bar.toml --set cell.wall_stiffness=3000:5000:8[/bold]

    What a tolerance of stress buys: [bold]surrofe2 grid RECIPE --law rve,cached
    --set cache.tolerance=1e-4:1e-1:7:log[/bold]
    """
    values = _values(entries)
    use_threads(threads)
    folder = out or Path("out") / f"grid-{recipe.stem}"
    kept = console.on_interrupt(f"{folder} keeps what is finished")
    with kept, executor_of(workers, scheduler) as executor:
        result = run_grid(
            recipe,
            values,
            folder,
            laws=law.split(","),
            threads=threads,
            executor=executor,
            fresh=fresh,
            stage=console.progress,
        )
    title = f"{recipe.name}, {len(result.rows)} runs"
    console.show_table(title, result.table, names=result.names)
    console.done(folder, f"{len(result.rows)} runs, {', '.join(GRID_FILES)}")
    if result.failed:
        name, sentence = next(iter(result.failed.items()))
        raise SimulationError(
            f"{len(result.failed)} of {len(result.rows)} runs failed, {name} first: {sentence}"
        )


def _values(entries: list[str]) -> dict[str, list[Any]]:
    """Values by entry of KEY=VALUES."""
    values: dict[str, list[Any]] = {}
    for entry in entries:
        name, sign, text = entry.partition("=")
        if not sign or name in values:
            why = "it is there twice" if sign else "it must be KEY=VALUES"
            raise InputError(f"--set: {quoted(entry)}; {why}")
        values[name] = listed_values(name, text)
    return values
