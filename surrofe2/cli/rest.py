"""`surrofe2 rest` and `surrofe2 modes`: equilibria, and small oscillations about them."""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter
from typing import Annotated, Any

import typer

from surrofe2.cli import console
from surrofe2.recipe.recipe import changed, load_recipe
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS
from surrofe2.workflow.laws import open_study, recipe_notes, surface_notes, use_threads
from surrofe2.workflow.rest import modes_study, rest_study, rest_summary


def rest(
    recipe: console.RecipeFile,
    out: console.RunFolder,
    factor: Annotated[
        float, typer.Option(help="Of all loads and prescribed motions, at the end.")
    ] = 1.0,
    load_steps: Annotated[
        int, typer.Option(min=1, metavar="N", help="Load steps; halved where one fails.")
    ] = 10,
    initialisation: console.Initialisation = None,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Find the tissue at rest under the recipe's loads, by full FE², without time.

    The load rises in steps; Newton's method with line search solves each. DIR receives run.json
    (configuration, costs), path.csv (factor of the load, displacement of the watched point in µm),
    history.csv and energies.csv (forces and works over the factor) and fields.xdmf for ParaView,
    where the factor stands for the time.

    Example: surrofe2 rest data/bending-bar.toml --out out/rest

    Next: surrofe2 modes data/bending-bar.toml
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    study = replace(study, rve=changed(study.rve, initialisation=initialisation))
    with console.running("rest", 1.0, "loads", out, "load steps up to here") as report:
        record = rest_study(
            study, out, factor=factor, load_steps=load_steps, fresh=fresh, report=report
        )
    console.done(out, rest_summary(record), timed=False)
    console.show_notes(surface_notes(record))


def modes(
    recipe: console.RecipeFile,
    initialisation: console.AnyInitialisation = "all",
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Modes, slowest first.")] = 4,
    threads: console.Threads = None,
    out: console.JsonFile = None,
    fresh: console.Fresh = False,
) -> None:
    """Period and damping of the tissue's small oscillations, by full FE² and its exact tangents.

    About the tissue without load, and about its rest under the recipe's loads. The decrement is
    logarithmic, a period; the damping ratio is 1 where nothing oscillates any more.

    Example: surrofe2 modes data/bending-bar-water.toml --out out/modes.json

    Next: surrofe2 run data/bending-bar-water.toml --law rve --out out/rve oscillates
    with the loaded periods.
    """
    study = load_recipe(recipe)
    use_threads(threads)
    methods = INITIALISATIONS if initialisation == "all" else (initialisation,)
    record = modes_study(study, methods, count, out, fresh=fresh, stage=console.progress)
    n = study.problem().mesh.nelements
    for state, of_state in record["states"].items():
        title = f"{state.capitalize()}, {n} elements, preset {study.cells[study.cell_name].preset}"
        rows = [
            (method, numbers["watched"][1], k, *each)
            for method, numbers in of_state.items()
            for k, each in enumerate(zip(*(numbers[name] for name in _OF_MODES), strict=True), 1)
        ]
        console.show_table(title, Table(_COLUMNS, rows))
        for method, numbers in of_state.items():
            if not numbers["stable"]:
                console.print_warning(
                    f"{state}, {method}: a motion grows; the tissue is not stable there"
                )
    console.done(out, f"by {', '.join(methods)}")


_OF_MODES = ("period", "decrement", "damping_ratio")
_COLUMNS: tuple[Quantity[Any], ...] = (
    Quantity("initialisation", "", "", itemgetter(0)),
    Quantity("u_y", "µm", ".2f", itemgetter(1)),
    Quantity("mode", "", "", itemgetter(2)),
    Quantity("period", "µs", ".3f", itemgetter(3)),
    Quantity("decrement", "", ".4f", itemgetter(4)),
    Quantity("damping ratio", "", ".5f", itemgetter(5)),
)
