"""What a stress tolerance buys: error of displacement, hits and speed over tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.errors import InputError
from surrofe2.io.run_folder import StoredRun
from surrofe2.report.comparison import compare


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


@dataclass(frozen=True, slots=True)
class Sweep:
    """Rows by falling tolerance, and what they are of."""

    law: str
    preset: str
    reference: str
    load: Mapping[str, Any]
    spread: float | None
    true_wall_time: float
    rows: tuple[SweepRow, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for sweep.json."""
        return asdict(self)


def make_sweep(reference: StoredRun, runs: Sequence[StoredRun]) -> Sweep:
    """Relate cached runs at several tolerances to the run by true RVEs.

    Raises:
        InputError: a run is not by a cached law.
        MismatchError: the runs are of different load cases.
    """
    for run in runs:
        if run.record.cache is None:
            raise InputError(f"{run.folder}: law {run.record.law} has no cache; sweep cached runs")
    rows = sorted((_row(reference, run) for run in runs), key=lambda row: -row.tolerance)
    record = reference.record
    return Sweep(
        law=runs[0].record.law,
        preset=record.recipe["cell"]["preset"],
        reference=reference.folder.name,
        load=record.recipe["load"],
        spread=_cache(runs[0])["tolerance"]["spread"],
        true_wall_time=record.wall_time["total"],
        rows=tuple(rows),
    )


def _cache(run: StoredRun) -> Mapping[str, Any]:
    cache = run.record.cache
    assert cache is not None
    return cache


def _row(reference: StoredRun, run: StoredRun) -> SweepRow:
    (compared,) = compare([reference, run]).runs
    cache, counts = _cache(run), run.record.counts
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
