"""`surrofe2 rest`: the tissue at rest under its load, quasi-statically, into a run folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from surrofe2.cli.console import duration, keeping, progress, say
from surrofe2.cli.options import Initialisation, RecipeFile, ReplaceRun, RunFolder, Threads
from surrofe2.errors import SimulationError

if TYPE_CHECKING:
    from surrofe2.io.runs import RunRecord
    from surrofe2.macro import Rest
    from surrofe2.recipe import Recipe


def rest_study(
    recipe: Recipe,
    folder: Path,
    *,
    factor: float = 1.0,
    load_steps: int = 10,
    threads: int | None = None,
    force: bool = False,
    report: Callable[[float, str], None] = lambda factor, note: None,
) -> tuple[RunRecord, list[Rest]]:
    """Load the recipe's bar in steps and write the run folder; its record and all equilibria.

    What was found before a failure or an interrupt is written, and the record says how it ended.

    Args:
        factor: of the body force, at the end.
        report: called with the part of the load that is on, 0 to 1, and a remark.

    Raises:
        SimulationError: a load step finds no equilibrium.
    """
    from surrofe2.cli.laws import choose_law, use_threads, warm_up
    from surrofe2.cli.run_records import new_record
    from surrofe2.io.runs import ended, open_run_folder
    from surrofe2.macro import find_rest

    used = use_threads(threads)
    chosen = choose_law(recipe, "rve")
    record = new_record(recipe, "rve", used)
    stated = {"factor": factor, "load_steps": load_steps}
    record = replace(record, recipe={**record.recipe, "rest": stated})
    open_run_folder(folder, record, force=force)
    compilation = warm_up(chosen.parts, recipe.macro)
    begin = time.perf_counter()
    path: list[Rest] = []

    def reached(rest: Rest) -> None:
        path.append(rest)
        report(rest.factor / factor if factor else 1.0, "")

    def store(status: str, error: str | None = None) -> RunRecord:
        wall = {"total": time.perf_counter() - begin, "compilation": compilation}
        return _store(folder, replace(ended(record, status, error), wall_time=wall), path)

    try:
        find_rest(
            recipe.load,
            chosen.law,
            recipe.macro,
            factor=factor,
            load_steps=load_steps,
            reached=reached,
        )
    except SimulationError as error:
        store("failed", str(error))
        raise
    except KeyboardInterrupt:
        store("interrupted")
        raise
    return store("finished"), path


def _store(folder: Path, record: RunRecord, path: list[Rest]) -> RunRecord:
    """Write the equilibria found so far; run.json last."""
    from surrofe2.io.fields import write_fields
    from surrofe2.io.runs import write_load_path, write_record
    from surrofe2.macro import rest_frames

    if path:
        bar = path[0].discretisation
        write_load_path(folder, path[-1].path)
        write_fields(folder, bar.nodes, bar.quads, rest_frames(path))
        record = replace(record, counts=path[-1].counts)
    write_record(folder, record)
    return record


def rest(
    recipe: RecipeFile,
    out: RunFolder,
    factor: Annotated[float, typer.Option(help="Of the recipe's body force, at the end.")] = 1.0,
    load_steps: Annotated[
        int, typer.Option(min=1, metavar="N", help="Load steps; halved where one fails.")
    ] = 10,
    initialisation: Initialisation = None,
    threads: Threads = None,
    force: ReplaceRun = False,
) -> None:
    """Find the tissue at rest under the recipe's body force, by true FE², without time.

    The load goes on in steps, Newton's method with line search solves each. DIR receives run.json
    (configuration, costs), path.csv (factor of the load, displacement of the watched point in µm)
    and fields.xdmf for ParaView, where the factor stands for the time.

    Example: [bold]surrofe2 rest data/bending-bar.toml --out out/rest[/bold]

    Next: [bold]surrofe2 modes data/bending-bar.toml[/bold]
    """
    from surrofe2.cli.run import change_rve
    from surrofe2.recipe import load_recipe

    study = change_rve(load_recipe(recipe), initialisation, None)
    kept = f"{out} keeps the load steps up to here"
    with keeping(kept), progress("rest", 1.0, "loads") as report:
        record, path = rest_study(
            study,
            out,
            factor=factor,
            load_steps=load_steps,
            threads=threads,
            force=force,
            report=report,
        )
    u_x, u_y = path[-1].watched
    counts = record.counts
    say(
        f"{out}: at rest under {factor:g} times the load, watched point at ({u_x:.4g}, {u_y:.4g}) "
        f"µm, in {duration(record.wall_time['total'])}: {counts['load_steps']} load steps, "
        f"{counts['halvings']} halvings, {counts['factorisations']} Newton corrections"
    )
