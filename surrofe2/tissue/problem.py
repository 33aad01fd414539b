"""What happens to a rectangle of tissue: supports, loads, rigid bodies; the bar is one of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.load_case import LoadCase, output_times
from surrofe2.problem.amplitude import ONE, Amplitude, Table
from surrofe2.problem.rigid_bodies import RigidBody

Array = NDArray[np.float64]
Vector = tuple[float, float]


class Part(Protocol):
    """A part of the plane."""

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether each of the points (n, 2) is in it."""


@dataclass(frozen=True, slots=True)
class Line:
    """All points with x or y (axis 0 or 1) at a value, µm."""

    axis: int
    value: float

    def holds(self, points: Array) -> NDArray[np.bool_]:
        near: NDArray[np.bool_] = abs(points[:, self.axis] - self.value) < 1e-6
        return near


@dataclass(frozen=True, slots=True, kw_only=True)
class Support:
    """Particles that are held, or follow `displacement` times an amplitude.

    Attributes:
        on: a boundary, of which wall particles are held, or a region, of which all are.
        components: whether it takes x and y.
    """

    name: str
    on: str
    components: tuple[bool, bool] = (True, True)
    displacement: Vector = (0.0, 0.0)
    amplitude: Amplitude = ONE

    @property
    def moves(self) -> bool:
        """Whether it ever does."""
        return any(self.displacement)


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """A dead load: force per mass of plant cells, or per unloaded length of a boundary.

    Attributes:
        on: of a traction its boundary, of an acceleration a region or all plant cells.
    """

    name: str
    acceleration: Vector = (0.0, 0.0)
    traction: Vector = (0.0, 0.0)
    on: str | None = None
    amplitude: Amplitude = ONE


@dataclass(frozen=True, slots=True, kw_only=True)
class Pressure:
    """A follower load: force per current length of a boundary, against the outward normal."""

    name: str
    on: str
    pressure: float
    amplitude: Amplitude = ONE


@dataclass(frozen=True, slots=True, kw_only=True)
class Foundation:
    """Springs (µN/µm²) and dashpots (µN µs/µm²) per unloaded length of a boundary to a base."""

    name: str
    on: str
    stiffness: float = 0.0
    damping: float = 0.0
    components: tuple[bool, bool] = (True, True)
    amplitude: Amplitude = ONE


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueProblem:
    """A rectangle [0, width] × [0, height] of plant cells and what happens to it.

    Attributes:
        boundaries: parts of its outline by name. regions: of its plant cells, by their middles.
        kind: (n, m) type of each plant cell; None: there is one.
        velocities: (boundary, region or None, velocity) at t = 0 of what moves freely, µm/µs.
        watched: reference positions by name, µm; each means the nearest particle.
    """

    width: float
    height: float
    boundaries: Mapping[str, Part]
    regions: Mapping[str, Part] = field(default_factory=dict)
    kind: NDArray[np.int64] | None = None
    supports: tuple[Support, ...] = ()
    loads: tuple[Load | Pressure | Foundation, ...] = ()
    bodies: tuple[RigidBody, ...] = ()
    velocities: tuple[tuple[str | None, Vector], ...] = ()
    duration: float
    output_interval: float
    watched: Mapping[str, Vector]

    @property
    def moved_bodies(self) -> tuple[RigidBody, ...]:
        """Those that follow an amplitude."""
        return tuple(each for each in self.bodies if each.moves)

    @property
    def motions(self) -> tuple[Amplitude, ...]:
        """Amplitudes of supports that move, then of bodies that do."""
        supports = tuple(each.amplitude for each in self.supports if each.moves)
        return supports + tuple(each.amplitude for each in self.moved_bodies)

    @property
    def acting(self) -> list[str]:
        """Names of all that exerts a force: supports, loads, bodies."""
        found = [each.name for each in self.supports] + [each.name for each in self.loads]
        return found + [each.name for each in self.bodies]

    def places(self) -> list[str]:
        """Boundaries that something acts on."""
        used = {each.on for each in (*self.supports, *self.loads, *self.bodies)}
        return [name for name in self.boundaries if name in used]

    def output_times(self) -> Array:
        """(m,) times in µs at which results are kept."""
        return output_times(self.duration, self.output_interval)


def middles_of(cells: tuple[int, int], side: float) -> Array:
    """(n m, 2) middles of n × m plant cells, column by column, µm."""
    corners: Array = np.indices(cells).reshape(2, -1).T.astype(np.float64)
    return side * (corners + 0.5)


def outline(width: float, height: float) -> dict[str, Part]:
    """The four sides of a rectangle by name."""
    return {
        "left": Line(0, 0.0), "right": Line(0, width), "bottom": Line(1, 0.0),
        "top": Line(1, height),
    }  # fmt: skip


def as_problem(given: TissueProblem | LoadCase) -> TissueProblem:
    """A load case as the bar that it is: clamped at x = 0 under a body force."""
    if isinstance(given, TissueProblem):
        return given
    amplitude = Table(points=given.amplitude) if given.amplitude else ONE
    return TissueProblem(
        width=given.width,
        height=given.height,
        boundaries=outline(given.width, given.height),
        supports=(Support(name="clamp", on="left"),),
        loads=(Load(name="load", acceleration=given.body_force, amplitude=amplitude),),
        duration=given.duration,
        output_interval=given.output_interval,
        watched={"point": given.watched},
    )
