"""`surrofe2 refine`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import (
    Fresh,
    RecipeFile,
    Threads,
    on_interrupt,
    print_line,
    progress,
    show_table,
)
from surrofe2.errors import SimulationError
from surrofe2.recipe import load_recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.refinement import SURROGATE, Round, refine_surrogate
from surrofe2.workflow.run_lifecycle import time_text


def refine(
    recipe: RecipeFile,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the rounds; default: out/refine-RECIPE."),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, metavar="N", help="Rounds at most.")] = 6,
    fresh: Fresh = False,
    threads: Threads = None,
) -> None:
    """Teach the surrogate what the recipe's own run meets.

    Runs through the cache, collects the states that the surrogate did not know well enough, asks
    RVEs there and around, trains again, and so on until a run has no unknown state and its audit
    holds. DIR receives refine.json (the table of rounds) and surrogate.safetensors.

    Example: [bold]surrofe2 refine data/bending-bar-triple-load.toml[/bold]

    Next: [bold]surrofe2 run RECIPE --law cached --surrogate DIR/surrogate.safetensors[/bold]
    """
    study = load_recipe(recipe)
    folder = out or Path("out") / f"refine-{recipe.stem}"
    use_threads(threads)
    begin = time.perf_counter()
    found: list[Round] = []

    def tell(row: Round) -> None:
        found.append(row)
        print_line(
            f"round {row.round}: {100 * row.hits:.4g} % hits, {row.unknown} unknown states, "
            f"{row.added} samples added"
        )

    try:
        with on_interrupt(f"{folder} keeps the finished rounds"):
            refine_surrogate(study, folder, rounds=rounds, fresh=fresh, stage=progress, tell=tell)
    except SimulationError:
        _show(found)
        raise
    _show(found)
    taken = time_text(time.perf_counter() - begin)
    print_line(f"{folder / SURROGATE}: settled after {len(found)} rounds, {taken}")


def _show(rows: list[Round]) -> None:
    columns = ["round", "hits", "unknown", "samples", "held-out RMS", "audit 99 %", "time"]
    cells = [
        [
            str(row.round),
            f"{100 * row.hits:.4g} %",
            str(row.unknown),
            str(row.samples),
            f"{100 * row.held_out:.2g} %",
            "–" if row.audit is None else f"{100 * row.audit:.2g} %",
            time_text(row.seconds),
        ]
        for row in rows
    ]
    show_table("Rounds", columns, cells)
