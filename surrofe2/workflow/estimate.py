"""What a study of a recipe will cost: memory and seconds, from a dry run and a few timed solves.

Nothing is written. Compilation and the start of commands are not counted, as nowhere else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache import CachedLaw
from surrofe2.macro.mesh import Mesh
from surrofe2.recipe import Recipe
from surrofe2.stress_law import StressLaw
from surrofe2.workflow import laws
from surrofe2.workflow.cell_laws import law_arrays, law_by_region
from surrofe2.workflow.dry_run import DryRun, dry_run, seconds_a_call
from surrofe2.workflow.run_lifecycle import Stage, silent
from surrofe2.workflow.stand_in import Learnt, learnt_of

Rows = NDArray[np.intp]

SECONDS = 8.0
"""For the dry run on one mesh; a fourth of it for what else is timed, each."""
_MOST_POINTS, _LEAST_POINTS = 2048, 64
_PROCESS = 2e8
"""Bytes of a run of a few points."""
_FRAME = 96.0
"""Bytes that a frame keeps of a point: F, its rate and the stress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Seconds of wall, and bytes.

    Attributes:
        points, calls: stresses asked at once, and how often, in a run.
        rve, cached, table: of a run by each law; None where there can be none.
        data, training: of what is missing, with the calibration.
        memory: bytes at the peak of a run, by law.
        is_whole: whether the dry run came to its end; else steps are extrapolated.
        solve: of an RVE, warm, along the run.
        in_range: share of the points along the run that a surrogate knows; NaN without one.
    """

    points: int
    calls: float
    rve: float
    data: float = 0.0
    training: float = 0.0
    cached: float | None = None
    table: float | None = None
    memory: dict[str, float] = field(default_factory=dict)
    is_whole: bool = True
    solve: float = 0.0
    in_range: float = math.nan

    @property
    def runs(self) -> dict[str, float]:
        """Of a run by each law that there can be."""
        times = {"rve": self.rve, "table": self.table, "cached": self.cached}
        return {law: time for law, time in times.items() if time is not None}

    @property
    def totals(self) -> dict[str, float]:
        """Of a first run by each law, with what must be made for it."""
        made = {"cached": self.data + self.training}
        return {law: time + made.get(law, 0.0) for law, time in self.runs.items()}

    @property
    def best(self) -> str:
        """The law by which a first run is done soonest."""
        return min(self.totals, key=self.totals.__getitem__)


def estimate(recipe: Recipe, stage: Stage = silent, seconds: float = SECONDS) -> Estimate:
    """What a study of a recipe will cost.

    Args:
        seconds: of the dry run on one mesh; the rest takes about as long again.

    Raises:
        SimulationError: the dry run could not be carried on.
    """
    with stage("dry run", recipe.duration, "µs") as report:
        run = dry_run(recipe, seconds, report)
    mesh, each = recipe.problem().mesh, seconds / 4.0
    with stage("timed solves", 4.0, "laws") as report:
        true = law_by_region(recipe, mesh, laws.true_law)
        rows = _rows(run, recipe)
        laws.warm_up((true,) if not recipe.types else (), recipe.macro, points=len(rows))
        share = run.points / len(rows)
        ask, state = seconds_a_call(true, run.windows, rows, each)
        report(1.0, "RVEs")
        found = Estimate(
            points=run.points,
            calls=run.calls,
            rve=run.calls * (share * ask + run.macro),
            memory=_memory(recipe, run, share * _bytes_of(true, state)),
            is_whole=run.is_whole,
            solve=ask / len(rows),
        )
        if _can_learn(recipe):
            learnt = {name: learnt_of(part, each) for name, part in recipe.parts().items()}
            report(2.0, "surrogate")
            found = _with_cache(found, recipe, run, learnt, each)
        report(3.0, "cached run")
        if _can_tabulate(recipe):
            found = replace(found, table=_by_table(recipe, mesh, run, rows, each))
        report(4.0, "table")
    return found


def _rows(run: DryRun, recipe: Recipe) -> Rows:
    """Points of the windows by which RVEs are timed: evenly some of them, all of several cells;
    fewer where an RVE has many particles."""
    count = len(run.windows[0][0].F)
    most = max(_LEAST_POINTS, _MOST_POINTS // recipe.cell.cells**2)
    few = count if recipe.types else min(count, most)
    return np.unique(np.linspace(0, count - 1, few).round().astype(np.intp))


def _bytes_of(law: StressLaw, state: Any) -> float:
    return float(sum(array.nbytes for array in law_arrays(law, state).values()))


def _memory(recipe: Recipe, run: DryRun, states: float) -> dict[str, float]:
    kept = _PROCESS + _FRAME * recipe.macro.frames * run.points
    return {"rve": kept + states, "table": kept, "cached": kept}


def _can_learn(recipe: Recipe) -> bool:
    return all(
        part.range is not None and part.samples.file is not None and part.training_file is not None
        for part in recipe.parts().values()
    )


def _can_tabulate(recipe: Recipe) -> bool:
    direct = recipe.rve.solver == "direct" and recipe.macro.integrator == "explicit"
    return direct and all(part.range is not None for part in recipe.parts().values())


def _with_cache(
    found: Estimate, recipe: Recipe, run: DryRun, learnt: dict[str, Learnt], seconds: float
) -> Estimate:
    """The estimate with what a surrogate costs, and a run by it with its audits."""
    mesh = recipe.problem().mesh
    by_cell: list[CachedLaw] = []

    def law_of(part: Recipe) -> CachedLaw:
        own = learnt[part.cell_name or ""]
        kept = part.cache if own.is_true else replace(part.cache, tolerance=math.inf)
        by_cell.append(CachedLaw(own.law, laws.true_law(part), kept))
        return by_cell[-1]

    law = law_by_region(recipe, mesh, law_of)
    rows = np.resize(np.arange(len(run.windows[0][0].F)), run.points)
    ask, _ = seconds_a_call(law, run.windows, rows, seconds)
    hits, missed = (sum(each.counts[name] for each in by_cell) for name in ("hits", "fallbacks"))
    audits = recipe.cache.audit * run.points * run.steps
    cold = max(each.cold for each in learnt.values())
    return replace(
        found,
        data=sum(each.data for each in learnt.values()),
        training=sum(each.training for each in learnt.values()),
        cached=run.calls * (ask + run.macro) + audits * cold,
        in_range=hits / max(hits + missed, 1),
    )


def _by_table(recipe: Recipe, mesh: Mesh, run: DryRun, rows: Rows, seconds: float) -> float:
    """Seconds of a run by a table: that of the second time it sees the windows, and learning."""

    def law_of(part: Recipe) -> CachedLaw:
        true = laws.true_law(part)
        table = laws.make_table(part, true)
        table.warm_up()
        return CachedLaw(table, true, part.cache)

    law = law_by_region(recipe, mesh, law_of)
    share = run.points / len(rows)
    began = perf_counter()
    seconds_a_call(law, run.windows, rows, seconds)
    first = perf_counter() - began
    began = perf_counter()
    ask, _ = seconds_a_call(law, run.windows, rows, seconds)
    second = perf_counter() - began
    return run.calls * (share * ask + run.macro) + share * max(0.0, first - second)
