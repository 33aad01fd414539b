"""What came out of runs, what they cost, and where they come from: settings, provenance."""

from __future__ import annotations

import json
import shlex
from typing import Any

import numpy as np

from surrofe2.base.costs import Balance
from surrofe2.report.comparison_plot import clock_of, difference_panels, displacement_panels
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.page.html import (
    bars,
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
from surrofe2.report.page.report_data import ReportData, RunData
from surrofe2.store.fields import F_NAME, STRESS_NAME
from surrofe2.store.run_folder import made_for
from surrofe2.store.store import flat

_MOST_RUNS = 2.0
"""Runs, as multiples of those from which on a cache pays, that its picture shows."""


def displacement_section(seen: ReportData) -> str:
    """Curves of all runs, their differences and the forces on the tissue."""
    runs = [each.run for each in seen.runs]
    parts: list[str] = []
    panels = displacement_panels(runs)
    caption = "Displacement of the watched point"
    if seen.comparison is None:
        parts.append(missing(seen.why_not))
    else:
        panels += difference_panels(runs)
        caption += " by all runs"
    captions = [
        f"Difference from {seen.comparison.reference}, at each time"
        if seen.comparison and panel.y_label.startswith("difference")
        else caption
        for panel in panels
    ]
    parts.append(grid([figure(chart(p), c) for p, c in zip(panels, captions, strict=True)]))
    if seen.comparison is not None:
        parts.append(table_of(seen.comparison.table))
        if seen.comparison.force_table.rows:
            parts.append("<h3>Forces on the tissue</h3>")
            parts.append(table_of(seen.comparison.force_table))
    return section("displacement", "Displacement", parts)


def energy_section(seen: ReportData) -> str:
    """Energies over time and how well they balance, and stress over strain."""
    figures, lacking = [], []
    for each in seen.runs:
        if not each.energies:
            lacking.append(missing(f"{each.name}: no energies.csv in its folder."))
            continue
        figures += _energies(each)
    strains = [strain for each in seen.runs if (strain := _stress_over_strain(each))]
    return section("energy", "Energies, stress and strain", [grid(figures + strains), *lacking])


def _energies(run: RunData) -> list[str]:
    clock = clock_of(run.run)
    columns = dict(run.energies)
    t = next(iter(columns.values()))
    named = {
        name.removesuffix("_pJ"): values
        for name, values in columns.items()
        if name.endswith("_pJ") and np.isfinite(values).any()
    }
    balance = named.pop("balance", None)
    curves = tuple(
        Curve("", t, values, name, markers=False, colour=k, dash=("-", "--", ":")[k // 6 % 3])
        for k, (name, values) in enumerate(named.items())
    )
    figures = [
        figure(chart(Panel(clock, "energy (pJ)", curves)), f"{run.name}: energies and works")
    ]
    largest = max((float(np.nanmax(abs(values))) for values in named.values()), default=0.0)
    if balance is not None and largest:
        error = abs(balance) / largest
        panel = Panel(
            clock, "error of the balance", (Curve("", t, error, markers=False),), log_y=True
        )
        figures.append(
            figure(
                chart(panel),
                f"{run.name}: what the energies lack of a balance, as a share of the largest; at "
                f"most {float(np.nanmax(error)):.1e}",
            )
        )
    return figures


def _stress_over_strain(run: RunData) -> str:
    """The largest component of stress over that of the stretch, where stress becomes largest."""
    fields = run.fields
    if fields is None or not {STRESS_NAME, F_NAME} <= fields.values.keys():
        return ""
    stress, F = fields.values[STRESS_NAME], fields.values[F_NAME]
    size = np.nan_to_num(np.abs(stress)).max(axis=0)
    e, i, j = (int(k) for k in np.unravel_index(size.argmax(), size.shape))
    strain = F - np.eye(2)
    symmetric = 0.5 * (strain + strain.swapaxes(-1, -2))
    x, y = fields.points[fields.cells[e]].mean(axis=0)
    axes = "xy"[i] + "xy"[j]
    panel = Panel(
        f"small strain $e_{axes}$ (1)",
        f"Cauchy stress $s_{axes}$ (µN/µm)",
        (Curve("", symmetric[:, e, i, j], stress[:, e, i, j], markers=False),),
    )
    return figure(
        chart(panel),
        f"{run.name}: stress over strain about ({x:.4g}, {y:.4g}) µm, where it is largest",
    )


def cost_section(seen: ReportData) -> str:
    """Seconds of each run and of what was made for it, and from when the cache pays."""
    rows = [(each.name, _seconds(each)) for each in seen.runs]
    figures = [
        figure(
            bars(rows, "s"),
            "Seconds of each run: in the stress law, in the macro scale, loading kernels before "
            "it, and what was made for its cache",
        )
    ]
    parts = []
    runs = seen.comparison.runs if seen.comparison else ()
    for run in runs:
        if run.balance is None:
            continue
        parts.append(paragraph(f"{run.name}: {run.balance.sentence}.", "headline"))
        if run.balance.made:
            figures.append(_break_even(run.name, run.balance))
    if not any(run.balance for run in runs):
        parts.append(
            missing(
                "No run through a cache beside one by true RVEs, so there is no speed-up to show."
            )
        )
    return section("cost", "Time and speed-up", [*parts, grid(figures)])


def _seconds(run: RunData) -> dict[str, float]:
    wall = run.record.wall_time
    law, macro = wall.get("law", 0.0), wall.get("macro", 0.0)
    seconds = (
        {"law": law, "macro scale": macro} if law or macro else {"run": wall.get("total", 0.0)}
    )
    if wall.get("compilation"):
        seconds["kernels"] = wall["compilation"]
    preparation = (run.record.surrogate or {}).get("seconds", {}) if made_for(run.record) else {}
    return seconds | preparation


def _break_even(name: str, balance: Balance) -> str:
    assert balance.made is not None
    most = max(2.0, _MOST_RUNS * (balance.pays_from or 5))
    runs = np.array([0.0, most])
    curves = (
        Curve("reference", runs, balance.true * runs, "full FE²", markers=False),
        Curve("", runs, balance.made + balance.run * runs, f"{name}, all counted", markers=False),
    )
    gain = f"{balance.true / balance.run:.3g}" if balance.run else "–"
    return figure(
        chart(Panel("number of runs", "seconds in all", curves)),
        f"{name}: {gain} times faster than full FE² by itself; with data and training it pays off "
        + (f"after {balance.pays_from} runs" if balance.pays_from else "never"),
    )


_MOST_EVENTS = 200


def particle_section(seen: ReportData) -> str:
    """The plant cells that `surrofe2 zoom` looked into."""
    figures = [
        figure(
            image(png, "particles of a plant cell at six times", "png"),
            f"{each.name}, {name}: the plant cell there, walls by stretch and fluid by turgor",
        )
        for each in seen.runs
        for name, png in each.particles.items()
    ]
    if not figures:
        folder = shlex.quote(str(seen.runs[0].run.folder))
        figures = [
            missing(
                "No look into the plant cells in the folders; make one with: "
                f"surrofe2 zoom {folder} --point X,Y"
            )
        ]
    return section("cells", "Plant cells", figures)


def event_section(seen: ReportData) -> str:
    """The events of all runs, the last ones where there are many."""
    parts = []
    for each in seen.runs:
        if not each.events:
            parts.append(missing(f"{each.name}: no log of events in its folder."))
            continue
        shown = each.events[-_MOST_EVENTS:]
        keys = list(dict.fromkeys(key for event in shown for key in event))
        rows = [[_short(event.get(key, "")) for key in keys] for event in shown]
        left = len(each.events) - len(shown)
        if left:
            parts.append(paragraph(f"{each.name}: the last {len(shown)} of {len(each.events)}."))
        listed = f'<div class="words">{table(keys, rows)}</div>'
        parts.append(folded(f"{each.name}: {len(each.events)} events", listed))
    return section("events", "Events", parts)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def origin_section(seen: ReportData) -> str:
    """Settings, by what and when each run was made, and the digests of its files."""
    names = [each.name for each in seen.runs]
    recipes = [flat(each.record.recipe) for each in seen.runs]
    keys = list(dict.fromkeys(key for recipe in recipes for key in recipe))
    settings = [[key, *(_short(recipe.get(key, "–")) for recipe in recipes)] for key in keys]
    apart = [row for row in settings if len(set(row[1:])) > 1]
    provenance = {each.name: _provenance(each) for each in seen.runs}
    entries = list(dict.fromkeys(key for of in provenance.values() for key in of))
    rows = [[key, *(provenance[name].get(key, "–") for name in names)] for key in entries]
    parts = [f'<div class="words">{table(["", *names], rows)}</div>']
    if len(names) > 1:
        same = paragraph("All entries of the recipe are the same in all runs.")
        differ = f'<div class="words">{table(["entry that differs", *names], apart)}</div>'
        parts.append(differ if apart else same)
    whole = [row if row in apart else row[:2] for row in settings]
    parts.append(
        folded(
            f"The whole recipe: {len(settings)} entries",
            f'<div class="words">{table(["entry", "value"], whole)}</div>',
        )
    )
    return section("origin", "Configuration and provenance", parts)


def _provenance(run: RunData) -> dict[str, str]:
    record = run.record
    law = {"law": record.law, "initialisation": record.initialisation, "solver": record.solver}
    mesh = {
        key: record.problem[key] for key in ("elements", "nodes", "points") if key in record.problem
    }
    surrogate = {"surrogate": (record.surrogate or {}).get("fingerprint", "–")}
    counts = {name.replace("_", " "): n for name, n in record.counts.items()}
    facts: dict[str, Any] = {
        "status": record.status,
        **({"error": record.error} if record.error else {}),
        **law,
        "plant cell": record.cell_fingerprint,
        **surrogate,
        **mesh,
        "seconds": record.wall_time.get("total", "–"),
        "seconds of all threads": record.wall_time.get("cpu", "–"),
        "threads": record.threads,
        **counts,
        "surrofe2": record.package_version,
        "made": record.created,
        **record.platform,
        **{f"SHA-256 of {name}": value[:16] for name, value in record.files.items()},
    }
    return {key: _short(value) for key, value in facts.items()}
