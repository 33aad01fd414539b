"""`surrofe2 modes`: small oscillations of the bar, unloaded and about its loaded rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from surrofe2.cli.console import complain, progress, say, show_table
from surrofe2.cli.options import AnyInitialisation, JsonFile, RecipeFile, ReplaceFile, Threads

if TYPE_CHECKING:
    from surrofe2.macro import Modes, Rest
    from surrofe2.recipe import Recipe

STATES = {"unloaded": 0.0, "loaded": 1.0}
"""Factor of the body force by the name of the state."""


def modes(
    recipe: RecipeFile,
    initialisation: Annotated[
        AnyInitialisation, typer.Option(help="How RVEs are initialised: one way, or all.")
    ] = "all",
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Modes, slowest first.")] = 4,
    threads: Threads = None,
    out: JsonFile = None,
    force: ReplaceFile = False,
) -> None:
    """Period and damping of the bar's small oscillations, by true FE² and its exact tangents.

    About the bar without load, and about its rest under the recipe's body force. The decrement is
    logarithmic, a period; the damping ratio is 1 where nothing oscillates any more.

    Example: [bold]surrofe2 modes data/bending-bar-water.toml --out out/modes.json[/bold]

    Next: [bold]surrofe2 run data/bending-bar-water.toml --law rve --out out/rve[/bold] oscillates
    with the loaded periods.
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.io.files import refuse_existing, write_json
    from surrofe2.recipe import load_recipe
    from surrofe2.rve import INITIALISATIONS

    if out is not None and not force:
        refuse_existing(out)
    study = load_recipe(recipe)
    used = use_threads(threads)
    methods = INITIALISATIONS if initialisation == "all" else (initialisation,)
    found: dict[str, dict[str, dict[str, Any]]] = {state: {} for state in STATES}
    with progress("modes", float(len(methods) * len(STATES)), "states") as report:
        for k, method in enumerate(methods):
            for j, (state, factor) in enumerate(STATES.items()):
                found[state][method] = _numbers(*_modes_of(study, method, factor, count))
                report(len(STATES) * k + j + 1.0, method)
    n, m = study.macro.elements
    for state, of_state in found.items():
        _show(f"{state.capitalize()}, {n} x {m} elements, preset {study.preset}", of_state)
        for method, numbers in of_state.items():
            if not numbers["stable"]:
                complain(f"{state}, {method}: a motion grows; the bar is not stable there")
    if out is not None:
        write_json(out, _record(study, used) | {"states": found})
        say(str(out))


def _modes_of(study: Recipe, method: str, factor: float, count: int) -> tuple[Rest, Modes]:
    from surrofe2.cli.laws import choose_law
    from surrofe2.cli.run import change_rve
    from surrofe2.macro import find_modes, find_rest

    law = choose_law(change_rve(study, method, None), "rve").law
    rest = find_rest(study.load, law, study.macro, factor=factor, load_steps=4)
    return rest, find_modes(rest, count)


def _numbers(rest: Rest, modes: Modes) -> dict[str, Any]:
    return {
        "watched": rest.watched,
        "period": modes.periods,
        "frequency": modes.frequencies,
        "decrement": modes.decrements,
        "damping_ratio": modes.damping_ratios,
        "creeping": modes.creeping,
        "stable": modes.stable,
    }


def _record(study: Recipe, threads: int) -> dict[str, Any]:
    """Everything needed to compute the modes again."""
    from importlib.metadata import version

    from surrofe2.cli.platforms import describe_platform

    return {
        "version": version("surrofe2"),
        "recipe": study.to_dict(),
        "fingerprint": study.cell.fingerprint,
        "threads": threads,
        "platform": describe_platform(),
        "units": {
            "watched": "µm, displacement of the watched point at rest",
            "period": "µs",
            "frequency": "1/µs",
            "decrement": "1, logarithmic, a period",
            "damping_ratio": "1",
            "creeping": "1/µs, real eigenvalues found on the way",
        },
    }


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
