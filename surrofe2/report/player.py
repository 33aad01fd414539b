"""What a page has of runs, and the tissue in motion: arrays for the script, a picture for paper."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surrofe2.law.stress_law import SURROGATE, TABLE, Status
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.report.comparison import Comparison
from surrofe2.report.figures import Colours, DrawnBody, box, draw_tissue, drawn_bodies, rim
from surrofe2.report.html import figure, grid, image, missing
from surrofe2.run.charts import encoded
from surrofe2.store.fields import SOURCE_NAME, StoredFields
from surrofe2.store.run_folder import RunRecord, StoredRun

Array = NDArray[np.float64]

VON_MISES, WALL_STRETCH = "von_mises_in_plane_uN_per_um", "largest_wall_stretch"
OF_ELEMENTS = (VON_MISES, SOURCE_NAME, WALL_STRETCH)
"""What a page shows of elements."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunData:
    """A run as a page shows it; what its folder lacks is None or empty.

    `particles` are PNGs of looks into the plant cells, by the names of their folders."""

    run: StoredRun
    fields: StoredFields | None = None
    events: Sequence[Mapping[str, Any]] = ()
    particles: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """That of its folder."""
        return self.run.name

    @property
    def record(self) -> RunRecord:
        """What run.json says."""
        return self.run.record


@dataclass(frozen=True, slots=True)
class ReportData:
    """All that a page is made of: runs, the reference first, and their comparison or why there is
    none."""

    runs: tuple[RunData, ...]
    comparison: Comparison | None = None
    why_not: str = ""


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
"""Fraction of the tissue's size that the largest displacement is drawn with at first, about."""
_FACTORS = (1, 2, 5, 10, 20, 50, 100)
_WIDTH = 4.4
"""Of a picture of the tissue, inches."""


def motion_section(runs: tuple[RunData, ...]) -> tuple[list[str], list[dict[str, Any]]]:
    """Parts of the section, and what the script needs of each run."""
    shown = [each for each in runs if each.fields is not None]
    parts = [
        missing(f"{each.name}: no fields in its folder, so its motion is not shown.")
        for each in runs
        if each.fields is None
    ]
    data = [_arrays(each, _BUDGET // len(shown)) for each in shown]
    if data:
        parts.insert(0, _PLAYER)
    stills = [_still(each, arrays["factor"]) for each, arrays in zip(shown, data, strict=True)]
    return [*parts, f'<div class="still">{grid(stills)}</div>'], data


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


def _quantities(fields: StoredFields) -> dict[str, tuple[str, Array]]:
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


def _arrays(run: RunData, budget: int) -> dict[str, Any]:
    """A run for the script, as many times as the budget has room for, as bytes in base64:
    displacements are 16-bit fractions of the largest component, values 8-bit levels."""
    fields = run.fields
    assert fields is not None
    quantities = _quantities(fields)
    each = 4 * len(fields.points) + len(quantities) * len(fields.cells)
    kept = max(2, min(len(fields.t), budget // max(each, 1)))
    at = np.unique(np.linspace(0, len(fields.t) - 1, kept).round().astype(int))
    u = fields.displacement[at]
    largest = float(abs(u).max()) or 1.0
    order, bodies = rim(fields), bodies_of(run)
    factor = 1 if bodies else _factor(fields)  # multiplied, a gap closes before it should
    (x0, y0), (x1, y1) = box(fields.points + factor * u, bodies)
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
        "colours": [_colour(name, unit, values[at]) for name, (unit, values) in quantities.items()],
    }


def _colour(name: str, unit: str, values: Array) -> dict[str, Any]:
    if name == "stress source":
        codes = np.nan_to_num(values, nan=UNKNOWN).astype(np.int16).astype(np.uint8)
        shown = {int(code) % 256: list(each) for code, each in SOURCES.items()}  # one byte each
        words = {code: shown[code] for code in shown if (codes == code).any()}
        return {"name": name, "sources": words, "data": _base64(codes)}
    colours = Colours.of(unit, values)
    low, high = colours.low, colours.high
    fraction = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    stored = np.rint(LEVELS * fraction).astype(np.uint8)
    stored[~np.isfinite(values)] = UNKNOWN
    ends = [f"{low:.4g}", f"{high:.4g} {unit}"]
    return {"name": name, "ends": ends, "stops": STOPS, "data": _base64(stored)}


def _factor(fields: StoredFields) -> int:
    """By what displacements are multiplied, so that they are seen."""
    size = float(np.ptp(fields.points, axis=0).max())
    largest = float(np.linalg.norm(fields.displacement, axis=2).max()) or size
    return max((f for f in _FACTORS if f * largest <= 1.5 * _SHOWN * size), default=1)


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def bodies_of(run: RunData) -> list[DrawnBody]:
    """The bodies of a run with fields."""
    if run.fields is None:
        return []
    stated = run.record.recipe.get("bodies", {})
    bodies = [RigidBody.read(f"bodies.{name}", table) for name, table in stated.items()]
    return drawn_bodies(bodies, run.run.curve.t, run.run.history, run.fields)


def _still(run: RunData, factor: int) -> str:
    """The tissue where it has moved farthest, by stress, for paper and without the script."""
    fields = run.fields
    assert fields is not None
    k = int(np.linalg.norm(fields.displacement, axis=2).max(axis=1).argmax())
    quantities = _quantities(fields)
    what = "von Mises stress" if "von Mises stress" in quantities else "displacement"
    unit, values = quantities[what]
    picture = tissue_image(run, k, values[k], Colours.of(f"{what} ({unit})", values[k]), factor)
    clock = "load factor {:.4g}" if "rest" in run.record.recipe else "t = {:.4g} µs"
    caption = f"{run.name} where it has moved farthest, {clock.format(fields.t[k])}"
    return figure(picture, f"{caption}; displacement × {factor}" if factor > 1 else caption)


def tissue_image(run: RunData, k: int, values: Array, colours: Colours, factor: float = 1.0) -> str:
    """The tissue of a run at time k coloured by the values of its elements, with a colour bar."""
    fields, bodies = run.fields, bodies_of(run)
    assert fields is not None
    low, high = box(fields.points + factor * fields.displacement[k], bodies)
    height = float(np.clip((high - low)[1] / ((high - low)[0] or 1.0), 0.3, 1.5)) * (_WIDTH - 1.0)
    shown = Figure(figsize=(_WIDTH, height + 0.4), layout="constrained")
    axes = shown.subplots()
    drawn = draw_tissue(axes, fields, k, values, colours, factor=factor, bodies=bodies)
    colours.bar(axes, drawn)
    return image(encoded(shown, "png"), f"the tissue of {run.name} by {colours.label}", "png")
