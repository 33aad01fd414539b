"""`surrofe2 tissue`."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Annotated

import typer

# Its threads meet every 0.1 ms; they must not fall asleep in between, as others should. Read when
# the first kernel starts, and set to less by surrofe2.compilation unless it is set.
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

from surrofe2.cli.console import (
    KEPT_RUN,
    Fresh,
    RecipeFile,
    RunFolder,
    Threads,
    on_interrupt,
    print_line,
    progress,
)
from surrofe2.recipe import load_recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.tissue import resized, run_tissue, tissue_summary


def tissue(
    recipe: RecipeFile,
    out: RunFolder,
    cells: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="N M",
            help="Plant cells in x and y, which then set the extent; default: those that fill "
            "the recipe's.",
        ),
    ] = None,
    micro_step: Annotated[
        float | None, typer.Option(metavar="DT", help="Longest step in µs; default: the recipe's.")
    ] = None,
    threads: Threads = None,
    fresh: Fresh = False,
) -> None:
    """Run the recipe's load case on all particles of the tissue: what FE² approximates.

    Walls at the free boundary are single; particles at x = 0 are held. The tissue is relaxed
    without load, then loaded. DIR receives run.json (configuration, costs), curve.csv (t in µs,
    displacement of the watched particle in µm), energies.csv (pJ) and fields.xdmf for ParaView.

    Example: [bold]surrofe2 tissue data/bending-bar.toml --out out/tissue[/bold]

    Next: [bold]surrofe2 compare out/tissue out/rve --out out/comparison[/bold]
    """
    study = load_recipe(recipe)
    if cells is not None:
        study = resized(study, cells)
    if micro_step is not None:
        study = replace(study, tissue=replace(study.tissue, micro_step=micro_step))
    use_threads(threads)
    with (
        on_interrupt(KEPT_RUN.format(out)),
        progress("full tissue", study.duration, "µs") as report,
    ):
        record = run_tissue(study, out, fresh=fresh, report=report)
    print_line(f"{out}: {tissue_summary(record)}")
