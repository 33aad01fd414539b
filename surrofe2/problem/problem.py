"""What is computed: a mesh, what acts on it, for how long, and what is watched."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.problem.amplitude import Amplitude, Constant
from surrofe2.problem.conditions import (
    Condition,
    DrivenCondition,
    InitialVelocity,
    PrescribedMotion,
    Surface,
)
from surrofe2.problem.mesh import check_mesh, extent, with_boundaries, with_regions
from surrofe2.problem.regions import Part
from surrofe2.problem.rigid_bodies import RigidBody

Array = NDArray[np.float64]

MOST_ROWS = 1_000_000
SURFACE = "surface"
TAKEN = (
    "kinetic", "internal", "elastic", "dissipated", "balance", "motion", "numerical", "contact",
    "contact dissipated", SURFACE,
)  # fmt: skip
"""Names of energies, which no condition may have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A tissue and what happens to it.

    Attributes:
        mesh: a `skfem.MeshQuad1`, `MeshTri1` or `MeshTri2` in µm with named boundaries and
            subdomains; three-node triangles get the middles of their sides.
        conditions: supports, loads, initial velocity.
        bodies: rigid bodies that touch it.
        duration: length of the run, µs.
        output_interval: time between rows of the results, µs.
        watched: reference positions whose displacement is recorded, µm, by name; the first is
            the one of the displacement curve. The tissue's middle if there is none.
        boundaries, regions: more of them, by name the part of the plane that holds the ends of
            outer sides, or centres of elements; of a full tissue wall particles, or middles of
            plant cells.
        surface: free sides with a surface law, under which the tissue comes to rest before the
            run; displacements count from there. None: there are none. A full tissue needs none.

    Raises:
        InputError: as of `check_mesh`; two things have one name, or a number is out of range.
    """

    mesh: skfem.Mesh
    conditions: tuple[Condition, ...]
    bodies: tuple[RigidBody, ...] = ()
    duration: float = 250.0
    output_interval: float = 0.5
    watched: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    boundaries: Mapping[str, Part] = field(default_factory=dict)
    regions: Mapping[str, Part] = field(default_factory=dict)
    surface: Surface | None = None

    def __post_init__(self) -> None:
        mesh = with_boundaries(check_mesh(self.mesh), **self.boundaries)
        object.__setattr__(self, "mesh", with_regions(mesh, **self.regions))
        self._check_times()
        _check_all(Condition, self.conditions)
        _check_all(RigidBody, self.bodies)
        if not isinstance(self.surface, Surface | None):
            raise InputError(f"problem.surface: {quoted(self.surface)}; it must be a Surface")
        for amplitude in self.amplitudes():
            if not isinstance(amplitude, Amplitude):
                raise InputError(
                    f"problem: amplitude: {quoted(amplitude)}; it must be an Amplitude, as Table"
                )
        self._check_names()
        if not self.watched:
            middle = 0.5 * np.add(*extent(self.mesh))
            x, y = self.mesh.p[:, abs(self.mesh.p.T - middle).sum(axis=1).argmin()]
            object.__setattr__(self, "watched", {"middle": (float(x), float(y))})

    def _check_times(self) -> None:
        for name, value in (("duration", self.duration), ("output_interval", self.output_interval)):
            if not 0.0 < value < np.inf:
                raise InputError(f"problem.{name}: {value}; it must be positive and finite (µs)")
        if self.duration > MOST_ROWS * self.output_interval:
            raise InputError(
                f"problem.output_interval: {self.output_interval} µs; it must be at least "
                f"{self.duration / MOST_ROWS:g} µs, a millionth of the duration"
            )

    def _check_names(self) -> None:
        """Results tell conditions, bodies and energies apart by name, velocities by their place."""
        names = Counter([*map(label, self.conditions), *(body.name for body in self.bodies)])
        for name, number in names.items():
            if number > 1:
                raise InputError(f"problem: {number} conditions are called {name}; name them apart")
            if name in TAKEN:
                raise InputError(f"problem: a condition is called {name}; an energy has that name")
        thrown = Counter(each.on for each in self.conditions if isinstance(each, InitialVelocity))
        for place, number in thrown.items():
            if number > 1:
                where = place or "the whole mesh"
                raise InputError(f"problem: {number} initial velocities on {where}; give one")

    def amplitudes(self) -> Iterator[Amplitude]:
        """Those of all conditions and bodies."""
        for condition in self.conditions:
            if isinstance(condition, DrivenCondition):
                yield condition.amplitude
        yield from (body.amplitude for body in self.bodies)

    def check_course(self) -> None:
        """Refuse amplitudes that no run can follow, or that are zero all of it but not constant.

        Raises:
            InputError: a prescribed motion does not begin at 0 or jumps, or a load or a motion is
                zero from the start of the run to its end.
        """
        corners = self.corners().tolist()
        pieces = [*pairwise(corners)]
        driven = [each for each in self.conditions if isinstance(each, DrivenCondition)]
        moved = [body for body in self.bodies if any(body.displacement)]
        for name, amplitude, moves in (
            *((label(each), each.amplitude, isinstance(each, PrescribedMotion)) for each in driven),
            *((body.name, body.amplitude, True) for body in moved),
        ):
            left = 0.0
            for begin, end in pieces if moves else ():
                right = amplitude.at(begin, 0.5 * (begin + end))[0]
                if abs(right - left) > 1e-9:
                    raise InputError(
                        f"{name}.amplitude: jumps from {left:g} to {right:g} at t = {begin:g} µs; "
                        "a prescribed motion must begin at 0 and must not jump"
                    )
                left = amplitude.at(end, 0.5 * (begin + end))[0]
            values = (
                amplitude.at(begin + part * (end - begin), 0.5 * (begin + end))[0]
                for begin, end in pieces
                for part in (0.13, 0.51, 0.77)
            )
            if not isinstance(amplitude, Constant) and not any(values):
                raise InputError(
                    f"{name}.amplitude: zero during the whole run of {self.duration:g} µs; it must "
                    "act before the end, or be left out"
                )

    def places(self) -> set[str | None]:
        """Boundaries and regions that conditions and bodies act on; None: everywhere."""
        return {each.on for each in self.conditions} | {body.on for body in self.bodies}

    def acted_boundaries(self) -> list[str]:
        """Boundaries that conditions and bodies act on, in the order of the mesh."""
        places = self.places()
        return [name for name in self.mesh.boundaries or {} if name in places]

    def corners(self) -> Array:
        """(m,) times in µs at which a step must end, from 0 to the end of the run."""
        inner = [t for amplitude in self.amplitudes() for t in amplitude.corners()]
        inside = [t for t in inner if 0.0 < t < self.duration]
        return np.array(sorted({0.0, *inside, self.duration}))

    @property
    def resolved_by(self) -> float:
        """Longest step (µs) that sees the shape of all amplitudes."""
        return min((each.resolved_by for each in self.amplitudes()), default=np.inf)

    def output_times(self) -> Array:
        """(m,) times in µs at which results are kept: multiples of the interval, and the end."""
        count = int(np.floor(self.duration / self.output_interval * (1.0 + 1e-12)))
        times: Array = self.output_interval * np.arange(count + 1.0)
        return times if np.isclose(times[-1], self.duration) else np.append(times, self.duration)


def label(condition: Condition) -> str:
    """What results call a condition: its name, or its kind and where it acts."""
    if condition.name is not None:
        return condition.name
    return f"{condition.kind()} {condition.on}" if condition.on else condition.kind()


def _check_all(kind: type, given: Any) -> None:
    """Refuse what is no tuple of `kind`, as a single condition is not."""
    is_many = isinstance(given, tuple | list)
    for one in given if is_many else (given,):
        if not (is_many and isinstance(one, kind)):
            raise InputError(f"problem: {quoted(one)}; there must be a tuple of {kind.__name__}")
