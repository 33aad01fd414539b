"""How far displacement curves of one load case are apart, what each run cost, and the picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.costs import Balance
from surrofe2.displacement_curve import (
    CurveDifference,
    DisplacementCurve,
    ForceDifference,
    difference,
    force_difference,
)
from surrofe2.errors import InputError, MismatchError
from surrofe2.io.files import flat
from surrofe2.io.run_costs import balance_of
from surrofe2.io.run_folder import RunRecord, StoredRun, caches_of, presets_of
from surrofe2.report.figures import Curve, Panel, write_figure
from surrofe2.report.tables import Quantity, Table, percent

_BINS_A_DECADE = 10


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
    forces: Mapping[str, ForceDifference] = field(default_factory=dict)
    balance: Balance | None = None


QUANTITIES: tuple[Quantity[ComparedRun], ...] = (
    Quantity("run", "", "", lambda run: run.name),
    Quantity("largest difference", "", percent(".3g"), lambda run: run.difference.largest),
    Quantity("of largest", "", percent("+.2g"), lambda run: run.difference.of_largest),
    Quantity("RMS", "", percent(".3g"), lambda run: run.difference.rms),
    Quantity("wall time", "s", ".3g", lambda run: run.wall_time),
    Quantity("speed-up", "×", ".3g", lambda run: run.speed_up["wall_time"]),
    Quantity(
        "all counted", "×", ".3g", lambda run: None if run.balance is None else run.balance.gain
    ),
    Quantity("RVE solves", "", ",", lambda run: run.counts.get("rve_solves", 0)),
    Quantity("fewer solves", "×", ".3g", lambda run: run.speed_up["rve_solves"]),
    Quantity("fallbacks", "", ",", lambda run: run.counts.get("fallbacks")),
)


@dataclass(frozen=True, slots=True)
class ComparedForce:
    """A force resultant of a run against that of the reference."""

    run: str
    name: str
    difference: ForceDifference

    def share(self, apart: float) -> float | None:
        """A difference as a share of the reference's largest; None where that is zero."""
        return apart / self.difference.scale if self.difference.scale else None


FORCE_QUANTITIES: tuple[Quantity[ComparedForce], ...] = (
    Quantity("run", "", "", lambda force: force.run),
    Quantity("force", "", "", lambda force: force.name),
    Quantity("largest", "µN", ".4g", lambda force: force.difference.scale),
    Quantity(
        "largest difference",
        "",
        percent(".3g"),
        lambda force: force.share(force.difference.largest),
    ),
    Quantity(
        "of largest", "", percent("+.2g"), lambda force: force.share(force.difference.of_largest)
    ),
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
    def force_table(self) -> Table[ComparedForce]:
        """Of the forces of supports, surface loads and rigid bodies on the tissue."""
        rows = [
            ComparedForce(run.name, name, force)
            for run in self.runs
            for name, force in run.forces.items()
        ]
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
    recipe, of = run.record.recipe, ("load", "conditions", "bodies", "watch", "time")
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
    there = force_curves(reference)
    return ComparedRun(
        name=run.folder.name,
        law=run.record.law,
        preset=presets_of(run.record.recipe),
        difference=difference(run.curve, reference.curve),
        wall_time=run.record.wall_time["total"],
        counts=run.record.counts,
        speed_up={
            name: _ratio(cost(reference.record), cost(run.record)) for name, cost in _COSTS.items()
        },
        cache=run.record.cache or {},
        forces={
            name: force_difference(force, there[name])
            for name, force in force_curves(run).items()
            if name in there
        },
        balance=balance_of(run.record, reference.record),
    )


def _ratio(reference: float, own: float) -> float | None:
    return reference / own if own and reference else None


def _law_time(record: RunRecord) -> float:
    asked = record.counts.get("stress_points", 0) + record.counts.get("dissipation_points", 0)
    return record.wall_time.get("law", 0.0) / max(asked, 1)


_COSTS: Mapping[str, Callable[[RunRecord], float]] = {
    "wall_time": lambda record: record.wall_time["total"],
    "law_time_per_stress": _law_time,
    "rve_solves": lambda record: record.counts.get("rve_solves", 0),
    "right_hand_sides": lambda record: record.counts.get("right_hand_sides", 0),
}


def write_comparison_plot(path: Path, comparison: Comparison, runs: Sequence[StoredRun]) -> None:
    """Draw displacement curves, their differences, audits and the table into a PNG."""
    reference, *others = order_runs(runs)
    t, there = reference.curve.t, reference.curve.displacement
    scale = np.linalg.norm(there, axis=1).max()
    axis = int(abs(there).max(axis=0).argmax())
    curves = [Curve("reference", t, there[:, axis], _label(reference, reference), markers=False)]
    differences: list[Curve] = []
    audits: list[Curve] = []
    for k, run in enumerate(others):
        u = run.curve.displacement
        curves.append(Curve("", run.curve.t, u[:, axis], _label(run, reference), markers=False))
        apart = [u[:, i] - np.interp(run.curve.t, t, there[:, i]) for i in range(2)]
        share = 100.0 * np.linalg.norm(apart, axis=0) / scale
        differences.append(Curve("", run.curve.t, share, markers=False))
        for cache in caches_of(run.record.cache).values():
            if cache["audit"]["quantiles"]:
                audits += _audit_curves(k, cache["audit"])
    panels = [
        Panel("", f"displacement $u_{'xy'[axis]}$ (µm)", tuple(curves)),
        Panel(
            x_label="time $t$ (µs)",
            y_label="difference (% of\nlargest displacement)",
            curves=tuple(differences),
            height=0.55,
        ),
    ]
    if audits:
        label = "error of the cache's stress found by audits (µN/µm); dotted: 99 % are below"
        panels.append(
            Panel(label, "audited\nanswers (%)", tuple(audits), log_x=True, zero=True, height=0.55)
        )
    write_figure(path, _title(reference), panels, table=comparison.table)


def _title(reference: StoredRun) -> str:
    recipe = reference.record.recipe
    return (
        f"Watched point: {problem_title(recipe)},\n"
        f"cell preset “{presets_of(recipe)}”, {reference.record.initialisation}"
    )


def _label(run: StoredRun, reference: StoredRun) -> str:
    """The folder, and what differs from the title's preset and initialisation."""
    record, usual = run.record, reference.record
    notes = [] if run.folder.name == record.law else [record.law]
    if presets_of(record.recipe) != presets_of(usual.recipe):
        notes.append(presets_of(record.recipe))
    if record.initialisation != usual.initialisation:
        notes.append(record.initialisation)
    return f"{run.folder.name} ({', '.join(notes)})" if notes else run.folder.name


def _audit_curves(k: int, audit: Mapping[str, Any]) -> list[Curve]:
    """Share of run k's audited answers over their error, its 99 % quantile and the tolerance."""
    edges, shares = coarse_histogram(audit["histogram"])
    high = np.array([0.0, 100.0 * shares.max()])

    def line(x: float, dash: str, label: str = "") -> Curve:
        return Curve("", np.full(2, x), high, label, markers=False, colour=k, dash=dash)

    percent = np.concatenate([[0.0], 100.0 * shares])
    found = [Curve("", edges, percent, markers=False, colour=k, dash="-", steps=True)]
    found.append(line(audit["quantiles"]["0.99"], ":"))
    if np.isfinite(tolerance := float(audit["tolerance"])):
        above = f"tolerance: {audit['violations']} of {audit['audited']:,} above"
        found.append(line(tolerance, "--", above))
    return found


def coarse_histogram(histogram: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """(b + 1,) edges and (b,) shares of a stored histogram in ten bins a decade."""
    fine, counts = np.array(histogram["bins"]), np.array(histogram["counts"], dtype=np.float64)
    many = histogram["bins_a_decade"] // _BINS_A_DECADE
    # Fine bin k ends at the smallest edge times 10^(k / bins a decade).
    coarse = -(-fine // many)
    first, last = coarse.min(), coarse.max()
    shares = np.bincount(coarse - first, weights=counts) / counts.sum()
    powers = np.arange(first - 1, last + 1) / _BINS_A_DECADE
    return histogram["smallest_edge"] * 10.0**powers, shares


def problem_title(recipe: Mapping[str, Any]) -> str:
    """What a run computes, in a line: the bar, or the mesh and all that acts on it."""
    if "load" in recipe:
        load = recipe["load"]
        g = float(np.hypot(*load["body_force"]))
        size = f"{load['width']:g} × {load['height']:g} µm tissue"
        return f"{size}, body force {g:g} µm/µs², {_elements(recipe)} elements"
    mesh = recipe["mesh"]
    number = mesh["elements"]  # one number where the mesh was made in Python
    number = number if isinstance(number, int) else _elements(recipe)
    of = mesh["file"] or f"{mesh['width']:g} × {mesh['height']:g} µm, {number} elements"
    return f"{of}: {', '.join([*recipe['conditions'], *recipe['bodies']])}"


def _elements(recipe: Mapping[str, Any]) -> str:
    return "{} × {}".format(*recipe["macro"]["elements"])
