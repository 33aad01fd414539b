"""`surrofe2 demo`: the main job, end to end."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from surrofe2.cli.compare import compare_runs, show_comparison
from surrofe2.cli.console import duration, keeping, progress, say
from surrofe2.cli.generate import generate_data_set
from surrofe2.cli.generate import summary as data_summary
from surrofe2.cli.options import Again
from surrofe2.cli.run import run_study
from surrofe2.cli.run import summary as run_summary
from surrofe2.cli.train import summary as training_summary
from surrofe2.cli.train import train_surrogate

if TYPE_CHECKING:
    from surrofe2.recipe import Recipe
    from surrofe2.report.comparison import Comparison

LAWS = ("rve", "cached")


def run_demo(recipe: Recipe, out: Path, *, force: bool = False) -> Comparison:
    """Data set, training, true and cached FE² and their comparison; says each step's outcome.

    Steps that are already finished for this very recipe are kept, unless `force`.
    """
    say(f"1/4 data set {recipe.data_path()}")
    with progress("generate", recipe.samples.count, "samples") as report:
        made = generate_data_set(recipe, resume=not force, force=force, report=report)
    say(f"    {data_summary(made)}")
    say(f"2/4 surrogate {recipe.training_path()}")
    trained = train_surrogate(recipe, resume=not force, keep=not force, force=True, stage=progress)
    say(f"    {training_summary(trained)}")
    say(f"    {trained.bound}")
    for k, law in enumerate(LAWS):
        say(f"3/4 FE² by {law}: {out / law}" if k == 0 else f"    FE² by {law}: {out / law}")
        with progress(f"run by {law}", recipe.load.duration, "µs") as report:
            record = run_study(recipe, law, out / law, resume=not force, force=force, report=report)
        say(f"    {run_summary(record)}")
    say(f"4/4 comparison {out / 'comparison'}")
    return compare_runs([out / law for law in LAWS], out / "comparison", force=True)


def demo(
    recipe: Annotated[
        Path, typer.Option("--recipe", metavar="RECIPE", help="The study's TOML file.")
    ] = Path("data/bending-bar.toml"),
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for runs and picture.")] = Path(
        "out/demo"
    ),
    force: Again = False,
) -> None:
    """The bending bar by true and by cached FE²: data set, training, both runs, comparison.

    Takes a few minutes on two cores. Steps that an earlier call finished for the same recipe
    are kept.

    Example: [bold]surrofe2 demo --out out/demo[/bold]
    """
    from surrofe2.recipe import load_recipe

    study = load_recipe(recipe)
    begin = time.perf_counter()
    kept = "finished steps and the samples so far are kept; `surrofe2 demo` goes on from there"
    with keeping(kept):
        result = run_demo(study, out, force=force)
    show_comparison(result)
    say(f"done in {duration(time.perf_counter() - begin)}: {out / 'comparison/comparison.png'}")
