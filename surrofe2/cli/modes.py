"""`surrofe2 modes`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from surrofe2.cli.console import (
    HOW,
    AnyInitialisation,
    Fresh,
    JsonFile,
    RecipeFile,
    Threads,
    done,
    print_warning,
    progress,
    show_table,
)
from surrofe2.recipe import load_recipe
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS
from surrofe2.store.store import keep
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.rest import find_all_modes, modes_identity, modes_record


def modes(
    recipe: RecipeFile,
    initialisation: Annotated[AnyInitialisation, typer.Option(metavar="NAME", help=HOW)] = "all",
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Modes, slowest first.")] = 4,
    threads: Threads = None,
    out: JsonFile = None,
    fresh: Fresh = False,
) -> None:
    """Period and damping of the tissue's small oscillations, by true FE² and its exact tangents.

    About the tissue without load, and about its rest under the recipe's loads. The decrement is
    logarithmic, a period; the damping ratio is 1 where nothing oscillates any more.

    Example: [bold]surrofe2 modes data/bending-bar-water.toml --out out/modes.json[/bold]

    Next: [bold]surrofe2 run data/bending-bar-water.toml --law rve --out out/rve[/bold] oscillates
    with the loaded periods.
    """
    study = load_recipe(recipe)
    use_threads(threads)
    methods = INITIALISATIONS if initialisation == "all" else (initialisation,)
    asked = modes_identity(study, methods, count)

    def make() -> dict[str, Any]:
        return modes_record(study, find_all_modes(study, methods, count, stage=progress))

    record = make() if out is None else keep(out, asked, make, fresh=fresh)[0]
    n = study.problem().mesh.nelements
    for state, of_state in record["states"].items():
        title = f"{state.capitalize()}, {n} elements, preset {study.preset}"
        show_table(title, _table(of_state))
        for method, numbers in of_state.items():
            if not numbers["stable"]:
                print_warning(f"{state}, {method}: a motion grows; the tissue is not stable there")
    done(out, f"by {', '.join(methods)}")


_COLUMNS: tuple[Quantity[Any], ...] = (
    Quantity("initialisation", "", ""),
    Quantity("u_y", "µm", ".2f"),
    Quantity("mode", "", ""),
    Quantity("period", "µs", ".3f"),
    Quantity("decrement", "", ".4f"),
    Quantity("damping ratio", "", ".5f"),
)


def _table(found: dict[str, dict[str, Any]]) -> Table[Any]:
    rows = []
    for method, numbers in found.items():
        figures = zip(*(numbers[k] for k in ("period", "decrement", "damping_ratio")), strict=True)
        for k, each in enumerate(figures):
            values = method, numbers["watched"][1], k + 1, *each
            rows.append(dict(zip((column.name for column in _COLUMNS), values, strict=True)))
    return Table(_COLUMNS, rows)
