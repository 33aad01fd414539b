"""How the bar's damping depends on initialisation, mesh, tolerances, micro step, and on the fit.

The decrement is read off a curve by a least-squares fit, which has an error of its own: more modes
than two are in the curve, and the longest ones beat. So each curve is fitted in several ways, and
what they differ by is the uncertainty; the ratio to the tissue's decrement is taken way by way,
since what a way leaves out it leaves out of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.damped_fit import DampedFit, fit_damped_modes
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.studies.bar_runs import MICRO_STEP, TISSUE, BarCase, BarRun

METHODS = ("elastic", "constrained-runs", "slow-manifold")
MESHES = (4, 8, 16)
TIGHTER = 0.1


@dataclass(frozen=True, slots=True)
class Way:
    """A way to fit: `modes` damped modes to the samples between two fractions of the curve."""

    name: str
    modes: int
    begin: float = 0.0
    end: float = 1.0

    def fit(self, curve: DisplacementCurve) -> DampedFit:
        """The fit of the vertical displacement."""
        span = curve.t[-1] - curve.t[0]
        within = (curve.t >= self.begin * span) & (curve.t <= self.end * span)
        return fit_damped_modes(curve.t[within], curve.displacement[within, 1], self.modes)


WAYS = (
    Way("two modes", 2),
    Way("three modes", 3),
    Way("four modes", 4),
    Way("two modes, last four fifths", 2, 0.2),
    Way("two modes, last three fifths", 2, 0.4),
    Way("two modes, first four fifths", 2, 0.0, 0.8),
)
"""The first is the one of the figures (docs/theory.md, period and decrement)."""


def cases(
    cell: CellParameters,
    preset: str,
    meshes: Sequence[int] = MESHES,
    duration: float = 250.0,
) -> list[BarCase]:
    """The tissue at two steps; each method on each mesh; on all but the finest tolerances × 0.1."""
    tissue = BarCase(cell=cell, preset=preset, method=TISSUE, load_case=LoadCase(duration=duration))
    found = [tissue, replace(tissue, micro_step=0.5 * MICRO_STEP)]
    for mesh in sorted(meshes):
        for method in METHODS:
            case = replace(tissue, method=method, elements=(mesh, mesh))
            found.append(case)
            if mesh < max(meshes) or len(meshes) == 1:
                found.append(replace(case, tolerance_factor=TIGHTER))
    return found


@dataclass(frozen=True, slots=True)
class Damping:
    """What a run's curve says of its damping: a fit and an excess for each of `WAYS`.

    excess: decrement over the tissue's, less 1, %.
    """

    case: BarCase
    fits: tuple[DampedFit, ...]
    excess: tuple[float, ...]

    @property
    def decrements(self) -> tuple[float, ...]:
        """Of the first mode, logarithmic, a period, in each way."""
        return tuple(fit.first.decrement for fit in self.fits)


def dampings(runs: Sequence[BarRun]) -> list[Damping]:
    """Fit all curves in all ways; the first tissue is what all are compared with."""
    fits = [(run.fit, *(way.fit(run.curve) for way in WAYS[1:])) for run in runs]
    there = next(fit for run, fit in zip(runs, fits, strict=True) if run.case.elements is None)
    return [
        Damping(
            run.case,
            ways,
            tuple(
                100.0 * (here.first.decrement / tissue.first.decrement - 1.0)
                for here, tissue in zip(ways, there, strict=True)
            ),
        )
        for run, ways in zip(runs, fits, strict=True)
    ]


def _of_way(k: int) -> tuple[Quantity[Damping], ...]:
    name = WAYS[k].name
    return (
        Quantity(f"period, {name}", "µs", None, lambda row: row.fits[k].first.period),
        Quantity(f"decrement, {name}", "", None, lambda row: row.decrements[k]),
        Quantity(f"fit residual, {name}", "µm", None, lambda row: row.fits[k].residual),
    )


QUANTITIES: tuple[Quantity[Damping], ...] = (
    Quantity("run", "", "", lambda row: row.case.label),
    Quantity("period", "µs", ".2f", lambda row: row.fits[0].first.period),
    Quantity("decrement", "", ".4f", lambda row: row.decrements[0]),
    Quantity("standard error", "", ".4f", lambda row: row.fits[0].decrement_error),
    Quantity("lowest of all fits", "", ".4f", lambda row: min(row.decrements)),
    Quantity("highest of all fits", "", ".4f", lambda row: max(row.decrements)),
    Quantity("excess over the tissue's", "%", "+.1f", lambda row: row.excess[0]),
    Quantity("lowest excess", "%", "+.1f", lambda row: min(row.excess)),
    Quantity("highest excess", "%", "+.1f", lambda row: max(row.excess)),
    Quantity("fit residual", "µm", ".3f", lambda row: row.fits[0].residual),
    *(quantity for k in range(len(WAYS)) for quantity in _of_way(k)),
)


def describe(runs: Sequence[BarRun]) -> Study:
    """Excess of the decrement over the tissue's for each run, with the spread over the fits."""
    rows, case = dampings(runs), runs[0].case
    curves = []
    for method in METHODS:
        of_method = [
            (float(row.case.elements[0]), row.excess[0])
            for row in rows
            if row.case.elements and row.case.method == method and row.case.tolerance_factor == 1.0
        ]
        n, excess = np.array(of_method).reshape(-1, 2).T
        curves.append(Curve(method, n, excess))
    panel = Panel(
        x_label="elements a side",
        y_label="decrement over the tissue's − 1 (%)",
        curves=tuple(curves),
        log_x=True,
        x_ticks=tuple(dict.fromkeys(float(n) for curve in curves for n in curve.x)),
        zero=True,
    )
    return Study(
        name=f"damping-{case.preset}",
        title=f"Damping of the bar against the full tissue, preset “{case.preset}”",
        panels=(panel,),
        table=Table(QUANTITIES, rows),
    )
