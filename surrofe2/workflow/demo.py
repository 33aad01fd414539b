"""The demo: data set, surrogate, and two bars by true and by cached FE²."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from surrofe2.recipe import Recipe
from surrofe2.workflow.new_recipe import write_recipe
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.study import LAWS, Steps, Studied, Tell, compared, learn, untold

BAR = Path("data/bending-bar.toml")
LARGE_ELEMENTS, LARGE_DURATION = (16, 16), 100.0
"""Elements, and time in µs, of the finer bar."""


def demo_recipe(out: Path) -> Path:
    """The bar's recipe: a clone's where the working folder is one, else a copy beside the runs."""
    if BAR.exists():
        return BAR
    path = out / BAR.name
    if not path.exists():
        write_recipe(path, "bar")
    return path


def run_demo(
    recipe: Recipe,
    out: Path,
    *,
    fresh: bool = False,
    stage: Stage = silent,
    tell: Tell = untold,
) -> list[tuple[str, Studied]]:
    """Data set, surrogate, and two bars by true and by cached FE²: the recipe's, and finer.

    Each law runs a bar for an instant before it runs it for the record, so that both are warm.

    Args:
        tell: is told each step's outcome.

    Returns:
        A title and the runs of each bar.
    """
    n, m = LARGE_ELEMENTS
    large = replace(
        recipe,
        macro=replace(recipe.macro, elements=LARGE_ELEMENTS),
        load=replace(recipe.bar_load(), duration=min(LARGE_DURATION, recipe.duration)),
    )
    steps = Steps(2 + 2 * len(LAWS), stage, tell)
    learn(recipe, steps, fresh=fresh)
    found = []
    for k, (study, folder) in enumerate(((recipe, out), (large, out / f"{n}x{m}"))):
        title = "{} × {} elements over {:g} µs".format(*study.macro.elements, study.duration)
        first = 3 + k * len(LAWS)
        found.append((title, compared(study, folder, steps, first=first, fresh=fresh)))
    return found
