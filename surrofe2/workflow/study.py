"""A whole study of a recipe: what is missing of data set, surrogate, runs and their comparison."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from surrofe2.recipe.recipe import Recipe
from surrofe2.report.comparison import Comparison
from surrofe2.store.run_folder import RunRecord
from surrofe2.workflow.comparison import compare_runs
from surrofe2.workflow.generate import data_summary, generate_data_set, wanted_count
from surrofe2.workflow.progress import Report, Stage
from surrofe2.workflow.recipe_check import refuse_faults
from surrofe2.workflow.report import write_report
from surrofe2.workflow.run import run_study, run_summary
from surrofe2.workflow.train import is_trained, large_errors, train_surrogate, training_summary

log = logging.getLogger(__name__)

Tell = Callable[[str], None]
"""Is told what a step came to."""

COMPARISON, REPORT = "comparison", "report.html"
"""Folder of the comparison, and the page on it, among the folders of the runs."""


def run_recipe(
    recipe: Recipe,
    out: Path,
    laws: Sequence[str],
    true: Path | None,
    *,
    fresh: bool,
    stage: Stage,
    tell: Tell,
) -> tuple[list[RunRecord], Comparison | None]:
    """Data set, surrogate, runs by each law in `out`, and their comparison: what is missing of it.

    Args:
        laws: of the runs, in their order.
        true: folder of a run by true RVEs to compare with besides.
        stage: begins the display of a stage.
        tell: is told each step's outcome.

    Returns:
        The runs that it made or found, and their comparison where there are two or more.

    Raises:
        InputError: the recipe's mesh, names, range or files are not what a study needs.
    """
    refuse_faults(recipe, tuple(laws), fresh=fresh)
    first = 3 if "cached" in laws else 1

    def step(number: int) -> tuple[Stage, Tell]:
        """Display and outcome of the step of this number, from 1."""
        place = f"{number}/{first - 1 + len(laws)}"

        def numbered(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
            return stage(f"{place} {what}", total, unit)

        return numbered, lambda sentence: tell(f"{place} {sentence}")

    if "cached" in laws:
        for part in recipe.parts().values():
            _learn(part, step(1), step(2), fresh)
    folders, records = [] if true is None else [true], []
    for k, law in enumerate(laws):
        shown, told = step(first + k)
        with shown(f"run by {law}", recipe.duration, "µs") as report:
            records.append(run_study(recipe, law, out / law, fresh=fresh, report=report))
        told(f"{out / law}: {run_summary(records[-1])}")
        folders.append(out / law)
    # the comparison is made anew: it takes no time, and its table is what people come for
    result = compare_runs(folders, out / COMPARISON, fresh=True) if len(folders) > 1 else None
    tell(f"{write_report(folders, out / REPORT)}: all of it on one page")
    return records, result


def _learn(
    recipe: Recipe, of_data: tuple[Stage, Tell], of_training: tuple[Stage, Tell], fresh: bool
) -> None:
    """Data set and surrogate of one cell; a surrogate whose data set is gone is kept."""
    (show_data, tell_data), (show_training, tell_training) = of_data, of_training
    if not fresh and not recipe.data_path().exists() and is_trained(recipe):
        tell_training(f"surrogate {recipe.training_path()}: already trained")
        return
    count, what = wanted_count(recipe, fresh=fresh), f"generate {recipe.cell_name or ''}".rstrip()
    with show_data(what, count, "samples") as report:
        made = generate_data_set(recipe, fresh=fresh, report=report)
    tell_data(f"data set {made.path}: {data_summary(made)}")
    trained = train_surrogate(recipe, fresh=fresh, stage=show_training)
    tell_training(f"surrogate {trained.path}: {training_summary(trained)}; {trained.bound}")
    warning = large_errors(recipe, trained)
    if warning is not None:
        log.warning(warning)
