"""The plot of cost over the number of points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from surrofe2.io.files import replacing

if TYPE_CHECKING:
    from benchmarks.linear_cost import Costs

# Okabe and Ito's palette; the markers differ too.
_STYLES = (("#D55E00", "o"), ("#0072B2", "s"), ("#009E73", "^"))


def write_cost_plot(path: Path, costs: Sequence[Costs], threads: int) -> None:
    """Milliseconds of a right-hand side over points, both logarithmic, with lines of slope 1."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for cost, (colour, marker) in zip(costs, _STYLES, strict=False):
        milli = 1e3 * cost.median
        axes.plot(
            cost.points, milli[-1] * cost.points / cost.points[-1], color=colour, linestyle=":",
            linewidth=1.0,
        )  # fmt: skip
        axes.plot(
            cost.points, milli, color=colour, marker=marker, markersize=6, linewidth=1.6,
            label=f"{cost.label}: time ~ points$^{{{cost.exponent:.2f}}}$",
        )  # fmt: skip
        axes.annotate(
            f"{1e3 * milli[-1] / cost.points[-1]:.2g} µs a point",
            (cost.points[-1], milli[-1]), xytext=(-10, 0), textcoords="offset points",
            ha="right", va="bottom", color=colour,
        )  # fmt: skip
    axes.plot([], [], color="0.4", linestyle=":", linewidth=1.0, label="proportional to points")
    axes.set(xscale="log", yscale="log", xlabel="stress points (five an element)")
    axes.set_ylabel("a right-hand side (ms)")
    axes.set_title(f"Cost of the macro scale and its stress law, {threads} threads", fontsize=11)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, loc="upper left")
    axes.set_xlim(0.8 * np.min(costs[0].points), 1.25 * np.max(costs[0].points))
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=150)
