"""`surrofe2 check`."""

from __future__ import annotations

from typing import Annotated

import typer

from surrofe2.base.errors import InputError
from surrofe2.base.units import rough_time
from surrofe2.cli import console
from surrofe2.workflow.check import (
    MARGIN,
    SECONDS,
    DryRun,
    advised_law,
    checked_mesh,
    compile_kernels,
    dry_run,
    proposed_range,
    range_section,
    recipe_faults,
    seconds_by_rves,
    study_faults,
)
from surrofe2.workflow.laws import open_study


def check(
    recipe: console.RecipeFile,
    only: Annotated[
        bool, typer.Option("--only", help="Read the recipe and its files; no dry run.")
    ] = False,
    compile: Annotated[
        bool,
        typer.Option("--compile", help="Compile the kernels of its runs, before a job array."),
    ] = False,
    margin: Annotated[
        float, typer.Option(metavar="X", help="Strain and rate beyond what was met, as a share.")
    ] = MARGIN,
    seconds: Annotated[
        float, typer.Option(min=0.0, metavar="S", help="Processor time of the dry runs, s.")
    ] = SECONDS,
    threads: console.Threads = None,
) -> None:
    """Check a recipe: its faults, the range it needs, how long it takes, which law to take.

    Reports everything that is wrong with the recipe, its mesh, names and files. Then a dry run by
    the tangents of the RVE at rest, on a coarser mesh where the recipe's takes too long, proposes
    the [bold]\\[range][/bold], to be copied into the recipe. It knows neither stiffening nor loss
    of stability; the margin is for that. The number of RVEs to solve and the time of one give the
    order of magnitude of a run by RVEs. Nothing is written.

    Example: [bold]surrofe2 check data/large-bar.toml[/bold]

    Next: [bold]surrofe2 study data/large-bar.toml[/bold]
    """
    faults = recipe_faults(recipe)
    if not faults:
        study = open_study(recipe, threads)
        mesh, merged = checked_mesh(study)
        # a recipe may be for RVEs alone: what a surrogate lacks is reported, and is no fault
        faults = study_faults(mesh, ("rve",))
    for message in faults:
        console.print_warning(message)
    if faults:
        raise InputError(f"{recipe}: {len(faults)} problem{'s' * (len(faults) > 1)} found")
    if merged:
        console.print_line(f"checked with {mesh.stated.mesh.elements} elements: the mesh is large")
    without = [part.section("range") for part in study.parts().values() if part.range is None]
    if without:
        console.print_line(f"No [{without[0]}]: only `--law rve` can run this recipe.")
    else:
        for message in study_faults(mesh, ("rve", "cached")):
            console.print_line(f"not by --law cached or surrogate: {message}")
    if compile:
        with console.working("compile", 1.0, "laws", "compiled kernels are kept"):
            kinds = compile_kernels(study)
        console.print_line(f"kernels of {', '.join(kinds)}: compiled")
    if only:
        console.done(recipe, "no problem found")
        return
    with console.working("dry run", study.duration, "µs", "nothing was changed") as report:
        run = dry_run(study, seconds, report)
        by_rves = seconds_by_rves(study, run)
    _show_ranges(run, margin)
    console.print_line(
        f"{run.points:,} points, some {run.calls:.2g} calls: {run.solves:.1g} RVEs to solve. "
        f"The run would take about {rough_time(by_rves / 2.0)} to {rough_time(2.0 * by_rves)} by "
        "--law rve"
    )
    # without the seconds of the check, which would read as those of the law
    console.done(recipe, f"take --law {advised_law(study, by_rves)}", timed=False)


def _show_ranges(run: DryRun, margin: float) -> None:
    for cell, met in run.met.items():
        low, high = met.stretch
        try:
            console.print_line(range_section(proposed_range(met, margin), cell))
        except InputError as error:
            console.print_warning(str(error))
        console.print_line(
            f"# by the quadratic law of the RVE at rest: met stretch {low:.4g} to {high:.4g}, "
            f"shear {met.shear:.3g}, rate {met.rate:.3g} 1/µs; margin {100.0 * margin:g} %"
        )
    if run.omitted:
        console.print_line(f"# left out, for lack of time: {run.omitted}")
