"""Runs on one HTML page that needs nothing else: what it has of them, its sections, its elements.

The tissue in motion is arrays for the script `page.js`, and a picture for paper.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.units import number
from surrofe2.law.stress_law import SURROGATE, TABLE, Status
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.report.comparison import (
    Comparison,
    audit_panels,
    audit_sentence,
    clock_of,
    compare,
    comparison_title,
    difference_panels,
    displacement_panels,
    fallback_reasons,
    made_for,
    order_runs,
)
from surrofe2.report.figures import Colours, DrawnBody, box, draw_tissue, drawn_bodies, rim
from surrofe2.report.tables import Table, percent
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded
from surrofe2.store.fields import DISPLACEMENT_NAME, FIELDS, SOURCE_NAME, StoredFields, read_fields
from surrofe2.store.run_folder import EVENTS, StoredRun, read_run
from surrofe2.store.store import check_replaceable, flat, read_bytes, write_text

Array = NDArray[np.float64]

VON_MISES, WALL_STRETCH = "von_mises_in_plane_uN_per_um", "largest_wall_stretch"
OF_ELEMENTS = (VON_MISES, SOURCE_NAME, WALL_STRETCH)
"""What a page shows of elements."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RunData(StoredRun):
    """A run as a page shows it; what its folder lacks is None or empty.

    `particles` are PNGs of looks into the plant cells, by the names of their folders."""

    fields: StoredFields | None = None
    events: Sequence[Mapping[str, Any]] = ()
    particles: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ReportData:
    """All that a page is made of: runs, the reference first, and their comparison or why there is
    none."""

    runs: tuple[RunData, ...]
    comparison: Comparison | None = None
    why_not: str = ""


_CACHE = (SURROGATE, TABLE)
_MOST_EVENTS, _MOST_PICTURES = 200, 4


def write_report(folders: Sequence[str | Path], out: str | Path) -> Path:
    """Write one HTML file on these runs, which needs nothing else; its path.

    Args:
        out: the file; a page that is there is replaced, and no other file.

    Raises:
        FileError: a folder has no run, or the file cannot be written.
        InputError: a run has not begun to have results, or no folder is given.
    """
    if not folders:
        raise InputError("report: no run folder; give at least one")
    path, page = Path(out), page_of(load_runs(folders))
    check_replaceable(path, "page", "<!doctype html>", "surrofe2")
    write_text(path, page)
    return path


def load_runs(folders: Sequence[str | Path]) -> ReportData:
    """What these run folders hold, the reference first."""
    runs = [read_run(folder, finished=False) for folder in folders]
    seen = tuple(_load(run) for run in order_runs(runs))
    if len(runs) == 1:
        return ReportData(seen, None, "One run, so there is nothing to compare it with.")
    try:
        return ReportData(seen, compare(runs))
    except MismatchError as error:
        return ReportData(seen, None, f"Not compared: {error}.")


def _load(run: StoredRun) -> RunData:
    folder = run.folder
    has_fields = (folder / f"{FIELDS}.h5").exists()
    events = folder / EVENTS
    lines = read_bytes(events).decode("utf-8").splitlines() if events.exists() else []
    zooms = sorted(folder.glob("zoom-*/zoom.png"))[:_MOST_PICTURES]
    return RunData(
        **{item.name: getattr(run, item.name) for item in fields(run)},
        fields=read_fields(folder, [DISPLACEMENT_NAME], OF_ELEMENTS) if has_fields else None,
        events=[json.loads(line) for line in lines],
        particles={path.parent.name: read_bytes(path) for path in zooms},
    )


def page_of(seen: ReportData) -> str:
    """One HTML file that needs nothing else."""
    motion, data = motion_section(seen.runs)
    title = "surrofe2: " + ", ".join(each.name for each in seen.runs)
    sections = (
        ("motion", "Motion", "The tissue in motion", [*_headlines(seen), *motion]),
        ("displacement", "Displacement", "Displacement", _displacement(seen)),
        ("cost", "Time and speed-up", "Time and speed-up", _cost(seen)),
        ("fallback", "Fallbacks", "Where the cache fell back", _fallback(seen)),
        ("audit", "Audits", "Audits", _audits(seen)),
        ("range", "Range", "Range that was met", _range(seen)),
        ("energy", "Energies", "Energies", _energies(seen)),
        ("cells", "Plant cells", "Plant cells", _plant_cells(seen)),
        ("events", "Events", "Events", _events(seen)),
        ("origin", "Provenance", "Configuration and provenance", _origin(seen)),
    )
    return _document(title, sections, json.dumps({"runs": data}))


def _document(
    title: str, sections: Sequence[tuple[str, str, str, Sequence[str]]], data: str
) -> str:
    """The whole page of sections (key, link, heading, parts), and JSON for the script."""
    folder = files("surrofe2.report")
    style, script = (
        folder.joinpath(f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js")
    )
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; "
        f"script-src {_digest(script)}; base-uri 'none'; form-action 'none'"
    )
    links = "".join(f'<li><a href="#{key}">{escape(name)}</a></li>' for key, name, *_ in sections)
    content = "".join(
        f'<section id="{key}"><h2>{escape(heading)}</h2>{"".join(parts)}</section>'
        for key, _, heading, parts in sections
    )
    # A JSON string has no "<" that could end the element early.
    safe = data.replace("<", "\\u003c")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style></head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><nav aria-label="Sections"><ul>{links}</ul></nav>'
        f"</header>\n<main>{content}</main>\n"
        f'<script type="application/json" id="data">{safe}</script>\n'
        f"<script>{script}</script>\n</body></html>\n"
    )


def _digest(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return f"'sha256-{digest}'"


def _headlines(seen: ReportData) -> list[str]:
    """What was run, and what came out of it."""
    parts = [_paragraph(" ".join(comparison_title(seen.runs).split()))]
    for run in seen.comparison.runs if seen.comparison else ():
        faster = run.speed_up["wall_time"]
        parts.append(
            _paragraph(
                f"{run.name} differs from {seen.runs[0].name} by at most "
                f"{percent(2)(run.difference.largest)} of the largest displacement"
                + (f" and is {number(faster)} times faster by itself." if faster else "."),
                "headline",
            )
        )
    return parts + [
        _missing(f"{each.name}: {each.record.status}; {each.record.error or 'it is not whole'}")
        for each in seen.runs
        if each.record.status != "finished"
    ]


def _displacement(seen: ReportData) -> list[str]:
    """Curves of all runs, their differences and the forces on the tissue."""
    runs = seen.runs
    caption = "Displacement of the watched point" + (" by all runs" if len(runs) > 1 else "")
    figures = [_figure(_chart(panel), caption) for panel in displacement_panels(runs)]
    comparison = seen.comparison
    if comparison is None:
        return [_missing(seen.why_not), _grid(figures)]
    caption = f"Difference from {comparison.reference}, at each time"
    figures += [_figure(_chart(panel), caption) for panel in difference_panels(runs)]
    parts = [_grid(figures), _table_of(comparison.table)]
    if comparison.force_table.rows:
        parts += ["<h3>Forces on the tissue</h3>", _table_of(comparison.force_table)]
    return parts


def _cost(seen: ReportData) -> list[str]:
    """Seconds of each run and of what was made for it, and from when the cache pays off."""
    compared = seen.comparison.runs if seen.comparison else ()
    parts = [
        _paragraph(f"{run.name}: {run.balance.sentence}.", "headline")
        for run in compared
        if run.balance is not None
    ]
    if not parts:
        parts = [_missing("No run through a cache beside one by RVEs, so there is no speed-up.")]
    seconds = [_seconds(each) for each in seen.runs]
    names = list(dict.fromkeys(name for each in seconds for name in each))
    rows = [
        [run.name, *(number(each[name]) if name in each else "–" for name in names)]
        for run, each in zip(seen.runs, seconds, strict=True)
    ]
    return [*parts, _table(["run", *(f"{name} (s)" for name in names)], rows)]


def _seconds(run: RunData) -> dict[str, float]:
    """In the law, in the macro scale, loading kernels before it, making what its cache needs."""
    wall = run.record.wall_time
    law, macro = wall.get("law", 0.0), wall.get("macro", 0.0)
    seconds = {"law": law, "macro scale": macro}
    if not law and not macro:
        seconds = {"run": wall.get("total", 0.0)}
    if wall.get("compilation"):
        seconds["kernels"] = wall["compilation"]
    return seconds | (
        (run.record.surrogate or {}).get("seconds", {}) if made_for(run.record) else {}
    )


def _fallback(seen: ReportData) -> list[str]:
    """Where and when the cache fell back on RVEs."""
    parts: list[str] = []
    for each in seen.runs:
        for of, cache in each.caches.items():
            parts.append(_paragraph(f"{of}: {_counted(cache['accepted'])}"))
            parts += [
                _paragraph(f"{of}, step {event['step']}: {event['finding']}.")
                for event in cache["trust"]["events"]
            ]
        if each.fields is not None and SOURCE_NAME in each.fields.values:
            parts.append(_over_time_and_mesh(each))
    return parts or [_missing("No run through a cache, so nothing fell back.")]


def _counted(accepted: Mapping[str, int]) -> str:
    hits, fallbacks = accepted["hits"], accepted["fallbacks"]
    why = fallback_reasons(accepted)
    return (
        f"{hits:,} answers of kept steps came from the cache, {fallbacks:,} from RVEs{why}, "
        f"{percent(3)(fallbacks / max(hits + fallbacks, 1))}."
    )


def _over_time_and_mesh(run: RunData) -> str:
    fields = run.fields
    assert fields is not None
    source = fields.values[SOURCE_NAME]
    by_rve = ~np.isin(source, _CACHE)
    if not by_rve.any():
        return _missing(
            f"{run.name}: at none of the {len(fields.t)} stored times did an element fall back."
        )
    curves = tuple(
        Curve("", fields.t, 100.0 * (source == code).mean(axis=1), words, markers=False, colour=k)
        for k, (code, (words, _)) in enumerate(SOURCES.items())
        if (source == code).any()
    )
    panel = Panel(clock_of(run), "elements (%)", curves, zero=True)
    often = 100.0 * by_rve.mean(axis=0)
    colours = Colours.of("stored times with an RVE (%)", np.append(often, 0.0), "Oranges")
    return _grid(
        [
            _figure(_chart(panel), f"{run.name}: who answered at the stored times"),
            _figure(
                tissue_image(run, 0, often, colours),
                f"{run.name}: at how many of the stored times an element had a point on RVEs",
            ),
        ]
    )


def _audits(seen: ReportData) -> list[str]:
    """Audited errors with the tolerance."""
    figures, parts = [], []
    for each in seen.runs:
        panels = audit_panels([each])
        figures += [_figure(_chart(panel), f"{each.name}: audited errors") for panel in panels]
        for of, cache in each.caches.items():
            worst = cache["audit"]["worst"]
            parts.append(_paragraph(f"{of}: audited: {audit_sentence(cache)}."))
            if isinstance(worst, Mapping):
                where = f"step {worst['step']}, point {worst['point']}"
                risk = f"where the risk was {number(worst['risk'])} ({where})"
                error = f"{number(worst['error'])} µN/µm"
                parts.append(_paragraph(f"{of}: the worst error is {error}, {risk}."))
    if not parts:
        parts = [_missing("No run through a cache, so nothing was audited.")]
    return [*parts, _grid(figures)]


def _range(seen: ReportData) -> list[str]:
    """What each run met at any point and step, beside the range of the samples."""
    limits = seen.runs[0].record.recipe.get("range") or {}
    ranges = [*((each.name, each.record.met) for each in seen.runs), ("range of samples", limits)]
    rows = [
        [name, "{:.4g} … {:.4g}".format(*of["stretch"]), number(of["shear"]), number(of["rate"])]
        for name, of in ranges
        if {"stretch", "shear", "rate"} <= of.keys()
    ]
    heads = ["met at any point and step", "stretch (1)", "shear (1)", "rate (1/µs)"]
    return [_table(heads, rows) if rows else _missing("No run recorded what it met.")]


def _energies(seen: ReportData) -> list[str]:
    """Energies over time and how well they balance."""
    figures, lacking = [], []
    for each in seen.runs:
        named = {name: e for name, e in each.energies.items() if np.isfinite(e).any()}
        if not named:
            lacking.append(_missing(f"{each.name}: no energies.csv in its folder."))
            continue
        balance = named.pop("balance", None)
        curves = tuple(
            Curve("", each.curve.t, values, name, False) for name, values in named.items()
        )
        caption = f"{each.name}: energies and works"
        largest = max((float(np.nanmax(abs(values))) for values in named.values()), default=0.0)
        if balance is not None and largest:
            error = float(np.nanmax(abs(balance))) / largest
            caption += f"; they balance within {percent(2)(error)} of the largest"
        panel = Panel(clock_of(each), "energy (pJ)", curves)
        figures.append(_figure(_chart(panel), caption))
    return [_grid(figures), *lacking]


def _plant_cells(seen: ReportData) -> list[str]:
    """The plant cells that `surrofe2 zoom` looked into."""
    figures = [
        _figure(
            _image(png, "particles of a plant cell at six times", "png"),
            f"{each.name}, {name}: the plant cells there, walls by stretch and fluid by turgor",
        )
        for each in seen.runs
        for name, png in each.particles.items()
    ]
    folder = shlex.quote(str(seen.runs[0].folder))
    look = f"surrofe2 zoom {folder} --point X,Y"
    return figures or [
        _missing(f"No look into the plant cells in the folders; make one with: {look}")
    ]


def _events(seen: ReportData) -> list[str]:
    """The events of all runs, the last ones where there are many."""
    parts = []
    for each in seen.runs:
        if not each.events:
            parts.append(_missing(f"{each.name}: no log of events in its folder."))
            continue
        shown = each.events[-_MOST_EVENTS:]
        keys = list(dict.fromkeys(key for event in shown for key in event))
        rows = [[_short(event.get(key, "")) for key in keys] for event in shown]
        if len(shown) < len(each.events):
            parts.append(_paragraph(f"{each.name}: the last {len(shown)} of {len(each.events)}."))
        listed = _table(keys, rows, words=True)
        parts.append(_folded(f"{each.name}, events: {len(each.events)}", listed))
    return parts


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _origin(seen: ReportData) -> list[str]:
    """Settings, by what and when each run was made, and the digests of its files."""
    names = [each.name for each in seen.runs]
    settings = _side_by_side([flat(each.record.recipe) for each in seen.runs])
    apart = [row for row in settings if len(set(row[1:])) > 1]
    parts = [_table(["", *names], _side_by_side([*map(_provenance, seen.runs)]), words=True)]
    if len(names) > 1:
        same = _paragraph("All entries of the recipe are the same in all runs.")
        parts.append(_table(["entry that differs", *names], apart, words=True) if apart else same)
    whole = [row if row in apart else row[:2] for row in settings]
    summary = f"The whole recipe: {len(settings)} entries"
    return [*parts, _folded(summary, _table(["entry", "value"], whole, words=True))]


def _side_by_side(columns: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    keys = dict.fromkeys(key for column in columns for key in column)
    return [[key, *(_short(column.get(key, "–")) for column in columns)] for key in keys]


def _provenance(run: RunData) -> dict[str, Any]:
    record, problem = run.record, run.record.problem
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

STOPS = [to_hex(colormaps["viridis"](k / 9)) for k in range(10)]
"""Viridis, evenly from lowest to highest."""
LEVELS, UNKNOWN = 254, 255
"""Numbers are stored as 0 … LEVELS; UNKNOWN is none."""
SOURCES: dict[int, tuple[str, str]] = {
    SURROGATE: ("network", "#3b82c4"),
    TABLE: ("table", "#3aa37f"),
    Status.OUT_OF_RANGE: ("RVE: out of the domain", "#d9822b"),
    Status.NOT_FINITE: ("RVE: not finite", "#8c5bb0"),
    Status.NOT_TRUSTED: ("RVE: risk above the limit", "#c2413b"),
}
"""By the codes of `stress_law.Sources`: what people read, and the colour."""
_BUDGET = 1_200_000
"""Bytes of all animations together, before base64."""
_SHOWN = 0.08
"""Fraction of the tissue's size that the largest displacement is drawn with at first, about."""
_FACTORS = (1, 2, 5, 10, 20, 50, 100)
_WIDTH = 4.4
"""Of a picture of the tissue, inches."""


def motion_section(runs: tuple[RunData, ...]) -> tuple[list[str], list[dict[str, Any]]]:
    """Parts of the section, and what the script needs of each run."""
    shown = [each for each in runs if each.fields is not None]
    parts = [
        _missing(f"{each.name}: no fields in its folder, so its motion is not shown.")
        for each in runs
        if each.fields is None
    ]
    data = [_arrays(each, _BUDGET // len(shown)) for each in shown]
    if data:
        parts.insert(0, _PLAYER)
    stills = [_still(each, arrays["factor"]) for each, arrays in zip(shown, data, strict=True)]
    return [*parts, f'<div class="still">{_grid(stills)}</div>'], data


_PLAYER = (
    '<div class="player" id="player" hidden><div class="bar">'
    '<label>Run <select id="which"></select></label>'
    '<label>Colour <select id="colour"></select></label>'
    '<label>Displacement <select id="factor"></select></label></div>'
    '<canvas id="canvas" tabindex="0" role="img" aria-describedby="keys"></canvas>'
    '<div class="scale"><span id="low"></span><canvas id="ramp" aria-hidden="true"></canvas>'
    '<span id="high"></span></div><ul class="legend" id="sources" hidden></ul>'
    '<div class="bar"><button type="button" id="play" aria-pressed="false">Play</button>'
    '<input type="range" id="frame" min="0" value="0" aria-label="Time">'
    '<output id="clock" for="frame"></output></div>'
    '<p class="keys" id="keys">Keys on the picture: space plays and pauses, ← and → step, Home and '
    "End go to the first and last time. Rigid bodies are grey; their motion has the same factor, "
    "so above × 1 one that stood apart seems to enter the tissue."
    "</p></div>"
)


def _quantities(fields: StoredFields) -> dict[str, tuple[str, Array]]:
    """By name: unit and (m, e) values to colour by."""
    size = np.linalg.norm(fields.displacement, axis=2)
    found = {"displacement": ("µm", size[:, fields.cells].mean(axis=2))}
    for name, unit, key in (
        ("von Mises stress", "µN/µm", VON_MISES),
        ("largest wall stretch", "length / rest length", WALL_STRETCH),
        ("stress source", "", SOURCE_NAME),
    ):
        if key in fields.values:
            found[name] = unit, fields.values[key]
    return found


def _arrays(run: RunData, budget: int) -> dict[str, Any]:
    """A run for the script, as many times as the budget has room for, as bytes in base64:
    displacements are 16-bit fractions of the largest component, values 8-bit levels."""
    fields = run.fields
    assert fields is not None
    quantities = _quantities(fields)
    each = 4 * len(fields.points) + len(quantities) * len(fields.cells)
    kept = max(2, min(len(fields.t), budget // max(each, 1)))
    at = np.unique(np.linspace(0, len(fields.t) - 1, kept).round().astype(int))
    u = fields.displacement[at]
    largest = float(abs(u).max()) or 1.0
    order, bodies = rim(fields), bodies_of(run)
    factor = 1 if bodies else _factor(fields)  # multiplied, a gap closes before it should
    (x0, y0), (x1, y1) = box(fields.points + factor * u, bodies)
    return {
        "name": run.name,
        "clock": "load factor" if "rest" in run.record.recipe else "µs",
        "t": fields.t[at].tolist(),
        "corners": len(order),
        "cells": _base64(fields.cells[:, order].astype("<u4")),
        "points": _base64(fields.points.astype("<f4")),
        "motion": _base64(np.rint(32767.0 * u / largest).astype("<i2")),
        "largest": largest,
        "box": [float(value) for value in (x0, y0, x1, y1)],
        "factor": factor,
        "factors": list(_FACTORS),
        "bodies": [
            {"outline": each.outline.round(3).tolist(), "moved": each.moved[at].round(3).tolist()}
            for each in bodies
        ],
        "levels": LEVELS,
        "unknown": UNKNOWN,
        "colours": [_colour(name, unit, values[at]) for name, (unit, values) in quantities.items()],
    }


def _colour(name: str, unit: str, values: Array) -> dict[str, Any]:
    if name == "stress source":
        codes = np.nan_to_num(values, nan=UNKNOWN).astype(np.int16).astype(np.uint8)
        shown = {int(code) % 256: list(each) for code, each in SOURCES.items()}  # one byte each
        words = {code: shown[code] for code in shown if (codes == code).any()}
        return {"name": name, "sources": words, "data": _base64(codes)}
    colours = Colours.of(unit, values)
    low, high = colours.low, colours.high
    fraction = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    stored = np.rint(LEVELS * fraction).astype(np.uint8)
    stored[~np.isfinite(values)] = UNKNOWN
    ends = [f"{low:.4g}", f"{high:.4g} {unit}"]
    return {"name": name, "ends": ends, "stops": STOPS, "data": _base64(stored)}


def _factor(fields: StoredFields) -> int:
    """By what displacements are multiplied, so that they are seen."""
    size = float(np.ptp(fields.points, axis=0).max())
    largest = float(np.linalg.norm(fields.displacement, axis=2).max()) or size
    return max((f for f in _FACTORS if f * largest <= 1.5 * _SHOWN * size), default=1)


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def bodies_of(run: RunData) -> list[DrawnBody]:
    """The bodies of a run with fields."""
    if run.fields is None:
        return []
    stated = run.record.recipe.get("bodies", {})
    bodies = [RigidBody.read(f"bodies.{name}", table) for name, table in stated.items()]
    return drawn_bodies(bodies, run.curve.t, run.history, run.fields)


def _still(run: RunData, factor: int) -> str:
    """The tissue where it has moved farthest, by stress, for paper and without the script."""
    fields = run.fields
    assert fields is not None
    k = int(np.linalg.norm(fields.displacement, axis=2).max(axis=1).argmax())
    quantities = _quantities(fields)
    what = "von Mises stress" if "von Mises stress" in quantities else "displacement"
    unit, values = quantities[what]
    picture = tissue_image(run, k, values[k], Colours.of(f"{what} ({unit})", values[k]), factor)
    clock = "load factor {:.4g}" if "rest" in run.record.recipe else "t = {:.4g} µs"
    caption = f"{run.name} where it has moved farthest, {clock.format(fields.t[k])}"
    return _figure(picture, f"{caption}; displacement × {factor}" if factor > 1 else caption)


def tissue_image(run: RunData, k: int, values: Array, colours: Colours, factor: float = 1.0) -> str:
    """The tissue of a run at time k coloured by the values of its elements, with a colour bar."""
    fields, bodies = run.fields, bodies_of(run)
    assert fields is not None
    low, high = box(fields.points + factor * fields.displacement[k], bodies)
    height = float(np.clip((high - low)[1] / ((high - low)[0] or 1.0), 0.3, 1.5)) * (_WIDTH - 1.0)
    shown = Figure(figsize=(_WIDTH, height + 0.4), layout="constrained")
    axes = shown.subplots()
    drawn = draw_tissue(axes, fields, k, values, colours, factor=factor, bodies=bodies)
    colours.bar(axes, drawn)
    return _image(encoded(shown, "png"), f"the tissue of {run.name} by {colours.label}", "png")


# Elements of a page.


def _paragraph(text: str, kind: str = "") -> str:
    """A sentence or more."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def _missing(text: str) -> str:
    """What is left out, and why."""
    return _paragraph(text, "missing")


def _image(picture: bytes, words: str, form: str = "svg+xml") -> str:
    """A picture, SVG or "png"; its words for those who do not see it."""
    alternative = re.sub(
        r"\$([^$]*)\$", lambda symbol: symbol[1].replace("_", ""), " ".join(words.split())
    )
    source = f"data:image/{form};base64,{base64.b64encode(picture).decode()}"
    return f'<img class="chart" alt="{escape(alternative, quote=True)}" src="{source}">'


def _chart(panel: Panel) -> str:
    """The curves of a panel with its axes and legend."""
    named = ", ".join(dict.fromkeys(curve.label for curve in panel.curves if curve.label))
    what = f"{panel.title or panel.y_label} over {panel.x_label}"
    return _image(encoded(draw_panels([panel])), f"{what}: {named}" if named else what)


def _figure(content: str, caption: str) -> str:
    """A picture with its caption."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def _grid(figures: Sequence[str]) -> str:
    """Figures beside each other where there is room."""
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""


def _folded(summary: str, content: str) -> str:
    """What is shown when asked for."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"


def _table(headings: Sequence[str], rows: Sequence[Sequence[Any]], *, words: bool = False) -> str:
    """A table that scrolls by itself where it is wider than the page; words: of text, wrapped."""
    head = "".join(f'<th scope="col">{escape(str(each))}</th>' for each in headings)
    body = "".join(
        f'<tr><th scope="row">{escape(str(name))}</th>'
        + "".join(f"<td>{escape(str(value))}</td>" for value in values)
        + "</tr>"
        for name, *values in rows
    )
    kind = "wide words" if words else "wide"
    return (
        f'<div class="{kind}" tabindex="0"><table><thead><tr>'
        f"{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _table_of(quantities: Table[Any]) -> str:
    """What people are shown of a table."""
    return _table(*quantities.for_people())
