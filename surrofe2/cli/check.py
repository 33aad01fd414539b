"""`surrofe2 check`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.costs import Balance
from surrofe2.errors import InputError
from surrofe2.report.tables import Quantity, Table
from surrofe2.workflow.estimate import Estimate, estimate
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.recipe_check import recipe_faults, study_faults


def check(
    recipe: console.RecipeFile,
    only: Annotated[
        bool, typer.Option("--only", help="Read the recipe and its files; time nothing.")
    ] = False,
    threads: console.Threads = None,
) -> None:
    """Whether a recipe can be run, what a study of it will cost, and which law to take.

    Reads all of it, mesh, names, ranges and files, and tells everything that is wrong. Then a dry
    run by the tangents of the RVE at rest and what is timed say what memory, data set,
    training and runs will take. Nothing is written.

    Example: [bold]surrofe2 check data/large-bar.toml[/bold]

    Next: [bold]surrofe2 study data/large-bar.toml[/bold]
    """
    faults = recipe_faults(recipe)
    if not faults:
        study = open_study(recipe, threads)
        # a recipe may be for true runs alone: what a surrogate lacks is told, and is no fault
        faults = study_faults(study, ("rve",))
    for sentence in faults:
        console.print_warning(sentence)
    if faults:
        raise InputError(f"{recipe}: {len(faults)} thing{'s' * (len(faults) > 1)} to mend")
    lacking = study_faults(study, ("rve", "cached"))
    for sentence in lacking:
        console.print_line(f"not by a surrogate: {sentence}")
    if only:
        console.done(recipe, "nothing is wrong")
    else:
        with console.on_interrupt("nothing was changed"), console.stages() as stage:
            found = estimate(study, stage)
        _show(found)
        numbers = {**asdict(found), "totals": found.totals, "peaks": found.peaks}
        numbers["best"] = found.best
        console.done(recipe, f"take --law {found.best}", **numbers)


def _show(found: Estimate) -> None:
    about = "" if found.is_whole else " (extrapolated)"
    console.print_line(
        f"{found.points} points, asked {round(found.calls)} times{about}; "
        f"{1e6 * found.solve:.3g} µs an RVE along the run"
    )

    def of_cached(value: float) -> Callable[[str], float | None]:
        return lambda law: value if law == "cached" else None

    quantities: list[Quantity[str]] = [
        Quantity("law", "", "", lambda law: law),
        Quantity("in all", "s", ".3g", lambda law: found.totals[law]),
        Quantity("run", "s", ".3g", lambda law: found.runs[law]),
        Quantity("data set", "s", ".3g", of_cached(found.data)),
        Quantity("training", "s", ".3g", of_cached(found.training)),
        Quantity("memory", "GB", ".2g", lambda law: 1e-9 * found.peaks[law]),
    ]
    console.show_table("Estimates", Table(quantities, list(found.totals)))
    if found.in_range < 1.0:
        console.print_line(
            f"of the points along the run {1.0 - found.in_range:.2%} are out of the surrogate's "
            "range; true RVEs answer there"
        )
    if found.cached is not None:
        balance = Balance(made=found.data + found.training, run=found.cached, true=found.rve)
        console.print_line(f"surrogate: {balance.sentence}")
