"""`surrofe2 range`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.range import MARGIN, met_by_quadratic_law, proposed_range, range_section


def range(
    recipe: console.RecipeFile,
    margin: Annotated[
        float, typer.Option(metavar="X", help="Strain and rate beyond what was met, as a share.")
    ] = MARGIN,
    threads: console.Threads = None,
) -> None:
    """Propose the recipe's [bold]\\[range][/bold] from a dry run without RVEs.

    The dry run takes the quadratic law: the exact tangents of the recipe's RVE at rest, turned with
    the material. It knows neither stiffening nor loss of stability; the margin is for that. The
    section is printed to be pasted, one for each of several cells; no file is written.

    Example: [bold]surrofe2 range data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 generate data/bending-bar.toml[/bold]
    """
    study = open_study(recipe, threads)
    with console.working("range", study.duration, "µs", "nothing was changed") as report:
        found = met_by_quadratic_law(study, report=report)
    for cell, met in found.items():
        low, high = met.stretch
        wanted = proposed_range(met, margin)
        console.now().result |= {cell or "range": asdict(wanted)}
        console.print_line(range_section(wanted, cell))
        console.print_line(
            f"# by the quadratic law of the RVE at rest: met stretch {low:.4g} to {high:.4g}, "
            f"shear {met.shear:.3g}, rate {met.rate:.3g} 1/µs; margin {100.0 * margin:g} %, "
            f"{console.took()}"
        )
