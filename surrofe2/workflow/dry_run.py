"""A dry run of a recipe's problem: the sampling range that it needs, and how long true RVEs take.

The law of a dry run is the quadratic one, the exact tangents of the recipe's RVE at rest. It knows
neither stiffening nor loss of stability, but its time steps are those of a run by RVEs within a few
per cent. Times are orders of magnitude: the number of solves times the time of one.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import clock
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.sampling import SamplingRange
from surrofe2.law.stress_law import StressLaw, StressResponse
from surrofe2.macro import MetRange, simulate
from surrofe2.macro.frames import NO_EXTREMES, widen_extremes
from surrofe2.recipe.recipe import Recipe
from surrofe2.surrogate.deformation_paths import WatchedLaw
from surrofe2.workflow import laws
from surrofe2.workflow.cell_laws import law_by_region
from surrofe2.workflow.progress import Report, no_report
from surrofe2.workflow.train import is_trained

Array = NDArray[np.float64]

MARGIN = 0.2
SECONDS = 5.0
"""Longest dry run on one mesh; where it is too short for the whole run, a coarser mesh follows."""
ALL_SECONDS = 12.0
"""Longest dry runs on all meshes; the range then says until when it was met."""
_COARSEST = 4
_TIMED_STEPS, _TIMED_POINTS, _TIMED_SECONDS = 24, 128, 4.0
"""RVEs are timed along the second half of so many last steps of a dry run, since the first are cold
and without a prediction; none is begun after so many seconds."""
_LEARNING = 30.0
"""A run by RVEs that is shorter, in s, ends before a data set and a surrogate are made."""
_DIGITS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """What a run asks of its law, and what it meets.

    Attributes:
        points: of quadrature; all are asked at each call.
        calls: of the whole run; extrapolated where the dry run was cut short.
        seconds: of the whole run without its RVEs, extrapolated as `calls`.
        reached: share of the duration by which `met` is known.
        met: by name of the cell, which is "" where there is one.
        steps: by name of the cell the last accepted (F, Ḟ), (n, 2, 2) each, of some of its points.
        shares: by name of the cell, of the points.
    """

    points: int
    calls: float
    seconds: float
    reached: float
    met: dict[str, MetRange]
    steps: dict[str, list[tuple[Array, Array]]]
    shares: dict[str, float]

    @property
    def solves(self) -> float:
        """RVEs that a run by them solves."""
        return self.calls * self.points


class _CutShort(Exception):  # noqa: N818 - no error
    """The time of a dry run is up."""


class _Recorder(WatchedLaw):
    """The quadratic law of a cell, and a record of what it was asked."""

    def __init__(self, law: StressLaw) -> None:
        super().__init__(law, self._note)
        self.extremes = NO_EXTREMES.copy()
        self.steps: deque[tuple[Array, Array]] = deque(maxlen=_TIMED_STEPS)
        self.calls = self.points = 0

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        self.calls, self.points = self.calls + 1, len(F)
        return super().respond(F, F_dot, state, tangents=tangents)

    def _note(self, F: Array, F_dot: Array) -> None:
        widen_extremes(self.extremes, F, F_dot)
        some = slice(None, None, -(-len(F) // _TIMED_POINTS))
        self.steps.append((F[some].copy(), F_dot[some].copy()))


def dry_run(recipe: Recipe, seconds: float = SECONDS, report: Report = no_report) -> DryRun:
    """A dry run of a recipe's problem.

    Where `seconds` are too short for the whole run, rectangles are meshed with half as many
    elements each way until they suffice: for the range and the steps; calls are those of the
    recipe's mesh, extrapolated. All of them take at most `ALL_SECONDS`, or twice `seconds`.

    Args:
        seconds: of the run on one mesh.
        report: is told the time reached in µs.

    Raises:
        SimulationError: the run could not be carried on.
    """
    end = clock() + max(ALL_SECONDS, 2.0 * seconds)
    found = best = _dry_run(recipe, seconds, report)
    coarse = recipe
    while best.reached < 1.0 and clock() < end and (coarser := _coarser(coarse)) is not None:
        coarse, best = coarser, _dry_run(coarser, min(seconds, end - clock()), report)
    return replace(best, points=found.points, calls=found.calls, seconds=found.seconds)


def _coarser(recipe: Recipe) -> Recipe | None:
    """The recipe on a quarter of the elements; None where the mesh is no rectangle to be halved."""
    stated, elements = recipe.stated, recipe.stated.mesh.elements
    if elements is None or len(recipe.cells) > 1 or max(elements) <= _COARSEST:
        return None
    fewer = (max(1, elements[0] // 2), max(1, elements[1] // 2))
    other = replace(recipe, stated=replace(stated, mesh=replace(stated.mesh, elements=fewer)))
    try:
        other.problem()
    except InputError:  # it names a part of the boundary that a coarser mesh lacks
        return None
    return other


def _dry_run(recipe: Recipe, seconds: float, report: Report) -> DryRun:
    problem, recorders = recipe.problem(), dict[str, _Recorder]()

    def recorded(part: Recipe) -> StressLaw:
        recorder = recorders[part.cell_name] = _Recorder(laws.quadratic_law(part))
        return recorder

    law = law_by_region(recipe, problem.mesh, recorded)
    begin, marks = clock(), [(0.0, 0, 0.0)]

    def progress(t: float, duration: float) -> None:
        report(t, "")
        marks.append((t, max(each.calls for each in recorders.values()), clock() - begin))
        if marks[-1][2] > seconds:
            raise _CutShort

    try:
        with suppress(_CutShort), recipe.named(InputError):
            simulate(problem, law, replace(recipe.macro, frames=2), progress=progress)
    except SimulationError as error:
        raise SimulationError(f"check: the dry run by the quadratic law: {error}") from error
    # the first steps are shorter than most: the second half says how the run goes on
    (t, calls, taken), (then, before, earlier) = marks[-1], marks[(len(marks) - 1) // 2]
    left = (recipe.duration - t) / (t - then) if t > then else 0.0
    points = sum(each.points for each in recorders.values())
    return DryRun(
        points=points,
        calls=calls + left * (calls - before),
        seconds=taken + left * (taken - earlier),
        reached=t / recipe.duration,
        met={name: MetRange.of(each.extremes) for name, each in recorders.items()},
        steps={name: list(each.steps) for name, each in recorders.items()},
        shares={name: each.points / points for name, each in recorders.items()},
    )


def seconds_by_rves(recipe: Recipe, run: DryRun) -> float:
    """The order of magnitude of a run by true RVEs: solves times a timed one, along a dry run."""
    parts = recipe.parts()
    a_point = sum(
        share * _seconds_a_solve(laws.true_law(parts[name]), run.steps[name])
        for name, share in run.shares.items()
    )
    return run.seconds + run.solves * a_point


def _seconds_a_solve(law: StressLaw, steps: list[tuple[Array, Array]]) -> float:
    """Seconds of an RVE that is solved from its state one step before."""
    state, times, begin = None, list[float](), clock()
    for F, F_dot in steps:
        started = clock()
        answer = law.respond(F, F_dot, state)
        times.append((clock() - started) / len(F))
        # a stepper repeats a step whose RVEs switch state; here they stay in the new one
        state = law.accept(F, F_dot, replace(answer, switched=None)).state
        if clock() - begin > _TIMED_SECONDS:
            break
    return float(np.median(times[len(times) // 2 :])) if times else 0.0


def advised_law(recipe: Recipe, seconds: float) -> str:
    """The law by which a first run probably ends first, if one by RVEs takes so many seconds."""
    parts = recipe.parts().values()
    files = [part.samples.file is not None and part.training_file is not None for part in parts]
    if any(part.range is None for part in parts):
        return "rve"
    if all(files) and all(is_trained(part) for part in parts):
        return "cached"
    if seconds < _LEARNING:
        return "rve"
    if all(files):
        return "cached"
    has_tables = recipe.rve.solver == "direct" and recipe.macro.integrator == "explicit"
    return "table" if has_tables else "rve"


def proposed_range(met: MetRange, margin: float = MARGIN) -> SamplingRange:
    """The range that holds `margin` times more strain and rate than was met, rounded outward.

    Raises:
        InputError: the margin is negative, nothing was strained, or a cell would have no length.
    """
    if not (math.isfinite(margin) and margin >= 0.0):
        raise InputError(f"--margin: {margin}; it must be a number of at least 0")
    low, high = met.stretch
    shorter, longer, shear, rate = (
        _rounded_up((1.0 + margin) * value)
        for value in (1.0 - low, high - 1.0, met.shear, met.rate)
    )
    if not shorter + longer > 0.0:
        raise InputError("range: the run met no strain; something must load or move the tissue")
    if shorter + shear >= 1.0:
        raise InputError(
            f"range: the run met stretches down to {low:.4g} and shear up to {met.shear:.4g}; "
            f"with a margin of {margin:g} no cell would be left; lower the load or the margin"
        )
    return SamplingRange(
        stretch=(_plain(1.0 - shorter), _plain(1.0 + longer)), shear=shear, rate=rate
    )


def range_section(range: SamplingRange, cell: str = "") -> str:
    """The section of a recipe, or of one of its cells, in TOML."""
    (low, high), name = range.stretch, f"cells.{cell}.range" if cell else "range"
    return f"[{name}]\nstretch = [{low}, {high}]\nshear = {range.shear}\nrate = {range.rate}"


def _rounded_up(value: float) -> float:
    """The next number of two digits; 0 of what is not positive."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) + 1 - _DIGITS)
    return _plain(math.ceil(value / unit * (1.0 - 1e-9)) * unit)


def _plain(value: float) -> float:
    """Without the rounding of binary sums."""
    return float(f"{value:.12g}")
