"""What a study of a recipe will cost: memory and seconds, from a dry run and what is timed.

Nothing is written. Compilation and the start of commands are not counted, as nowhere else.
"""

from __future__ import annotations

import logging
import math
import resource
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.cache import CachedLaw
from surrofe2.cache.audit import BATCH
from surrofe2.compilation import clock
from surrofe2.errors import SimulationError
from surrofe2.recipe import Recipe
from surrofe2.rve.rve_state import MANY_BYTES
from surrofe2.simd import TILE
from surrofe2.stress_law import StressLaw
from surrofe2.workflow import laws
from surrofe2.workflow.cell_laws import law_arrays, law_by_region
from surrofe2.workflow.dry_run import (
    DryRun,
    dry_run,
    evenly,
    replayed,
    seconds_a_call,
    timed_run,
)
from surrofe2.workflow.generate import CHUNK
from surrofe2.workflow.run_lifecycle import CHECKPOINT_INTERVAL, Stage, silent
from surrofe2.workflow.stand_in import Learnt, learnt_of

Rows = NDArray[np.intp]
log = logging.getLogger(__name__)

SECONDS = 8.0
"""For the dry run on one mesh; half of it for the cached run, a fourth for each other thing."""
_MOST_POINTS, _LEAST_POINTS = 2048, 64
_PROCESS = 1.9e8
"""Bytes of a run of a few points, measured."""
_MATRICES = 10.0
"""Blocks of factors that a thread works in, with what the reference and its lists take."""
_STATES, _AND_CHECKPOINT = 1.5, 3.5
"""States of the law that are there at once, for some factors are new and old; and copies of them
as a checkpoint is made in memory."""
_COLD = 3.0
"""Blocks of factors for each tile of a chunk of samples, solved cold."""
_FRAME = 210.0
"""Bytes that a frame takes for a point, most of them in three copies of the file at the end; twice
as many in a run that makes checkpoints, which hold the frames so far."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Seconds of wall, and bytes.

    Attributes:
        points, calls: stresses asked at once, and how often, in a run.
        rve, cached, table: of a run by each law; None where there can be none.
        data, training: of what is missing, with the calibration.
        memory: bytes at the peak of a run, by law.
        making: bytes at the peak of what makes data set and surrogate; 0 if they are there.
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
    making: float = 0.0
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
    def peaks(self) -> dict[str, float]:
        """Bytes at the peak of a first run by each law, and of what makes its surrogate."""
        made = {"cached": self.making}
        return {law: max(each, made.get(law, 0.0)) for law, each in self.memory.items()}

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
        cold = _cold(true, run, rows, len(rows) if recipe.types else BATCH)
        report(1.0, "RVEs")
        found = Estimate(
            points=run.points,
            calls=run.calls,
            rve=run.calls * (share * ask + run.macro),
            is_whole=run.is_whole,
            solve=ask / len(rows),
        )
        kept = law_arrays(true, state)
        block = _block_of(kept)
        least = _Least(
            process=_PROCESS + _MATRICES * numba.get_num_threads() * block,
            frames=_FRAME * min(recipe.macro.frames, run.steps) * run.points,
        )
        found.memory["rve"] = least.peak(kept, share, found.rve)
        if _can_learn(recipe):
            learnt = {name: learnt_of(part, each) for name, part in recipe.parts().items()}
            is_there = all(own.is_true for own in learnt.values())
            report(2.0, "surrogate")
            found = replace(
                _with_cache(found, recipe, run, learnt, 2.0 * each, least, cold),
                making=0.0 if is_there else _making(block),
            )
        report(3.0, "cached run")
        if _can_tabulate(recipe):
            seconds, memory = _by_table(recipe, run, rows, each, least, cold)
            found = replace(found, table=seconds, memory={**found.memory, "table": memory})
        report(4.0, "table")
    return found


def _rows(run: DryRun, recipe: Recipe) -> Rows:
    """Points of the windows by which RVEs are timed: evenly some of them, all of several cells;
    fewer where an RVE has many particles."""
    count = len(run.windows[0][0].F)
    most = max(_LEAST_POINTS, _MOST_POINTS // recipe.cell.cells**2)
    few = count if recipe.types else min(count, most)
    return evenly(count, few)


def _cold(true: StressLaw, run: DryRun, rows: Rows, most: int) -> float:
    """Seconds of an RVE solved cold, with so many others at most, mean of the windows."""
    few = rows[evenly(len(rows), most)]
    began = clock()
    for window in run.windows:
        true.respond(window[-1].F[few], window[-1].F_dot[few])
    return (clock() - began) / (len(few) * len(run.windows))


def _block_of(arrays: Mapping[str, NDArray[Any]]) -> float:
    """Bytes of the factors of a tile of the RVEs that are largest."""
    blocks = [each for name, each in arrays.items() if name.endswith("blocks")]
    return max((each.nbytes / len(each) for each in blocks), default=0.0)


def _making(block: float) -> float:
    """Bytes at the peak of data set and training, of which this process has done a part."""
    this = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(this, _PROCESS + _COLD * block * CHUNK / TILE)


@dataclass(frozen=True, slots=True)
class _Least:
    """Bytes of a run without what its law knows of its points: of the process, and of frames."""

    process: float
    frames: float

    def peak(self, arrays: Mapping[str, NDArray[Any]], share: float, seconds: float) -> float:
        """Bytes at the peak of a run of so many seconds.

        Args:
            arrays: of the law, for a part of the points. share: all of them over these.
        """
        states = share * sum(np.asarray(each).nbytes for each in arrays.values())
        has_checkpoints = seconds > CHECKPOINT_INTERVAL
        with_law = has_checkpoints and states < MANY_BYTES
        states *= _STATES + (_AND_CHECKPOINT if with_law else 0.0)
        return self.process + self.frames * (2.0 if has_checkpoints else 1.0) + states


def _can_learn(recipe: Recipe) -> bool:
    return all(
        part.range is not None and part.samples.file is not None and part.training_file is not None
        for part in recipe.parts().values()
    )


def _can_tabulate(recipe: Recipe) -> bool:
    direct = recipe.rve.solver == "direct" and recipe.macro.integrator == "explicit"
    return direct and all(part.range is not None for part in recipe.parts().values())


def _with_cache(
    found: Estimate,
    recipe: Recipe,
    run: DryRun,
    learnt: dict[str, Learnt],
    seconds: float,
    least: _Least,
    cold: float,
) -> Estimate:
    """The estimate with what a surrogate costs, and a run by it with its audits.

    Args:
        seconds: for the run; what is left of a longer one is estimated.
        cold: seconds of an audit.
    """
    mesh, is_true = recipe.problem().mesh, all(each.is_true for each in learnt.values())
    by_cell: list[CachedLaw] = []

    def law_of(part: Recipe) -> CachedLaw:
        own, kept = learnt[part.cell_name or ""], part.cache
        if not is_true:  # audits would find a stand-in wrong
            kept = replace(kept, audit=0.0)
        if not own.is_true:
            kept = replace(kept, tolerance=math.inf)
        by_cell.append(CachedLaw(own.law, laws.true_law(part), kept))
        return by_cell[-1]

    found = replace(
        found,
        data=sum(each.data for each in learnt.values()),
        training=sum(each.training for each in learnt.values()),
    )
    law = law_by_region(recipe, mesh, law_of)
    laws.warm_up(tuple(each.law for each in learnt.values()), recipe.macro, points=run.points)
    try:
        cached, _ = timed_run(recipe, law, seconds, run)
    except SimulationError as error:
        log.warning("no estimate of a cached run: %s", error)
        return found
    if not is_true:
        cached += _audits(recipe, run) * cold
    rows = np.resize(np.arange(len(run.windows[0][0].F)), run.points)
    before, state = _met(by_cell), None
    for window in run.windows:
        _, _, state = replayed(law, window, rows, warm=0)
    hits, missed = _met(by_cell) - before
    peak = least.peak(law_arrays(law, state), 1.0, cached)
    return replace(
        found,
        cached=cached,
        memory={**found.memory, "cached": peak},
        in_range=hits / max(hits + missed, 1),
    )


def _met(laws: Iterable[CachedLaw]) -> NDArray[np.int64]:
    """Hits and fallbacks so far."""
    return np.array([[law.counts["hits"], law.counts["fallbacks"]] for law in laws]).sum(axis=0)


def _unaudited(recipe: Recipe) -> Recipe:
    """The recipe without audits, which are counted apart: windows have too few."""
    return replace(recipe, cache=replace(recipe.cache, audit=0.0))


def _audits(recipe: Recipe, run: DryRun) -> float:
    return recipe.cache.audit * run.points * run.steps


def _by_table(
    recipe: Recipe, run: DryRun, rows: Rows, seconds: float, least: _Least, cold: float
) -> tuple[float, float]:
    """Seconds of a run by a table, and bytes at its peak.

    A run that takes no longer is done. Of another one, what it learns along the path is what it has
    to learn; then it is asked the windows.
    """

    def law_of(part: Recipe) -> CachedLaw:
        true = laws.true_law(part)
        table = laws.make_table(part, true)
        begun.append(table.cost.wall)
        return CachedLaw(table, true, part.cache)

    mesh, along = recipe.problem().mesh, np.arange(len(run.path[0].F))
    begun: list[float] = []
    law = law_by_region(recipe, mesh, law_of)
    before, taken, is_done = sum(begun), 0.0, False
    with suppress(SimulationError):
        taken, is_done = timed_run(recipe, law, seconds, run)
    if not is_done:
        law = law_by_region(recipe, mesh, lambda part: law_of(_unaudited(part)))
        taken = replayed(law, run.path, along, warm=0)[0]
        taken -= min(taken, replayed(law, run.path, along, warm=0)[0])
        ask, _ = seconds_a_call(law, run.windows, rows, seconds)
        taken += run.calls * (ask * run.points / len(rows) + run.macro)
        taken += _audits(recipe, run) * cold
    _, _, state = replayed(law, run.path, along)
    return before + taken, least.peak(law_arrays(law, state), run.points / len(along), taken)
