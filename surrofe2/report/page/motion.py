"""The deformed tissue: arrays for the script, and a still picture for paper."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.report.page.bodies import MARGIN, DrawnBody, bodies_of
from surrofe2.report.page.colours import (
    LEVELS,
    NO_COLOUR,
    SOURCES,
    STOPS,
    UNKNOWN,
    colour_of,
    levels_of,
)
from surrofe2.report.page.html import figure, grid, missing, section
from surrofe2.report.page.seen import VON_MISES, WALL_STRETCH, Seen, SeenRun
from surrofe2.store.fields import SOURCE_NAME, StoredFields

Array = NDArray[np.float64]

_BUDGET = 1_200_000
"""Bytes of all animations together, before base64."""
_STILL = 12_000
"""Cells that a still picture has at most."""
_OUTLINE = {6: [0, 3, 1, 4, 2, 5]}
"""Order of a triangle's nodes along its sides."""
_SHOWN = 0.08
"""Share of the tissue's size that the largest displacement is drawn with at first, about."""
_FACTORS = (1, 2, 5, 10, 20, 50, 100)
_WIDTH, _BANDS = 360, 24


def motion_section(seen: Seen) -> tuple[str, list[dict[str, Any]]]:
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
    found = {"displacement": ("µm", size[:, fields.cells].mean(axis=2))}
    for name, unit, key in (
        ("von Mises stress", "µN/µm", VON_MISES),
        ("largest wall stretch", "length / rest length", WALL_STRETCH),
        ("stress source", "", SOURCE_NAME),
    ):
        if key in fields.values:
            found[name] = unit, fields.values[key]
    return found


def _arrays(run: SeenRun, budget: int) -> dict[str, Any]:
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
    order = _OUTLINE.get(fields.cells.shape[1], list(range(fields.cells.shape[1])))
    bodies = bodies_of(run)
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


def _still(run: SeenRun, factor: int) -> str:
    """The tissue where it has moved farthest, by stress, for paper and without the script."""
    name, fields = run.name, run.fields
    assert fields is not None
    if len(fields.cells) > _STILL:
        return missing(
            f"{name}: {len(fields.cells):,} cells of the mesh; a still picture is left out."
        )
    k = int(np.linalg.norm(fields.displacement, axis=2).max(axis=1).argmax())
    colours = _colours(fields)
    what = "von Mises stress" if "von Mises stress" in colours else "displacement"
    unit, values = colours[what]
    drawn = mesh_picture(fields, values[k], k, factor, bodies=bodies_of(run))
    low, high = np.nanmin(values[k]), np.nanmax(values[k])
    caption = (
        f"{name} where it has moved farthest, t = {fields.t[k]:.4g}, displacement × {factor}; "
        f"{what} from {low:.3g} (dark) to {high:.3g} {unit} (bright)"
    )
    return figure(drawn, caption)


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
    scale = (_WIDTH - 8) / float((high - low).max() or 1.0)
    height = 8.0 + scale * float(high[1] - low[1])

    def on_page(points: Array) -> NDArray[np.int64]:
        """In tenths of a pixel, y downward."""
        found = np.rint(10.0 * (4.0 + scale * (points - low))).astype(int)
        found[:, 1] = round(10.0 * height) - found[:, 1]
        return found

    place = on_page(at)
    first, last = ends or (float(np.nanmin(values)), float(np.nanmax(values)))
    band = np.floor(_BANDS * (values - first) / ((last - first) or 1.0)).clip(0, _BANDS - 1)
    corners = fields.cells.shape[1]
    order = _OUTLINE.get(corners, list(range(corners)))
    paths = []
    for body in bodies:
        words = "L".join(f"{x / 10:g} {y / 10:g}" for x, y in on_page(body.at(k, factor)).tolist())
        paths.append(f'<path class="body" d="M{words}z"/>')
    for each in np.unique(band[np.isfinite(band)]):
        outlines = place[fields.cells[band == each][:, order]]
        closed = "z" if corners > 2 else ""
        words = "".join(
            "M" + "L".join(f"{x / 10:g} {y / 10:g}" for x, y in outline.tolist()) + closed
            for outline in outlines
        )
        kind = "cells" if corners > 2 else "springs"
        colour = colour_of((each + 0.5) / _BANDS)
        paint = f'fill="{colour}"' if corners > 2 else f'stroke="{colour}"'
        paths.append(f'<path class="{kind}" {paint} d="{words}"/>')
    if np.isnan(band).any() and corners > 2:
        unknown = place[fields.cells[np.isnan(band)][:, order]].tolist()
        words = "".join(
            "M" + "L".join(f"{x / 10:g} {y / 10:g}" for x, y in each) + "z" for each in unknown
        )
        paths.append(f'<path class="cells" fill="{NO_COLOUR}" d="{words}"/>')
    return (
        f'<svg class="mesh" viewBox="0 0 {_WIDTH} {height:.0f}" role="img" aria-label="the mesh">'
        f"{''.join(paths)}</svg>"
    )
