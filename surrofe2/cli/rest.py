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
from surrofe2.workflow.laws import (
    open_study,
    recipe_notes,
    surrogates_by_cell,
    use_threads,
)
from surrofe2.workflow.rest import (
    modes_study,
    response_lines,
    rest_notes,
    rest_study,
    rest_summary,
)


def rest(
    recipe: console.RecipeFile,
    out: console.RunFolder,
    law: console.Law = "rve",
    factor: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Of all loads and prescribed motions, at the end; default: the recipe's, or 1.",
        ),
    ] = None,
    load_steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Load steps; halved where one fails; default: the recipe's, or 10.",
        ),
    ] = None,
    surrogate: console.SurrogateFiles = None,
    table: console.TableFiles = None,
    initialisation: console.Initialisation = None,
    tolerance: console.Tolerance = None,
    audit: console.Audit = None,
    correct: Annotated[
        bool,
        typer.Option(
            "--correct",
            help="With a cache: solve RVEs at all points at the end, and keep the corrected state.",
        ),
    ] = False,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Find the tissue at rest under the recipe's loads, without time.

    The load rises in steps; Newton's method with line search solves each. DIR receives run.json
    (configuration, costs), path.csv (over the factor of the load: displacement of the watched
    points in µm, forces in µN, how many points left a bifurcation), energies.csv (works) and
    fields.xdmf for ParaView, where the factor stands for the time; with --law table the table, with
    --law cached or table the harvest of RVE stresses. Caches are audited as in runs in time, and at
    the end RVEs and one Newton correction tell the error of displacements and forces.

    Example: surrofe2 rest data/bending-bar.toml --out out/rest

    Next: surrofe2 modes data/bending-bar.toml
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    if study.rest is None:
        console.print_line("at rest, though the recipe states a run in time: it has no [rest]")
    study = replace(
        study,
        rve=changed(study.rve, initialisation=initialisation),
        cache=changed(study.cache, tolerance=tolerance, audit=audit),
    )
    with console.running(f"rest by {law}", 1.0, "loads", out, "load steps up to here") as report:
        record = rest_study(
            study,
            out,
            law,
            factor=factor,
            load_steps=load_steps,
            surrogates=surrogates_by_cell(study, surrogate or ()),
            tables=table or (),
            correct=correct,
            fresh=fresh,
            report=report,
        )
    for line in response_lines(out, record):
        console.print_line(line)
    console.done(out, rest_summary(record), timed=False)
    console.show_notes(rest_notes(record))


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
        title = f"{state.capitalize()}, {n} elements, preset {study.study().cell.preset}"
        rows = []
        for method, numbers in of_state.items():
            modes = zip(*(numbers[name] for name in _OF_MODES), strict=True)
            for k, mode in enumerate(modes, 1):
                rows.append((method, numbers["watched"][1], k, *mode))
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
