"""What the processes of a parameter study are given: by itself, so that a run loads no torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.recipe.recipe import Recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.progress import Stage
from surrofe2.workflow.run import run_study


@dataclass(frozen=True, slots=True, kw_only=True)
class GridTask:
    """Work that a process can be given: a surrogate, or a run.

    Attributes:
        name: of its file, or its folder.
        values: of the entries that change and that the run depends on.
        true: name of the run of the same values by true RVEs.
        needs: files of the surrogates of a run by name of the cell.
        is_own: whether a surrogate is the recipe's own, which is never started over.
    """

    name: str
    recipe: Recipe
    law: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    true: str = ""
    needs: Mapping[str, Path] = field(default_factory=dict)
    is_own: bool = False


Work = Callable[[GridTask, Stage], str | None]
"""Does a task; the sentence of the error that ended it, or None."""


def run_member(
    out: Path, threads: int | None, fresh: bool, task: GridTask, stage: Stage
) -> str | None:
    """Run a member of a grid in its folder; the sentence of the error that ended it, or None."""
    use_threads(threads)
    try:
        with stage(task.name, task.recipe.duration, "µs") as report:
            run_study(
                task.recipe,
                task.law,
                out / task.name,
                surrogates=task.needs,
                fresh=fresh,
                report=report,
            )
    except (InputError, SimulationError) as error:
        return str(error)
    return None
