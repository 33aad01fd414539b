"""What is computed: a mesh, what acts on it, for how long, and what is watched.

`Support` says which components are held or moved, each owned by one condition.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import skfem

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.problem.amplitude import ONE, Amplitude, Constant, Proportional
from surrofe2.problem.conditions import (
    Condition,
    DrivenCondition,
    Fixed,
    InitialVelocity,
    PrescribedMotion,
    Surface,
    Symmetry,
)
from surrofe2.problem.mesh import (
    Part,
    check_mesh,
    check_name,
    extent,
    nodes_on,
    precision,
    region,
    with_boundaries,
    with_regions,
)
from surrofe2.problem.rigid_bodies import RigidBody

Point = tuple[float, float]

MOST_ROWS = 1_000_000
_PARTS = np.array([0.0, 0.13, 0.51, 0.77, 1.0])
"""Of a piece of an amplitude, where it is looked at."""
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
        InputError: as of `check_mesh` and `check_name`; two conditions have one name, or a number
            is out of range.
    """

    mesh: skfem.Mesh
    conditions: tuple[Condition, ...]
    bodies: tuple[RigidBody, ...] = ()
    duration: float = 250.0
    output_interval: float = 0.5
    watched: Mapping[str, Point] = field(default_factory=dict)
    boundaries: Mapping[str, Part] = field(default_factory=dict)
    regions: Mapping[str, Part] = field(default_factory=dict)
    surface: Surface | None = None

    def __post_init__(self) -> None:
        mesh = with_boundaries(check_mesh(self.mesh), **self.boundaries)
        object.__setattr__(self, "mesh", with_regions(mesh, **self.regions))
        object.__setattr__(self, "watched", self.watched or {"middle": _middle_node(self.mesh)})
        if not 0.0 < self.duration < np.inf:
            raise InputError(f"problem.duration: {self.duration}; it must be positive, finite (µs)")
        least = self.duration / MOST_ROWS
        if not max(least, np.finfo(float).tiny) <= self.output_interval < np.inf:
            raise InputError(
                f"problem.output_interval: {self.output_interval}; it must be finite and at least "
                f"{least:g} µs, a millionth of the duration"
            )
        # Results tell conditions, bodies and energies apart by name.
        names = Counter([*map(label, self.conditions), *(body.name for body in self.bodies)])
        for name, number in names.items():
            if number > 1:
                raise InputError(f"problem: {number} conditions are called {name}; name them apart")
            if name in TAKEN:
                raise InputError(f"problem: a condition is called {name}; an energy has that name")
        for condition in self.conditions:
            if condition.on is not None:
                check_name(self.mesh, condition.on, f"{label(condition)}.on")
        for body in self.bodies:
            check_name(self.mesh, body.on, f"{body.name}.on")
        thrown = Counter(each.on for each in self.conditions if isinstance(each, InitialVelocity))
        for place, number in thrown.items():
            if number > 1:
                where = place or "the whole mesh"
                raise InputError(f"problem: {number} initial velocities on {where}; give one")

    def amplitudes(self) -> list[Amplitude]:
        """Those of all conditions and bodies."""
        driven = [each.amplitude for each in self.conditions if isinstance(each, DrivenCondition)]
        return driven + [body.amplitude for body in self.bodies]

    def check_course(self) -> None:
        """Refuse amplitudes that no run can follow, or that are zero all of it but not constant.

        Raises:
            InputError: a prescribed motion does not begin at 0 or jumps, or a load or a motion is
                zero from the start of the run to its end.
        """
        driven = [each for each in self.conditions if isinstance(each, DrivenCondition)]
        moved = [body for body in self.bodies if any(body.displacement)]
        for name, amplitude, moves in (
            *((label(each), each.amplitude, isinstance(each, PrescribedMotion)) for each in driven),
            *((body.name, body.amplitude, True) for body in moved),
        ):
            values = np.array([
                [amplitude.at(t, 0.5 * (begin + end))[0] for t in begin + _PARTS * (end - begin)]
                for begin, end in pairwise(self.corners())
            ])  # fmt: skip
            before = np.append(0.0, values[:-1, -1])
            jumps = np.flatnonzero(abs(values[:, 0] - before) > 1e-9)
            if moves and jumps.size:
                k = jumps[0]
                raise InputError(
                    f"{name}.amplitude: jumps from {before[k]:g} to {values[k, 0]:g} at "
                    f"t = {self.corners()[k]:g} µs; a prescribed motion must begin at 0 and must "
                    "not jump"
                )
            if not isinstance(amplitude, Constant) and not values[:, 1:-1].any():
                raise InputError(
                    f"{name}.amplitude: zero during the whole run of {self.duration:g} µs; it must "
                    "act before the end, or be left out"
                )

    def proportional(self) -> Problem:
        """The same with loads and motions that grow in proportion to t, which is then a factor."""

        def grows(acts: Any) -> Any:
            return replace(acts, amplitude=Proportional()) if hasattr(acts, "amplitude") else acts

        return replace(
            self, conditions=(*map(grows, self.conditions),), bodies=(*map(grows, self.bodies),),
            boundaries={}, regions={},
        )  # fmt: skip

    def places(self) -> set[str | None]:
        """Boundaries and regions that conditions and bodies act on; None: everywhere."""
        return {each.on for each in self.conditions} | {body.on for body in self.bodies}

    def acted_boundaries(self) -> list[str]:
        """Boundaries that conditions and bodies act on, in the order of the mesh."""
        places = self.places()
        return [name for name in self.mesh.boundaries or {} if name in places]

    def cells_inside(self, name: str, cells: tuple[int, int], side: float) -> Flags:
        """(n, m) which square plant cells of a `side` in µm have their middle in a region.

        Raises:
            InputError: there is no region of that name.
        """
        middles = side * (np.indices(cells).reshape(2, -1).T + np.array(0.5))
        if name in self.regions:
            return self.regions[name].holds(middles).reshape(cells)
        elements = self.mesh.element_finder()(*middles.T)
        return np.isin(elements, region(self.mesh, name)).reshape(cells)

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


def _middle_node(mesh: skfem.Mesh) -> Point:
    middle = 0.5 * np.add(*extent(mesh))
    x, y = mesh.p[:, abs(mesh.p.T - middle).sum(axis=1).argmin()]
    return float(x), float(y)


def label(condition: Condition) -> str:
    """What results call a condition: its name, or its kind and where it acts."""
    if condition.name is not None:
        return condition.name
    return f"{condition.kind()} {condition.on}" if condition.on else condition.kind()


def sections_of(
    conditions: Iterable[Condition], bodies: Iterable[RigidBody], watched: Mapping[str, Point]
) -> dict[str, dict[str, Any]]:
    """What acts on a tissue and what is watched, as a recipe has it."""
    return {
        "conditions": {label(each): each.entry() for each in conditions},
        "bodies": {body.name: body.entry() for body in bodies},
        "watch": dict(watched),
    }


@dataclass(frozen=True, slots=True)
class Support:
    """Unknowns that a condition holds or moves: `largest` times the amplitude, µm.

    Places are nodes of a mesh or particles of a tissue; component i of place a is unknown 2 a + i.
    """

    name: str
    unknowns: Index
    largest: Array
    amplitude: Amplitude


def supports_of(problem: Problem, places_of: Callable[[Condition], Index]) -> list[Support]:
    """A support for each condition that holds or moves `places_of` it; they may share unknowns."""
    supports = []
    for condition in problem.conditions:
        match condition:
            case Fixed():
                ends = {k: 0.0 for k in (0, 1) if "xy"[k] in condition.components}
            case Symmetry():
                ends = {_normal_component(problem.mesh, condition): 0.0}
            case PrescribedMotion(displacement=moved):
                ends = {k: value for k, value in enumerate(moved) if value is not None}
            case _:
                continue
        places = places_of(condition)
        unknowns = (2 * places[:, None] + np.array([*ends], dtype=np.int64)).ravel()
        amplitude = condition.amplitude if isinstance(condition, PrescribedMotion) else ONE
        values = np.tile([*ends.values()], places.size)
        supports.append(Support(label(condition), unknowns, values, amplitude))
    return supports


def without_overlap(
    supports: Sequence[Support], at: Array, what: str = "node"
) -> tuple[Support, ...]:
    """Supports that share no unknown: fixed ones may meet, what moves must agree.

    Args:
        at: (n, 2) where the places are that may be shared, µm.
        what: a place is.

    Raises:
        InputError: two move one component differently.
    """
    owners, kept = dict[int, tuple[Support, float]](), list[Support]()
    for support in supports:
        mine = np.ones(support.unknowns.size, dtype=bool)
        for k, each in enumerate(zip(support.unknowns.tolist(), support.largest, strict=True)):
            unknown, largest = each
            owner, value = owners.setdefault(unknown, (support, largest))
            mine[k] = owner is support
            moves_apart = largest != 0.0 and owner.amplitude != support.amplitude
            if largest != value or moves_apart:
                place, component = divmod(unknown, 2)
                x, y = at[place]
                raise InputError(
                    f"{support.name}: component {'xy'[component]} of the {what} at "
                    f"({x:.6g}, {y:.6g}) µm; {owner.name} prescribes it otherwise, "
                    "and only one may"
                )
        unknowns, values = support.unknowns[mine], support.largest[mine]
        kept.append(replace(support, unknowns=unknowns, largest=values))
    return tuple(kept)


def _normal_component(mesh: skfem.Mesh, condition: Symmetry) -> int:
    extent = np.ptp(mesh.p.T[nodes_on(mesh, condition.on, "symmetry.on")], axis=0)
    if extent.min() > max(1e-9 * extent.max(), 2.0 * precision(mesh)):
        raise InputError(
            f"{label(condition)}.on: {condition.on}; a symmetry must be straight along x or along y"
        )
    return int(extent.argmin())
