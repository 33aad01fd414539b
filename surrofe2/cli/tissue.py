"""`surrofe2 tissue`."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Annotated

import typer

# Its threads meet every 0.1 ms; they must not fall asleep in between, as others should. Read when
# the first kernel starts, and set to less by surrofe2.base.compilation unless it is set.
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

from surrofe2.cli import console
from surrofe2.recipe.recipe import changed
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.tissue import resized, run_tissue, tissue_summary


def tissue(
    recipe: console.RecipeFile,
    out: console.OutFolder,
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
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Run the recipe's problem on all particles of the tissue: what FE² approximates.

    The bar of \\[load], or a rectangle of one or several cells with the conditions and rigid bodies
    of FE². Walls at the free boundary are single. The tissue is relaxed without load, then loaded.
    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of watched
    particles in µm), history.csv (forces in µN), energies.csv (pJ) and fields.xdmf for ParaView.

    Example: [bold]surrofe2 tissue data/bending-bar.toml --out out/tissue[/bold]

    Next: [bold]surrofe2 compare out/tissue out/rve --out out/comparison[/bold]
    """
    study = open_study(recipe, threads)
    study = replace(study, tissue=changed(study.tissue, micro_step=micro_step))
    if cells is not None:
        study = resized(study, cells)
    kept = console.KEPT_RUN.format(out)
    begun = (out / "run.json",)
    with console.working("full tissue", study.duration, "µs", kept, begun) as report:
        record = run_tissue(study, out, fresh=fresh, report=report)
    console.done(out, tissue_summary(record), timed=False)
