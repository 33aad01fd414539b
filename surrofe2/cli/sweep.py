"""`surrofe2 sweep`: the load case at several stress tolerances, against true FE²."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from surrofe2.cli.compare import ratio
from surrofe2.cli.console import keeping, progress, say, show_table
from surrofe2.cli.options import Again, RecipeFile, SurrogateFile, Threads
from surrofe2.cli.run import change_cache, run_study
from surrofe2.errors import InputError

if TYPE_CHECKING:
    from surrofe2.recipe import Recipe
    from surrofe2.report.tolerance_sweep import Sweep

FILES = ("sweep.json", "sweep.png")


def run_sweep(
    recipe: Recipe,
    out: Path,
    tolerances: Sequence[float],
    *,
    law: str = "cached",
    surrogate_file: Path | None = None,
    threads: int | None = None,
    force: bool = False,
) -> Sweep:
    """True FE² and a cached run at each tolerance, each in a folder of its own, and their sweep.

    Runs that are already finished in `out` are kept, unless `force`.
    """
    from surrofe2.io.files import write_json
    from surrofe2.io.runs import read_run
    from surrofe2.report.tolerance_plot import write_sweep_plot
    from surrofe2.report.tolerance_sweep import make_sweep

    names = ["rve", *(f"tolerance-{each:g}" for each in tolerances)]
    studies = [recipe, *(change_cache(recipe, each, None) for each in tolerances)]
    for k, (name, study) in enumerate(zip(names, studies, strict=True)):
        kind = law if k else "rve"
        with progress(f"{k + 1}/{len(names)} {name}", study.load.duration, "µs") as report:
            run_study(
                study,
                kind,
                out / name,
                surrogate_file=surrogate_file,
                threads=threads,
                resume=not force,
                force=force,
                report=report,
            )
    reference, *runs = (read_run(out / name) for name in names)
    sweep = make_sweep(reference, runs)
    write_json(out / FILES[0], sweep.to_dict())
    write_sweep_plot(out / FILES[1], sweep)
    return sweep


def sweep(
    recipe: RecipeFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the runs and the picture.")],
    tolerances: Annotated[
        str, typer.Option(metavar="X,…", help="Stress tolerances, shares of the spread of stress.")
    ] = "1e-1,3e-2,1e-2,3e-3,1e-3,3e-4,1e-4",
    audit: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Share of answers audited; default: the recipe's."),
    ] = None,
    surrogate: SurrogateFile = None,
    threads: Threads = None,
    force: Again = False,
) -> None:
    """Run the load case at several stress tolerances: what a tolerance buys.

    DIR receives a run folder for true FE² and for each tolerance, sweep.json and sweep.png: error
    of stress and displacement, hits and speed-up over tolerance. What an earlier call finished is
    kept.

    Example: [bold]surrofe2 sweep data/bending-bar.toml --out out/sweep[/bold]
    """
    from surrofe2.recipe import load_recipe

    study = change_cache(load_recipe(recipe), None, audit)
    numbers = parse_tolerances(tolerances)
    for tolerance in numbers:
        change_cache(study, tolerance, None)
    if force:
        _make_way(out)
    with keeping(f"{out} keeps what is finished; the same command goes on from there"):
        result = run_sweep(
            study, out, numbers, surrogate_file=surrogate, threads=threads, force=force
        )
    show_sweep(result)
    say(f"{out}: {' and '.join(FILES)} written")


def _make_way(out: Path) -> None:
    from surrofe2.io.files import reported

    for name in FILES:
        with reported(out / name, "written"):
            (out / name).unlink(missing_ok=True)


def parse_tolerances(text: str) -> tuple[float, ...]:
    """Numbers between commas, falling, each once.

    Raises:
        InputError: something between them is no number.
    """
    try:
        numbers = {float(part) for part in text.split(",")}
    except ValueError:
        raise InputError(f"--tolerances: {text!r}; they must be numbers between commas") from None
    return tuple(sorted(numbers, reverse=True))


def show_sweep(sweep: Sweep) -> None:
    """The figures of a sweep as a table."""
    columns = [
        "allowed",
        "stress",
        "above",
        "displaced",
        "hits",
        "speed-up",
        "steps",
    ]
    rows = [
        [
            f"{100 * row.tolerance:g} %",
            "–" if row.error_99 is None else f"{100 * row.error_99:.2g} %",
            f"{row.violations} of {row.audited}",
            f"{100 * row.displacement_error:.2g} %",
            f"{100 * row.hits:.3g} %",
            ratio(row.speed_up) + (" (off)" if row.off else ""),
            f"{100 * row.right_hand_sides:.4g} %",
        ]
        for row in sweep.rows
    ]
    show_table(f"Against true FE² of {sweep.true_wall_time:.3g} s", columns, rows)
    say(
        "allowed: tolerance; stress: error of 99 % of the audited answers, and how many were above "
        "the tolerance; displaced: largest error of displacement; steps: right-hand sides"
    )
