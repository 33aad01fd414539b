"""Drawing the panels of a study into a PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

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
from surrofe2.report.study import Curve, Panel, Study

_REFERENCE: dict[str, Any] = {"color": "black", "linewidth": 2.8, "alpha": 0.4, "zorder": 1}
# A grid of 41 x 41 points fills a panel of _PANEL_SIZE without gaps.
_TILE = ((-1.0, -0.62), (1.0, -0.62), (1.0, 0.62), (-1.0, 0.62))
_AREA: dict[str, Any] = {
    "linestyle": "none", "marker": _TILE, "markersize": 7.0, "fillstyle": "full", "mew": 0.0,
}  # fmt: skip
_STYLES: dict[str, dict[str, Any]] = {
    "cauchy-born": {"color": PURPLE, "linestyle": ":", "marker": "^"},
    "elastic": {"color": VERMILION, "linestyle": "--", "marker": "s"},
    "constrained-runs": {"color": BLUE, "linestyle": "-.", "marker": "o"},
    "slow-manifold": {"color": GREEN, "linestyle": "-", "marker": "x", "zorder": 1.5},
    "direct": {"color": SKY, "linestyle": "-", "marker": "D"},
    "micro-integration": _REFERENCE,
    "tissue": _REFERENCE,
    "stable": _AREA | {"color": BLUE},
    "stable after leaving a bifurcation": _AREA | {"color": ORANGE},
    "no stable state found": _AREA | {"color": PURPLE},
    "solve failed": _AREA | {"color": "black"},
}
_OTHER = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
_TURNS: tuple[dict[str, str], ...] = (
    {"marker": "o", "linestyle": "-"},
    {"marker": "s", "linestyle": "--"},
    {"marker": "^", "linestyle": ":"},
)
_PANEL_SIZE = (4.6, 3.1)  # inches
_LEGEND_HEIGHT = 0.7


def write_figure(path: Path, study: Study) -> None:
    """Draw a study; one legend below all panels."""
    columns = study.columns
    rows = -(-len(study.panels) // columns)
    width = max(_PANEL_SIZE[0] * columns, 6.4)
    figure = new_figure(width, _PANEL_SIZE[1] * rows + _LEGEND_HEIGHT)
    axes = figure.subplots(rows, columns, squeeze=False)
    for place, panel in zip(axes.flat, study.panels, strict=False):
        _draw(place, panel)
    for place in axes.flat[len(study.panels) :]:
        place.axis("off")
    figure.suptitle(study.title, fontsize=11)
    _draw_legend(figure, axes)
    write_png(path, figure)


def _draw(axes: Axes, panel: Panel) -> None:
    for k, curve in enumerate(panel.curves):
        _draw_curve(axes, curve, k)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.title:
        axes.set_title(panel.title, fontsize=10)
    if not panel.log_x:
        axes.xaxis.set_major_locator(MaxNLocator(6))
    else:
        axes.set_xscale("symlog" if _has_zero(panel) else "log", **_linear_part(panel))
    if panel.log_y:
        axes.set_yscale("log")
    if panel.x_ticks:
        axes.set_xticks(panel.x_ticks, [f"{x:g}" for x in panel.x_ticks])
        axes.set_xticks([], minor=True)
    if panel.zero:
        axes.axhline(0.0, color="black", linewidth=0.8)
    axes.grid(alpha=0.25)
    axes.margins(x=0.03)


def _has_zero(panel: Panel) -> bool:
    return any(bool(np.any(np.asarray(curve.x) == 0.0)) for curve in panel.curves)


def _linear_part(panel: Panel) -> dict[str, Any]:
    return {"linthresh": 1.0, "linscale": 0.3} if _has_zero(panel) else {}


def _draw_curve(axes: Axes, curve: Curve, k: int) -> None:
    style: dict[str, Any] = {"linewidth": 1.3, "markersize": 4.5, "fillstyle": "none"}
    style |= _STYLES.get(curve.name, _other_style(k))
    if not curve.markers:
        style.pop("marker", None)
    axes.plot(curve.x, curve.y, label=curve.label or curve.name, **style)
    if curve.note:
        axes.annotate(
            curve.note,
            (float(curve.x[-1]), float(curve.y[-1])),
            xytext=(0, 6),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=style["color"],
        )


def _other_style(k: int) -> dict[str, str]:
    """Colours in turn; where they begin anew, with another marker and dash."""
    turn = k // len(_OTHER) % len(_TURNS)
    return {"color": _OTHER[k % len(_OTHER)], **_TURNS[turn]}


def _draw_legend(figure: Figure, axes: Any) -> None:
    found: dict[str, Any] = {}
    for place in axes.flat:
        for handle, label in zip(*place.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if len(found) > 1:
        figure.legend(
            list(found.values()),
            list(found),
            loc="outside lower center",
            ncols=3 if figure.get_figwidth() > 8.0 else 2,
            frameon=False,
            fontsize=9,
            handlelength=2.8,
        )
