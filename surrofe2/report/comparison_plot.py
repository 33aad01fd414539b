"""The picture of a comparison: displacement curves, their difference, audits, and a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from surrofe2.io.run_folder import StoredRun
from surrofe2.report.comparison import Comparison, order_runs, problem_title
from surrofe2.report.figures import Curve, Panel, colour_of, draw_panel, new_figure, write_png

_BINS_A_DECADE = 10


def write_comparison_plot(path: Path, comparison: Comparison, runs: Sequence[StoredRun]) -> None:
    """Draw the compared runs into a PNG."""
    reference, *others = order_runs(runs)
    audits = {k: audit for k, run in enumerate(others) if (audit := _audit_of(run)) is not None}
    figure = new_figure(8.0, 8.5 if audits else 6.6)
    heights = [3.0, 1.6, *([1.6] if audits else []), 0.32 * (len(others) + 2)]
    above, below, *middle, table = figure.subplots(len(heights), 1, height_ratios=heights)
    for axes, panel in zip((above, below), _panels(reference, others), strict=True):
        draw_panel(axes, panel)
    for axes in middle:
        for k, audit in audits.items():
            _draw_audit(axes, audit, colour_of(k))
    below.sharex(above)
    above.tick_params(labelbottom=False)
    above.set_xlim(reference.curve.t[0], reference.curve.t[-1])
    above.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(len(runs), 4), frameon=False,
        borderpad=0.0, handlelength=2.6,
    )  # fmt: skip
    below.set_ylim(bottom=0.0)
    _draw_table(table, comparison)
    figure.suptitle(_title(reference))
    write_png(path, figure)


def _panels(reference: StoredRun, others: Sequence[StoredRun]) -> tuple[Panel, Panel]:
    t, there = reference.curve.t, reference.curve.displacement
    scale = np.linalg.norm(there, axis=1).max()
    curves = [Curve("reference", t, there[:, 1], _label(reference, reference), markers=False)]
    differences = []
    for run in others:
        u = run.curve.displacement
        curves.append(Curve("", run.curve.t, u[:, 1], _label(run, reference), markers=False))
        apart = [u[:, i] - np.interp(run.curve.t, t, there[:, i]) for i in range(2)]
        percent = 100.0 * np.linalg.norm(apart, axis=0) / scale
        differences.append(Curve("", run.curve.t, percent, markers=False))
    return (
        Panel(x_label="", y_label="displacement $u_y$ (µm)", curves=tuple(curves)),
        Panel(
            x_label="time $t$ (µs)",
            y_label="difference (% of\nlargest displacement)",
            curves=tuple(differences),
        ),
    )


def _title(reference: StoredRun) -> str:
    recipe = reference.record.recipe
    return (
        f"Watched point of {problem_title(recipe)},\n"
        f"cell preset “{recipe['cell']['preset']}”, {reference.record.initialisation}"
    )


def _label(run: StoredRun, reference: StoredRun) -> str:
    """The folder, and what differs from the title's preset and initialisation."""
    record, usual = run.record, reference.record
    notes = [] if run.folder.name == record.law else [record.law]
    if record.recipe["cell"]["preset"] != usual.recipe["cell"]["preset"]:
        notes.append(record.recipe["cell"]["preset"])
    if record.initialisation != usual.initialisation:
        notes.append(record.initialisation)
    return f"{run.folder.name} ({', '.join(notes)})" if notes else run.folder.name


def _audit_of(run: StoredRun) -> Mapping[str, Any] | None:
    """What the audit of a cached run found, where any answer was audited and solved."""
    cache = run.record.cache
    return cache["audit"] if cache is not None and cache["audit"]["quantiles"] else None


def _draw_audit(axes: Axes, audit: Mapping[str, Any], colour: str) -> None:
    """Share of the audited answers over their error, the tolerance and the 99 % quantile marked."""
    edges, shares = coarse_histogram(audit["histogram"])
    axes.stairs(100.0 * shares, edges, color=colour, fill=True, alpha=0.25)
    axes.stairs(100.0 * shares, edges, color=colour, linewidth=1.0)
    axes.axvline(audit["quantiles"]["0.99"], color=colour, linewidth=1.0, linestyle=":")
    tolerance = float(audit["tolerance"])
    if np.isfinite(tolerance):
        axes.axvline(tolerance, color=colour, linewidth=1.4, linestyle="--")
        axes.annotate(
            f"tolerance: {audit['violations']} of {audit['audited']:,} above",
            (tolerance, 0.95), xycoords=("data", "axes fraction"), xytext=(-4, 0),
            textcoords="offset points", ha="right", va="top", rotation=90, fontsize=7,
            color=colour,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlabel("error of the cache's stress found by audits (µN/µm); dotted: 99 % are below")
    axes.set_ylabel("audited\nanswers (%)")
    axes.grid(alpha=0.25)


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


def _draw_table(axes: Axes, comparison: Comparison) -> None:
    axes.axis("off")
    headings, rows = comparison.table.for_people()
    table = axes.table(rows, colLabels=headings, loc="center", cellLoc="center", edges="horizontal")
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    table.scale(1.0, 1.25)
    for entry in table.get_celld().values():
        entry.set_linewidth(0.5)
        entry.set_edgecolor("0.6")
