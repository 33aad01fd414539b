"""A whole study of a recipe: what is missing of data set, surrogate, runs and their comparison."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from surrofe2.recipe import Recipe
from surrofe2.report.comparison import Comparison
from surrofe2.store.run_folder import RunRecord
from surrofe2.workflow.comparison import compare_runs
from surrofe2.workflow.generate import data_summary, generate_data_set, wanted_count
from surrofe2.workflow.progress import Report, Stage, no_stage
from surrofe2.workflow.recipe_check import refuse_faults
from surrofe2.workflow.report import write_report
from surrofe2.workflow.run import run_study, run_summary
from surrofe2.workflow.train import is_trained, large_errors, train_surrogate, training_summary

log = logging.getLogger(__name__)

Tell = Callable[[str], None]
"""Is told what a step came to."""

LAWS = ("rve", "cached")
COMPARISON, REPORT = "comparison", "report.html"
"""Folder of the comparison, and the page on it, among the folders of the runs."""


def no_report(sentence: str) -> None:
    """Tells nobody."""


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps of a study, numbered as it goes: their displays, and what each came to."""

    count: int
    stage: Stage = no_stage
    tell: Tell = no_report

    def step(self, number: int) -> tuple[Stage, Tell]:
        """Display and outcome of the step of this number, from 1."""
        place = f"{number}/{self.count}"

        def stage(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
            return self.stage(f"{place} {what}", total, unit)

        return stage, lambda sentence: self.tell(f"{place} {sentence}")


@dataclass(frozen=True, slots=True)
class Studied:
    """Runs of one problem: their folders, records, and comparison where there are two or more."""

    folders: tuple[Path, ...]
    records: tuple[RunRecord, ...]
    comparison: Comparison | None


def run_recipe(
    recipe: Recipe,
    out: Path,
    *,
    laws: Sequence[str] = LAWS,
    true: Path | None = None,
    fresh: bool = False,
    stage: Stage = no_stage,
    tell: Tell = no_report,
) -> Studied:
    """Data set, surrogate, runs by each law in `out`, and their comparison: what is missing of it.

    Args:
        laws: of the runs, in their order.
        true: folder of a run by true RVEs to compare with besides.
        stage: begins the display of a stage.
        tell: is told each step's outcome.

    Raises:
        InputError: the recipe's mesh, names, range or files are not what a study needs.
    """
    refuse_faults(recipe, tuple(laws), fresh=fresh)
    first = 3 if "cached" in laws else 1
    steps = Steps(first - 1 + len(laws), stage, tell)
    if "cached" in laws:
        learn(recipe, steps, fresh=fresh)
    return compared(recipe, out, steps, laws=laws, first=first, true=true, fresh=fresh)


def learn(recipe: Recipe, steps: Steps, *, fresh: bool = False) -> None:
    """Steps 1 and 2: data set and surrogate of each of the recipe's cells.

    A surrogate whose data set is gone is kept.
    """
    of_data, tell_data = steps.step(1)
    of_training, tell_training = steps.step(2)
    for name, part in recipe.parts().items():
        if not fresh and not part.data_path().exists() and is_trained(part):
            tell_training(f"surrogate {part.training_path()}: already trained")
            continue
        count = wanted_count(part, fresh=fresh)
        with of_data(f"generate {name}".rstrip(), count, "samples") as report:
            made = generate_data_set(part, fresh=fresh, report=report)
        tell_data(f"data set {made.path}: {data_summary(made)}")
        trained = train_surrogate(part, fresh=fresh, stage=of_training)
        tell_training(f"surrogate {trained.path}: {training_summary(trained)}; {trained.bound}")
        warning = large_errors(part, trained)
        if warning is not None:
            log.warning(warning)


def compared(
    recipe: Recipe,
    out: Path,
    steps: Steps,
    *,
    laws: Sequence[str] = LAWS,
    first: int = 3,
    true: Path | None = None,
    fresh: bool = False,
) -> Studied:
    """Runs of the recipe's problem by each law, from the step `first` on, and what they show."""
    folders, records = [] if true is None else [true], []
    for k, law in enumerate(laws):
        stage, tell = steps.step(first + k)
        with stage(f"run by {law}", recipe.duration, "µs") as report:
            records.append(run_study(recipe, law, out / law, fresh=fresh, report=report))
        tell(f"{out / law}: {run_summary(records[-1])}")
        folders.append(out / law)
    # the comparison is made anew: it takes no time, and its table is what people come for
    result = compare_runs(folders, out / COMPARISON, fresh=True) if len(folders) > 1 else None
    steps.tell(f"{write_report(folders, out / REPORT)}: all of it on one page")
    return Studied(tuple(folders), tuple(records), result)
