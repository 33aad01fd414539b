"""Charts: panels of curves in one style, for figures, the page and notebooks.

matplotlib is loaded where a chart is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from surrofe2.base.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# The palette of Okabe and Ito, told apart by readers of every colour vision.
BLUE = "#0072B2"
SKY = "#56B4E9"
GREEN = "#009E73"
VERMILION = "#D55E00"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
# Colours of curves without a style of their own, in turn.
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
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
    "guide": {"color": "0.45", "linestyle": (0, (1, 1.5)), "linewidth": 1.0, "zorder": 1},
    "point": {"color": "black", "linestyle": "none", "marker": "+", "markersize": 9.0, "mew": 1.8},
    "outline": {"color": "black", "linewidth": 1.4},
    "stable": _AREA | {"color": BLUE},
    "stable after leaving a bifurcation": _AREA | {"color": "#C6DBEF"},
    "no stable state found": _AREA | {"color": "#F6DDB5"},
    "solve failed": _AREA | {"color": "0.82"},
}
# Words for the names of curves that have no label of their own.
_WORDS = {
    "cauchy-born": "Cauchy–Born",
    "elastic": "elastic relaxation",
    "constrained-runs": "constrained runs",
    "slow-manifold": "slow manifold",
    "micro-integration": "integrated in time",
    "tissue": "full tissue",
}
# Marker and dash of curves in turn; the next pair where the colours begin again.
_TURNS = (("o", "-"), ("s", "--"), ("^", ":"))
# Dashes of lines without markers, in turn.
_DASHES = ("-", "--", "-.", ":")
# Inches: a panel, a row of a legend, the room about a legend, a row of a title.
_PANEL_SIZE = (4.6, 3.1)
_LEGEND_ROW = 0.2
_LEGEND_ROOM = 0.15
_TITLE_ROW = 0.2
# Lines that a legend inside a panel names at most; a longer one stands below.
_MOST_INSIDE = 2
# Letters of a label from which on a legend has one label in a row.
_LONG = 30


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a panel.

    Attributes:
        name: decides colour, dash and marker, so that a name looks alike in all figures.
        x, y: (m,) values in the units of the panel's axes; NaN leaves a gap, as does a value that a
            logarithm does not show.
        label: for the legend; empty: the name, in words.
        markers: whether single points are marked.
        colour: number of the colour of a curve without a style; None: the next one.
        dash: of matplotlib; empty: that of the name or of the colour.
        note: text beside its last point, in place of an entry in the legend.
    """

    name: str
    x: Array
    y: Array
    label: str = ""
    markers: bool = True
    colour: int | None = None
    dash: str = ""
    note: str = ""

    @property
    def words(self) -> str:
        """What a legend calls it."""
        return self.label or _WORDS.get(self.name, self.name)


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes; labels carry units.

    Attributes:
        x_label, y_label: of the axes.
        curves: its lines.
        title: above it.
        log_x, log_y: whether an axis is logarithmic.
        x_ticks: numbers at which x is marked; empty: wherever it suits.
        x_names: texts there instead of the numbers.
        zero: whether the line y = 0 is drawn and in sight.
        height: of the panel, relative to the usual.
        width: of the panel, relative to the usual; a column has that of its widest panel.
        has_legend: whether its lines are named; False where another panel names them.
        sketch: draws a sketch instead of curves, without axes; None: there are curves.
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
    width: float = 1.0
    has_legend: bool = True
    sketch: Callable[[Axes], None] | None = None


def draw_panels(
    panels: Sequence[Panel], columns: int = 1, *, title: str = "", figure: Figure | None = None
) -> Figure:
    """Draw a figure of panels, so many in a row, with one legend where they have the same lines.

    Args:
        title: heading of the figure, of one line or several.
        figure: where to draw; None: a new one, which no window shows.
    """
    from matplotlib.figure import Figure

    figure = figure or Figure()
    rows = [panels[first : first + columns] for first in range(0, len(panels), columns)]
    heights = [_PANEL_SIZE[1] * max(panel.height for panel in row) for row in rows]
    figure.set_layout_engine("constrained")
    if not heights:
        return figure
    widths = [max(panel.width for panel in panels[k::columns] or panels) for k in range(columns)]
    axes = figure.subplots(
        len(heights), columns, squeeze=False, height_ratios=heights, width_ratios=widths
    )
    for place in axes.flat[len(panels) :]:
        place.axis("off")
    width = max(_PANEL_SIZE[0] * sum(widths), 6.4 if title else 0.0)  # a title needs some room
    for k, (place, panel) in enumerate(zip(axes.flat, panels, strict=False)):
        _draw_panel(place, panel, int(11 * width * widths[k % columns] / sum(widths)))
    legend = _draw_legends(figure, panels, width, columns)
    letters = int(11 * width)  # about eleven of them take an inch
    lines = [part for line in title.split("\n") for part in wrap(in_words(line), letters)]
    figure.set_size_inches(width, sum(heights) + legend + _TITLE_ROW * len(lines))
    figure.align_ylabels()
    if lines:
        figure.suptitle("\n".join(lines), fontsize=11)
    return figure


def in_words(text: str) -> str:
    """Return a text that may hold names of folders, as matplotlib draws it literally.

    Dollar signs begin no formula, and a sign that its font lacks is drawn as an escape. Titles of
    panels may have formulas, so that names in them need this; labels and titles of figures get it.
    """
    from matplotlib.font_manager import FontProperties, findfont, get_font

    known = get_font(findfont(FontProperties())).get_charmap()
    signs = []
    for sign in text:
        if ord(sign) in known or sign == "\n":
            signs.append(sign)
        else:
            signs.append(sign.encode("unicode_escape").decode())
    shown = "".join(signs).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown  # such labels would be left out


def encoded(figure: Figure, form: str = "svg") -> bytes:
    """Return a figure as "png" of 300 dpi, "pdf", or "svg", whose words stay words."""
    from matplotlib import rc_context

    picture = BytesIO()
    options: dict[str, Any] = {"dpi": 300}
    if form == "svg":  # the same figure gives the same file
        options = {"metadata": {"Date": None}}
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "surrofe2"}):
        figure.savefig(picture, format=form, **options)
    return picture.getvalue()


def _draw_panel(axes: Axes, panel: Panel, letters: int) -> None:
    """Draw the curves of a panel; its title has lines of so many letters."""
    from matplotlib.ticker import MaxNLocator

    axes.set_title("\n".join(wrap(panel.title, letters)), fontsize=10)
    if panel.sketch is not None:
        axes.axis("off")
        panel.sketch(axes)
        return
    others = 0
    for curve in panel.curves:
        style: dict[str, Any] = {"linewidth": 1.3, "markersize": 4.5, "fillstyle": "none"}
        if curve.name in _STYLES:
            style |= _STYLES[curve.name]
        else:
            k = others if curve.colour is None else curve.colour
            others += 1
            marker, dash = _TURNS[k // len(PALETTE) % len(_TURNS)]
            dash = dash if curve.markers else _DASHES[k % len(_DASHES)]
            style |= {"color": PALETTE[k % len(PALETTE)], "marker": marker, "linestyle": dash}
        if not curve.markers:
            style.pop("marker", None)
        if curve.dash:
            style["linestyle"] = curve.dash
        y = np.where(np.asarray(curve.y) > 0.0, curve.y, np.nan) if panel.log_y else curve.y
        label = "_nolegend_" if curve.note else in_words(curve.words)
        axes.plot(curve.x, y, label=label, **style)
        if curve.note:
            end = (curve.x[-1], y[-1])
            look: Any = {"xytext": (-4, 3), "textcoords": "offset points", "fontsize": 8}
            axes.annotate(curve.note, end, ha="right", va="bottom", color="0.3", **look)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
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


def _draw_legends(figure: Figure, panels: Sequence[Panel], width: float, columns: int) -> float:
    """Draw legends where there is more than one line.

    Where most panels have the same lines there is one legend below all axes, else one for each.

    Returns:
        The height in inches of the legend below all axes; 0 without one.
    """
    handles: dict[str, Any] = {}
    labels: list[set[str]] = []
    places = []
    for place, panel in zip(figure.axes, panels, strict=False):
        if not panel.has_legend:
            continue
        places.append(place)
        handles_of_place, labels_of_place = place.get_legend_handles_labels()
        handles = dict(zip(labels_of_place, handles_of_place, strict=True)) | handles
        labels.append({*labels_of_place})
    if len(handles) < 2:
        return 0.0
    if all(3 * len(names) >= 2 * len(handles) for names in labels if len(names) > 1):
        longest = max(map(len, handles))
        # inches of a line with its gaps, and of a letter
        in_a_row = max(1, min(3, int(width / (0.6 + 0.075 * longest))))
        figure.legend(
            [*handles.values()], [*handles], loc="outside lower center", ncols=in_a_row,
            frameon=False, fontsize=9, handlelength=2.4,
        )  # fmt: skip
        return _LEGEND_ROOM + _LEGEND_ROW * -(-len(handles) // in_a_row)
    for place, names in zip(places, labels, strict=True):
        where: dict[str, Any] = {"loc": "best", "framealpha": 0.8}
        if columns > 1:
            in_a_row = 1 if max(map(len, names), default=0) > _LONG else 2
            where = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": in_a_row}
        elif not place.get_title() and len(names) <= _MOST_INSIDE:  # above the axes
            where = {"loc": "lower right", "bbox_to_anchor": (1.01, 0.98), "ncols": _MOST_INSIDE}
        elif len(names) > _MOST_INSIDE:
            where = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
        if len(names) > 1:
            place.legend(fontsize=8, **{"frameon": "framealpha" in where, **where})
    return 0.0
