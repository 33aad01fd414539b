"""A sketch of a specimen: its outline and regions, what holds, pulls and presses it, its scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from surrofe2.base.arrays import Array
from surrofe2.problem import BodyForce, Fixed, PrescribedMotion, Problem
from surrofe2.problem.rigid_bodies import Plane
from surrofe2.report.figures import draw_scale_bar
from surrofe2.run.charts import VERMILION

_TISSUE, _OTHER = "#CCE5B9", "#7FB069"
_ARROW: Any = {"arrowstyle": "-|>", "color": VERMILION, "linewidth": 1.6}
# Sizes as fractions of the larger side of the specimen: a hatched support, a plate, an arrow.
_SUPPORT, _PLATE, _PULL = 0.06, 0.07, 0.2


def draw_sketch(axes: Axes, problem: Problem) -> None:
    """Draw a rectangle of tissue with clamps at its left, grips at its right, weight and plates.

    Dots are watched points.
    """
    mesh = problem.mesh
    low = mesh.p.min(axis=1)
    high = mesh.p.max(axis=1)
    size = float((high - low).max())
    _draw_box(axes, low, high, facecolor=_TISSUE, edgecolor="0.3")
    for name, elements in (mesh.subdomains or {}).items():
        corners = mesh.p[:, mesh.t[:, elements]]
        begin = corners.min(axis=(1, 2))
        end = corners.max(axis=(1, 2))
        _draw_box(axes, begin, end, facecolor=_OTHER, edgecolor="0.3")
        x, y = 0.5 * (begin + end)
        axes.text(x, y, name, ha="center", va="center", fontsize=8)
    middle = 0.5 * (low + high)
    for condition in problem.conditions:
        if isinstance(condition, Fixed):
            begin = low - np.array([_SUPPORT * size, 0.0])
            end = np.array([low[0], high[1]])
            look = {"facecolor": "none", "edgecolor": "0.3", "hatch": "/////", "linewidth": 0.0}
            _draw_box(axes, begin, end, **look)
            axes.plot([low[0], low[0]], [low[1], high[1]], color="0.15", linewidth=2.5)
        elif isinstance(condition, PrescribedMotion):
            axes.plot([high[0], high[0]], [low[1], high[1]], color="0.15", linewidth=2.5)
            begin = np.array([high[0], middle[1]])
            _draw_arrow(axes, begin, begin + np.array([_PULL * size, 0.0]))
        elif isinstance(condition, BodyForce):
            way = np.array(condition.acceleration) / np.linalg.norm(condition.acceleration)
            for part in (1, 3, 5):
                x = low[0] + part / 6.0 * (high - low)[0]
                centre = np.array([x, middle[1]])
                half = 0.5 * _PULL * size * way
                _draw_arrow(axes, centre - half, centre + half)
    for body in problem.bodies:
        assert isinstance(body.shape, Plane)
        begin = np.array([low[0] - _PLATE * size, body.position[1]])
        end = np.array([high[0] + _PLATE * size, body.position[1]])
        # the tissue is on the side to which the normal points
        if body.shape.normal[1] > 0.0:
            begin = begin - np.array([0.0, _PLATE * size])
        else:
            end = end + np.array([0.0, _PLATE * size])
        _draw_box(axes, begin, end, facecolor="0.85", edgecolor="0.4")
        if body.moves:
            top = np.array([middle[0], end[1]])
            _draw_arrow(axes, top + np.array([0.0, _PULL * size]), top)
    for x, y in problem.watched.values():
        axes.plot(x, y, "o", color="0.1", markersize=4.0)
    room = np.array([0.22, 0.1]) * size
    above = np.array([0.22, 0.28]) * size
    draw_scale_bar(axes, low - room, high + above)


def _draw_box(axes: Axes, begin: Array, end: Array, **look: Any) -> None:
    """Draw a rectangle between two corners (2,)."""
    width, height = (end - begin).tolist()
    axes.add_patch(Rectangle((begin[0], begin[1]), width, height, **look))


def _draw_arrow(axes: Axes, begin: Array, end: Array) -> None:
    """Draw an arrow between two points (2,)."""
    axes.annotate("", (end[0], end[1]), (begin[0], begin[1]), arrowprops=_ARROW)
