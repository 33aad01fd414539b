"""Regions of the plane, by which boundaries, and regions of a tissue, get their names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import LENGTH

Array = NDArray[np.float64]


class Part(Protocol):
    """A part of the plane."""

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether each of the points (n, 2) is in it."""


@dataclass(frozen=True, slots=True)
class Box:
    """x from low[0] to high[0], y from low[1] to high[1], edges included, µm."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """As of `Part`; rounding of 1e-9 of the box is forgiven."""
        low, high = np.array(self.low), np.array(self.high)
        width = high - low
        slack = 1e-9 * np.max(width[np.isfinite(width)], initial=1.0)
        return ((points >= low - slack) & (points <= high + slack)).all(axis=1)


@dataclass(frozen=True, slots=True)
class HalfPlane:
    """All points p with (p − through)·normal ≥ 0, µm."""

    through: tuple[float, float] = setting(about="a point of its edge", unit=LENGTH)
    normal: tuple[float, float] = setting(about="pointing into it")

    def __post_init__(self) -> None:
        check_settings(self, "half_plane")
        if not any(self.normal):
            raise InputError("half_plane.normal", f"{list(self.normal)}; it must not be zero")

    def holds(self, points: Array) -> NDArray[np.bool_]:
        slack = 1e-9 * abs(points).max(initial=1.0)
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (points - np.array(self.through)) @ normal >= -slack


@dataclass(frozen=True, slots=True)
class Disc:
    """All points at most `radius` from the centre, µm."""

    centre: tuple[float, float] = setting(about="its middle", unit=LENGTH)
    radius: float = setting(about="of its edge", unit=LENGTH, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "circle")

    def holds(self, points: Array) -> NDArray[np.bool_]:
        distance = np.linalg.norm(points - np.array(self.centre), axis=1)
        return distance <= self.radius * (1.0 + 1e-9)
