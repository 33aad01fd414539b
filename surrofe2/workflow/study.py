"""A whole study of a recipe: what is missing of data set, surrogate, runs and their comparison."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from surrofe2.recipe.recipe import Recipe
from surrofe2.report.comparison import Comparison, compare_runs
from surrofe2.report.page import write_report
from surrofe2.run.loop import Stage
from surrofe2.store.run_folder import RunRecord
from surrofe2.workflow.check import refuse_faults
from surrofe2.workflow.generate import data_summary
from surrofe2.workflow.run import run_study, run_summary
from surrofe2.workflow.train import is_trained, large_errors, learn, training_summary

log = logging.getLogger(__name__)

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
    tell: Callable[[str], None],
) -> tuple[list[RunRecord], Comparison | None]:
    """Data set, surrogate, runs by each law in `out`, and their comparison: what is missing of it.

    `true` is the folder of a run by RVEs to compare with besides; `tell` is called with what each
    step came to. Returns the runs, and their comparison where there are two or more.

    Raises:
        InputError: the recipe's mesh, names, range or files are not what a study needs.
    """
    refuse_faults(recipe, tuple(laws), fresh=fresh)
    first = 3 if "cached" in laws else 1

    def place(step: int) -> str:
        return f"{step}/{first - 1 + len(laws)}"

    for part in recipe.parts().values() if "cached" in laws else ():
        path = part.training_path()
        if not (fresh or part.data_path().exists()) and is_trained(part):  # it needs no data set
            tell(f"{place(2)} surrogate {path}: already trained")
            continue
        data, trained = learn(part, fresh=fresh, stage=stage)
        tell(f"{place(1)} data set {data.path}: {data_summary(data)}")
        tell(f"{place(2)} surrogate {path}: {training_summary(trained)}; {trained.bound}")
        warning = large_errors(part, trained)
        if warning is not None:
            log.warning(warning)
    folders, records = [] if true is None else [true], list[RunRecord]()
    for k, law in enumerate(laws, first):
        with stage(f"{place(k)} run by {law}", recipe.duration, "µs") as report:
            records.append(run_study(recipe, law, out / law, fresh=fresh, report=report))
        tell(f"{place(k)} {out / law}: {run_summary(records[-1])}")
        folders.append(out / law)
    # the comparison is made again: it takes no time, and its table is what people come for
    result = compare_runs(folders, out / COMPARISON, fresh=True) if len(folders) > 1 else None
    tell(f"{write_report(folders, out / REPORT)}: all of it on one page")
    return records, result
