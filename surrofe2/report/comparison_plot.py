"""The picture of a comparison: displacement curves above, their difference below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surrofe2.io.run_folder import StoredRun
from surrofe2.report.audit_plot import draw_audits, has_audit
from surrofe2.report.comparison import ComparedRun, Comparison, order_runs
from surrofe2.report.pictures import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
    write_png,
)

_COLOURS = (VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY)
_DASHES = ("--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))


def write_comparison_plot(path: Path, comparison: Comparison, runs: Sequence[StoredRun]) -> None:
    """Draw the compared runs into a PNG."""
    reference, *others = order_runs(runs)
    figure = new_figure(8.0, 6.6)
    audited = [run for run in others if has_audit(run)]
    heights = [3.0, 1.6, *([1.6] if audited else []), 0.32 * (len(others) + 2)]
    figure.set_figheight(6.6 + (1.9 if audited else 0.0))
    above, below, *middle, table = figure.subplots(len(heights), 1, height_ratios=heights)
    for axes in middle:
        draw_audits(axes, audited, [_COLOURS[others.index(run) % len(_COLOURS)] for run in audited])
    below.sharex(above)
    _draw_curves(above, reference, others)
    _draw_differences(below, reference, others)
    _draw_table(table, reference, comparison)
    figure.suptitle(_title(reference))
    write_png(path, figure)


def _title(reference: StoredRun) -> str:
    recipe = reference.record.recipe
    load, elements = recipe["load"], recipe["macro"]["elements"]
    g = float(np.hypot(*load["body_force"]))
    return (
        f"Watched point of a {load['width']:g} × {load['height']:g} µm tissue, "
        f"body force {g:g} µm/µs², {elements[0]} × {elements[1]} elements,\n"
        f"cell preset “{recipe['cell']['preset']}”, {reference.record.initialisation}"
    )


def _style(k: int) -> dict[str, object]:
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _DASHES[k % len(_DASHES)]}


def _draw_curves(axes, reference: StoredRun, others: Sequence[StoredRun]) -> None:  # type: ignore[no-untyped-def]
    curve = reference.curve
    axes.plot(
        curve.t,
        curve.displacement[:, 1],
        color="black",
        linewidth=2.6,
        alpha=0.45,
        label=_label(reference, reference),
    )
    for k, run in enumerate(others):
        axes.plot(
            run.curve.t,
            run.curve.displacement[:, 1],
            linewidth=1.4,
            label=_label(run, reference),
            **_style(k),
        )
    axes.set_ylabel("displacement $u_y$ (µm)")
    axes.set_xlim(curve.t[0], curve.t[-1])
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=min(len(others) + 1, 4),
        frameon=False,
        borderpad=0.0,
        handlelength=2.6,
    )
    axes.grid(alpha=0.25)
    axes.tick_params(labelbottom=False)


def _draw_differences(axes, reference: StoredRun, others: Sequence[StoredRun]) -> None:  # type: ignore[no-untyped-def]
    scale = np.linalg.norm(reference.curve.displacement, axis=1).max()
    for k, run in enumerate(others):
        distance = np.stack(
            [
                run.curve.displacement[:, i]
                - np.interp(run.curve.t, reference.curve.t, reference.curve.displacement[:, i])
                for i in range(2)
            ]
        )
        percent = 100.0 * np.linalg.norm(distance, axis=0) / scale
        axes.plot(run.curve.t, percent, color=_style(k)["color"], linewidth=1.0)
    axes.set_ylabel("difference (% of\nlargest displacement)")
    axes.set_xlabel("time $t$ (µs)")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.25)


def _draw_table(axes, reference: StoredRun, comparison: Comparison) -> None:  # type: ignore[no-untyped-def]
    axes.axis("off")
    counts = reference.record.counts
    first = (
        comparison.reference,
        "–",
        f"{reference.record.wall_time['total']:.3g} s",
        "1",
        f"{counts.get('rve_solves', 0):,}",
        "–",
    )
    table = axes.table(
        [first, *(_row(run) for run in comparison.runs)],
        colLabels=["run", "largest difference", "wall time", "speed-up", "RVE solves", "fallbacks"],
        loc="center",
        cellLoc="center",
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(9)
    table.scale(1.0, 1.25)
    for entry in table.get_celld().values():
        entry.set_linewidth(0.5)
        entry.set_edgecolor("0.6")


def _row(run: ComparedRun) -> tuple[str, ...]:
    speed_up = run.speed_up["wall_time"]
    return (
        run.name,
        f"{100 * run.difference.largest:.2g} %",
        f"{run.wall_time:.3g} s",
        f"{speed_up:.3g}×" if speed_up else "–",
        f"{run.counts.get('rve_solves', 0):,}",
        f"{run.counts.get('fallbacks', 0):,}" if run.law == "cached" else "–",
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
