"""Runs on one HTML page that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.units import number
from surrofe2.law.stress_law import SURROGATE, TABLE
from surrofe2.report.comparison import (
    audit_panels,
    audit_sentence,
    clock_of,
    compare,
    comparison_title,
    difference_panels,
    displacement_panels,
    fallback_reasons,
    order_runs,
)
from surrofe2.report.figures import Colours
from surrofe2.report.html import (
    chart,
    figure,
    folded,
    grid,
    image,
    missing,
    paragraph,
    section,
    table,
    table_of,
)
from surrofe2.report.player import (
    OF_ELEMENTS,
    SOURCES,
    ReportData,
    RunData,
    motion_section,
    tissue_image,
)
from surrofe2.report.tables import percent
from surrofe2.run.charts import Curve, Panel
from surrofe2.store.fields import DISPLACEMENT_NAME, FIELDS, SOURCE_NAME, read_fields
from surrofe2.store.run_folder import EVENTS, StoredRun, caches_of, made_for, read_run
from surrofe2.store.store import check_replaceable, flat, read_bytes, write_text

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
    if len(runs) == 1:
        return ReportData(
            (_load(runs[0]),), None, "One run, so there is nothing to compare it with."
        )
    seen = tuple(_load(run) for run in order_runs(runs))
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
        run=run,
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
    content = "".join(section(key, heading, parts) for key, _, heading, parts in sections)
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
    parts = [paragraph(" ".join(comparison_title([each.run for each in seen.runs]).split()))]
    for run in seen.comparison.runs if seen.comparison else ():
        faster = run.speed_up["wall_time"]
        parts.append(
            paragraph(
                f"{run.name} differs from {seen.runs[0].name} by at most "
                f"{percent(2)(run.difference.largest)} of the largest displacement"
                + (f" and is {number(faster)} times faster by itself." if faster else "."),
                "headline",
            )
        )
    return parts + [
        missing(f"{each.name}: {each.record.status}; {each.record.error or 'it is not whole'}")
        for each in seen.runs
        if each.record.status != "finished"
    ]


def _displacement(seen: ReportData) -> list[str]:
    """Curves of all runs, their differences and the forces on the tissue."""
    runs = [each.run for each in seen.runs]
    caption = "Displacement of the watched point" + (" by all runs" if len(runs) > 1 else "")
    figures = [figure(chart(panel), caption) for panel in displacement_panels(runs)]
    comparison = seen.comparison
    if comparison is None:
        return [missing(seen.why_not), grid(figures)]
    caption = f"Difference from {comparison.reference}, at each time"
    figures += [figure(chart(panel), caption) for panel in difference_panels(runs)]
    parts = [grid(figures), table_of(comparison.table)]
    if comparison.force_table.rows:
        parts += ["<h3>Forces on the tissue</h3>", table_of(comparison.force_table)]
    return parts


def _cost(seen: ReportData) -> list[str]:
    """Seconds of each run and of what was made for it, and from when the cache pays off."""
    compared = seen.comparison.runs if seen.comparison else ()
    parts = [
        paragraph(f"{run.name}: {run.balance.sentence}.", "headline")
        for run in compared
        if run.balance is not None
    ]
    if not parts:
        parts = [missing("No run through a cache beside one by RVEs, so there is no speed-up.")]
    seconds = [_seconds(each) for each in seen.runs]
    names = list(dict.fromkeys(name for each in seconds for name in each))
    rows = [
        [run.name, *(number(each[name]) if name in each else "–" for name in names)]
        for run, each in zip(seen.runs, seconds, strict=True)
    ]
    return [*parts, table(["run", *(f"{name} (s)" for name in names)], rows)]


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
        for cell, cache in caches_of(each.record.cache).items():
            of = f"{each.name}, {cell}" if cell else each.name
            parts.append(paragraph(f"{of}: {_counted(cache['accepted'])}"))
            parts += [
                paragraph(f"{of}, step {event['step']}: {event['finding']}.")
                for event in cache["trust"]["events"]
            ]
        if each.fields is not None and SOURCE_NAME in each.fields.values:
            parts.append(_over_time_and_mesh(each))
    return parts or [missing("No run through a cache, so nothing fell back.")]


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
        return missing(
            f"{run.name}: at none of the {len(fields.t)} stored times did an element fall back."
        )
    curves = tuple(
        Curve("", fields.t, 100.0 * (source == code).mean(axis=1), words, markers=False, colour=k)
        for k, (code, (words, _)) in enumerate(SOURCES.items())
        if (source == code).any()
    )
    panel = Panel(clock_of(run.run), "elements (%)", curves, zero=True)
    often = 100.0 * by_rve.mean(axis=0)
    colours = Colours.of("stored times with an RVE (%)", np.append(often, 0.0), "Oranges")
    return grid(
        [
            figure(chart(panel), f"{run.name}: who answered at the stored times"),
            figure(
                tissue_image(run, 0, often, colours),
                f"{run.name}: at how many of the stored times an element had a point on RVEs",
            ),
        ]
    )


def _audits(seen: ReportData) -> list[str]:
    """Audited errors with the tolerance."""
    figures, parts = [], []
    for each in seen.runs:
        panels = audit_panels([each.run])
        figures += [figure(chart(panel), f"{each.name}: audited errors") for panel in panels]
        for cell, cache in caches_of(each.record.cache).items():
            of, worst = f"{each.name}, {cell}" if cell else each.name, cache["audit"]["worst"]
            parts.append(paragraph(f"{of}: audited: {audit_sentence(cache)}."))
            if isinstance(worst, Mapping):
                where = f"step {worst['step']}, point {worst['point']}"
                risk = f"where the risk was {number(worst['risk'])} ({where})"
                error = f"{number(worst['error'])} µN/µm"
                parts.append(paragraph(f"{of}: the worst error is {error}, {risk}."))
    if not parts:
        parts = [missing("No run through a cache, so nothing was audited.")]
    return [*parts, grid(figures)]


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
    return [table(heads, rows) if rows else missing("No run recorded what it met.")]


def _energies(seen: ReportData) -> list[str]:
    """Energies over time and how well they balance."""
    figures, lacking = [], []
    for each in seen.runs:
        named = {name: e for name, e in each.run.energies.items() if np.isfinite(e).any()}
        if not named:
            lacking.append(missing(f"{each.name}: no energies.csv in its folder."))
            continue
        balance = named.pop("balance", None)
        curves = tuple(
            Curve("", each.run.curve.t, values, name, False) for name, values in named.items()
        )
        caption = f"{each.name}: energies and works"
        largest = max((float(np.nanmax(abs(values))) for values in named.values()), default=0.0)
        if balance is not None and largest:
            error = float(np.nanmax(abs(balance))) / largest
            caption += f"; they balance within {percent(2)(error)} of the largest"
        panel = Panel(clock_of(each.run), "energy (pJ)", curves)
        figures.append(figure(chart(panel), caption))
    return [grid(figures), *lacking]


def _plant_cells(seen: ReportData) -> list[str]:
    """The plant cells that `surrofe2 zoom` looked into."""
    figures = [
        figure(
            image(png, "particles of a plant cell at six times", "png"),
            f"{each.name}, {name}: the plant cells there, walls by stretch and fluid by turgor",
        )
        for each in seen.runs
        for name, png in each.particles.items()
    ]
    folder = shlex.quote(str(seen.runs[0].run.folder))
    look = f"surrofe2 zoom {folder} --point X,Y"
    return figures or [
        missing(f"No look into the plant cells in the folders; make one with: {look}")
    ]


def _events(seen: ReportData) -> list[str]:
    """The events of all runs, the last ones where there are many."""
    parts = []
    for each in seen.runs:
        if not each.events:
            parts.append(missing(f"{each.name}: no log of events in its folder."))
            continue
        shown = each.events[-_MOST_EVENTS:]
        keys = list(dict.fromkeys(key for event in shown for key in event))
        rows = [[_short(event.get(key, "")) for key in keys] for event in shown]
        if len(shown) < len(each.events):
            parts.append(paragraph(f"{each.name}: the last {len(shown)} of {len(each.events)}."))
        listed = table(keys, rows, words=True)
        parts.append(folded(f"{each.name}, events: {len(each.events)}", listed))
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
    parts = [table(["", *names], _side_by_side([*map(_provenance, seen.runs)]), words=True)]
    if len(names) > 1:
        same = paragraph("All entries of the recipe are the same in all runs.")
        parts.append(table(["entry that differs", *names], apart, words=True) if apart else same)
    whole = [row if row in apart else row[:2] for row in settings]
    summary = f"The whole recipe: {len(settings)} entries"
    return [*parts, folded(summary, table(["entry", "value"], whole, words=True))]


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
