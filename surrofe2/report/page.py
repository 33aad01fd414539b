"""Runs on one HTML page that needs nothing else: `page.html`, and the content of its sections.

The tissue in motion is arrays for the script `page.js`, and a picture for paper.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, MismatchError, Surrofe2Error
from surrofe2.base.units import number
from surrofe2.law.stress_law import SURROGATE, TABLE, Status
from surrofe2.problem.conditions import Condition
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import (
    ComparedRun,
    Comparison,
    audit_panels,
    audit_sentence,
    buckling_sentence,
    closing_sentence,
    compare,
    comparison_title,
    difference_panel,
    displacement_panels,
    fallback_reasons,
    force_panels,
    made_for,
    order_runs,
)
from surrofe2.report.figures import (
    ARROW,
    Colours,
    DrawnBody,
    DrawnNode,
    bar_length,
    box,
    draw_tissue,
    drawn_bodies,
    drawn_loads,
    drawn_nodes,
    length_in_words,
    rim,
    supported_sides,
)
from surrofe2.report.tables import percent
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded
from surrofe2.store.fields import (
    BEYOND_NAME,
    DISPLACEMENT_NAME,
    FIELDS,
    SOURCE_NAME,
    StoredFields,
    read_fields,
)
from surrofe2.store.run_folder import EVENTS, StoredRun, cells_of, check_inputs, read_run
from surrofe2.store.store import check_replaceable, flat, read_bytes, write_text

RunFields = tuple[StoredRun, StoredFields | None]  # a run and its fields, None without any

VON_MISES = "von_mises_in_plane_uN_per_um"
WALL_STRETCH = "largest_wall_stretch"
# Sources of stress that are no RVE.
_CACHE = (SURROGATE, TABLE)
# Events of a run, and pictures of its plant cells, that a page has at most.
_MOST_EVENTS = 200
_MOST_PICTURES = 4


class Section(NamedTuple):
    """A section of the page.

    Attributes:
        key: its anchor.
        link: its name in the list of sections.
        heading: its heading in HTML.
        parts: its elements in HTML.
        missing: sentence that is shown where there are no parts.
    """

    key: str
    link: str
    heading: str
    parts: Iterable[str]
    missing: str = ""

    def html(self) -> str:
        """Return the section in HTML; its parts are made here."""
        content = "".join(self.parts) or _missing(self.missing)
        return f'<section id="{self.key}"><h2>{self.heading}</h2>{content}</section>'


def write_report(folders: Sequence[str | Path], out: str | Path) -> Path:
    """Write one HTML file on these runs, which needs nothing else, and return its path.

    Args:
        out: the file; a page that is there is replaced, and no other file.

    Raises:
        FileError: a folder has no run, or the file cannot be written.
        InputError: a run has not begun to have results, or no folder is given.
    """
    if not folders:
        raise InputError("report: no run folder; give at least one")
    runs = order_runs([read_run(folder, finished=False) for folder in folders])
    comparison: Comparison | str = "One run, so there is nothing to compare it with."
    if len(runs) > 1:
        try:
            comparison = compare(runs)
        except MismatchError as error:
            comparison = f"Not compared: {error}."
    compared = () if isinstance(comparison, str) else comparison.runs
    shown = [(run, fields_of(run)) for run in runs]
    stills, motion = motion_section(shown)
    look = f"surrofe2 zoom {shlex.quote(str(runs[0].folder))} --point X,Y"
    sections = (
        Section("displacement", "Displacement", "Displacement", _displacement(runs, comparison)),
        Section(
            "curves", "Curves", "Forces over displacements", _responses(runs),
            "No motion, surface load or body whose force and displacement both change.",
        ),
        Section("cost", "Time and speed-up", "Time and speed-up", _cost(runs, compared)),
        Section(
            "fallback", "Fallbacks", "Where the cache fell back", _fallback(shown),
            "No run through a cache, so nothing fell back.",
        ),
        Section(
            "audit", "Audits", "Audits", _audits(runs),
            "No run through a cache, so nothing was audited.",
        ),
        Section(
            "range", "Range", "Range that was met", _range(runs), "No run recorded what it met."
        ),
        Section("energy", "Energies", "Energies", _energies(runs)),
        Section(
            "cells", "Plant cells", "Plant cells", _plant_cells(runs),
            f"No look into the plant cells in the folders; make one with: {look}",
        ),
        Section("events", "Events", "Events", _events(runs)),
        Section("origin", "Provenance", "Configuration and provenance", _origin(runs)),
    )  # fmt: skip
    html = _packaged("page.html")
    css = _packaged("page.css")
    js = _packaged("page.js")
    page = Template(html).substitute(
        title=escape("surrofe2: " + ", ".join(run.name for run in runs)),
        css=css,
        css_digest=_base64(hashlib.sha256(css.encode()).digest()),
        js=js,
        js_digest=_base64(hashlib.sha256(js.encode()).digest()),
        links="".join(
            f'<li><a href="#{section.key}">{section.link}</a></li>' for section in sections
        ),
        headlines="".join(_headlines(runs, compared)),
        stills="".join(stills),
        sections="\n".join(section.html() for section in sections),
        # a JSON string has no "<" that could end the element early
        data=json.dumps({"runs": motion}).replace("<", "\\u003c"),
    )
    check_replaceable(Path(out), "page", "<!doctype html>", "surrofe2")
    write_text(Path(out), page)
    return Path(out)


def _packaged(name: str) -> str:
    """Read a text that lies beside this module."""
    return files("surrofe2.report").joinpath(name).read_text("utf-8")


def fields_of(run: StoredRun) -> StoredFields | None:
    """Read the fields of a run that the page shows; None where its folder has no fields."""
    if not (run.folder / f"{FIELDS}.h5").exists():
        return None
    shown = VON_MISES, SOURCE_NAME, WALL_STRETCH, BEYOND_NAME
    return read_fields(run.folder, [DISPLACEMENT_NAME], shown)


def _base64(content: bytes) -> str:
    """Write bytes in base64, as HTML takes them."""
    return base64.b64encode(content).decode()


def _headlines(runs: Sequence[StoredRun], compared: Sequence[ComparedRun]) -> Iterator[str]:
    """Yield sentences on what was run, and with which result."""
    yield _paragraph("; ".join(comparison_title(runs).split("\n")))
    for run in compared:
        text = (
            f"{run.name} differs from {runs[0].name} by at most "
            f"{percent(2)(run.difference.largest)} of the largest displacement"
        )
        faster = run.speed_up["wall_time"]
        if faster:
            text += f" and is {number(faster)} times faster by itself"
        yield _paragraph(f"{text}.", "headline")
    for stored in runs:
        buckling = buckling_sentence(stored.record)
        if buckling:
            yield _paragraph(f"{stored.name}: {buckling}.", "headline")
        if stored.record.status != "finished":
            why = stored.record.error or "it is not whole"
            yield _missing(f"{stored.name}: {stored.record.status}; {why}")


def _displacement(runs: Sequence[StoredRun], comparison: Comparison | str) -> Iterator[str]:
    """Yield curves of all runs, their differences and the forces on the tissue."""
    caption = "Displacement of the watched point"
    if len(runs) > 1:
        caption += " by all runs"
    figures = [_chart(panel, caption) for panel in displacement_panels(runs)]
    figures += [_chart(panel, "Largest force on the tissue") for panel in force_panels(runs)]
    if isinstance(comparison, str):
        yield _missing(comparison)
        yield _grid(figures)
        return
    caption = f"Difference from {comparison.reference}, at each time"
    yield _grid([*figures, _chart(difference_panel(runs), caption)])
    yield _table(*comparison.table.for_people())
    if comparison.force_table.rows:
        yield "<h3>Forces on the tissue</h3>"
        yield _table(*comparison.force_table.for_people())


def _responses(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield force–displacement curves of supports, loads and bodies, with peak, slope and work."""
    responses_of = [
        {(response.name, response.axis): response for response in run.responses} for run in runs
    ]
    keys = dict.fromkeys(key for responses in responses_of for key in responses)
    figures = []
    for name, axis in keys:
        curves = []
        for k, (run, responses) in enumerate(zip(runs, responses_of, strict=True)):
            response = responses.get((name, axis))
            if response is not None:
                u = response.displacement
                curves.append(Curve("", u, response.force, run.name, markers=False, colour=k))
        panel = Panel("displacement (µm)", "force (µN)", tuple(curves))
        figures.append(_chart(panel, f"{name}, along {axis}"))
    if figures:
        yield _grid(figures)
    for run, responses in zip(runs, responses_of, strict=True):
        for response in responses.values():
            yield _paragraph(f"{run.name}: {response.sentence}.")


def _cost(runs: Sequence[StoredRun], compared: Sequence[ComparedRun]) -> Iterator[str]:
    """Yield seconds of each run and of making its cache, and from when on the cache pays off."""
    balances = [(run.name, run.balance) for run in compared if run.balance is not None]
    for name, balance in balances:
        yield _paragraph(f"{name}: {balance.sentence}.", "headline")
    if not balances:
        yield _missing("No run through a cache beside one by RVEs, so there is no speed-up.")
    seconds = [_seconds(run) for run in runs]
    names = list(dict.fromkeys(name for of_run in seconds for name in of_run))
    rows = []
    for run, of_run in zip(runs, seconds, strict=True):
        texts = [number(of_run[name]) if name in of_run else "–" for name in names]
        rows.append([run.name, *texts])
    yield _table(["run", *(f"{name} (s)" for name in names)], rows)


def _seconds(run: StoredRun) -> dict[str, float]:
    """Return the seconds of a run by what they were spent on.

    This is law and macro scale, loading kernels before them, and making the surrogate or table.
    """
    wall = run.record.wall_time
    law = wall.get("law", 0.0)
    macro = wall.get("macro", 0.0)
    if law or macro:
        seconds = {"law": law, "macro scale": macro}
    else:  # a full tissue has no such parts
        seconds = {"run": wall.get("total", 0.0)}
    if wall.get("compilation"):
        seconds["kernels"] = wall["compilation"]
    if made_for(run.record):
        seconds |= (run.record.surrogate or {}).get("seconds", {})
    return seconds


def _fallback(shown: Sequence[RunFields]) -> Iterator[str]:
    """Yield where and when the cache fell back on RVEs."""
    for run, fields in shown:
        for name, cache in run.caches.items():
            hits = cache["accepted"]["hits"]
            fallbacks = cache["accepted"]["fallbacks"]
            reasons = fallback_reasons(cache["accepted"])
            fraction = percent(3)(fallbacks / max(hits + fallbacks, 1))
            counts = (
                f"{hits:,} answers of accepted steps came from the cache, {fallbacks:,} from RVEs"
            )
            yield _paragraph(f"{name}: {counts}{reasons}, {fraction}.")
            for event in cache["trust"]["events"]:
                yield _paragraph(f"{name}, step {event['step']}: {event['finding']}.")
        if fields is not None and SOURCE_NAME in fields.values:
            yield _over_time_and_mesh(run, fields)


def _over_time_and_mesh(run: StoredRun, fields: StoredFields) -> str:
    """Draw the sources of stress over the stored times, and where RVEs were needed."""
    source = fields.values[SOURCE_NAME]
    by_rve = ~np.isin(source, _CACHE)  # (m, e) at each time and element
    if not by_rve.any():
        return _missing(
            f"{run.name}: at none of the {len(fields.t)} stored times did an element fall back."
        )
    curves = tuple(
        Curve("", fields.t, 100.0 * (source == code).mean(axis=1), words, markers=False, colour=k)
        for k, (code, (words, _)) in enumerate(SOURCES.items())
        if (source == code).any()
    )
    panel = Panel(run.clock, "elements (%)", curves, zero=True)
    often = 100.0 * by_rve.mean(axis=0)
    colours = Colours.of("stored times with an RVE (%)", np.append(often, 0.0), "Oranges")
    caption = f"{run.name}: at how many of the stored times an element had a point on RVEs"
    return _grid(
        [
            _chart(panel, f"{run.name}: who answered at the stored times"),
            _tissue(run, fields, 0, often, colours, caption),
        ]
    )


def _audits(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield audited errors with the tolerance, and what the closing audits guarantee."""
    charts = []
    for run in runs:
        for name, cache in run.caches.items():
            worst = cache["audit"]["worst"]
            yield _paragraph(f"{name}: audited: {audit_sentence(cache)}.")
            if isinstance(worst, Mapping):
                where = f"step {worst['step']}, point {worst['point']}"
                risk = f"where the risk was {number(worst['risk'])} ({where})"
                error = f"{number(worst['error'])} µN/µm"
                yield _paragraph(f"{name}: the worst error is {error}, {risk}.")
            sentence = closing_sentence(cache)
            if sentence:
                yield _paragraph(f"{name}: closing audit: {sentence}.")
        for panel in audit_panels([run]):
            charts.append(_chart(panel, f"{run.name}: audited errors"))
    yield _grid(charts)


def _range(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield a table of what each run met at any point and step, beside the range of the samples."""
    limits = runs[0].record.recipe.get("range") or {}
    ranges = [*((run.name, run.record.met) for run in runs), ("range of samples", limits)]
    rows = []
    for name, met in ranges:
        if {"stretch", "shear", "rate"} <= met.keys():
            low, high = met["stretch"]
            stretch = f"{low:.4g} … {high:.4g}"
            rows.append([name, stretch, number(met["shear"]), number(met["rate"])])
    if rows:
        yield _table(["met at any point and step", "stretch (1)", "shear (1)", "rate (1/µs)"], rows)


def _energies(runs: Sequence[StoredRun]) -> list[str]:
    """Return figures of energies over time, with how well they balance."""
    figures = []
    lacking = []
    for run in runs:
        # energies that were not recorded are NaN
        named = {name: values for name, values in run.energies.items() if np.isfinite(values).any()}
        if not named:
            lacking.append(_missing(f"{run.name}: no energies.csv in its folder."))
            continue
        balance = named.pop("balance", None)
        curves = tuple(
            Curve("", run.curve.t, values, name, False) for name, values in named.items()
        )
        caption = f"{run.name}: energies and works"
        largest = max((float(np.nanmax(abs(values))) for values in named.values()), default=0.0)
        if balance is not None and largest:
            error = float(np.nanmax(abs(balance))) / largest
            caption += f"; they balance within {percent(2)(error)} of the largest"
        figures.append(_chart(Panel(run.clock, "energy (pJ)", curves), caption))
    return [_grid(figures), *lacking]


def _plant_cells(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield pictures of the plant cells that `surrofe2 zoom` looked into."""
    for run in runs:
        for path in sorted(run.folder.glob("zoom-*/zoom.png"))[:_MOST_PICTURES]:
            of = f"{run.name}, {path.parent.name}: the plant cells there"
            yield _figure(
                read_bytes(path),
                "particles of a plant cell at six times",
                f"{of}, walls by stretch and fluid by pressure",
            )


def _events(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield the events of all runs, the last ones where there are many."""
    for run in runs:
        path = run.folder / EVENTS
        events = read_bytes(path).decode("utf-8").splitlines() if path.exists() else []
        if not events:
            yield _missing(f"{run.name}: no log of events in its folder.")
            continue
        shown = [json.loads(line) for line in events[-_MOST_EVENTS:]]
        keys = list(dict.fromkeys(key for event in shown for key in event))
        rows = [[_short(event.get(key, "")) for key in keys] for event in shown]
        if len(shown) < len(events):
            yield _paragraph(f"{run.name}: the last {len(shown)} of {len(events)}.")
        yield _folded(f"{run.name}, events: {len(events)}", keys, rows)


def _short(value: Any) -> str:
    """Write a value of a log or record in few characters."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _origin(runs: Sequence[StoredRun]) -> Iterator[str]:
    """Yield settings, by what and when each run was made, and the digests of its files."""
    names = [run.name for run in runs]
    settings = _side_by_side([flat(run.record.recipe) for run in runs])
    apart = [row for row in settings if len(set(row[1:])) > 1]
    yield _table(["", *names], _side_by_side([*map(_provenance, runs)]), words=True)
    if apart:
        yield _table(["entry that differs", *names], apart, words=True)
    elif len(names) > 1:
        yield _paragraph("All entries of the recipe are the same in all runs.")
    whole = [row if row in apart else row[:2] for row in settings]
    yield _folded(f"The whole recipe: {len(settings)} entries", ["entry", "value"], whole)


def _side_by_side(columns: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Make rows of a table from columns: a key, and its value in each column."""
    keys = dict.fromkeys(key for column in columns for key in column)
    return [[key, *(_short(column.get(key, "–")) for column in columns)] for key in keys]


def _provenance(run: StoredRun) -> dict[str, Any]:
    """Return what made a run and what it took, by the words of a table."""
    record = run.record
    problem = record.problem
    return {
        "status": record.status,
        **({"error": record.error} if record.error else {}),
        "law": record.law,
        "initialisation": record.initialisation,
        "solver": record.solver,
        "plant cell": record.cell_fingerprint,
        "surrogate": (record.surrogate or {}).get("fingerprint", "–"),
        **{key: problem[key] for key in ("elements", "nodes", "points") if key in problem},
        "seconds": record.wall_time.get("total", "–"),
        "seconds of all threads": record.wall_time.get("cpu", "–"),
        "threads": record.threads,
        **{name.replace("_", " "): n for name, n in record.counts.items()},
        **{f"rolled back {name.replace('_', ' ')}": n for name, n in record.rolled_back.items()},
        "surrofe2": record.package_version,
        "made": record.created,
        **record.platform,
        **{f"SHA-256 of {name}": value[:16] for name, value in record.files.items()},
    }


# The tissue in motion.

# Colours of viridis, evenly from lowest to highest.
STOPS = [to_hex(colormaps["viridis"](k / 9)) for k in range(10)]
# Values are stored as bytes: whole numbers from 0 to `LEVELS`, and one for an unknown value.
LEVELS = 254
UNKNOWN = 255
# Words and colour of each source of stress, by the codes of `stress_law.Sources`.
SOURCES: dict[int, tuple[str, str]] = {
    SURROGATE: ("network", "#3b82c4"),
    TABLE: ("table", "#3aa37f"),
    Status.OUT_OF_RANGE: ("RVE: out of the domain", "#d9822b"),
    Status.NOT_FINITE: ("RVE: not finite", "#8c5bb0"),
    Status.NOT_TRUSTED: ("RVE: risk above the limit", "#c2413b"),
}
# Bytes of all animations together, before base64.
_BUDGET = 1_200_000
# The largest displacement is drawn with about this fraction of the tissue's size at first, by one
# of the factors.
_SHOWN = 0.08
_FACTORS = (1, 2, 5, 10, 20, 50, 100)
# Width of a picture of the tissue, inches.
_WIDTH = 4.4


def motion_section(shown: Sequence[RunFields]) -> tuple[list[str], list[dict[str, Any]]]:
    """Return pictures for paper and without the script, and what the script needs of each run."""
    lacking = []
    stills = []
    data = []
    count = sum(fields is not None for _, fields in shown)
    for run, fields in shown:
        if fields is None:
            text = f"{run.name}: no fields in its folder, so its motion is not shown."
            lacking.append(_missing(text))
            continue
        loads, reason = loads_of(run, fields)
        if reason:
            lacking.append(_missing(f"Only loads on single nodes are drawn: {reason}."))
        data.append(_arrays(run, fields, loads, _BUDGET // count))
        stills.append(_still(run, fields, loads, data[-1]["factor"]))
    return [*lacking, f'<div class="still">{_grid(stills)}</div>'], data


def _quantities(run: StoredRun, fields: StoredFields) -> dict[str, tuple[str, Array]]:
    """Return unit and values (m, e) of the quantities to colour elements by, by name.

    Stresses are in MPa where the tissue has one thickness.
    """
    thicknesses = {cell.get("tissue_thickness") for cell in cells_of(run.record.recipe).values()}
    (thickness,) = thicknesses if len(thicknesses) == 1 else (None,)
    size = np.linalg.norm(fields.displacement, axis=2)
    quantities = {"displacement": ("µm", size[:, fields.cells].mean(axis=2))}
    for name, unit, key in (
        ("von Mises stress", "µN/µm", VON_MISES),
        ("largest wall stretch", "length / rest length", WALL_STRETCH),
        ("stress source", "", SOURCE_NAME),
        ("beyond a bifurcation", "elements with such a point", BEYOND_NAME),
    ):
        if key not in fields.values:
            continue
        if key == BEYOND_NAME and not fields.values[key].any():  # nothing would be seen
            continue
        quantities[name] = unit, fields.values[key]
    if thickness is not None and "von Mises stress" in quantities:
        quantities["von Mises stress"] = "MPa", fields.values[VON_MISES] / thickness
    return quantities


def _arrays(
    run: StoredRun, fields: StoredFields, loads: Sequence[DrawnNode], budget: int
) -> dict[str, Any]:
    """Return a run for the script, at as many times as the budget of bytes has room for.

    Arrays are bytes in base64: displacements are 16-bit fractions of the largest component, values
    8-bit levels.
    """
    quantities = _quantities(run, fields)
    # two components of two bytes for each node, and a byte for each element and quantity
    bytes_of_a_time = 4 * len(fields.points) + len(quantities) * len(fields.cells)
    times = max(2, min(len(fields.t), budget // max(bytes_of_a_time, 1)))
    chosen = np.unique(np.linspace(0, len(fields.t) - 1, times).round().astype(int))
    u = fields.displacement[chosen]
    largest = float(abs(u).max()) or 1.0
    order = rim(fields)
    bodies = bodies_of(run, fields)
    factor = 1
    if not bodies:  # multiplied, a gap to a body closes before it should
        size = float(np.ptp(fields.points, axis=0).max())
        farthest = float(np.linalg.norm(fields.displacement, axis=2).max()) or size
        factor = max((f for f in _FACTORS if f * farthest <= 1.5 * _SHOWN * size), default=1)
    low, high = box(fields.points + factor * u, bodies)
    arrow = ARROW * float(max(high - low))
    arrows = [node for node in loads if node.pull.any()]
    if arrows:
        low = low - arrow
        high = high + arrow
    length = bar_length(float(high[0] - low[0]))
    return {
        "name": run.name,
        "t": fields.t[chosen].tolist(),
        "clock": ["load factor ", ""] if run.is_rest else ["t = ", " µs"],
        "corners": len(order),
        "cells": _base64(fields.cells[:, order].astype("<u4").tobytes()),
        "points": _base64(fields.points.astype("<f4").tobytes()),
        "motion": _base64(np.rint(32767.0 * u / largest).astype("<i2").tobytes()),
        "largest": largest,
        "box": [*low.tolist(), *high.tolist()],
        "factor": factor,
        "factors": list(_FACTORS),
        "bodies": [
            {
                "outline": body.outline.round(3).tolist(),
                "moved": body.moved[chosen].round(3).tolist(),
            }
            for body in bodies
        ],
        "held": supported_sides(fields),
        # node, and both ends of its arrow from there
        "arrows": [[node.node, *node.arrow(np.zeros(2), arrow).tolist()] for node in arrows],
        "bar": [length, length_in_words(length)],
        "levels": LEVELS,
        "colours": [
            _colour(name, unit, values[chosen]) for name, (unit, values) in quantities.items()
        ],
    }


def _colour(name: str, unit: str, values: Array) -> dict[str, Any]:
    """Return a quantity for the script: its name, its colours, and the bytes of its values."""
    if name == "stress source":
        codes = np.nan_to_num(values, nan=UNKNOWN).astype(np.int16).astype(np.uint8)
        # codes are one byte each, so negative ones are counted from 256
        shown = {int(code) % 256: list(look) for code, look in SOURCES.items()}
        words = {code: shown[code] for code in shown if (codes == code).any()}
        return {"name": name, "sources": words, "data": _base64(codes.tobytes())}
    colours = Colours.of(unit, values)
    low = colours.low
    high = colours.high
    fraction = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    stored = np.rint(LEVELS * fraction).astype(np.uint8)
    stored[~np.isfinite(values)] = UNKNOWN
    ends = [f"{low:.4g}", f"{high:.4g} {unit}"]
    return {"name": name, "ends": ends, "stops": STOPS, "data": _base64(stored.tobytes())}


def bodies_of(run: StoredRun, fields: StoredFields) -> list[DrawnBody]:
    """Return the rigid bodies of a run at the times of its fields."""
    stated = run.record.recipe.get("bodies", {})
    bodies = [RigidBody.read(f"bodies.{name}", table) for name, table in stated.items()]
    return drawn_bodies(bodies, run.curve.t, run.history, fields)


def conditions_on_nodes(run: StoredRun) -> list[Condition]:
    """Return the conditions of a run that act on a node alone."""
    stated = run.record.recipe.get("conditions", {})
    return [
        Condition.read(f"conditions.{name}", table, name)
        for name, table in stated.items()
        if isinstance(table["on"], Mapping)
    ]


def loads_of(run: StoredRun, fields: StoredFields) -> tuple[list[DrawnNode], str]:
    """Return what acts on the tissue of a run.

    Where its recipe is missing, damaged or no longer read, that is what acts on single nodes, and
    the second result says why.
    """
    try:
        recipe = load_recipe(check_inputs(run.folder, run.record))
        return drawn_loads(recipe.problem(), fields), ""
    except Surrofe2Error as error:
        return drawn_nodes(conditions_on_nodes(run), fields), str(error)


def _still(run: StoredRun, fields: StoredFields, loads: Sequence[DrawnNode], factor: int) -> str:
    """Draw the tissue where it has moved farthest, by stress, for paper and without the script."""
    k = int(np.linalg.norm(fields.displacement, axis=2).max(axis=1).argmax())
    quantities = _quantities(run, fields)
    what = "von Mises stress" if "von Mises stress" in quantities else "displacement"
    unit, values = quantities[what]
    when = f"load factor {fields.t[k]:.4g}" if run.is_rest else f"t = {fields.t[k]:.4g} µs"
    caption = f"{run.name} where it has moved farthest, {when}"
    if factor > 1:
        caption += f"; displacement × {factor}"
    colours = Colours.of(f"{what} ({unit})", values[k])
    return _tissue(run, fields, k, values[k], colours, caption, factor, loads)


def _tissue(
    run: StoredRun,
    fields: StoredFields,
    k: int,
    values: Array,
    colours: Colours,
    caption: str,
    factor: float = 1.0,
    nodes: Sequence[DrawnNode] = (),
) -> str:
    """Draw the tissue of a run at time k by the values of its elements, with a colour bar."""
    bodies = bodies_of(run, fields)
    low, high = box(fields.points + factor * fields.displacement[k], bodies)
    height = float(np.clip((high - low)[1] / ((high - low)[0] or 1.0), 0.3, 1.5)) * (_WIDTH - 1.0)
    shown = Figure(figsize=(_WIDTH, height + 0.4), layout="constrained")
    axes = shown.subplots()
    drawn = draw_tissue(axes, fields, k, values, colours, factor=factor, bodies=bodies, nodes=nodes)
    colours.bar(axes, drawn)
    return _figure(encoded(shown, "png"), f"the tissue of {run.name} by {colours.label}", caption)


# Elements of a page.


def _paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of HTML, of a class `kind`."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def _missing(text: str) -> str:
    """Return a sentence on what is left out, and why."""
    return _paragraph(text, "missing")


def _figure(picture: bytes, words: str, caption: str, form: str = "png") -> str:
    """Return a picture, "png" or "svg+xml", with caption, and words for those who do not see it."""
    words = re.sub(
        r"\$([^$]*)\$", lambda symbol: symbol[1].replace("_", ""), " ".join(words.split())
    )
    source = f"data:image/{form};base64,{_base64(picture)}"
    image = f'<img class="chart" alt="{escape(words)}" src="{source}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def _chart(panel: Panel, caption: str) -> str:
    """Draw the curves of a panel with its axes and legend."""
    named = ", ".join(dict.fromkeys(curve.label for curve in panel.curves if curve.label))
    what = f"{panel.title or panel.y_label} over {panel.x_label}"
    words = f"{what}: {named}" if named else what
    alone = replace(panel, height=max(panel.height, 0.8))  # room for the label of its axis
    return _figure(encoded(draw_panels([alone])), words, caption, "svg+xml")


def _grid(figures: Sequence[str]) -> str:
    """Put figures beside each other where there is room."""
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""


def _folded(summary: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of words that is folded until a reader opens it."""
    table = _table(headings, rows, words=True)
    return f"<details><summary>{escape(summary)}</summary>{table}</details>"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, words: bool = False) -> str:
    """Return a table that scrolls where it is wider than the page; `words` of text are wrapped."""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = ""
    for name, *values in rows:
        cells = "".join(f"<td>{escape(value)}</td>" for value in values)
        body += f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>'
    kind = "wide words" if words else "wide"
    return (
        f'<div class="{kind}" tabindex="0"><table><thead><tr>'
        f"{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )
