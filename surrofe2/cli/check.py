"""`surrofe2 check`."""

from __future__ import annotations

from typing import Annotated

import typer

from surrofe2.base.errors import InputError
from surrofe2.base.units import rough_time
from surrofe2.cli import console
from surrofe2.workflow.dry_run import (
    MARGIN,
    SECONDS,
    DryRun,
    advised_law,
    dry_run,
    proposed_range,
    range_section,
    seconds_by_rves,
)
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.recipe_check import recipe_faults, study_faults


def check(
    recipe: console.RecipeFile,
    only: Annotated[
        bool, typer.Option("--only", help="Read the recipe and its files; no dry run.")
    ] = False,
    margin: Annotated[
        float, typer.Option(metavar="X", help="Strain and rate beyond what was met, as a share.")
    ] = MARGIN,
    seconds: Annotated[
        float, typer.Option(min=0.0, metavar="S", help="Longest dry run on one mesh, s.")
    ] = SECONDS,
    threads: console.Threads = None,
) -> None:
    """Whether a recipe can be run, which range it needs, how long it takes, which law to take.

    Reads all of it, mesh, names, ranges and files, and tells everything that is wrong. Then a dry
    run by the tangents of the RVE at rest, on a coarser mesh where the recipe's takes too long,
    proposes the [bold]\\[range][/bold], to be copied into the recipe. It knows neither stiffening
    nor loss of stability; the margin is for that. The number of RVEs to solve and the time of one
    give the order of magnitude of a run by RVEs. Nothing is written.

    Example: [bold]surrofe2 check data/large-bar.toml[/bold]

    Next: [bold]surrofe2 study data/large-bar.toml[/bold]
    """
    faults = recipe_faults(recipe)
    if not faults:
        study = open_study(recipe, threads)
        # a recipe may be for RVEs alone: what a surrogate lacks is reported, and is no fault
        faults = study_faults(study, ("rve",))
    for sentence in faults:
        console.print_warning(sentence)
    if faults:
        raise InputError(f"{recipe}: {len(faults)} thing{'s' * (len(faults) > 1)} to mend")
    for sentence in study_faults(study, ("rve", "cached")):
        console.print_line(f"not by a surrogate: {sentence}")
    if only:
        console.done(recipe, "nothing is wrong")
        return
    with console.working("dry run", study.duration, "µs", "nothing was changed") as report:
        run = dry_run(study, seconds, report)
        by_rves = seconds_by_rves(study, run)
    _show_ranges(run, study.duration, margin)
    console.print_line(
        f"{run.points} points, asked about {run.calls:.2g} times: {run.solves:.1g} RVEs to solve, "
        f"about {rough_time(by_rves / 2.0)} to {rough_time(2.0 * by_rves)} by --law rve"
    )
    # without the seconds of the check, which would read as those of the law
    console.done(recipe, f"take --law {advised_law(study, by_rves)}", timed=False)


def _show_ranges(run: DryRun, duration: float, margin: float) -> None:
    until = "" if run.reached >= 1.0 else f" until {run.reached * duration:.3g} of {duration:g} µs"
    for cell, met in run.met.items():
        low, high = met.stretch
        try:
            console.print_line(range_section(proposed_range(met, margin), cell))
        except InputError as error:
            console.print_warning(str(error))
        console.print_line(
            f"# by the quadratic law of the RVE at rest: met{until} stretch {low:.4g} to "
            f"{high:.4g}, shear {met.shear:.3g}, rate {met.rate:.3g} 1/µs; "
            f"margin {100.0 * margin:g} %"
        )
