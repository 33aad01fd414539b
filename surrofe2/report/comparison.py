"""How far displacement curves of one load case are apart, and what each run cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from surrofe2.base.costs import Balance
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.run.displacement_curve import CurveDifference, DisplacementCurve, difference
from surrofe2.store.run_folder import RunRecord, StoredRun, balance_of, presets_of
from surrofe2.store.store import flat


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run against the reference.

    Attributes:
        name: the run's folder.
        difference: of the watched displacement, relative to the reference's largest.
        wall_time: seconds of law and macro together; compilation is not in it.
        speed_up: ratios reference / this run, by what is counted; above 1 is less work. A ratio
            is None where either needed none of it.
        cache: of a cached run, what its law reported: tolerance, audit, trust; else empty.
        forces: by name, of every force resultant that both runs have.
        balance: of a run through a cache, with what that cost to make; None where there is none.
    """

    name: str
    law: str
    preset: str
    difference: CurveDifference
    wall_time: float
    counts: Mapping[str, int]
    speed_up: Mapping[str, float | None]
    cache: Mapping[str, Any] = field(default_factory=dict)
    forces: Mapping[str, CurveDifference] = field(default_factory=dict)
    balance: Balance | None = None


QUANTITIES: tuple[Quantity[ComparedRun], ...] = (
    Quantity("run", "", "", lambda run: run.name),
    Quantity("largest difference", "", percent(3), lambda run: run.difference.largest),
    Quantity("of largest", "", None, lambda run: run.difference.of_largest),
    Quantity("RMS", "", percent(3), lambda run: run.difference.rms),
    Quantity("wall time", "s", ".3g", lambda run: run.wall_time),
    Quantity("speed-up", "×", ".3g", lambda run: run.speed_up["wall_time"]),
    Quantity(
        "first run", "×", ".3g", lambda run: None if run.balance is None else run.balance.gain
    ),
    Quantity("RVE solves", "", ",", lambda run: run.counts.get("rve_solves", 0)),
    Quantity("fewer solves", "×", None, lambda run: run.speed_up["rve_solves"]),
    Quantity("fallbacks", "", ",", lambda run: run.counts.get("fallbacks")),
)


FORCE_QUANTITIES: tuple[Quantity[Mapping[str, Any]], ...] = (
    Quantity("run", "", ""),
    Quantity("force", "", ""),
    Quantity("largest", "µN", ".4g"),
    Quantity("largest difference", "", percent(3)),
    Quantity("of largest", "", None),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Runs of one load case against a reference, whose folder and cost are kept too."""

    reference: str
    load: Mapping[str, Any]
    reference_run: ComparedRun
    runs: tuple[ComparedRun, ...]

    @property
    def table(self) -> Table[ComparedRun]:
        """What people read of it."""
        return Table(QUANTITIES, (self.reference_run, *self.runs))

    @property
    def force_table(self) -> Table[Mapping[str, Any]]:
        """Of the forces of supports, surface loads and rigid bodies on the tissue."""
        rows = []
        for run in self.runs:
            for name, force in run.forces.items():
                row = {"run": run.name, "force": name, "largest": force.scale}
                relative = {"largest difference": force.largest, "of largest": force.of_largest}
                rows.append(row | relative if force.scale else row)
        return Table(FORCE_QUANTITIES, rows)

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
        MismatchError: the runs are of different load cases or problems; meshes may differ.
        InputError: fewer than two runs.
    """
    reference, *others = order_runs(runs)
    load = _load_of(reference)
    for run in others:
        here = _load_of(run)
        for key in {**load, **here}:
            if here.get(key) != load.get(key):
                raise MismatchError(
                    f"{run.folder}: {key} is {here.get(key)}, in {reference.folder} "
                    f"{load.get(key)}; compare runs of one load case"
                )
    compared = (compared_run(run, reference) for run in (reference, *others))
    return Comparison(reference.folder.name, load, next(compared), tuple(compared))


def _load_of(run: StoredRun) -> dict[str, Any]:
    """All that a run's problem states, by dotted names, but the mesh it is computed on."""
    recipe, of = run.record.recipe, ("conditions", "bodies", "watch", "time")
    stated = flat({name: recipe[name] for name in of if name in recipe})
    stated.pop("time.frames", None)
    return stated


def force_curves(run: StoredRun) -> dict[str, DisplacementCurve]:
    """Force resultants on the tissue over time by name, µN; not what holds rigid bodies."""
    held = {f"force {body} position" for body in run.record.recipe.get("bodies", {})}
    names = [name.removesuffix(" x") for name in run.history if name.endswith(" x")]
    return {
        name.removeprefix("force "): DisplacementCurve(
            run.curve.t, np.stack([run.history[f"{name} {axis}"] for axis in "xy"], axis=1)
        )
        for name in names
        if name.startswith("force ") and name not in held
    }


def compared_run(run: StoredRun, reference: StoredRun) -> ComparedRun:
    """Difference and speed-up of a run against another of its load case."""
    there, apart = force_curves(reference), difference(run.curve, reference.curve)
    if not apart.scale:
        raise InputError(f"{reference.folder}: the watched point does not move; nothing to compare")
    return ComparedRun(
        name=run.folder.name,
        law=run.record.law,
        preset=presets_of(run.record.recipe),
        difference=apart,
        wall_time=run.record.wall_time["total"],
        counts=run.record.counts,
        speed_up={
            name: _ratio(cost(reference.record), cost(run.record)) for name, cost in _COSTS.items()
        },
        cache=run.record.cache or {},
        forces={
            name: difference(force, there[name])
            for name, force in force_curves(run).items()
            if name in there
        },
        balance=balance_of(run.record, reference.record),
    )


def _ratio(reference: float, run: float) -> float | None:
    return reference / run if run and reference else None


def _law_time(record: RunRecord) -> float:
    asked = record.counts.get("stress_points", 0) + record.counts.get("dissipation_points", 0)
    return record.wall_time.get("law", 0.0) / max(asked, 1)


_COSTS: Mapping[str, Callable[[RunRecord], float]] = {
    "wall_time": lambda record: record.wall_time["total"],
    "law_time_per_stress": _law_time,
    "rve_solves": lambda record: record.counts.get("rve_solves", 0),
    "right_hand_sides": lambda record: record.counts.get("right_hand_sides", 0),
}


def audit_sentence(cache: Mapping[str, Any]) -> str:
    """How many answers were audited and how wrong they were."""
    audit, allowed = cache["audit"], float(cache["tolerance"]["absolute"])
    if not audit["audited"]:
        return "none of the cache's answers"
    text = f"{audit['audited']} of {cache['accepted']['hits']} accepted answers"
    if audit["quantiles"]:
        text += (
            f", error {audit['quantiles']['0.99']:.2g} µN/µm at 99 %, {audit['largest']:.2g} worst"
        )
    if allowed == float("inf"):
        return f"{text}; no bound, so no tolerance is held"
    text += f"; {audit['violations']} above the tolerance of {allowed:.2g} µN/µm"
    wrong = audit.get("wrong_at_most")  # runs of earlier versions do not have it
    if wrong is not None:
        text += f", so with 95 % confidence at most {100.0 * wrong:.2g} % of all"
    return text
