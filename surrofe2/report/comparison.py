"""How far displacement curves of one load case are apart, what each run cost, and its picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.units import number
from surrofe2.plant_cell.parameters import PRESETS
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded, in_words
from surrofe2.run.displacement_curve import CurveDifference, DisplacementCurve, difference
from surrofe2.store.run_folder import RunRecord, StoredRun, is_rest, read_run
from surrofe2.store.store import digest, flat, keep, write_bytes

COMPARISON_FILES = ("comparison.json", "comparison.png")


BUCKLED = "beyond_bifurcation"
"""Entry of a record's `met`: how many `points`, `of` how many, are beyond a bifurcation, `from`
which time or load factor on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """A run through a cache against one by RVEs, with what the cache took to make; s.

    Attributes:
        made: of data set, training and calibration; None where that is not known.
        run, true: of the two runs.
    """

    made: float | None
    run: float
    true: float

    @property
    def gain(self) -> float | None:
        """How many times faster than the full run with everything counted."""
        return None if self.made is None else self.true / (self.made + self.run)

    @property
    def pays_from(self) -> int | None:
        """The number of such runs from which on it pays; None: never, or not known."""
        if self.made is None or self.true <= self.run:
            return None
        return max(1, math.ceil(self.made / (self.true - self.run)))

    @property
    def sentence(self) -> str:
        """What it comes to."""
        if self.made is None or self.gain is None:
            return "the time to make its surrogate is not known; train again to have it counted"
        ratio, what = (self.gain, "faster") if self.gain >= 1.0 else (1.0 / self.gain, "slower")
        text = f"{number(ratio, 2)} times {what} than full FE²"
        text = f"including data and training ({number(self.made)} s), {text}"
        if self.pays_from is None:
            return f"{text}; it never pays off, since full FE² is faster"
        if self.pays_from == 1:
            return f"{text}; it pays off in the first run"
        times = self.made / (self.true - self.run)
        runs = f"it pays off after {self.pays_from:,} such runs"
        return f"{text}; {runs}, or on {number(times, 2)} times as many elements"


def made_for(record: RunRecord) -> float | None:
    """Seconds of what was made for a run, a surrogate or a table to begin with; None: not known."""
    if record.surrogate is None:
        return None if record.law in ("cached", "surrogate") else 0.0
    seconds = record.surrogate.get("seconds", {})
    is_known = record.law == "table" or any(name.startswith("data") for name in seconds)
    return float(sum(seconds.values())) if seconds and is_known else None


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run, named by its folder, against the reference.

    Attributes:
        difference: of the watched displacement, relative to the reference's largest.
        wall_time: seconds of law and macro together; compilation is not in it.
        speed_up: ratios reference / this run, by what is counted; None where either needed none.
        cache: of a cached run, what its law reported: tolerance, audit, trust; else empty.
        forces: by name, of every force resultant that both runs have.
        buckled: points beyond a bifurcation at most.
        balance: of a run through a cache, with what that cost to make; None where there is none.
    """

    name: str
    law: str
    difference: CurveDifference
    wall_time: float
    counts: Mapping[str, int]
    speed_up: Mapping[str, float | None]
    cache: Mapping[str, Any]
    forces: Mapping[str, CurveDifference]
    balance: Balance | None
    buckled: int = 0


QUANTITIES: tuple[Quantity[ComparedRun], ...] = (
    Quantity("run", "", "", lambda run: run.name),
    Quantity("largest difference", "", percent(3), lambda run: run.difference.largest),
    Quantity("of largest", "", None, lambda run: run.difference.of_largest),
    Quantity("RMS", "", percent(3), lambda run: run.difference.rms),
    Quantity("wall time", "s", ".3g", lambda run: run.wall_time),
    Quantity("speed-up", "×", ".3g", lambda run: run.speed_up["wall_time"]),
    Quantity("first run", "×", ".3g", lambda run: run.balance and run.balance.gain),
    Quantity("RVE solves", "", ",", lambda run: run.counts.get("rve_solves", 0)),
    Quantity("fewer solves", "×", None, lambda run: run.speed_up["rve_solves"]),
    Quantity("fallbacks", "", ",", lambda run: run.counts.get("fallbacks")),
    Quantity("points beyond a bifurcation", "", ",", lambda run: run.buckled or None),
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


def order_runs(runs: Sequence[StoredRun]) -> list[StoredRun]:
    """The reference first: the first full tissue, else by RVEs, else the first of all."""
    ranks = {"tissue": 0, "rve": 1}
    reference = min(runs, key=lambda run: ranks.get(run.record.law, 2))
    return [reference, *(run for run in runs if run is not reference)]


def compare(runs: Sequence[StoredRun]) -> Comparison:
    """Difference and speed-up of every run against the reference (see `order_runs`).

    Raises:
        MismatchError: the runs are of different load cases or problems; meshes may differ.
        InputError: fewer than two runs.
    """
    if len(runs) < 2:
        raise InputError(f"compare: {len(runs)} run folder; give at least two")
    runs = order_runs(runs)
    reference, load = runs[0], _load_of(runs[0])
    for run in runs[1:]:
        here = _load_of(run)
        for key in {**load, **here}:
            if here.get(key) != load.get(key):
                raise MismatchError(
                    f"{run.folder}: {key} is {here.get(key)}, in {reference.folder} "
                    f"{load.get(key)}; compare runs of one load case"
                )
    first, *others = (compared_run(run, reference) for run in runs)
    return Comparison(reference.name, load, first, tuple(others))


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`."""
    out, runs = Path(out), [read_run(folder) for folder in folders]
    of = {run.name: digest(run.folder / "run.json")[:16] for run in runs}
    result, runs = compare(runs), order_runs(runs)

    def make() -> dict[str, Any]:
        panels = [*displacement_panels(runs), difference_panel(runs), *audit_panels(runs)]
        figure = draw_panels(panels, title=comparison_title(runs))
        write_bytes(out / COMPARISON_FILES[1], encoded(figure, "png"))
        return asdict(result)

    keep(out / COMPARISON_FILES[0], {"of": of}, make, fresh=fresh)
    return result


def _load_of(run: StoredRun) -> dict[str, Any]:
    """All that a run's problem states, by dotted names, but the mesh it is computed on."""
    recipe, of = run.record.recipe, ("conditions", "bodies", "watch", "time")
    if run.is_rest:
        of = ("conditions", "bodies", "watch", "rest")
    stated = flat({name: recipe[name] for name in of if name in recipe})
    stated.pop("rest.load_steps", None)
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
    record, full = run.record, reference.record
    seconds, full_seconds = record.wall_time["total"], full.wall_time["total"]
    solves, full_solves = (each.spent.get("rve_solves", 0) for each in (record, full))
    balance = None
    if record.law in ("cached", "table", "surrogate") and full.law in ("rve", "tissue"):
        balance = Balance(made=made_for(record), run=seconds, true=full_seconds)
    return ComparedRun(
        name=run.name,
        law=record.law,
        difference=apart,
        wall_time=seconds,
        counts=record.spent,
        speed_up={
            "wall_time": full_seconds / seconds if seconds and full_seconds else None,
            "rve_solves": full_solves / solves if solves and full_solves else None,
        },
        cache=record.cache or {},
        forces={
            name: difference(force, there[name])
            for name, force in force_curves(run).items()
            if name in there
        },
        balance=balance,
        buckled=record.met.get(BUCKLED, {}).get("points", 0),
    )


def audit_sentence(cache: Mapping[str, Any]) -> str:
    """How many answers were audited and how wrong they were."""
    audit, allowed = cache["audit"], float(cache["tolerance"]["absolute"])
    if not audit["audited"]:
        return "none of the cache's answers"
    text = f"{audit['audited']:,} of {cache['accepted']['hits']:,} accepted answers{_since(cache)}"
    if audit["quantiles"]:
        text += (
            f", error {number(audit['quantiles']['0.99'], 2)} µN/µm at 99 %, "
            f"{number(audit['largest'], 2)} worst"
        )
    if allowed == float("inf"):
        return f"{text}; no bound, so no tolerance is held"
    return f"{text}; {audit['violations']} above the tolerance of {number(allowed, 2)} µN/µm"


def closing_sentence(cache: Mapping[str, Any]) -> str:
    """What the closing audit of a run guarantees, by which formula and at which confidence; empty
    where there was none, or it is not complete."""
    audit = cache.get("closing_audit", {})  # which runs of earlier versions have not
    bound = audit.get("wrong_at_most")
    if bound is None:
        return ""
    sampled, answers, wrong = audit["sampled"], audit["answers"], audit["violations"]
    above = f"wrong by more than the tolerance of {number(audit['tolerance'], 2)} µN/µm"
    since = _since(cache)
    stand = f"{answers:,} answers that stand{since}"
    whole = "these" if since else "all"
    if sampled == answers:
        return f"all {stand}; {wrong:,} {above}, {percent(2)(bound)} of {whole}"
    formula = "Clopper–Pearson"
    if not wrong:
        formula += f", 1 − 0.05^(1/{sampled})"
    return (
        f"{sampled:,} of the {stand}, drawn at random, which decided nothing; {wrong:,} {above}, "
        f"so with 95 % confidence at most {percent(2)(bound)} of {whole} are ({formula})"
    )


def _since(cache: Mapping[str, Any]) -> str:
    """From when on a cache has counted and audited; empty where that is the whole run."""
    since = cache.get("since", 0.0)  # which runs of earlier versions have not
    if not since:
        return ""
    return f" since t = {number(since)} µs, where the run resumed without the state of its law"


def buckling_sentence(record: RunRecord) -> str:
    """From when on how many points left a bifurcation; empty where none did."""
    beyond = record.met.get(BUCKLED)
    if not beyond or not beyond["points"]:
        return ""
    begin = f"{beyond['from']:.3g}"
    begin = f"load factor {begin}" if is_rest(record) else f"{begin} µs"
    return (
        f"from {begin} on, {beyond['points']} of {beyond['of']} points left a bifurcation: walls "
        "buckled, see what to trust"
    )


def fallback_reasons(counts: Mapping[str, int]) -> str:
    """How many fallbacks there were for which reason, in brackets; empty where there were none."""
    reasons = [
        f"{n:,} {name.removeprefix('fallbacks_').replace('_', ' ')}"
        for name, n in counts.items()
        if name.startswith("fallbacks_") and n
    ]
    return f" ({', '.join(reasons)})" if reasons else ""


# The picture, of runs of which the reference is the first.

_SEEN = 0.02
"""Relative to the largest displacement: from there on a component has a panel."""
_TOGETHER = 0.003
"""Relative to the largest displacement: curves that are closer are drawn as one line."""
_MOST_NAMED = 3


def displacement_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """The watched point's displacement by all runs, each component that counts in a panel.

    Runs that nobody could tell from the reference are named at its line.
    """
    reference, *others = runs
    largest = abs(reference.curve.displacement).max(axis=0)
    apart = {k: difference(run.curve, reference.curve).largest for k, run in enumerate(others)}
    close = [k for k in apart if apart[k] < _TOGETHER]
    label = ", ".join(_label(run, reference) for run in (reference, *(others[k] for k in close)))
    if close:
        label += f" (at most {percent(2)(max(apart[k] for k in close))} apart)"
    lines = [("reference" if len(close) < len(others) else "", label, 0, reference.curve)]
    lines += [
        ("", _label(run, reference), k, run.curve) for k, run in enumerate(others) if k not in close
    ]
    panels: list[Panel] = []
    for axis in np.argsort(-largest).tolist():
        if panels and largest[axis] < _SEEN * largest.max():
            continue
        curves = tuple(
            Curve(name, curve.t, curve.displacement[:, axis], what, markers=False, colour=k)
            for name, what, k, curve in lines
        )
        y_label = f"displacement $u_{'xy'[axis]}$ (µm)"
        title = "" if panels or len(curves) > 1 else in_words(label)
        height = 0.55 if panels else 1.0
        panels.append(Panel(reference.clock, y_label, curves, title, height=height))
    return panels


def difference_panel(runs: Sequence[StoredRun]) -> Panel:
    """How far each run's displacement is from the reference's, relative to the largest."""
    reference, *others = runs
    t, there = reference.curve.t, reference.curve.displacement
    scale = np.linalg.norm(there, axis=1).max() or 1.0
    differences = []
    for k, run in enumerate(others):
        u = run.curve.displacement
        apart = [u[:, i] - np.interp(run.curve.t, t, there[:, i]) for i in range(2)]
        relative = 100.0 * np.linalg.norm(apart, axis=0) / scale
        label = _label(run, reference)
        differences.append(Curve("", run.curve.t, relative, label, markers=False, colour=k))
    names = f"{differences[0].label} and " if len(differences) == 1 else "each run and "
    title = f"Difference of {names}{reference.name}, relative to the largest displacement"
    what = tuple(differences)
    return Panel(reference.clock, "difference (%)", what, in_words(title), height=0.6)


def audit_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """How many audited answers of the caches have at most which error; none without audits."""
    curves: list[Curve] = []
    for k, run in enumerate(runs[1:] or runs):
        for of, cache in run.caches.items():
            if cache["audit"]["quantiles"]:
                curves += audit_curves(cache["audit"], k, of)
    title = "Errors of the cache's stress found by audits"
    labels = "error of the stress (µN/µm)", "answers with at\nmost this error (%)"
    panel = Panel(*labels, tuple(curves), title, log_x=True, zero=True, height=0.6)
    return [panel] if curves else []


def audit_curves(audit: Mapping[str, Any], k: int, of: str) -> list[Curve]:
    """Audited answers of run k with at most an error over that error, and the tolerance."""
    histogram = audit["histogram"]
    first, *others = histogram["bins"]
    bins = np.array([first - 1, first, *others])
    # Bin k ends at the smallest edge times 10^(k / bins a decade).
    errors = histogram["smallest_edge"] * 10.0 ** (bins / histogram["bins_a_decade"])
    counts = np.cumsum([0.0, *histogram["counts"]])
    below = 100.0 * (counts / counts[-1])
    curves = [Curve("", errors, below, f"{of}: audited errors", False, k, "-")]
    if np.isfinite(tolerance := float(audit["tolerance"])):
        label = f"tolerance: {audit['violations']} of {audit['audited']:,} above"
        line = np.full(2, tolerance), np.array([0.0, 100.0])
        curves.append(Curve("", *line, label, False, k, "--"))
    return curves


def comparison_title(runs: Sequence[StoredRun]) -> str:
    """Watched point, problem, plant cell, and the initialisation that the runs have in common."""
    record = runs[0].record
    recipe, point = record.recipe, "Watched point"
    watched = record.problem.get("watched") or recipe.get("watch", {})
    for name, at in [(name, at) for name, at in watched.items() if at][:1]:
        label = "" if name == "point" else f" “{name}”"
        point = f"Watched point{label} ({at[0]:g}, {at[1]:g}) µm"
    details = ", ".join(filter(None, [_cells_of(recipe), _words(record.initialisation)]))
    return "\n".join(filter(None, [point, _problem_of(recipe), details]))


def _problem_of(recipe: Mapping[str, Any]) -> str:
    """What a run computes, in a line: the bar, or the mesh and all that acts on it."""
    mesh, conditions, bodies = recipe["mesh"], recipe["conditions"], recipe["bodies"]
    acting = [*conditions, *bodies]
    if mesh.get("file"):
        return f"{mesh['file']}: {', '.join(acting)}"
    sizes = mesh["elements"]  # one number where the mesh was made in Python
    sizes = [sizes] if isinstance(sizes, int) else sizes
    elements = f"{' × '.join(map(_words, sizes))} elements"
    of = f"{_words(mesh['width'])} × {_words(mesh['height'])} µm"
    if acting == ["clamp", "load"] and "acceleration" in conditions["load"]:
        g_x, g_y = (f"{g:g}".replace("-", "−") for g in conditions["load"]["acceleration"])
        return f"{of} tissue, body force ({g_x}, {g_y}) µm/µs², {elements}"
    return f"{of}, {elements}: {', '.join(acting)}"


def _cells_of(recipe: Mapping[str, Any]) -> str:
    """The preset of each cell, with the constants that are not the preset's."""
    cells = {"": recipe["cell"]} if "cell" in recipe else recipe.get("cells", {})
    titles = []
    for name, cell in cells.items():
        preset = str(cell.get("preset", "none"))
        known = PRESETS[preset].to_dict() if preset in PRESETS else {}
        other = {key: cell[key] for key in known if cell.get(key, known[key]) != known[key]}
        changed = [f"{_words(key)} {_words(value)}" for key, value in other.items()]
        if len(changed) > _MOST_NAMED:
            changed = [*changed[:_MOST_NAMED], f"{len(changed) - _MOST_NAMED} more constants"]
        but = f" with {', '.join(changed)}" if changed else ""
        titles.append(f"cell {name and name + ' '}by preset “{preset}”{but}")
    return ", ".join(titles)


_NAMES = {"none": "", "rve": "RVEs", "cauchy-born": "Cauchy–Born", "tissue": "full tissue"}


def _words(entry: Any) -> str:
    """An entry of a record as people write it: "constrained runs", "5,000"."""
    if isinstance(entry, str):
        return _NAMES.get(entry, entry.translate(str.maketrans("-_", "  ")))
    return f"{entry:,}" if isinstance(entry, int) else f"{entry:,.6g}"


def _label(run: StoredRun, reference: StoredRun) -> str:
    """The folder, and what differs from the title's cell and initialisation."""
    record, usual = run.record, reference.record
    notes = [] if run.name == record.law else [_words(record.law)]
    if _cells_of(record.recipe) != _cells_of(usual.recipe):
        notes.append(_cells_of(record.recipe))
    if record.initialisation not in ("none", usual.initialisation):
        notes.append(_words(record.initialisation))
    return f"{run.name} ({', '.join(notes)})" if notes else run.name
