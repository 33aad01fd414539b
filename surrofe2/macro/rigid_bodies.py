"""Rigid bodies that tissue comes into contact with: a plane, a circle, a rounded corner.

A body translates without turning. A shape gives, at points p relative to the body's position, the
gap (positive outside), its gradient n, which is the outward normal, and the curvature κ of its
level line, so that ∂n/∂p = κ (I − n nᵀ).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.amplitude import ONE, Amplitude
from surrofe2.errors import InputError
from surrofe2.settings import check_settings, setting
from surrofe2.units import ACCELERATION, LENGTH, MASS, NONE

Array = NDArray[np.float64]


class Shape(Protocol):
    """The outline of a rigid body."""

    def gap(self, p: Array) -> tuple[Array, Array, Array]:
        """(n,) gap in µm, (n, 2) outward normal, (n,) curvature in 1/µm at points p (n, 2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A half plane behind the body's position; `normal` points out of it."""

    normal: tuple[float, float] = setting(about="out of the body, of any length")

    def __post_init__(self) -> None:
        check_settings(self, "plane")
        if not np.linalg.norm(self.normal) > 0.0:
            raise InputError(f"plane.normal: {list(self.normal)}; it must not be zero")

    def gap(self, p: Array) -> tuple[Array, Array, Array]:
        """As of `Shape`."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return p @ normal, np.broadcast_to(normal, p.shape), np.zeros(len(p))


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A disc about the body's position."""

    radius: float = setting(about="of the disc", unit=LENGTH, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "circle")

    def gap(self, p: Array) -> tuple[Array, Array, Array]:
        """As of `Shape`."""
        distance = np.maximum(np.linalg.norm(p, axis=1), np.finfo(float).tiny)
        return distance - self.radius, p / distance[:, None], 1.0 / distance


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """A wedge with a rounded tip, which is the body's position; `axis` points into the body."""

    axis: tuple[float, float] = setting(about="from the tip into the body, of any length")
    angle: float = setting(about="between its sides", unit="°", above=0.0, below=180.0)
    radius: float = setting(about="of the rounding", unit=LENGTH, above=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "corner")
        if not np.linalg.norm(self.axis) > 0.0:
            raise InputError(f"corner.axis: {list(self.axis)}; it must not be zero")

    def gap(self, p: Array) -> tuple[Array, Array, Array]:
        """As of `Shape`: the distance from a sharp wedge, less the radius."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        across = np.array([-axis[1], axis[0]])
        p = p - self.radius * axis
        sign = np.where(p @ across >= 0.0, 1.0, -1.0)
        half = 0.5 * np.radians(self.angle)
        along = np.cos(half) * axis + np.sin(half) * sign[:, None] * across
        flank = -np.sin(half) * axis + np.cos(half) * sign[:, None] * across
        distance = np.maximum(np.linalg.norm(p, axis=1), np.finfo(float).tiny)
        at_tip = np.einsum("ni,ni->n", p, along) < 0.0
        gap = np.where(at_tip, distance, np.einsum("ni,ni->n", p, flank)) - self.radius
        normal = np.where(at_tip[:, None], p / distance[:, None], flank)
        return gap, normal, np.where(at_tip, 1.0 / distance, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidBody:
    """A rigid body that a boundary of the tissue may touch.

    It flies freely if it has a `mass`; else it follows `displacement` times `amplitude`.

    Attributes:
        shape: its outline.
    """

    name: str = setting("body", "by which results call it")
    shape: Shape
    on: str = setting(about="boundary of the tissue that may touch it")
    position: tuple[float, float] = setting(about="at t = 0", unit=LENGTH)
    displacement: tuple[float, float] = setting((0.0, 0.0), "largest displacement", LENGTH)
    amplitude: Amplitude = ONE
    mass: float | None = setting(
        None, "of a free body, per thickness of the sheet", MASS, above=0.0
    )
    velocity: tuple[float, float] = setting((0.0, 0.0), "of a free body at t = 0", "µm/µs")
    acceleration: tuple[float, float] = setting(
        (0.0, 0.0), "force per mass on a free body", ACCELERATION
    )
    friction: float = setting(0.0, "Coulomb's coefficient", NONE, least=0.0, most=10.0)
    stiffness: float | None = setting(
        None, "contact pressure per penetration; left out: 200 moduli of the tissue a side of "
        "an element", "µN/µm²", above=0.0,
    )  # fmt: skip
    smoothing: float | None = setting(
        None, "penetration over which contact sets in; left out: where the pressure is "
        "1/50 of the tissue's modulus", LENGTH, above=0.0,
    )  # fmt: skip
    damping: float | None = setting(
        None, "contact pressure per speed of closing, fully in where contact has set in; left out: "
        "half of the critical one of the tissue's boundary", "µN µs/µm²", least=0.0,
    )  # fmt: skip
    slip_speed: float | None = setting(
        None, "sliding speed at which friction is 0.7 of its limit; left out: a thousandth of the "
        "tissue's wave speed", "µm/µs", above=0.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self, f"bodies.{self.name}")
        moved = self.displacement != (0.0, 0.0)
        if self.mass is not None and moved:
            raise InputError(
                f"bodies.{self.name}: mass {self.mass} and displacement {list(self.displacement)}; "
                "a body is either free, with a mass, or moved"
            )
        for name, value in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            if self.mass is None and value != (0.0, 0.0):
                raise InputError(
                    f"bodies.{self.name}.{name}: {list(value)}; it is of a free body: give a mass, "
                    "or a displacement with its amplitude"
                )
