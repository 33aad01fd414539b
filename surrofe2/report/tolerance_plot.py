"""The picture of a sweep over tolerances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from surrofe2.report.pictures import BLUE, VERMILION, new_figure, write_png
from surrofe2.report.tolerance_sweep import Sweep

_GREY = "0.45"
_STYLE: dict[str, Any] = {"linewidth": 1.3, "markersize": 5.0}


def write_sweep_plot(path: Path, sweep: Sweep) -> None:
    """Draw stress error, displacement error, hits and speed-up over tolerance into a PNG."""
    figure = new_figure(8.6, 6.4)
    (stress, displacement), (hits, speed) = figure.subplots(2, 2, sharex=True)
    tolerances = [row.tolerance for row in sweep.rows]
    _draw_stress(stress, sweep)
    displacement.plot(
        tolerances, [row.displacement_error for row in sweep.rows], "o-", color=BLUE, **_STYLE
    )
    displacement.set_yscale("log")
    displacement.set_title("largest error of displacement", fontsize=10)
    displacement.set_ylabel("relative to largest displacement")
    hits.plot(tolerances, [100.0 * row.hits for row in sweep.rows], "o-", color=BLUE, **_STYLE)
    hits.set_ylim(-4.0, 104.0)
    hits.set_title("stresses answered by the cache", fontsize=10)
    hits.set_ylabel("hits (%)")
    speed.plot(tolerances, [row.speed_up for row in sweep.rows], "o-", color=BLUE, **_STYLE)
    speed.axhline(1.0, color=_GREY, linewidth=1.0, linestyle="--")
    speed.annotate(
        f"true FE², {sweep.true_wall_time:.3g} s",
        (max(tolerances), 1.0),
        xytext=(0, -4),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=8,
        color=_GREY,
    )
    speed.set_ylim(bottom=0.0)
    speed.set_title("speed-up of the run", fontsize=10)
    speed.set_ylabel("times faster than true FE²")
    for axes in (stress, displacement, hits, speed):
        axes.set_xscale("log")
        axes.grid(alpha=0.25)
    for axes in (stress, displacement):
        low, high = axes.get_ylim()
        axes.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))
        axes.yaxis.set_major_formatter(FuncFormatter(_percent))
        axes.yaxis.set_minor_formatter(NullFormatter())
    for axes in (hits, speed):
        axes.set_xlabel("stress tolerance (share of the spread of stress)")
        axes.xaxis.set_major_formatter(FuncFormatter(_percent))
    _mark_off(speed, sweep)
    figure.suptitle(_title(sweep), fontsize=11)
    write_png(path, figure)


def _draw_stress(axes: Axes, sweep: Sweep) -> None:
    """The error found by audits, below the line of what is allowed."""
    tolerances = [row.tolerance for row in sweep.rows]
    axes.plot(tolerances, tolerances, "--", color=_GREY, linewidth=1.0, label="allowed")
    audited = [row for row in sweep.rows if row.error_99]
    if audited:
        at = [row.tolerance for row in audited]
        largest: list[Any] = [row.error_largest for row in audited]
        most: list[Any] = [row.error_99 for row in audited]
        axes.plot(at, largest, "s--", color=VERMILION, fillstyle="none", label="largest", **_STYLE)
        axes.plot(at, most, "o-", color=BLUE, label="99 % are below", **_STYLE)
    axes.set_yscale("log")
    axes.set_title("stress error found by audits", fontsize=10)
    axes.set_ylabel("relative to spread of stress")
    axes.legend(frameon=False, fontsize=8)


def _mark_off(axes: Axes, sweep: Sweep) -> None:
    for row in sweep.rows:
        if row.off:
            axes.annotate(
                "switched off",
                (row.tolerance, row.speed_up),
                xytext=(-4, -6),
                textcoords="offset points",
                ha="left",
                va="top",
                fontsize=8,
                color=VERMILION,
            )


def _percent(value: float, _: Any = None) -> str:
    return f"{100.0 * value:g} %"


def _title(sweep: Sweep) -> str:
    load = sweep.load
    spread = f", spread of stress {sweep.spread:.3g} µN/µm" if sweep.spread else ""
    return (
        f"What a stress tolerance buys: {load['width']:g} × {load['height']:g} µm tissue over "
        f"{load['duration']:g} µs,\ncell preset “{sweep.preset}”, law {sweep.law}{spread}"
    )
