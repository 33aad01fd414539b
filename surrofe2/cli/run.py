"""`surrofe2 run`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.cli.console import (
    KEPT_RUN,
    Fresh,
    Initialisation,
    RecipeFile,
    RunFolder,
    SurrogateFile,
    Threads,
    on_interrupt,
    print_error,
    print_line,
    progress,
)
from surrofe2.recipe import load_recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.run import cache_notes, change_cache, change_rve, run_study, run_summary

Law = Annotated[
    Literal["rve", "surrogate", "cached", "table"],
    typer.Option(
        help="True RVEs, the surrogate alone, the surrogate with RVEs where it is out of "
        "its range, or a table that learns from RVEs as it goes, without any training."
    ),
]
Tables = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="Table (.h5) to start from, e.g. table.h5 of an earlier run; more than one are "
        "merged. Default: an empty one.",
    ),
]
Harvest = Annotated[
    bool, typer.Option(help="Keep the true answers of cached runs in DIR/harvest.h5.")
]
Solver = Annotated[
    str | None, typer.Option(help="How constrained runs are solved; default: the recipe's.")
]
Integrator = Annotated[
    Literal["explicit", "implicit"] | None,
    typer.Option(help="Time integration (implicit: not --law table); default: the recipe's."),
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="Cached: allowed error of a stress relative to the spread of stress; default: "
        "the recipe's.",
    ),
]
Audit = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        help="Cached: share of its answers that RVEs check, 1: all; default: the recipe's.",
    ),
]


def run(
    recipe: RecipeFile,
    law: Law,
    out: RunFolder,
    surrogate: SurrogateFile = None,
    table: Tables = None,
    harvest: Harvest = True,
    initialisation: Initialisation = None,
    solver: Solver = None,
    integrator: Integrator = None,
    tolerance: Tolerance = None,
    audit: Audit = None,
    threads: Threads = None,
    fresh: Fresh = False,
) -> None:
    """Run the recipe's problem: a tissue on its mesh, and all that holds, moves or touches it.

    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of the watched
    points in µm), history.csv (forces, motion of boundaries), energies.csv (pJ) and fields.xdmf for
    ParaView; with --law table the table, with --law cached or table the harvest of true stresses.

    Example: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]

    Next: [bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
    """
    study = change_rve(load_recipe(recipe), initialisation, solver)
    study = change_cache(study, tolerance, audit)
    if integrator is not None:
        study = replace(study, macro=replace(study.macro, integrator=integrator))
    use_threads(threads)
    with (
        on_interrupt(KEPT_RUN.format(out)),
        progress(f"run by {law}", study.duration, "µs") as report,
    ):
        record = run_study(
            study,
            law,
            out,
            surrogate_file=surrogate,
            tables=table or (),
            harvest=harvest,
            fresh=fresh,
            report=report,
        )
    print_line(f"{out}: {run_summary(record)}")
    for sentence, is_warning in cache_notes(record):
        (print_error if is_warning else print_line)(sentence)
