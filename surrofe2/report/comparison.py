"""How far displacement curves of one load case are apart, and what each run cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from surrofe2.displacement_curve import (
    CurveDifference,
    DisplacementCurve,
    ForceDifference,
    difference,
    force_difference,
)
from surrofe2.errors import InputError, MismatchError
from surrofe2.io.files import flat
from surrofe2.io.run_folder import RunRecord, StoredRun
from surrofe2.report.tables import Quantity, Table, percent


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run against the reference.

    Attributes:
        name: the run's folder.
        difference: of the watched displacement, relative to the reference's largest.
        wall_time: seconds of law and macro together; compilation is not in it.
        speed_up: ratios reference / this run, by what is counted; above 1 is less work. A ratio
            is None where this run needed none of it.
        audit: of a cached run, the errors its audit found and the tolerance, µN/µm; else None.
        forces: by name, of every force resultant that both runs have.
    """

    name: str
    law: str
    preset: str
    difference: CurveDifference
    wall_time: float
    counts: Mapping[str, int]
    speed_up: Mapping[str, float | None]
    audit: Mapping[str, Any] | None = None
    forces: Mapping[str, ForceDifference] = field(default_factory=dict)


QUANTITIES: tuple[Quantity[ComparedRun], ...] = (
    Quantity("run", "", "", lambda run: run.name),
    Quantity("largest difference", "", percent(".3g"), lambda run: run.difference.largest),
    Quantity("RMS", "", percent(".3g"), lambda run: run.difference.rms),
    Quantity("wall time", "s", ".3g", lambda run: run.wall_time),
    Quantity("speed-up", "×", ".3g", lambda run: run.speed_up["wall_time"]),
    Quantity("RVE solves", "", ",", lambda run: run.counts.get("rve_solves", 0)),
    Quantity("fewer solves", "×", ".3g", lambda run: run.speed_up["rve_solves"]),
    Quantity("fallbacks", "", ",", lambda run: run.counts.get("fallbacks")),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Runs against a reference; `reference` is its folder, `reference_run` what it cost."""

    reference: str
    load: Mapping[str, Any]
    reference_run: ComparedRun
    runs: tuple[ComparedRun, ...]

    @property
    def table(self) -> Table[ComparedRun]:
        """What people read of it."""
        return Table(QUANTITIES, (self.reference_run, *self.runs))

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
    return Comparison(
        reference=reference.folder.name,
        load=load,
        reference_run=_compared(reference, reference),
        runs=tuple(_compared(run, reference) for run in others),
    )


def _load_of(run: StoredRun) -> dict[str, Any]:
    """All that a run's problem states, by dotted names, but the mesh it is computed on."""
    recipe, of = run.record.recipe, ("load", "conditions", "bodies", "watch", "time")
    stated = flat({name: recipe[name] for name in of if name in recipe})
    stated.pop("time.frames", None)
    return stated


def force_curves(run: StoredRun) -> dict[str, DisplacementCurve]:
    """Force resultants over time by name, µN."""
    names = [name.removesuffix(" x") for name in run.history if name.endswith(" x")]
    return {
        name.removeprefix("force "): DisplacementCurve(
            run.curve.t, np.stack([run.history[f"{name} {axis}"] for axis in "xy"], axis=1)
        )
        for name in names
        if name.startswith("force ")
    }


def _compared(run: StoredRun, reference: StoredRun) -> ComparedRun:
    cache, there = run.record.cache, force_curves(reference)
    return ComparedRun(
        name=run.folder.name,
        law=run.record.law,
        preset=run.record.recipe["cell"]["preset"],
        difference=difference(run.curve, reference.curve),
        wall_time=run.record.wall_time["total"],
        counts=run.record.counts,
        speed_up={
            name: cost(reference.record) / cost(run.record) if cost(run.record) else None
            for name, cost in _COSTS.items()
        },
        audit=None if cache is None else {**cache["audit"], "trust": cache["trust"]},
        forces={
            name: force_difference(force, there[name])
            for name, force in force_curves(run).items()
            if name in there
        },
    )


def _law_time(record: RunRecord) -> float:
    asked = record.counts.get("stress_points", 0) + record.counts.get("dissipation_points", 0)
    return record.wall_time.get("law", 0.0) / max(asked, 1)


_COSTS: Mapping[str, Callable[[RunRecord], float]] = {
    "wall_time": lambda record: record.wall_time["total"],
    "law_time_per_stress": _law_time,
    "rve_solves": lambda record: record.counts.get("rve_solves", 0),
}


def problem_title(recipe: Mapping[str, Any]) -> str:
    """What a run computes, in a line: the bar, or the mesh and all that acts on it."""
    if "load" in recipe:
        load = recipe["load"]
        g = float(np.hypot(*load["body_force"]))
        size = f"{load['width']:g} × {load['height']:g} µm tissue"
        return f"{size}, body force {g:g} µm/µs², {_elements(recipe)} elements"
    mesh = recipe["mesh"]
    of = mesh["file"] or f"{mesh['width']:g} × {mesh['height']:g} µm, {_elements(recipe)} elements"
    return f"{of}: {', '.join([*recipe['conditions'], *recipe['bodies']])}"


def _elements(recipe: Mapping[str, Any]) -> str:
    return "{} × {}".format(*recipe["macro"]["elements"])
