"""How far displacement curves of one load case are apart, and what each run cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.displacement_curve import CurveDifference, difference
from surrofe2.errors import InputError, MismatchError
from surrofe2.io.run_folder import RunRecord, StoredRun


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run against the reference.

    Attributes:
        name: the run's folder.
        difference: of the watched displacement, relative to the reference's largest.
        wall_time: seconds of law and macro together; compilation is not in it.
        audit: of a cached run, the errors its audit found and the tolerance, µN/µm; else None.
        speed_up: ratios reference / this run, by what is counted; above 1 is less work. A ratio
            is None where this run needed none of it.
    """

    name: str
    law: str
    preset: str
    difference: CurveDifference
    wall_time: float
    counts: Mapping[str, int]
    speed_up: Mapping[str, float | None]
    audit: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Runs against a reference; `reference` is its folder."""

    reference: str
    load: Mapping[str, Any]
    runs: tuple[ComparedRun, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for comparison.json."""
        return asdict(self)


def order_runs(runs: Sequence[StoredRun]) -> list[StoredRun]:
    """The reference first: the first full tissue, else by true RVEs, else the first of all.

    Raises:
        InputError: fewer than two runs.
    """
    if len(runs) < 2:
        raise InputError(f"compare: {len(runs)} run folder; give at least two")
    ranks = {"tissue": 0, "rve": 1}
    reference = min(runs, key=lambda run: ranks.get(run.record.law, 2))
    return [reference, *(run for run in runs if run is not reference)]


def compare(runs: Sequence[StoredRun]) -> Comparison:
    """Difference and speed-up of every run against the reference (see `order_runs`).

    Raises:
        MismatchError: the runs are of different load cases.
        InputError: fewer than two runs.
    """
    reference, *others = order_runs(runs)
    for run in others:
        _check_load(run, reference)
    return Comparison(
        reference=reference.folder.name,
        load=reference.record.recipe["load"],
        runs=tuple(_compared(run, reference) for run in others),
    )


def _check_load(run: StoredRun, reference: StoredRun) -> None:
    here, there = run.record.recipe["load"], reference.record.recipe["load"]
    for key in {**there, **here}:
        if here.get(key) != there.get(key):
            raise MismatchError(
                f"{run.folder}: load.{key} is {here.get(key)}, in {reference.folder} "
                f"{there.get(key)}; compare runs of one load case"
            )


def _compared(run: StoredRun, reference: StoredRun) -> ComparedRun:
    return ComparedRun(
        name=run.folder.name,
        law=run.record.law,
        preset=run.record.recipe["cell"]["preset"],
        difference=difference(run.curve, reference.curve),
        wall_time=run.record.wall_time["total"],
        counts=run.record.counts,
        speed_up={
            name: _ratio(ours, theirs)
            for name, theirs, ours in (
                ("wall_time", *_both(reference, run, _wall_time)),
                ("law_time_per_stress", *_both(reference, run, _time_per_stress)),
                ("rve_solves", *_both(reference, run, _rve_solves)),
            )
        },
        audit=audit_of(run),
    )


def audit_of(run: StoredRun) -> Mapping[str, Any] | None:
    """What the audit of a cached run found, with what became of the trust; else None."""
    cache = run.record.cache
    return None if cache is None else {**cache["audit"], "trust": cache["trust"]}


def _both(reference: StoredRun, run: StoredRun, figure: Any) -> tuple[float, float]:
    return figure(reference.record), figure(run.record)


def _wall_time(record: RunRecord) -> float:
    return record.wall_time["total"]


def _time_per_stress(record: RunRecord) -> float:
    asked = record.counts.get("stress_points", 0) + record.counts.get("dissipation_points", 0)
    return record.wall_time.get("law", 0.0) / max(asked, 1)


def _rve_solves(record: RunRecord) -> float:
    return record.counts.get("rve_solves", 0)


def _ratio(ours: float, theirs: float) -> float | None:
    return theirs / ours if ours else None
