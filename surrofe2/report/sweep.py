"""What a stress tolerance is worth: error of displacement, hits and speed over tolerances."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.errors import InputError
from surrofe2.io.run_folder import StoredRun
from surrofe2.report.comparison import compare, problem_title
from surrofe2.report.figures import Curve, Panel, write_figure
from surrofe2.report.tables import Quantity, Table, percent


@dataclass(frozen=True, slots=True)
class SweepRow:
    """A cached run at one tolerance against true FE²; stresses relative to their spread.

    Attributes:
        tolerance: share of the spread of stress.
        displacement_error: largest difference of the watched point, relative to the largest
            displacement.
        hits: share of the stresses that the surrogate answered.
        audited: answers that RVEs checked; violations: of these, errors above the tolerance.
        error_99, error_largest: found by the audit; None without audits or spread.
        speed_up: of wall time.
        right_hand_sides: relative to true FE².
        factor: by which the bound counts at the end; off: the cache was switched off.
    """

    tolerance: float
    displacement_error: float
    hits: float
    audited: int
    violations: int
    error_99: float | None
    error_largest: float | None
    speed_up: float
    right_hand_sides: float
    factor: float
    off: bool


QUANTITIES: tuple[Quantity[SweepRow], ...] = (
    Quantity("tolerance", "", percent("g"), lambda row: row.tolerance),
    Quantity("stress error", "", percent(".2g"), lambda row: row.error_99),
    Quantity("above", "", "", lambda row: f"{row.violations} of {row.audited}"),
    Quantity("displacement error", "", percent(".2g"), lambda row: row.displacement_error),
    Quantity("hits", "", percent(".3g"), lambda row: row.hits),
    Quantity("speed-up", "×", ".3g", lambda row: row.speed_up),
    Quantity("right-hand sides", "", percent(".4g"), lambda row: row.right_hand_sides),
    Quantity("switched off", "", "", lambda row: "yes" if row.off else None),
)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Rows by falling tolerance, and what they are of."""

    law: str
    preset: str
    reference: str
    load: Mapping[str, Any]
    true_wall_time: float
    rows: tuple[SweepRow, ...]

    @property
    def table(self) -> Table[SweepRow]:
        """What people read of it."""
        return Table(QUANTITIES, self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for sweep.json."""
        return asdict(self)


def make_sweep(reference: StoredRun, runs: Sequence[StoredRun]) -> Sweep:
    """Relate cached runs at several tolerances to the run by true RVEs.

    Raises:
        InputError: a run is not by a cached law.
        MismatchError: the runs are of different load cases.
    """
    rows = sorted((_row(reference, run) for run in runs), key=lambda row: -row.tolerance)
    record = reference.record
    return Sweep(
        law=runs[0].record.law,
        preset=record.recipe["cell"]["preset"],
        reference=reference.folder.name,
        load={"title": problem_title(record.recipe), "duration": record.duration},
        true_wall_time=record.wall_time["total"],
        rows=tuple(rows),
    )


def _row(reference: StoredRun, run: StoredRun) -> SweepRow:
    cache, counts = run.record.cache, run.record.counts
    if cache is None:
        raise InputError(f"{run.folder}: law {run.record.law} has no cache; sweep cached runs")
    (compared,) = compare([reference, run]).runs
    audit, spread = cache["audit"], cache["tolerance"]["spread"]
    known = audit["quantiles"] and spread
    return SweepRow(
        tolerance=float(cache["tolerance"]["share"]),
        displacement_error=compared.difference.largest,
        hits=counts["hits"] / max(counts["hits"] + counts["fallbacks"], 1),
        audited=audit["audited"],
        violations=audit["violations"],
        error_99=audit["quantiles"]["0.99"] / spread if known else None,
        error_largest=audit["largest"] / spread if known else None,
        speed_up=compared.speed_up["wall_time"] or float("nan"),
        right_hand_sides=counts["right_hand_sides"] / reference.record.counts["right_hand_sides"],
        factor=cache["trust"]["factor"],
        off=cache["trust"]["off"],
    )


def write_sweep_plot(path: Path, sweep: Sweep) -> None:
    """Draw stress error, displacement error, hits and speed-up over tolerance into a PNG."""
    tolerance = np.array([row.tolerance for row in sweep.rows])

    def curve(get: Callable[[SweepRow], float | None], label: str = "_", name: str = "") -> Curve:
        values = np.array([get(row) for row in sweep.rows], dtype=np.float64)  # None: NaN
        return Curve(name or label, tolerance, values, label)

    def panel(title: str, y_label: str, *curves: Curve, log_y: bool = False) -> Panel:
        x_label = "stress tolerance (relative to the spread of stress)"
        return Panel(x_label, y_label, curves, title, log_x=True, log_y=log_y, zero=not log_y)

    panels = (
        panel(
            "stress error found by audits",
            "relative to the spread of stress",
            curve(lambda row: row.tolerance, "allowed", "reference"),
            curve(lambda row: row.error_99, "99 % of the errors are below"),
            curve(lambda row: row.error_largest, "largest error"),
            log_y=True,
        ),
        panel(
            "largest error of displacement",
            "relative to the largest",
            curve(lambda row: row.displacement_error),
            log_y=True,
        ),
        panel("stresses answered by the cache", "hits (%)", curve(lambda row: 100.0 * row.hits)),
        panel(
            "speed-up of the run",
            "times faster than true FE²",
            curve(lambda row: 1.0, f"true FE², {sweep.true_wall_time:.3g} s", "reference"),
            curve(lambda row: row.speed_up),
            curve(lambda row: row.speed_up if row.off else None, "switched off"),
        ),
    )
    load = sweep.load
    title = (
        f"What a stress tolerance buys: {load['title']} over {load['duration']:g} µs,\n"
        f"cell preset “{sweep.preset}”, law {sweep.law}"
    )
    write_figure(path, title, panels, columns=2)
