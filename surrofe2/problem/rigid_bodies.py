"""Rigid bodies that tissue comes into contact with: a plane, a circle, a rounded corner.

A body translates without turning. At points p relative to the body's position, a shape has a gap
(positive outside), its gradient n, which is the outward normal, and the curvature κ of its level
line, so that ∂n/∂p = κ (I − n nᵀ).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import (
    Faults,
    build,
    build_only,
    check_settings,
    check_table,
    setting,
    with_kind,
)
from surrofe2.base.units import ACCELERATION, LENGTH, MASS, NONE
from surrofe2.problem.amplitude import IN_TIME, ONE, Amplitude
from surrofe2.problem.contact_law import gap

# A rounded wedge as six numbers: axis (two), cosine, sine, radius and reach, see `contact_law.gap`.
Outline = tuple[float, float, float, float, float, float]


class Shape(ABC):
    """The outline of a rigid body, a rounded wedge."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_settings(self, type(self).__name__.lower())
        _ = self.outline  # raises for a direction without length

    @property
    @abstractmethod
    def outline(self) -> Outline:
        """The six numbers that `contact_law.gap` takes."""

    def gap(self, p: Array) -> tuple[Array, Array, Array]:
        """Compute gaps (n,) in µm, outward normals (n, 2), and curvatures (n,) in 1/µm.

        Args:
            p: (n, 2) points relative to the body's position, µm.
        """
        gaps = np.empty(len(p))
        normals = np.empty((len(p), 2))
        curvatures = np.empty(len(p))
        points = np.ascontiguousarray(p, dtype=np.float64)
        set_gaps(points, self.outline, (gaps, normals, curvatures))
        return gaps, normals, curvatures


@kernel
def set_gaps(p: Any, outline: Any, results: Any) -> None:
    """Set the three arrays of `Shape.gap`, in place, at points p (n, 2)."""
    distance, normal, curvature = results
    for k in range(p.shape[0]):
        distance[k], normal[k, 0], normal[k, 1], curvature[k] = gap(p[k, 0], p[k, 1], outline)


def _unit(where: str, vector: tuple[float, float]) -> tuple[float, float]:
    """Return the vector divided by its length; `where` names it in the error of a zero one."""
    length = math.hypot(*vector)
    if not length > 0.0:
        raise InputError(where, f"{list(vector)}; it must not be zero")
    return vector[0] / length, vector[1] / length


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane(Shape):
    """A half plane behind the body's position; `normal` points out of it."""

    normal: tuple[float, float] = setting(about="vector out of the body, of any length")

    @property
    def outline(self) -> Outline:
        x, y = _unit("plane.normal", self.normal)
        return -x, -y, 0.0, 1.0, 0.0, 0.0  # a wedge of twice 90°, without rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle(Shape):
    """A disc about the body's position."""

    radius: float = setting(about="radius of the disc", unit=LENGTH, above=0.0)

    @property
    def outline(self) -> Outline:
        return 0.0, 0.0, 1.0, 0.0, self.radius, math.inf  # the rounding of a tip, all around


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner(Shape):
    """A wedge with a rounded tip, which is the body's position; `axis` points into the body."""

    axis: tuple[float, float] = setting(about="vector from the tip into the body, of any length")
    angle: float = setting(about="angle between its sides", unit="°", above=0.0, below=180.0)
    radius: float = setting(about="radius of the rounding", unit=LENGTH, above=0.0)

    @property
    def outline(self) -> Outline:
        half = math.radians(0.5 * self.angle)
        axis_x, axis_y = _unit("corner.axis", self.axis)
        return axis_x, axis_y, math.cos(half), math.sin(half), self.radius, 0.0


SHAPES: dict[str, type[Shape]] = {"plane": Plane, "circle": Circle, "corner": Corner}


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidBody:
    """A rigid body that a boundary of the tissue may touch.

    It flies freely if it has a `mass`; else it follows `displacement` times `amplitude`.

    Attributes:
        shape: the outline of the body; the settings below describe the other fields.
    """

    name: str = setting("body", "by which results call it")
    shape: Shape
    on: str = setting(about="boundary of the tissue that may touch it")
    position: tuple[float, float] = setting(about="position at t = 0", unit=LENGTH)
    displacement: tuple[float, float] = setting((0.0, 0.0), "largest displacement", LENGTH)
    amplitude: Amplitude = setting(ONE, IN_TIME)
    mass: float | None = setting(
        None, "mass of a free body, per thickness of the sheet", MASS, above=0.0
    )
    velocity: tuple[float, float] = setting((0.0, 0.0), "velocity of a free body at t = 0", "µm/µs")
    acceleration: tuple[float, float] = setting(
        (0.0, 0.0), "force per mass on a free body", ACCELERATION
    )
    friction: float = setting(0.0, "Coulomb's coefficient", NONE, least=0.0, most=10.0)
    stiffness: float | None = setting(
        None, "contact pressure per penetration; left out: 200 × tissue modulus / element side",
        "µN/µm²", above=0.0,
    )  # fmt: skip
    smoothing: float | None = setting(
        None, "penetration over which contact sets in; left out: where the pressure is "
        "1/50 of the tissue's modulus, of that at constant area where the sap is undrained and a "
        "stiffness is stated", LENGTH, above=0.0,
    )  # fmt: skip
    damping: float | None = setting(
        None, "contact pressure per speed of closing, fully in where contact has set in; left out: "
        "half of the critical one of the tissue's boundary", "µN µs/µm²", least=0.0,
    )  # fmt: skip
    slip_speed: float | None = setting(
        None, "sliding speed at which friction is 0.7 of its limit, below which points creep; left "
        "out: points stick until they slip", "µm/µs", above=0.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        where = f"bodies.{self.name}"
        check_settings(self, where)
        if self.mass is not None and self.displacement != (0.0, 0.0):
            raise InputError(
                where,
                f"mass {self.mass} and displacement {list(self.displacement)}; "
                "a body is either free, with a mass, or moved",
            )
        for name, value in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            if self.mass is None and value != (0.0, 0.0):
                raise InputError(
                    f"{where}.{name}",
                    f"{list(value)}; it is of a free body: give a mass, "
                    "or a displacement with its amplitude",
                )

    @staticmethod
    def read(where: str, entry: Any) -> RigidBody:
        """Read a body that a recipe states in its section of bodies, with all faults at once."""
        faults = Faults()
        check_table(where, entry)
        shapes = {key: entry[key] for key in SHAPES if key in entry}
        others = {key: value for key, value in entry.items() if key not in SHAPES}
        name = where.removeprefix("bodies.")
        shape = faults.take(build_only, SHAPES, shapes, where)
        if "amplitude" in entry and "displacement" not in entry:
            with faults.noted():
                raise InputError(
                    f"{where}.amplitude",
                    f"{quoted(entry['amplitude'])}; it is of a displacement, which is missing",
                )
        with faults.noted():
            body = build(RigidBody, others, where, SHAPES, name=name, shape=shape)
        faults.check()
        return body

    def entry(self) -> dict[str, Any]:
        """Return the table that states this body in a recipe, under its name."""
        entries = asdict(self)
        del entries["name"]
        del entries["shape"]
        entries["amplitude"] = self.amplitude.entry()
        kind, shape = with_kind(self.shape, SHAPES)
        entries[kind] = shape
        return entries

    @property
    def moves(self) -> bool:
        """True if the body follows an amplitude; else it rests or flies freely."""
        return self.mass is None and any(self.displacement)


def check_outside(body: str, shape: Shape, position: Array, points: Array, allowed: float) -> None:
    """Check that a body does not begin with a tissue inside it.

    Args:
        body: name of the body.
        shape: its outline.
        position: (2,) its position, µm.
        points: (n, 2) points of the tissue, µm.
        allowed: depth inside the body that a point may have, µm.

    Raises:
        InputError: a point is deeper; the message names the deepest.
    """
    gaps, _, _ = shape.gap(points - position)
    deepest = int(gaps.argmin())
    if gaps[deepest] < -allowed:
        x, y = points[deepest]
        raise InputError(
            f"bodies.{body}.position",
            f"{position.tolist()}; the tissue begins {-gaps[deepest]:.3g} "
            f"µm inside it, at ({x:.6g}, {y:.6g}) µm; it must begin outside",
        )
