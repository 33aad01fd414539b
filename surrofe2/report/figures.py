"""Figures: panels of curves in one style, and how they become PNG files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.report.tables import Table
from surrofe2.store.store import write_bytes

Array = NDArray[np.float64]

# Okabe and Ito's palette, told apart by readers of every colour vision.
BLUE, SKY, GREEN = "#0072B2", "#56B4E9", "#009E73"
VERMILION, ORANGE, PURPLE = "#D55E00", "#E69F00", "#CC79A7"
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
    "reference": _REFERENCE,
    "stable": _AREA | {"color": BLUE},
    "stable after leaving a bifurcation": _AREA | {"color": ORANGE},
    "no stable state found": _AREA | {"color": PURPLE},
    "solve failed": _AREA | {"color": "black"},
}
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""Colours of curves without a style of their own, in turn."""
_TURNS: tuple[dict[str, str], ...] = (
    {"marker": "o", "linestyle": "-"},
    {"marker": "s", "linestyle": "--"},
    {"marker": "^", "linestyle": ":"},
)
_DASHES = ("-", "--", "-.", ":")
"""Of lines without markers, in turn."""
_PANEL_SIZE = (4.6, 3.1)  # inches
_LEGEND_HEIGHT, _LINE_HEIGHT = 0.7, 0.32


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a panel.

    Attributes:
        name: decides colour, dash and marker, so that a name looks alike in all figures.
        x, y: (m,) values in the units of the panel's axes; NaN leaves a gap, as does a value that a
            logarithm does not show.
        label: for the legend; empty: the name.
        markers: whether single points are marked.
        colour: which one of those for curves without a style; None: the next one.
        dash: of matplotlib; empty: as the name or the turn has it.
        steps: whether y holds from the point before on, filled below; for histograms.
    """

    name: str
    x: Array
    y: Array
    label: str = ""
    markers: bool = True
    colour: int | None = None
    dash: str = ""
    steps: bool = False

    def __post_init__(self) -> None:
        if np.shape(self.x) != np.shape(self.y) or np.ndim(self.x) != 1:
            raise InputError(
                f"curve {self.name}: x {np.shape(self.x)} and y {np.shape(self.y)}; both must be "
                "(m,)"
            )


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes; labels carry units.

    Attributes:
        x_ticks: where x is marked, by these numbers; empty: wherever it suits.
        x_names: what stands there in the place of the numbers.
        zero: whether the line y = 0 is drawn and in sight.
        height: of the panel, relative to the usual.
    """

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    log_x: bool = False
    log_y: bool = False
    x_ticks: tuple[float, ...] = ()
    x_names: tuple[str, ...] = ()
    zero: bool = False
    height: float = 1.0


def write_figure(
    path: Path,
    title: str,
    panels: Sequence[Panel],
    columns: int = 1,
    table: Table[Any] | None = None,
) -> None:
    """Draw panels, so many in a row, into a PNG; below all of them the table and one legend."""
    figure = make_figure(panels, columns=columns, table=table)
    figure.suptitle(title, fontsize=11)
    write_png(path, figure)


def make_figure(
    panels: Sequence[Panel],
    size: tuple[float, float] | None = None,
    columns: int = 1,
    table: Table[Any] | None = None,
) -> Figure:
    """A figure of panels, so many in a row; below all of them the table and one legend.

    size: width and height in inches; None: as the panels need.
    """
    rows = [panels[first : first + columns] for first in range(0, len(panels), columns)]
    heights = [_PANEL_SIZE[1] * max(panel.height for panel in row) for row in rows]
    if table is not None:
        heights.append(_LINE_HEIGHT * (len(table.rows) + 2))
    if size is None:
        width = max(_PANEL_SIZE[0] * columns, 6.4 if table is None else 8.0)
        size = (width, sum(heights) + _LEGEND_HEIGHT)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    if not heights:
        return figure
    axes = figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights)
    for place in axes.flat[len(panels) :]:
        place.axis("off")
    for place, panel in zip(axes.flat, panels, strict=False):
        _draw_panel(place, panel)
    if table is not None:
        _draw_table(axes[-1, 0], table)
    _draw_legend(figure, axes.flat)
    return figure


def drawn(figure: Figure, form: str = "png") -> bytes:
    """A figure as PNG, or as SVG, whose words stay words."""
    picture, options = BytesIO(), {"dpi": 150} if form == "png" else {"metadata": {"Date": None}}
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "surrofe2"}):
        figure.savefig(picture, format=form, **options)
    return picture.getvalue()


def write_png(path: Path, figure: Figure) -> None:
    """Write a figure as PNG."""
    write_bytes(path, drawn(figure))


def _draw_table(axes: Axes, table: Table[Any]) -> None:
    headings, rows = table.for_people()
    drawn = axes.table(rows, colLabels=headings, loc="center", cellLoc="center", edges="horizontal")
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(min(8.0, 64.0 / len(headings)))
    drawn.auto_set_column_width(range(len(headings)))
    drawn.scale(1.0, 1.25)
    for entry in drawn.get_celld().values():
        entry.set_linewidth(0.5)
        entry.set_edgecolor("0.6")


def _draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw curves, labels and scales."""
    others = 0
    for curve in panel.curves:
        style = _STYLES.get(curve.name)
        if style is None:
            style = _other_style(others if curve.colour is None else curve.colour, curve.markers)
            others += 1
        style = {"linewidth": 1.3, "markersize": 4.5, "fillstyle": "none", **style}
        if not curve.markers:
            style.pop("marker", None)
        if curve.dash:
            style["linestyle"] = curve.dash
        y = np.where(np.asarray(curve.y) > 0.0, curve.y, np.nan) if panel.log_y else curve.y
        if curve.steps:
            axes.fill_between(curve.x, y, step="pre", color=style["color"], alpha=0.25, linewidth=0)
            style["drawstyle"] = "steps-pre"
        axes.plot(curve.x, y, label=curve.label or curve.name, **style)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.title:
        axes.set_title(panel.title, fontsize=10)
    if not panel.log_x:
        axes.xaxis.set_major_locator(MaxNLocator(6))
    elif any(bool(np.any(np.asarray(curve.x) == 0.0)) for curve in panel.curves):
        axes.set_xscale("symlog", linthresh=1.0, linscale=0.3)
    else:
        axes.set_xscale("log")
    if panel.log_y:
        axes.set_yscale("log")
    if panel.x_ticks:
        axes.set_xticks(panel.x_ticks, panel.x_names or [f"{x:g}" for x in panel.x_ticks])
        axes.set_xticks([], minor=True)
    if panel.zero:
        axes.axhline(0.0, color="black", linewidth=0.8)
    axes.grid(alpha=0.25)
    axes.margins(x=0.03)


def _other_style(k: int, markers: bool) -> dict[str, str]:
    """Colours in turn; where they begin anew, with another marker and dash."""
    colour = PALETTE[k % len(PALETTE)]
    if not markers:
        return {"color": colour, "linestyle": _DASHES[k % len(_DASHES)]}
    return {"color": colour, **_TURNS[k // len(PALETTE) % len(_TURNS)]}


def _draw_legend(figure: Figure, places: Iterable[Axes]) -> None:
    """One legend below all axes, each label once; none for a single label."""
    handles: dict[str, Any] = {}
    for place in places:
        for handle, label in zip(*place.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if len(handles) > 1:
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside lower center",
            ncols=3 if figure.get_figwidth() > 8.0 else 2,
            frameon=False,
            fontsize=9,
            handlelength=2.8,
        )
