"""The deformed tissue and rigid bodies: arrays for the script, and a still picture for paper."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from surrofe2.law.stress_law import SURROGATE, TABLE, Status
from surrofe2.problem.entries import body_of
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, Shape
from surrofe2.report.figures import drawn, make_figure
from surrofe2.report.page.html import figure, grid, image, missing, section
from surrofe2.report.page.report_data import VON_MISES, WALL_STRETCH, ReportData, RunData
from surrofe2.store.fields import SOURCE_NAME, StoredFields

Array = NDArray[np.float64]

STOPS = [to_hex(colormaps["viridis"](k / 9)) for k in range(10)]
"""Viridis, evenly from lowest to highest."""
LEVELS, UNKNOWN = 254, 255
"""Numbers are stored as 0 … LEVELS; UNKNOWN is none."""
SOURCES: dict[int, tuple[str, str]] = {
    SURROGATE: ("network", "#3b82c4"),
    TABLE: ("table", "#3aa37f"),
    Status.OUT_OF_RANGE: ("RVE: out of the domain", "#d9822b"),
    Status.NOT_FINITE: ("RVE: not finite", "#8c5bb0"),
    Status.NOT_TRUSTED: ("RVE: risk above the limit", "#c2413b"),
}
"""By the codes of `stress_law.Sources`: what people read, and the colour."""
_BUDGET = 1_200_000
"""Bytes of all animations together, before base64."""
_SHOWN = 0.08
"""Share of the tissue's size that the largest displacement is drawn with at first, about."""
_FACTORS = (1, 2, 5, 10, 20, 50, 100)
_SIDES = 5000
"""Elements from which on their sides are not drawn."""
_WIDTH = 4.0
"""Of a still picture, inches."""
_COLOURS = colormaps["viridis"].with_extremes(bad="0.6")
"""Those of the script, grey where nothing is known."""


def motion_section(seen: ReportData) -> tuple[str, list[dict[str, Any]]]:
    """The section, and what the script needs of each run."""
    shown = [each for each in seen.runs if each.fields is not None]
    parts = [
        missing(f"{each.name}: no fields in its folder, so its motion is not shown.")
        for each in seen.runs
        if each.fields is None
    ]
    data = [_arrays(each, _BUDGET // len(shown)) for each in shown]
    if data:
        parts.insert(0, _PLAYER)
    stills = [_still(each, arrays["factor"]) for each, arrays in zip(shown, data, strict=True)]
    parts.append(f'<div class="still">{grid(stills)}</div>')
    return section("motion", "The tissue in motion", parts), data


_PLAYER = (
    '<div class="player" id="player" hidden><div class="bar">'
    '<label>Run <select id="which"></select></label>'
    '<label>Colour <select id="colour"></select></label>'
    '<label>Displacement <select id="factor"></select></label></div>'
    '<canvas id="canvas" tabindex="0" role="img" aria-describedby="keys"></canvas>'
    '<div class="scale"><span id="low"></span><canvas id="ramp" aria-hidden="true"></canvas>'
    '<span id="high"></span></div><ul class="legend" id="sources" hidden></ul>'
    '<div class="bar"><button type="button" id="play" aria-pressed="false">Play</button>'
    '<input type="range" id="frame" min="0" value="0" aria-label="Time">'
    '<output id="clock" for="frame"></output></div>'
    '<p class="keys" id="keys">Keys on the picture: space plays and pauses, ← and → step, Home and '
    "End go to the first and last time. Rigid bodies are grey; their motion has the same factor, "
    "so above × 1 one that stood apart seems to enter the tissue."
    "</p></div>"
)


def _colours(fields: StoredFields) -> dict[str, tuple[str, Array]]:
    """By name: unit and (m, e) values to colour by."""
    size = np.linalg.norm(fields.displacement, axis=2)
    colours = {"displacement": ("µm", size[:, fields.cells].mean(axis=2))}
    for name, unit, key in (
        ("von Mises stress", "µN/µm", VON_MISES),
        ("largest wall stretch", "length / rest length", WALL_STRETCH),
        ("stress source", "", SOURCE_NAME),
    ):
        if key in fields.values:
            colours[name] = unit, fields.values[key]
    return colours


def _arrays(run: RunData, budget: int) -> dict[str, Any]:
    """A run for the script: numbers as bytes in base64, as many times as the budget has room for.

    Displacements are 16-bit shares of the largest component, values 8-bit levels.
    """
    fields = run.fields
    assert fields is not None
    colours = _colours(fields)
    each = 4 * len(fields.points) + len(colours) * len(fields.cells)
    kept = max(2, min(len(fields.t), budget // max(each, 1)))
    at = np.unique(np.linspace(0, len(fields.t) - 1, kept).round().astype(int))
    u = fields.displacement[at]
    largest = float(abs(u).max()) or 1.0
    order, bodies = _outline(fields), bodies_of(run)
    factor = 1 if bodies else _factor(fields)  # multiplied, a gap closes before it should
    (x0, y0), (x1, y1) = _box(fields.points + factor * u, bodies)
    return {
        "name": run.name,
        "clock": "load factor" if "rest" in run.record.recipe else "µs",
        "t": fields.t[at].tolist(),
        "corners": len(order),
        "cells": _base64(fields.cells[:, order].astype("<u4")),
        "points": _base64(fields.points.astype("<f4")),
        "motion": _base64(np.rint(32767.0 * u / largest).astype("<i2")),
        "largest": largest,
        "box": [float(value) for value in (x0, y0, x1, y1)],
        "factor": factor,
        "factors": list(_FACTORS),
        "bodies": [
            {"outline": each.outline.round(3).tolist(), "moved": each.moved[at].round(3).tolist()}
            for each in bodies
        ],
        "levels": LEVELS,
        "unknown": UNKNOWN,
        "colours": [_colour(name, unit, values[at]) for name, (unit, values) in colours.items()],
    }


def _colour(name: str, unit: str, values: Array) -> dict[str, Any]:
    if name == "stress source":
        codes = np.nan_to_num(values, nan=UNKNOWN).astype(np.uint8)
        words = {code: list(SOURCES[code]) for code in SOURCES if (codes == code).any()}
        return {"name": name, "sources": words, "data": _base64(codes)}
    stored, low, high = levels_of(values)
    ends = [f"{_shown(low, high):.3g}", f"{high:.3g} {unit}"]
    return {"name": name, "ends": ends, "stops": STOPS, "data": _base64(stored)}


def _shown(low: float, high: float) -> float:
    """The lowest value, zero where it is so but for rounding."""
    return 0.0 if abs(low) < 1e-9 * abs(high) else low


def _factor(fields: StoredFields) -> int:
    """By what displacements are multiplied, so that they are seen."""
    size = float(np.ptp(fields.points, axis=0).max())
    largest = float(np.linalg.norm(fields.displacement, axis=2).max()) or size
    return max((f for f in _FACTORS if f * largest <= 1.5 * _SHOWN * size), default=1)


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _box(reached: Array, bodies: Sequence[DrawnBody]) -> tuple[Array, Array]:
    """Corners of what a picture shows: points (…, 2), with room for bodies."""
    points = reached.reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    room = MARGIN * float((high - low).max()) if bodies else 0.0
    return low - room, high + room


def _still(run: RunData, factor: int) -> str:
    """The tissue where it has moved farthest, by stress, for paper and without the script."""
    name, fields = run.name, run.fields
    assert fields is not None
    k = int(np.linalg.norm(fields.displacement, axis=2).max(axis=1).argmax())
    colours = _colours(fields)
    what = "von Mises stress" if "von Mises stress" in colours else "displacement"
    unit, values = colours[what]
    picture = mesh_picture(fields, values[k], k, factor, bodies=bodies_of(run))
    low, high = np.nanmin(values[k]), np.nanmax(values[k])
    caption = (
        f"{name} where it has moved farthest, t = {fields.t[k]:.4g}, displacement × {factor}; "
        f"{what} from {low:.3g} (dark) to {high:.3g} {unit} (bright)"
    )
    return figure(picture, caption)


def mesh_picture(
    fields: StoredFields,
    values: Array,
    k: int,
    factor: float = 1.0,
    ends: tuple[float, float] | None = None,
    bodies: Sequence[DrawnBody] = (),
) -> str:
    """Cells at time k coloured by values (e,) from the lowest to the highest, or between ends."""
    at = fields.points + factor * fields.displacement[k]
    low, high = _box(at, bodies)
    size = high - low
    shape = make_figure([], (_WIDTH, max(_WIDTH * float(size[1] / (size[0] or 1.0)), 0.5)))
    axes = shape.subplots()
    axes.axis("off")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for body in bodies:
        axes.fill(*body.at(k, factor).T, facecolor="0.8", edgecolor="0.5", linewidth=0.8)
    corners = [*at[fields.cells[:, _outline(fields)]]]
    width = 0.3 * (len(corners) < _SIDES)
    cells: Collection = PolyCollection(corners, edgecolors="0.5", linewidths=width)
    if fields.cells.shape[1] == 2:  # the springs of a full tissue
        cells = LineCollection(corners, linewidths=0.8)
    cells.set(array=values, cmap=_COLOURS, clim=ends or (np.nanmin(values), np.nanmax(values)))
    axes.add_collection(cells)
    return image(drawn(shape), "the mesh", "png")


def _outline(fields: StoredFields) -> list[int]:
    """Order of an element's nodes along its sides."""
    corners = fields.cells.shape[1]
    return [0, 3, 1, 4, 2, 5] if corners == 6 else [*range(corners)]


def levels_of(values: NDArray[np.float64]) -> tuple[NDArray[np.uint8], float, float]:
    """Values as stored numbers, with the lowest and highest value; NaN is unknown."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    width = high - low or 1.0
    share = np.clip((np.nan_to_num(values, nan=low) - low) / width, 0.0, 1.0)
    stored = np.rint(LEVELS * share).astype(np.uint8)
    stored[~np.isfinite(values)] = UNKNOWN
    return stored, low, high


MARGIN = 0.08
"""Room about a tissue with bodies, as a share of its size."""
_ARC = 48
"""Sides of a drawn circle."""


@dataclass(frozen=True, slots=True)
class DrawnBody:
    """A body at the times of the fields.

    Attributes:
        outline: (n, 2) where it began, a plane's and a corner's cut off far from the tissue, µm.
        moved: (m, 2) how far it is from there, µm.
    """

    outline: Array
    moved: Array

    def at(self, k: int, factor: float) -> Array:
        """(n, 2) outline at time k, its displacement multiplied as the tissue's is."""
        return self.outline + factor * self.moved[k]


def bodies_of(run: RunData) -> list[DrawnBody]:
    """The bodies of a run with fields."""
    fields, history = run.fields, run.run.history
    if fields is None:
        return []
    far = 4.0 * float(np.ptp(fields.points, axis=0).max())
    bodies = []
    for name, stated in run.record.recipe.get("bodies", {}).items():
        body = body_of(name, stated)
        moved = np.zeros((len(fields.t), 2))
        if f"position {name} x" in history:  # counted from where the body began
            position = [history[f"position {name} {axis}"] for axis in "xy"]
            moved = np.stack(
                [np.interp(fields.t, run.run.curve.t, each) for each in position], axis=1
            )
        bodies.append(DrawnBody(np.array(body.position) + outline(body.shape, far), moved))
    return bodies


def outline(shape: Shape, far: float) -> Array:
    """(n, 2) closed line of a shape about its position, cut off at a distance of some `far`, µm."""
    if isinstance(shape, Plane):
        x, y = np.array(shape.normal) / np.linalg.norm(shape.normal)
        along, inward = far * np.array([-y, x]), -far * np.array([x, y])
        return np.stack([along, -along, inward - along, inward + along])
    if isinstance(shape, Circle):
        turn = 2.0 * np.pi * np.arange(_ARC) / _ARC
        return shape.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    assert isinstance(shape, Corner)
    x, y, cosine, sine, radius = shape.wedge
    axis, across = np.array([x, y]), np.array([-y, x])
    half = np.arctan2(sine, cosine)
    turn = np.linspace(half + 0.5 * np.pi, 1.5 * np.pi - half, _ARC)[:, None]
    arc = radius * (axis + np.cos(turn) * axis + np.sin(turn) * across)
    ends = [arc[k] + far * (cosine * axis + side * sine * across) for k, side in ((0, 1), (-1, -1))]
    return np.vstack([ends[0], arc, ends[1]])
