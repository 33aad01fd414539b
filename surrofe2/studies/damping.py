"""How the bar's damping depends on initialisation, mesh, tolerances, micro step, and on the fit.

The decrement is read off a curve by a least-squares fit, which has an error of its own: more modes
than two are in the curve, and the longest ones beat. So each curve is fitted in several ways, and
what they differ by is the uncertainty; the ratio to the tissue's decrement is taken way by way,
since what a way leaves out it leaves out of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.damped_fit import DampedFit, fit_damped_modes
from surrofe2.report.study import Curve, Panel, Study
from surrofe2.studies.bar_comparison import TISSUE, BarRun
from surrofe2.studies.bar_pieces import MICRO_STEP, Piece

METHODS = ("elastic", "constrained-runs", "slow-manifold")
MESHES = (4, 8, 16)
TIGHTER = 0.1


@dataclass(frozen=True, slots=True)
class Way:
    """A way to fit: so many modes, to the samples between two fractions of the curve."""

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


def pieces(
    cell: CellParameters,
    preset: str,
    meshes: tuple[int, ...] = MESHES,
    duration: float = 250.0,
) -> list[Piece]:
    """The tissue at two steps; each method on each mesh; on all but the finest tolerances × 0.1."""
    load_case = LoadCase(duration=duration)
    common: dict[str, Any] = {"cell": cell, "preset": preset, "load_case": load_case}
    found = [Piece(method=TISSUE, micro_step=MICRO_STEP * k, **common) for k in (1.0, 0.5)]
    for mesh in sorted(meshes):
        for method in METHODS:
            one = Piece(method=method, elements=(mesh, mesh), **common)
            found.append(one)
            if mesh < max(meshes) or len(meshes) == 1:
                tight = Piece(
                    method=method, elements=(mesh, mesh), tolerance_factor=TIGHTER, **common
                )
                found.append(tight)
    return found


@dataclass(frozen=True, slots=True)
class Damping:
    """What a piece's curve says of its damping.

    Attributes:
        fits: by the name of the way.
        decrement: by the first way; spread: (lowest, highest) of all ways; error: standard error
            of the first way's decrement from its residuals.
        excess: decrement over the tissue's, less 1, %; excess_spread: (lowest, highest).
    """

    piece: Piece
    fits: Mapping[str, DampedFit]
    decrement: float
    spread: tuple[float, float]
    error: float
    excess: float
    excess_spread: tuple[float, float]


def dampings(runs: list[tuple[Piece, BarRun]]) -> list[Damping]:
    """Fit all curves in all ways; the first tissue is what all are compared with."""
    fits = [{way.name: way.fit(run.curve) for way in WAYS} for _, run in runs]
    reference = next(fit for (piece, _), fit in zip(runs, fits, strict=True) if not piece.elements)
    return [_damping(piece, fit, reference) for (piece, _), fit in zip(runs, fits, strict=True)]


def _damping(
    piece: Piece, fits: Mapping[str, DampedFit], reference: Mapping[str, DampedFit]
) -> Damping:
    decrements = [fits[way.name].first.decrement for way in WAYS]
    excess = [
        100.0 * (d / reference[way.name].first.decrement - 1.0)
        for d, way in zip(decrements, WAYS, strict=True)
    ]
    return Damping(
        piece=piece,
        fits=fits,
        decrement=decrements[0],
        spread=(min(decrements), max(decrements)),
        error=fits[WAYS[0].name].decrement_error,
        excess=excess[0],
        excess_spread=(min(excess), max(excess)),
    )


def describe(found: list[Damping], preset: str, name: str, **settings: Any) -> Study:
    """Excess of the decrement over the tissue's for each run, with the spread over the fits."""
    of_fe2 = [item for item in found if item.piece.elements is not None]
    return Study(
        name=name,
        title=f"Damping of the bar against the full tissue, preset “{preset}”",
        panels=(_panel(of_fe2),),
        columns=1,
        table=_table(found),
        results={"runs": [_numbers(item) for item in found]},
        units={"period": "µs", "decrement": "1, a period", "excess": "%", "residual": "µm"},
        settings=settings,
        shown=_shown(found),
    )


def _shown(found: list[Damping]) -> dict[str, list[str]]:
    first = WAYS[0].name
    return {
        "run": [item.piece.label for item in found],
        "period (µs)": [f"{item.fits[first].first.period:.2f}" for item in found],
        "decrement": [f"{item.decrement:.4f}" for item in found],
        "standard error": [f"{item.error:.4f}" for item in found],
        "all fits": [f"{item.spread[0]:.4f} to {item.spread[1]:.4f}" for item in found],
        "over the tissue's (%)": [f"{item.excess:+.1f}" for item in found],
        "all fits (%)": [
            f"{item.excess_spread[0]:+.1f} to {item.excess_spread[1]:+.1f}" for item in found
        ],
        "fit residual (µm)": [f"{item.fits[first].residual:.3f}" for item in found],
    }


def _table(found: list[Damping]) -> dict[str, list[Any]]:
    first = WAYS[0].name
    return {
        "run": [item.piece.label for item in found],
        "period (µs)": [item.fits[first].first.period for item in found],
        "decrement": [item.decrement for item in found],
        "standard error": [item.error for item in found],
        "lowest of all fits": [item.spread[0] for item in found],
        "highest of all fits": [item.spread[1] for item in found],
        "excess (%)": [item.excess for item in found],
        "lowest excess (%)": [item.excess_spread[0] for item in found],
        "highest excess (%)": [item.excess_spread[1] for item in found],
        "fit residual (µm)": [item.fits[first].residual for item in found],
    }


def _numbers(item: Damping) -> dict[str, Any]:
    return {
        "run": item.piece.label,
        "method": item.piece.method,
        "elements": item.piece.elements,
        "tolerance_factor": item.piece.tolerance_factor,
        "micro_step": item.piece.micro_step,
        "decrement": item.decrement,
        "standard_error": item.error,
        "excess": item.excess,
        "excess_lowest": item.excess_spread[0],
        "excess_highest": item.excess_spread[1],
        "fits": {
            way: {
                "period": fit.first.period,
                "decrement": fit.first.decrement,
                "residual": fit.residual,
            }
            for way, fit in item.fits.items()
        },
    }


def _panel(found: list[Damping]) -> Panel:
    curves = []
    for method in METHODS:
        mine = [d for d in found if d.piece.method == method and d.piece.tolerance_factor == 1.0]
        n = np.array([float((d.piece.elements or (0, 0))[0]) for d in mine])
        excess = np.array([d.excess for d in mine])
        curves.append(Curve(method, n, excess))
    return Panel(
        x_label="elements a side",
        y_label="decrement over the tissue's − 1 (%)",
        curves=tuple(curves),
        log_x=True,
        x_ticks=tuple(dict.fromkeys(n for curve in curves for n in curve.x)),
        zero=True,
    )
