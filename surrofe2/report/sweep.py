"""What a stress tolerance is worth: error of displacement, hits and speed over tolerances."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import InputError
from surrofe2.io.run_folder import StoredRun, caches_of
from surrofe2.report.comparison import ComparedRun, compare, problem_title
from surrofe2.report.figures import Curve, Panel, write_figure
from surrofe2.report.tables import Quantity, Table, percent


def _caches(run: ComparedRun) -> list[Mapping[str, Any]]:
    """What the caches of the run's cells report; of several, the worst is told."""
    return [*caches_of(run.cache).values()]


def _stress_error(run: ComparedRun, error: Callable[[Mapping[str, Any]], float]) -> float | None:
    """An error that audits found, relative to the spread of stress where both are known."""
    found = [
        error(cache["audit"]) / cache["tolerance"]["spread"]
        for cache in _caches(run)
        if cache["audit"]["quantiles"] and cache["tolerance"]["spread"]
    ]
    return max(found, default=None)


def _error_99(run: ComparedRun) -> float | None:
    return _stress_error(run, lambda audit: audit["quantiles"]["0.99"])


def _error_largest(run: ComparedRun) -> float | None:
    return _stress_error(run, lambda audit: audit["largest"])


def _above(run: ComparedRun) -> str:
    above, audited = (
        sum(cache["audit"][count] for cache in _caches(run)) for count in ("violations", "audited")
    )
    return f"{above} of {audited}"


def _tolerance(run: ComparedRun) -> float:
    return float(_caches(run)[0]["tolerance"]["share"])


def _is_off(run: ComparedRun) -> bool:
    return any(cache["trust"]["off"] for cache in _caches(run))


def _hits(run: ComparedRun) -> float:
    hits = run.counts["hits"]
    return hits / max(hits + run.counts["fallbacks"], 1)


QUANTITIES: tuple[Quantity[ComparedRun], ...] = (
    Quantity("tolerance", "", percent("g"), _tolerance),
    Quantity("stress error", "", percent(".2g"), _error_99),
    Quantity("largest stress error", "", None, _error_largest),
    Quantity("above", "", "", _above),
    Quantity("displacement error", "", percent(".2g"), lambda run: run.difference.largest),
    Quantity("hits", "", percent(".3g"), _hits),
    Quantity("speed-up", "×", ".3g", lambda run: run.speed_up["wall_time"]),
    Quantity(
        "right-hand sides",
        "",
        percent(".4g"),
        lambda run: 1.0 / (run.speed_up["right_hand_sides"] or float("inf")),
    ),
    Quantity("factor", "", None, lambda run: max(each["trust"]["factor"] for each in _caches(run))),
    Quantity("switched off", "", lambda off: "yes", lambda run: _is_off(run) or None),
)
"""Stresses relative to their spread; the stress error is what 99 % of the audited answers keep."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """Cached runs by falling tolerance, against true FE²."""

    reference: ComparedRun
    load: Mapping[str, Any]
    rows: tuple[ComparedRun, ...]

    @property
    def table(self) -> Table[ComparedRun]:
        """What people read of it."""
        return Table(QUANTITIES, self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for sweep.json."""
        return {
            "law": self.rows[0].law,
            "preset": self.reference.preset,
            "reference": self.reference.name,
            "load": self.load,
            "true_wall_time": self.reference.wall_time,
            "rows": self.table.to_records(),
        }


def make_sweep(reference: StoredRun, runs: Sequence[StoredRun]) -> Sweep:
    """Relate cached runs at several tolerances to the run by true RVEs.

    Raises:
        InputError: a run is not by a cached law.
        MismatchError: the runs are of different load cases.
    """
    found = compare([reference, *runs])
    for run in found.runs:
        if not run.cache:
            raise InputError(f"{run.name}: law {run.law} has no cache; sweep cached runs")
    rows = sorted(found.runs, key=lambda run: -_tolerance(run))
    record = reference.record
    load = {"title": problem_title(record.recipe), "duration": record.duration}
    return Sweep(found.reference_run, load, tuple(rows))


def write_sweep_plot(path: Path, sweep: Sweep) -> None:
    """Draw stress error, displacement error, hits and speed-up over tolerance into a PNG."""
    rows = sweep.table.to_records()
    tolerance = np.array([row["tolerance"] for row in rows])

    def curve(get: Callable[[dict[str, Any]], Any], label: str = "_", name: str = "") -> Curve:
        values = np.array([get(row) for row in rows], dtype=np.float64)  # None: NaN
        return Curve(name or label, tolerance, values, label)

    def panel(title: str, y_label: str, *curves: Curve, log_y: bool = False) -> Panel:
        x_label = "stress tolerance (relative to the spread of stress)"
        return Panel(x_label, y_label, curves, title, log_x=True, log_y=log_y, zero=not log_y)

    panels = (
        panel(
            "stress error found by audits",
            "relative to the spread of stress",
            curve(lambda row: row["tolerance"], "allowed", "reference"),
            curve(lambda row: row["stress_error"], "99 % of the errors are below"),
            curve(lambda row: row["largest_stress_error"], "largest error"),
            log_y=True,
        ),
        panel(
            "largest error of displacement",
            "relative to the largest",
            curve(lambda row: row["displacement_error"]),
            log_y=True,
        ),
        panel("stresses answered by the cache", "hits (%)", curve(lambda row: 100.0 * row["hits"])),
        panel(
            "speed-up of the run",
            "times faster than true FE²",
            curve(lambda row: 1.0, f"true FE², {sweep.reference.wall_time:.3g} s", "reference"),
            curve(lambda row: row["speed_up"]),
            curve(lambda row: row["speed_up"] if row["switched_off"] else None, "switched off"),
        ),
    )
    load = sweep.load
    title = (
        f"What a stress tolerance buys: {load['title']} over {load['duration']:g} µs,\n"
        f"cell preset “{sweep.reference.preset}”, law {sweep.rows[0].law}"
    )
    write_figure(path, title, panels, columns=2)
