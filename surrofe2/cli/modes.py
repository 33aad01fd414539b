"""`surrofe2 modes`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from surrofe2.cli.console import (
    AnyInitialisation,
    Fresh,
    JsonFile,
    RecipeFile,
    Threads,
    print_error,
    print_line,
    progress,
    show_table,
)
from surrofe2.io.files import is_there, read_json, write_json
from surrofe2.recipe import load_recipe
from surrofe2.rve import INITIALISATIONS
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.rest import find_all_modes, modes_identity, modes_record


def modes(
    recipe: RecipeFile,
    initialisation: Annotated[
        AnyInitialisation, typer.Option(help="How RVEs are initialised: one way, or all.")
    ] = "all",
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
    if out is not None and not fresh and is_there(out, asked):
        found = read_json(out)["states"]
    else:
        found = find_all_modes(study, methods, count, stage=progress)
        if out is not None:
            write_json(out, asked | modes_record(study, found))
    n = len(study.problem().mesh.elements)
    for state, of_state in found.items():
        _show(f"{state.capitalize()}, {n} elements, preset {study.preset}", of_state)
        for method, numbers in of_state.items():
            if not numbers["stable"]:
                print_error(f"{state}, {method}: a motion grows; the tissue is not stable there")
    if out is not None:
        print_line(str(out))


def _show(title: str, found: dict[str, dict[str, Any]]) -> None:
    columns = ["initialisation", "u_y (µm)", "mode", "period (µs)", "decrement", "damping ratio"]
    rows = []
    for method, numbers in found.items():
        figures = zip(
            numbers["period"], numbers["decrement"], numbers["damping_ratio"], strict=True
        )
        for k, (period, decrement, ratio) in enumerate(figures):
            names = [method, f"{numbers['watched'][1]:.2f}"] if k == 0 else ["", ""]
            rows.append([*names, str(k + 1), f"{period:.3f}", f"{decrement:.4f}", f"{ratio:.5f}"])
    show_table(title, columns, rows)
