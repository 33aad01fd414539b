"""A sampling range for a recipe's problem, from a cheap run of it."""

from __future__ import annotations

import math
from dataclasses import replace

from surrofe2.errors import InputError, SimulationError
from surrofe2.macro import MetRange, simulate
from surrofe2.macro.extremes import NO_EXTREMES, widen_extremes
from surrofe2.recipe import Recipe
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import StressLaw
from surrofe2.surrogate.deformation_paths import WatchedLaw
from surrofe2.workflow.cell_laws import law_by_region
from surrofe2.workflow.laws import quadratic_law
from surrofe2.workflow.run_lifecycle import Report, untold

MARGIN = 0.2
_DIGITS = 2


def met_by_quadratic_law(recipe: Recipe, *, report: Report = untold) -> dict[str, MetRange]:
    """What each cell of the recipe's problem meets by the tangents of its RVE at rest.

    Args:
        report: is told the time reached in µs.

    Returns:
        By name of the cell, which is "" where there is one.

    Raises:
        SimulationError: the run could not be carried on.
    """
    problem, extremes = recipe.problem(), {name: NO_EXTREMES.copy() for name in recipe.parts()}

    def watched(part: Recipe) -> StressLaw:
        own = extremes[part.cell_name or ""]
        return WatchedLaw(quadratic_law(part), lambda F, F_dot: widen_extremes(own, F, F_dot))

    law = law_by_region(recipe, problem.mesh, watched)
    settings = replace(recipe.macro, record_dissipation=False, frames=2)
    try:
        with recipe.named(InputError):
            simulate(problem, law, settings, progress=lambda t, duration: report(t, ""))
    except SimulationError as error:
        raise SimulationError(f"range: the run by the quadratic law: {error}") from error
    return {name: MetRange.of(met) for name, met in extremes.items()}


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
