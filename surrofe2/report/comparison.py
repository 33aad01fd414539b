"""Comparison of runs of one load case: differences of their curves, their cost, and a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.units import number
from surrofe2.plant_cell.parameters import PRESETS
from surrofe2.report.tables import Quantity, Table, check_form, percent
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded, in_words
from surrofe2.run.displacement_curve import CurveDifference, DisplacementCurve, difference
from surrofe2.store.run_folder import RunRecord, StoredRun, cells_of, is_rest, read_run
from surrofe2.store.store import digest, flat, keep, write_bytes

COMPARISON = "comparison.json"


# Entry of a record's `met` on points beyond a bifurcation: their number, `points`, the number of
# all points, `of`, and the time or load factor from which on there were any, `from`.
BUCKLED = "beyond_bifurcation"


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """The cost of a run through a cache beside that of a run by RVEs, and the cost of the cache.

    Attributes:
        preparation: seconds of data set, training and calibration; None where they are not known.
        run: seconds of the run through the cache.
        true: seconds of the run by RVEs.
    """

    preparation: float | None
    run: float
    true: float

    @property
    def gain(self) -> float | None:
        """Speed-up over the run by RVEs with everything counted; None where it is not known."""
        if self.preparation is None:
            return None
        return self.true / (self.preparation + self.run)

    @property
    def pays_from(self) -> int | None:
        """The number of such runs from which on it pays; None: never, or not known."""
        if self.preparation is None or self.true <= self.run:
            return None
        return max(1, math.ceil(self.preparation / (self.true - self.run)))

    @property
    def sentence(self) -> str:
        """The gain, and from when on the cache pays off, in words."""
        if self.preparation is None or self.gain is None:
            return "the time to make its surrogate is not known; train again to have it counted"
        if self.gain >= 1.0:
            speed = f"{number(self.gain, 2)} times faster"
        else:
            speed = f"{number(1.0 / self.gain, 2)} times slower"
        text = f"including data and training ({number(self.preparation)} s), {speed} than full FE²"
        if self.pays_from is None:
            return f"{text}; it never pays off, since full FE² is faster"
        if self.pays_from == 1:
            return f"{text}; it pays off in the first run"
        times = self.preparation / (self.true - self.run)
        runs = f"it pays off after {self.pays_from:,} such runs"
        return f"{text}; {runs}, or on {number(times, 2)} times as many elements"


def made_for(record: RunRecord) -> float | None:
    """Return the seconds that the surrogate or table of a run took to make; None: not known."""
    if record.surrogate is None:
        needs_one = record.law in ("cached", "surrogate")
        return None if needs_one else 0.0
    seconds = record.surrogate.get("seconds", {})
    # without those of its data set, the seconds of a surrogate are not all
    is_whole = record.law == "table" or any(name.startswith("data") for name in seconds)
    if not seconds or not is_whole:
        return None
    return float(sum(seconds.values()))


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One run, named by its folder, against the reference.

    Attributes:
        name: name of the run's folder.
        law: law of the run, as of `--law`, or "tissue".
        difference: difference of the watched displacement, relative to the reference's largest.
        wall_time: seconds of law and macro together, without compilation.
        counts: numbers of stresses and solves by name.
        speed_up: ratios reference / this run, by what is counted; None where either needed none.
        cache: report of the law of a cached run (tolerance, audit, trust); else empty.
        forces: difference of every force resultant that both runs have, by name.
        balance: cost of a run through a cache, with that of making it; None for other runs.
        buckled: largest number of points beyond a bifurcation.
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
    Quantity("first run", "×", ".3g", lambda run: run.balance.gain if run.balance else None),
    Quantity("RVE solves", "", ",", lambda run: run.counts.get("rve_solves", 0)),
    Quantity("fewer solves", "×", None, lambda run: run.speed_up["rve_solves"]),
    Quantity("fallbacks", "", ",", lambda run: run.counts.get("fallbacks")),
    Quantity("points beyond a bifurcation", "", ",", lambda run: run.buckled or None),
)
FORCE_QUANTITIES: tuple[Quantity[Mapping[str, Any]], ...] = (
    Quantity("run", "", ""),
    Quantity("force", "", ""),  # name of a support, surface load or body
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
        """The runs in a table, the reference first."""
        return Table(QUANTITIES, (self.reference_run, *self.runs))

    @property
    def force_table(self) -> Table[Mapping[str, Any]]:
        """The forces of supports, surface loads and rigid bodies on the tissue, in a table."""
        rows = []
        for run in self.runs:
            for name, force in run.forces.items():
                row: dict[str, Any] = {"run": run.name, "force": name, "largest": force.scale}
                if force.scale:  # a difference is relative to it
                    row["largest difference"] = force.largest
                    row["of largest"] = force.of_largest
                rows.append(row)
        return Table(FORCE_QUANTITIES, rows)


def order_runs(runs: Sequence[StoredRun]) -> list[StoredRun]:
    """Put the reference first: the first full tissue, else by RVEs, else the first of all."""
    ranks = {"tissue": 0, "rve": 1}
    reference = min(runs, key=lambda run: ranks.get(run.record.law, 2))
    return [reference, *(run for run in runs if run is not reference)]


def compare(runs: Sequence[StoredRun]) -> Comparison:
    """Compute difference and speed-up of every run against the reference (see `order_runs`).

    Raises:
        MismatchError: the runs are of different load cases or problems; meshes may differ.
        InputError: fewer than two runs.
    """
    if len(runs) < 2:
        raise InputError(f"compare: {len(runs)} run folder; give at least two")
    runs = order_runs(runs)
    reference = runs[0]
    load = _load_of(reference)
    for run in runs[1:]:
        load_of_run = _load_of(run)
        for key in {**load, **load_of_run}:
            if load_of_run.get(key) != load.get(key):
                raise MismatchError(
                    f"{run.folder}: {key} is {load_of_run.get(key)}, in {reference.folder} "
                    f"{load.get(key)}; compare runs of one load case"
                )
    reference_run, *others = (compared_run(run, reference) for run in runs)
    return Comparison(reference.name, load, reference_run, tuple(others))


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, form: str = "png", fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`.

    Args:
        form: format of the picture, of `PICTURE_FORMATS`; comparison.pdf, comparison.svg.
    """
    out = Path(out)
    check_form(form)
    stored_runs = [read_run(folder) for folder in folders]
    fingerprints = {run.name: digest(run.folder / "run.json")[:16] for run in stored_runs}
    comparison = compare(stored_runs)
    runs = order_runs(stored_runs)

    picture = out / f"comparison.{form}"

    def draw() -> None:
        """Draw the picture."""
        first, *others = displacement_panels(runs) + force_panels(runs)
        # the first names the lines of all
        over_time = [first, *(replace(panel, has_legend=False) for panel in others)]
        panels = [*over_time, difference_panel(runs), *audit_panels(runs)]
        figure = draw_panels(panels, title=comparison_title(runs))
        write_bytes(picture, encoded(figure, form))

    def make() -> dict[str, Any]:
        """Draw the picture, and return the entries of comparison.json."""
        draw()
        return asdict(comparison)

    keep(out / COMPARISON, {"of": fingerprints}, make, fresh=fresh)
    if not picture.exists():  # the comparison was kept, and had a picture of another format
        draw()
    return comparison


def _load_of(run: StoredRun) -> dict[str, Any]:
    """Return all that a run's problem states, by dotted names, without the mesh.

    Settings that change nothing of the problem are left out.
    """
    recipe = run.record.recipe
    last_section = "rest" if run.is_rest else "time"
    sections = ("conditions", "bodies", "watch", last_section)
    stated = flat({name: recipe[name] for name in sections if name in recipe})
    stated.pop("rest.load_steps", None)
    stated.pop("time.frames", None)
    return stated


def force_curves(run: StoredRun) -> dict[str, DisplacementCurve]:
    """Return force resultants on the tissue over time by name, µN.

    Forces that hold rigid bodies are left out.
    """
    on_bodies = {f"force {body} position" for body in run.record.recipe.get("bodies", {})}
    curves = {}
    for column in run.history:
        name = column.removesuffix(" x")
        if name == column or not name.startswith("force ") or name in on_bodies:
            continue
        force = np.stack([run.history[f"{name} x"], run.history[f"{name} y"]], axis=1)
        curves[name.removeprefix("force ")] = DisplacementCurve(run.curve.t, force)
    return curves


def compared_run(run: StoredRun, reference: StoredRun) -> ComparedRun:
    """Compute difference and speed-up of a run against another of its load case.

    Raises:
        InputError: the watched point of the reference does not move.
    """
    apart = difference(run.curve, reference.curve)
    if not apart.scale:
        raise InputError(f"{reference.folder}: the watched point does not move; nothing to compare")
    record = run.record
    full = reference.record
    seconds = record.wall_time["total"]
    full_seconds = full.wall_time["total"]
    balance = None
    if record.law in ("cached", "table", "surrogate") and full.law in ("rve", "tissue"):
        balance = Balance(preparation=made_for(record), run=seconds, true=full_seconds)
    reference_forces = force_curves(reference)
    return ComparedRun(
        name=run.name,
        law=record.law,
        difference=apart,
        wall_time=seconds,
        counts=record.spent,
        speed_up={
            "wall_time": _ratio(full_seconds, seconds),
            "rve_solves": _ratio(
                full.spent.get("rve_solves", 0), record.spent.get("rve_solves", 0)
            ),
        },
        cache=record.cache or {},
        forces={
            name: difference(force, reference_forces[name])
            for name, force in force_curves(run).items()
            if name in reference_forces
        },
        balance=balance,
        buckled=record.met.get(BUCKLED, {}).get("points", 0),
    )


def _ratio(of_reference: float, of_run: float) -> float | None:
    """Return how much more the reference needed; None where either needed nothing."""
    if not of_reference or not of_run:
        return None
    return of_reference / of_run


def audit_sentence(cache: Mapping[str, Any]) -> str:
    """Say how many stresses of a cache were audited, and how wrong they were."""
    audit = cache["audit"]
    allowed = float(cache["tolerance"]["absolute"])
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
    """Say what the closing audit of a run guarantees, by which formula and at which confidence.

    The sentence is empty where there was no audit, or it is not complete.
    """
    audit = cache.get("closing_audit", {})  # which runs of earlier versions have not
    bound = audit.get("wrong_at_most")
    if bound is None:
        return ""
    sampled = audit["sampled"]
    answers = audit["answers"]
    wrong = audit["violations"]
    above = f"wrong by more than the tolerance of {number(audit['tolerance'], 2)} µN/µm"
    since = _since(cache)
    stand = f"{answers:,} answers that stand{since}"
    whole = "these" if since else "all"
    if sampled == answers:  # every answer was audited, so the fraction is exact
        return f"all {stand}; {wrong:,} {above}, {percent(2)(bound)} of {whole}"
    formula = "Clopper–Pearson"
    if not wrong:
        formula += f", 1 − 0.05^(1/{sampled})"
    return (
        f"{sampled:,} of the {stand}, drawn at random, which decided nothing; {wrong:,} {above}, "
        f"so with 95 % confidence at most {percent(2)(bound)} of {whole} are ({formula})"
    )


def _since(cache: Mapping[str, Any]) -> str:
    """Say from when on a cache has counted and audited; empty where that is the whole run."""
    since = cache.get("since", 0.0)  # which runs of earlier versions have not
    if not since:
        return ""
    return f" since t = {number(since)} µs, where the run resumed without the state of its law"


def buckling_sentence(record: RunRecord) -> str:
    """Say from when on how many points were beyond a bifurcation; empty where none were."""
    beyond = record.met.get(BUCKLED)
    if not beyond or not beyond["points"]:
        return ""
    value = f"{beyond['from']:.3g}"
    begin = f"load factor {value}" if is_rest(record) else f"{value} µs"
    return (
        f"from {begin} on, {beyond['points']} of {beyond['of']} points left a bifurcation: walls "
        "buckled, see what to trust"
    )


def fallback_reasons(counts: Mapping[str, int]) -> str:
    """Say in brackets how many fallbacks had which reason; empty where there were none."""
    reasons = []
    for name, count in counts.items():
        if name.startswith("fallbacks_") and count:
            reason = name.removeprefix("fallbacks_").replace("_", " ")
            reasons.append(f"{count:,} {reason}")
    return f" ({', '.join(reasons)})" if reasons else ""


# The picture: of runs of which the reference is the first.

# A component of the displacement has a panel from this fraction of the largest displacement on;
# below, its curve would show lateral contraction and noise.
_LEAST_COMPONENT = 0.02
# Curves that are closer, relative to the largest displacement, lie on each other: the lines are
# thicker than that, and the legend says how close they are.
_LEAST_DISTANCE = 0.003
# Heights of panels relative to the first one, which has the watched component.
_HEIGHT_OF_OTHER_COMPONENT = 0.55
_HEIGHT_OF_DETAIL = 0.6
# Constants of a plant cell that are named in a title; of more, the number alone.
_MOST_NAMED = 3


def displacement_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """Draw the watched point's displacement by all runs, each component that counts in a panel.

    The largest component comes first. The reference is wide and grey, so that it is seen behind a
    run that nobody could tell from it; the legend says how far such a run is from it.
    """
    reference = runs[0]
    largest = abs(reference.curve.displacement).max(axis=0)
    panels: list[Panel] = []
    for axis in np.argsort(-largest).tolist():
        is_first = not panels
        if not is_first and largest[axis] < _LEAST_COMPONENT * largest.max():
            continue
        columns = [run.curve.displacement[:, axis] for run in runs]
        y_label = f"displacement $u_{'xy'[axis]}$ (µm)"
        height = 1.0 if is_first else _HEIGHT_OF_OTHER_COMPONENT
        curves = _curves_over_time(runs, columns)
        panels.append(Panel(reference.clock, y_label, curves, height=height))
    return panels


def force_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """Draw the largest component of the largest force that all runs have; none without forces."""
    reference = runs[0]
    forces = [force_curves(run) for run in runs]
    common = [name for name in forces[0] if all(name in of_run for of_run in forces)]
    largest = {name: abs(forces[0][name].displacement).max(axis=0) for name in common}
    names = sorted(common, key=lambda name: -largest[name].max())
    if not names or not largest[names[0]].any():
        return []
    name = names[0]
    axis = int(largest[name].argmax())
    columns = [of_run[name].displacement[:, axis] for of_run in forces]
    y_label = f"force {name} {'xy'[axis]} (µN)"
    curves = _curves_over_time(runs, columns)
    return [Panel(reference.clock, in_words(y_label), curves, height=_HEIGHT_OF_DETAIL)]


def _curves_over_time(runs: Sequence[StoredRun], columns: Sequence[Array]) -> tuple[Curve, ...]:
    """Return a line for each run, wide and grey for the reference, which is the first."""
    reference, *others = runs
    t = reference.curve.t
    # a run alone has nothing to be seen behind
    style = "reference" if others else ""
    curves = [Curve(style, t, columns[0], _label(reference, reference), markers=False)]
    for k, (run, column) in enumerate(zip(others, columns[1:], strict=True)):
        label = _label(run, reference)
        distance = difference(run.curve, reference.curve).largest
        if distance < _LEAST_DISTANCE:
            label += f" (displacement at most {percent(2)(distance)} apart)"
        # colours are by number, so that a run has the same one in every panel
        curves.append(Curve("", run.curve.t, column, label, markers=False, colour=k))
    return tuple(curves)


def difference_panel(runs: Sequence[StoredRun]) -> Panel:
    """Draw how far each run's displacement is from the reference's, relative to the largest."""
    reference, *others = runs
    t = reference.curve.t
    reference_u = reference.curve.displacement
    scale = np.linalg.norm(reference_u, axis=1).max() or 1.0  # without motion all is 0 %
    curves = []
    for k, run in enumerate(others):
        u = run.curve.displacement
        # runs have times of their own
        apart = [u[:, i] - np.interp(run.curve.t, t, reference_u[:, i]) for i in range(2)]
        relative = 100.0 * np.linalg.norm(apart, axis=0) / scale
        label = _label(run, reference)
        curves.append(Curve("", run.curve.t, relative, label, markers=False, colour=k))
    # with one curve, the title says whose it is
    if len(curves) == 1:
        names = curves[0].label
    else:
        names = "each run"
    title = f"Difference of {names} and {reference.name}, relative to the largest displacement"
    return Panel(
        reference.clock,
        "difference (%)",
        tuple(curves),
        in_words(title),
        height=_HEIGHT_OF_DETAIL,
    )


def audit_panels(runs: Sequence[StoredRun]) -> list[Panel]:
    """Draw which fraction of audited stresses has at most which error; none without audits."""
    curves: list[Curve] = []
    # without the reference, unless it is the only run
    for k, run in enumerate(runs[1:] or runs):
        for name, cache in run.caches.items():
            if cache["audit"]["quantiles"]:
                curves += audit_curves(cache["audit"], k, name)
    if not curves:
        return []
    panel = Panel(
        "error of the stress (µN/µm)",
        "answers with at\nmost this error (%)",
        tuple(curves),
        "Errors of the cache's stress found by audits",
        log_x=True,
        zero=True,
        height=_HEIGHT_OF_DETAIL,
    )
    return [panel]


def audit_curves(audit: Mapping[str, Any], k: int, of: str) -> list[Curve]:
    """Return the distribution of audited errors, and a line at the tolerance.

    Args:
        audit: audit of a cache, as its report has it.
        k: number of the run, by which curves are coloured.
        of: name of the cache.
    """
    histogram = audit["histogram"]
    first, *others = histogram["bins"]
    bins = np.array([first - 1, first, *others])
    # Bin k ends at the smallest edge times 10^(k / bins a decade). The curve begins where the first
    # bin does, at 0 %.
    errors = histogram["smallest_edge"] * 10.0 ** (bins / histogram["bins_a_decade"])
    counts = np.cumsum([0.0, *histogram["counts"]])
    below = 100.0 * (counts / counts[-1])
    curves = [Curve("", errors, below, f"{of}: audited errors", False, k, "-")]
    tolerance = float(audit["tolerance"])
    if np.isfinite(tolerance):
        label = f"tolerance: {audit['violations']} of {audit['audited']:,} above"
        ends = np.array([0.0, 100.0])
        curves.append(Curve("", np.full(2, tolerance), ends, label, False, k, "--"))
    return curves


def comparison_title(runs: Sequence[StoredRun]) -> str:
    """Name the watched point, the problem, the plant cell and the reference's initialisation."""
    record = runs[0].record
    recipe = record.recipe
    watched = record.problem.get("watched") or recipe.get("watch", {})
    details = [_cells_of(recipe), _words(record.initialisation)]
    lines = [
        _watched_point(watched),
        _problem_of(recipe),
        ", ".join(detail for detail in details if detail),
    ]
    return "\n".join(line for line in lines if line)


def _watched_point(watched: Mapping[str, Any]) -> str:
    """Name the first watched point whose position is known; it is that of the curve."""
    for name, position in watched.items():
        if position:
            label = "" if name == "point" else f" “{name}”"
            return f"Watched point{label} ({position[0]:g}, {position[1]:g}) µm"
    return "Watched point"


def _problem_of(recipe: Mapping[str, Any]) -> str:
    """Describe a problem in a line: the bar, or the mesh and all that acts on it."""
    mesh = recipe["mesh"]
    conditions = recipe["conditions"]
    acting = [*conditions, *recipe["bodies"]]
    if mesh.get("file"):
        return f"{mesh['file']}: {', '.join(acting)}"
    counts = mesh["elements"]
    if isinstance(counts, int):  # the mesh was made in Python
        counts = [counts]
    elements = f"{' × '.join(map(_words, counts))} elements"
    size = f"{_words(mesh['width'])} × {_words(mesh['height'])} µm"
    # the load case of the paper's bar
    if acting == ["clamp", "load"] and "acceleration" in conditions["load"]:
        g_x, g_y = (f"{g:g}".replace("-", "−") for g in conditions["load"]["acceleration"])
        return f"{size} tissue, body force ({g_x}, {g_y}) µm/µs², {elements}"
    return f"{size}, {elements}: {', '.join(acting)}"


def _cells_of(recipe: Mapping[str, Any]) -> str:
    """Name the preset of each cell, with the constants that are not the preset's."""
    titles = []
    for name, cell in cells_of(recipe).items():
        preset = str(cell.get("preset", "none"))
        of_preset = PRESETS[preset].to_dict() if preset in PRESETS else {}
        changed = []
        for key, value in of_preset.items():
            if cell.get(key, value) != value:
                changed.append(f"{_words(key)} {_words(cell[key])}")
        if len(changed) > _MOST_NAMED:
            changed = [*changed[:_MOST_NAMED], f"{len(changed) - _MOST_NAMED} more constants"]
        constants = f" with {', '.join(changed)}" if changed else ""
        which = "cell" if name is None else f"cell {name}"
        titles.append(f"{which} by preset “{preset}”{constants}")
    return ", ".join(titles)


_NAMES = {"none": "", "rve": "RVEs", "cauchy-born": "Cauchy–Born", "tissue": "full tissue"}


def _words(entry: Any) -> str:
    """Write an entry of a record as text: "constrained runs", "5,000"."""
    if isinstance(entry, str):
        return _NAMES.get(entry, entry.translate(str.maketrans("-_", "  ")))
    return f"{entry:,}" if isinstance(entry, int) else f"{entry:,.6g}"


def _label(run: StoredRun, reference: StoredRun) -> str:
    """Name a run by its folder, with a cell or initialisation that is not the reference's."""
    record = run.record
    usual = reference.record
    notes = []
    if run.name != record.law:
        notes.append(_words(record.law))
    if _cells_of(record.recipe) != _cells_of(usual.recipe):
        notes.append(_cells_of(record.recipe))
    if record.initialisation not in ("none", usual.initialisation):
        notes.append(_words(record.initialisation))
    return f"{run.name} ({', '.join(notes)})" if notes else run.name
