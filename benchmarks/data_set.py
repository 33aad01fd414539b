"""Item 7: samples a second, RVEs and file included, on all cores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import PRESETS, Setting
from benchmarks.timing import all_cores
from surrofe2.recipe.recipe import Recipe
from surrofe2.workflow.generate import Generated, generate_data_set

TITLE = "Data sets"
_COUNT = 16_384


def run(setting: Setting) -> list[Row]:
    """The shipped recipes, then with tangents, by the recipe's and the dearest initialisation."""
    rows = []
    for preset in PRESETS:
        recipe = setting.recipe(preset)
        slow = replace(recipe, rve=replace(recipe.rve, initialisation="slow-manifold"))
        rows.append(_generate(setting, preset, _with_tangents(recipe, False), 5000.0))
        rows += [
            _generate(setting, preset, _with_tangents(r, True), 3000.0) for r in (recipe, slow)
        ]
    return rows


def _with_tangents(recipe: Recipe, wanted: bool) -> Recipe:
    return recipe.with_cell(samples=replace(recipe.samples, tangents=wanted))


def _generate(setting: Setting, preset: str, recipe: Recipe, limit: float) -> Row:
    samples = replace(recipe.samples, count=setting.pick(_COUNT, 2048))
    recipe = recipe.with_cell(samples=samples)
    what = f", tangents too, {recipe.rve.initialisation}" if samples.tangents else ""
    rates = []
    for _ in range(setting.pick(5, 2) + 1):
        seconds, made = _once(recipe)
        rates.append(made.count / seconds)
    median, low, high = (float(np.percentile(rates[1:], p)) for p in (50, 25, 75))
    return Row(
        name=f"{preset}: samples a second into a finished file of {made.count:,}{what}",
        value=median,
        spread=high - low,
        unit="1/s",
        limit=limit,
        at_least=True,
        threads=all_cores(),
        note=f"{sum(made.failed.values())} failed",
    )


def _once(recipe: Recipe) -> tuple[float, Generated]:
    with TemporaryDirectory() as folder:
        samples = replace(recipe.samples, file="samples.h5")
        here = replace(recipe, path=Path(folder) / recipe.path.name).with_cell(samples=samples)
        begin = perf_counter()
        made = generate_data_set(here)
        return perf_counter() - begin, made
