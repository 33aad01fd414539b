"""The picture of a labelled image: outlines and long axes of its cells, and of an RVE like them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.report.figures import draw_scale_bar
from surrofe2.run.charts import BLUE, VERMILION

# Colours of cells that count, cells that are left out, and holes.
_LEAF = (0.80, 0.90, 0.74)
_CUT = (0.88, 0.88, 0.88)
_HOLE = (1.0, 1.0, 1.0)
_SHADES = 0.12  # the largest difference of the colours of neighbours
# Fraction of a long axis that is drawn, so that it stays within its cell.
_OF_AXIS = 0.7
_HEIGHT = 4.6  # inches
# Shifts by which an RVE is drawn four times.
_PERIODS = [(a, b) for a in range(2) for b in range(2)]


def outlines_figure(
    labels: NDArray[np.int64],
    pixel: float,
    counted: Index,
    axes: Array,
    rve: tuple[Sequence[Array], Array] | None = None,
) -> Figure:
    """Draw the image with the outlines of its cells, beside it four periods of an RVE at its scale.

    Args:
        labels: (rows, columns) labels of the pixels, 0 in holes.
        pixel: side of a pixel, µm.
        counted: labels of the cells that count; the others are grey.
        axes: (n, 2, 2) ends of the long axes of cells, x and y, µm.
        rve: polygons (k, 2) of an RVE and its (2, 2) periods, columns, µm.
    """
    figure = Figure(layout="constrained")
    places = figure.subplots(1, 1 if rve is None else 2, squeeze=False)[0]
    height, width = (pixel * count for count in labels.shape)
    place = places[0]
    place.imshow(_coloured(labels, counted), extent=(0.0, width, 0.0, height))
    lines = _outlines(labels, pixel)
    place.add_collection(LineCollection(lines, colors="black", linewidths=0.6))
    place.add_collection(LineCollection(list(axes), colors=VERMILION, linewidths=1.0))
    place.set_title("cells and their long axes; grey: left out, white: holes", fontsize=9)
    _finish(place, np.zeros(2), np.array([width, height]))
    if rve is not None:
        polygons, lattice = rve
        repeated = [polygon + lattice @ period for period in _PERIODS for polygon in polygons]
        drawn = PolyCollection(repeated, facecolors=[_LEAF], edgecolors="black", linewidths=0.6)
        places[1].add_collection(drawn)
        corners = np.concatenate(repeated)
        polygons_of_cells = PolyCollection(
            list(polygons), facecolors="none", edgecolors=BLUE, linewidths=1.2
        )
        places[1].add_collection(polygons_of_cells)
        places[1].set_title("RVE at rest (blue), repeated, at the same scale", fontsize=9)
        low = corners.min(axis=0)
        high = corners.max(axis=0)
        size = np.maximum(high - low, [width, height])
        middle = (low + high) / 2.0
        _finish(places[1], middle - size / 2.0, middle + size / 2.0)
    # the shape of the figure is that of the axes, which have room for the scale bar now
    across = np.ptp(place.get_xlim())
    up = np.ptp(place.get_ylim())
    figure.set_size_inches(len(places) * _HEIGHT * min(max(across / up, 0.6), 1.8), _HEIGHT)
    return figure


def _coloured(labels: NDArray[np.int64], counted: Index) -> NDArray[np.float64]:
    """Return the colours (rows, columns, 3) of the pixels."""
    colour = np.full((labels.max() + 1, 3), _CUT)
    # neighbours mostly have labels near each other; of labels that differ by less than 5, shades
    # differ
    shade = 1.0 - _SHADES * ((counted * 7) % 5) / 4.0
    colour[counted] = np.array(_LEAF) * shade[:, None]
    colour[0] = _HOLE
    return np.asarray(colour[labels])


def _outlines(labels: NDArray[np.int64], pixel: float) -> list[Array]:
    """Return the sides of pixels between different labels, two points (2, 2) each, µm."""
    rows = labels.shape[0]
    y, x = np.nonzero(labels[:, :-1] != labels[:, 1:])
    upright = np.stack([np.stack([x + 1, rows - y], 1), np.stack([x + 1, rows - y - 1], 1)], 1)
    y, x = np.nonzero(labels[:-1] != labels[1:])
    level = np.stack([np.stack([x, rows - y - 1], 1), np.stack([x + 1, rows - y - 1], 1)], 1)
    return list(pixel * np.concatenate([upright, level]))


def _finish(place: Axes, low: Array, high: Array) -> None:
    """Show the window between two corners (2,), with a scale bar and no axes."""
    place.set_xlim(low[0], high[0])
    place.set_ylim(low[1], high[1])
    place.set_aspect("equal")
    place.set_axis_off()
    draw_scale_bar(place, low, high)


def long_axes(centre: Array, area: Array, aspect: Array, direction: Array) -> Array:
    """Compute the ends (n, 2, 2) of most of the long axes of ellipses of these areas, µm."""
    half = _OF_AXIS * np.sqrt(area * aspect / np.pi)
    angle = np.deg2rad(direction)
    way = half[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.stack([centre - way, centre + way], axis=1)
