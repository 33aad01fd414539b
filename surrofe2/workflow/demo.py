"""The demo: data set, surrogate, and two bars by true and by cached FE²."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from surrofe2.recipe import Recipe
from surrofe2.report.comparison import Comparison
from surrofe2.workflow.comparison import compare_runs
from surrofe2.workflow.generate import data_summary, generate_data_set
from surrofe2.workflow.run import run_study, run_summary
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.train import train_surrogate, training_summary

LAWS = ("rve", "cached")
LARGE_ELEMENTS, LARGE_DURATION = (16, 16), 100.0
"""Elements, and time in µs, of the finer bar."""


def run_demo(
    recipe: Recipe,
    out: Path,
    *,
    fresh: bool = False,
    stage: Stage = silent,
    tell: Callable[[str], None] = lambda sentence: None,
) -> list[tuple[str, Comparison]]:
    """Data set, surrogate, and two bars by true and by cached FE²: the recipe's, and finer.

    Each law runs a bar for an instant before it runs it for the record, so that both are warm.

    Args:
        tell: is told each step's outcome.

    Returns:
        A title and the comparison of each bar.
    """
    tell(f"1/4 data set {recipe.data_path()}")
    with stage("generate", recipe.samples.count, "samples") as report:
        made = generate_data_set(recipe, fresh=fresh, report=report)
    tell(f"    {data_summary(made)}")
    tell(f"2/4 surrogate {recipe.training_path()}")
    trained = train_surrogate(recipe, fresh=fresh, stage=stage)
    tell(f"    {training_summary(trained)}")
    tell(f"    {trained.bound}")
    n, m = LARGE_ELEMENTS
    large = replace(
        recipe,
        macro=replace(recipe.macro, elements=LARGE_ELEMENTS),
        load=replace(recipe.bar_load(), duration=min(LARGE_DURATION, recipe.duration)),
    )
    found = []
    for k, (study, folder) in enumerate(((recipe, out), (large, out / f"{n}x{m}"))):
        title = "{} × {} elements over {:g} µs".format(*study.macro.elements, study.duration)
        tell(f"{k + 3}/4 {title}")
        for law in LAWS:
            with stage(f"run by {law}", study.duration, "µs") as report:
                record = run_study(study, law, folder / law, fresh=fresh, report=report)
            tell(f"    {folder / law}: {run_summary(record)}")
        runs = [folder / law for law in LAWS]
        found.append((title, compare_runs(runs, folder / "comparison", fresh=True)))
    return found
