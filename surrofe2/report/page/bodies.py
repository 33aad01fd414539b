"""Rigid bodies over time, as closed lines beside the deformed tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.problem.entries import body_of
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, Shape
from surrofe2.report.page.seen import SeenRun

Array = NDArray[np.float64]

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


def bodies_of(run: SeenRun) -> list[DrawnBody]:
    """The bodies of a run with fields."""
    fields, history = run.fields, run.run.history
    if fields is None:
        return []
    far = 4.0 * float(np.ptp(fields.points, axis=0).max())
    found = []
    for name, stated in run.record.recipe.get("bodies", {}).items():
        body = body_of(name, stated)
        moved = np.zeros((len(fields.t), 2))
        if f"position {name} x" in history:  # counted from where the body began
            told = [history[f"position {name} {axis}"] for axis in "xy"]
            moved = np.stack([np.interp(fields.t, run.run.curve.t, each) for each in told], axis=1)
        found.append(DrawnBody(np.array(body.position) + outline(body.shape, far), moved))
    return found


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
