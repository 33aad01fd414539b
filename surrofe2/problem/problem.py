"""`Problem`: a mesh, the conditions on it, the length of a run, and the points to be recorded.

`Support` lists the components that a condition holds or moves; each belongs to one condition.
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
from surrofe2.base.errors import InputError, shortened
from surrofe2.problem.amplitude import ONE, Amplitude, Constant, Proportional
from surrofe2.problem.conditions import (
    BodyForce,
    Condition,
    DrivenCondition,
    Fixed,
    Foundation,
    InitialVelocity,
    PointForce,
    PrescribedMotion,
    Pressure,
    Surface,
    Symmetry,
    Traction,
)
from surrofe2.problem.mesh import (
    NodeAt,
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

# Rows of results that a run has at most.
MOST_ROWS = 1_000_000
# Fractions of a piece of an amplitude at which it is sampled: its ends, and places between at which
# an oscillation that is zero at its quarters is not.
_SAMPLED_AT = np.array([0.0, 0.13, 0.51, 0.77, 1.0])
# A jump of a motion that is larger than rounding, as a fraction of its largest displacement.
_JUMP = 1e-9
# Name of the surface tension of free sides in results.
SURFACE = "surface"
# Names of energies, which no condition may have.
TAKEN = (
    "kinetic", "internal", "elastic", "dissipated", "balance", "motion", "numerical", "contact",
    "contact dissipated", SURFACE,
)  # fmt: skip


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
        times: times of rows that replace the interval, µs, increasing and within the duration.
        watched: reference positions whose displacement is recorded, µm, by name; the first is
            the one of the displacement curve. The tissue's middle if there is none.
        boundaries: further boundaries, by name the part of the plane that holds the ends of their
            outer sides (in a full tissue, the wall particles).
        regions: further regions, by name the part of the plane that holds the centres of their
            elements (in a full tissue, the middles of plant cells).
        surface: free sides with a surface law, under which the tissue comes to rest before the
            run; displacements count from there. None: there are none. A full tissue needs none.

    Raises:
        InputError: the mesh or a name is rejected by `check_mesh` or `check_name`, two conditions
            have one name, or a number is out of range.

    Examples:
        A block of 2 mm × 1 mm stands on a glued side while its upper side moves to the right:

        >>> from surrofe2 import Fixed, PrescribedMotion, Problem, Ramp, rectangle
        >>> ramp = Ramp(end=100.0, smooth=True)  # µs
        >>> plate = PrescribedMotion(on="top", displacement=(50.0, 0.0), amplitude=ramp)
        >>> block = Problem(
        ...     mesh=rectangle(2000.0, 1000.0, (4, 2)),
        ...     conditions=(Fixed(on="bottom"), plate),
        ...     duration=200.0,
        ...     output_interval=2.0,
        ...     watched={"middle": (1000.0, 500.0)},
        ... )
        >>> block.acted_boundaries()
        ['bottom', 'top']
        >>> len(block.output_times())  # from 0 to 200 µs
        101
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
    times: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        mesh = with_boundaries(check_mesh(self.mesh), **self.boundaries)
        object.__setattr__(self, "mesh", with_regions(mesh, **self.regions))
        if not self.watched:
            object.__setattr__(self, "watched", {"middle": _middle_node(self.mesh)})
        if not 0.0 < self.duration < np.inf:
            raise InputError(f"problem.duration: {self.duration}; it must be positive, finite (µs)")
        self._check_times()
        self._check_names()

    def _check_times(self) -> None:
        """Check that rows of results are not too many, and are at times within the run."""
        if self.times is None:
            least = self.duration / MOST_ROWS
            if not max(least, np.finfo(float).tiny) <= self.output_interval < np.inf:
                raise InputError(
                    f"problem.output_interval: {self.output_interval}; it must be finite and at "
                    f"least {least:g} µs, a millionth of the duration"
                )
            return
        steps = np.diff([0.0, *self.times])
        if not (len(self.times) and (steps > 0.0).all() and self.times[-1] <= self.duration):
            raise InputError(
                f"problem.times: {shortened(str(list(self.times)), 80)}; they must increase, from "
                f"above 0 to at most the duration, {self.duration} µs"
            )

    def _check_names(self) -> None:
        """Check that names are unique, and that conditions and bodies act on places of the mesh.

        Results tell conditions, bodies and energies apart by name.
        """
        names_of_conditions = [label(condition) for condition in self.conditions]
        names_of_bodies = [body.name for body in self.bodies]
        for name, number in Counter(names_of_conditions + names_of_bodies).items():
            if number > 1:
                raise InputError(f"problem: {number} conditions are called {name}; name them apart")
            if name in TAKEN:
                raise InputError(f"problem: a condition is called {name}; an energy has that name")
        for condition in self.conditions:
            if isinstance(condition.on, str):
                check_name(self.mesh, condition.on, f"{label(condition)}.on")
        for body in self.bodies:
            check_name(self.mesh, body.on, f"{body.name}.on")
        thrown = [
            condition.on for condition in self.conditions if isinstance(condition, InitialVelocity)
        ]
        for place, number in Counter(thrown).items():
            if number > 1:
                where = place or "the whole mesh"
                raise InputError(f"problem: {number} initial velocities on {where}; give one")

    def amplitudes(self) -> list[Amplitude]:
        """Return the amplitudes of all conditions and bodies."""
        of_conditions = [
            condition.amplitude
            for condition in self.conditions
            if isinstance(condition, DrivenCondition)
        ]
        return of_conditions + [body.amplitude for body in self.bodies]

    def check_course(self) -> None:
        """Reject amplitudes that no run can follow, or that do nothing during the run.

        A constant amplitude of zero is meant, and passes.

        Raises:
            InputError: a prescribed motion does not begin at 0 or jumps, or a load or a motion is
                zero from the start of the run to its end.
        """
        for condition in self.conditions:
            if isinstance(condition, DrivenCondition):
                is_motion = isinstance(condition, PrescribedMotion)
                self._check_amplitude(label(condition), condition.amplitude, is_motion)
        for body in self.bodies:
            if any(body.displacement):
                self._check_amplitude(body.name, body.amplitude, is_motion=True)

    def _check_amplitude(self, name: str, amplitude: Amplitude, is_motion: bool) -> None:
        """Reject one amplitude as `check_course` says; `name` is that of its condition or body."""
        corners = self.corners()
        values = np.empty((len(corners) - 1, len(_SAMPLED_AT)))
        for k, (begin, end) in enumerate(pairwise(corners)):
            middle = 0.5 * (begin + end)
            for j, t in enumerate(begin + _SAMPLED_AT * (end - begin)):
                values[k, j], _, _ = amplitude.at(t, within=middle)
        # the value that each piece must begin with: 0 at first, then the end of the last piece
        before = np.append(0.0, values[:-1, -1])
        jumps = np.flatnonzero(abs(values[:, 0] - before) > _JUMP)
        if is_motion and jumps.size:
            k = jumps[0]
            raise InputError(
                f"{name}.amplitude: jumps from {before[k]:g} to {values[k, 0]:g} at "
                f"t = {corners[k]:g} µs; a prescribed motion must begin at 0 and must not jump"
            )
        # ends of pieces do not count: a load that begins at the end of the run does nothing
        is_zero = not values[:, 1:-1].any()
        if is_zero and not isinstance(amplitude, Constant):
            raise InputError(
                f"{name}.amplitude: zero during the whole run of {self.duration:g} µs; it must "
                "act before the end, or be left out"
            )

    def proportional(self) -> Problem:
        """Return the problem with loads and motions in proportion to t, which is then a factor."""
        return replace(
            self,
            conditions=tuple(_in_proportion(condition) for condition in self.conditions),
            bodies=tuple(_in_proportion(body) for body in self.bodies),
            boundaries={},  # the mesh has them already
            regions={},
        )

    def places(self) -> set[str | NodeAt | None]:
        """Return where conditions or bodies act: boundaries, regions, nodes; None: everywhere."""
        of_conditions = {condition.on for condition in self.conditions}
        return of_conditions | {body.on for body in self.bodies}

    def acted_boundaries(self) -> list[str]:
        """Return the boundaries with conditions or bodies, in the order of the mesh."""
        places = self.places()
        return [name for name in self.mesh.boundaries or {} if name in places]

    def acted_nodes(self) -> list[NodeAt]:
        """Return the nodes on which conditions act alone, each once, in their order."""
        nodes = []
        for condition in self.conditions:
            if isinstance(condition.on, NodeAt):
                nodes.append(condition.on)
        return list(dict.fromkeys(nodes))

    def cells_inside(self, name: str, middles: Array) -> Flags:
        """Return (n,) whether a region holds plant cells, by their middles (n, 2) in µm.

        Raises:
            InputError: there is no region of that name.
        """
        if name in self.regions:
            return self.regions[name].holds(middles)
        elements = self.mesh.element_finder()(*middles.T)
        return np.isin(elements, region(self.mesh, name))

    def corners(self) -> Array:
        """Return the times (m,) in µs at which a step must end, from 0 to the end of the run."""
        times = {0.0, self.duration}
        for amplitude in self.amplitudes():
            times.update(t for t in amplitude.corners() if 0.0 < t < self.duration)
        return np.array(sorted(times))

    @property
    def resolved_by(self) -> float:
        """Longest step (µs) that sees the shape of all amplitudes."""
        return min((amplitude.resolved_by for amplitude in self.amplitudes()), default=np.inf)

    def output_times(self) -> Array:
        """Return the times (m,) in µs of rows of results.

        These are 0, the stated times or multiples of the interval, and the end.
        """
        if self.times is not None:
            last = self.times[-1]
            end = () if np.isclose(last, self.duration) else (self.duration,)
            return np.array([0.0, *self.times, *end])
        # 1e-12: a whole number of intervals may round to just below it
        count = int(np.floor(self.duration / self.output_interval * (1.0 + 1e-12)))
        times: Array = self.output_interval * np.arange(count + 1.0)
        if np.isclose(times[-1], self.duration):
            return times
        return np.append(times, self.duration)


def _in_proportion(acting: Any) -> Any:
    """Return a condition or body whose amplitude, where it has one, is t itself."""
    if hasattr(acting, "amplitude"):
        return replace(acting, amplitude=Proportional())
    return acting


def _middle_node(mesh: skfem.Mesh) -> Point:
    """Return the position of the node that is nearest to the middle of the mesh's extent, µm."""
    low, high = extent(mesh)
    middle = 0.5 * np.add(low, high)
    nearest = abs(mesh.p.T - middle).sum(axis=1).argmin()
    x, y = mesh.p[:, nearest]
    return float(x), float(y)


def displacement_of(node: NodeAt) -> str:
    """Return the name, in results, of the displacement of a node on which a condition acts."""
    return f"node displacement {node}"


def label(condition: Condition) -> str:
    """Return the name of a condition in results: its own, or its kind and where it acts."""
    if condition.name is not None:
        return condition.name
    if condition.on:
        return f"{condition.kind()} {condition.on}"
    return condition.kind()


def sections_of(
    conditions: Iterable[Condition], bodies: Iterable[RigidBody], watched: Mapping[str, Point]
) -> dict[str, dict[str, Any]]:
    """Return the sections of a recipe that state conditions, bodies and watched points."""
    return {
        "conditions": {label(condition): condition.entry() for condition in conditions},
        "bodies": {body.name: body.entry() for body in bodies},
        "watch": dict(watched),
    }


@dataclass(frozen=True, slots=True)
class Support:
    """The unknowns that a condition holds or moves.

    Places are nodes of a mesh or particles of a tissue; component i of place a is unknown 2 a + i.

    Attributes:
        name: name of the condition in results.
        unknowns: (m,) numbers of the unknowns.
        largest: (m,) displacement of each at an amplitude of 1, µm.
        amplitude: factor in time of these displacements.
    """

    name: str
    unknowns: Index
    largest: Array
    amplitude: Amplitude


def supports_of(problem: Problem, places_of: Callable[[Condition], Index]) -> list[Support]:
    """Make a support for each condition that holds or moves something; they may share unknowns.

    Args:
        places_of: returns the places, nodes or particles, on which a condition acts.
    """
    supports = []
    for condition in problem.conditions:
        # largest displacement by component, µm; a component that is free is left out
        largest: dict[int, float]
        amplitude: Amplitude = ONE
        match condition:
            case Fixed():
                largest = {k: 0.0 for k in (0, 1) if "xy"[k] in condition.components}
            case Symmetry():
                largest = {_normal_component(problem.mesh, condition): 0.0}
            case PrescribedMotion():
                components = enumerate(condition.displacement)
                largest = {k: value for k, value in components if value is not None}
                amplitude = condition.amplitude
            case _:  # loads leave all components free
                continue
        places = places_of(condition)
        unknowns = (2 * places[:, None] + np.array([*largest], dtype=np.int64)).ravel()
        values = np.tile([*largest.values()], places.size)
        supports.append(Support(label(condition), unknowns, values, amplitude))
    return supports


def without_overlap(
    supports: Sequence[Support], positions: Array, what: str = "node"
) -> tuple[Support, ...]:
    """Take from supports the unknowns that an earlier one has already.

    Supports that hold may meet; those that move must prescribe the same where they meet.

    Args:
        supports: supports that may share unknowns.
        positions: (n, 2) positions of the places, µm, for messages.
        what: name of a place in messages.

    Raises:
        InputError: two supports move one component differently.
    """
    owners: dict[int, tuple[Support, float]] = {}  # first support of an unknown, and its value
    disjoint: list[Support] = []
    for support in supports:
        is_owned = np.ones(support.unknowns.size, dtype=bool)
        pairs = zip(support.unknowns.tolist(), support.largest, strict=True)
        for k, (unknown, largest) in enumerate(pairs):
            owner, value = owners.setdefault(unknown, (support, largest))
            is_owned[k] = owner is support
            # at a displacement of 0 the amplitude does not matter
            moves_apart = largest != 0.0 and owner.amplitude != support.amplitude
            if largest != value or moves_apart:
                place, component = divmod(unknown, 2)
                x, y = positions[place]
                raise InputError(
                    f"{support.name}: component {'xy'[component]} of the {what} at "
                    f"({x:.6g}, {y:.6g}) µm; {owner.name} prescribes it otherwise, "
                    "and only one may"
                )
        disjoint.append(
            replace(
                support,
                unknowns=support.unknowns[is_owned],
                largest=support.largest[is_owned],
            )
        )
    return tuple(disjoint)


def check_loads(
    problem: Problem, supports: Sequence[Support], places_of: Callable[[Condition], Index]
) -> None:
    """Check that loads and initial velocities act on something that supports leave free.

    Args:
        supports: all supports of the problem.
        places_of: returns the places, nodes or particles, on which a condition acts.

    Raises:
        InputError: supports hold or move every component that a condition acts on.
    """
    held = set[int]()
    for support in supports:
        held.update(support.unknowns.tolist())
    for condition in problem.conditions:
        components = [k for k in (0, 1) if _acts_along(condition)[k]]
        if not components:
            continue
        unknowns = (2 * places_of(condition)[:, None] + components).ravel()
        if held.issuperset(unknowns.tolist()):
            is_velocity = isinstance(condition, InitialVelocity)
            effect = "it can have no initial velocity" if is_velocity else "the load does nothing"
            raise InputError(
                f"{label(condition)}.on: {condition.on or 'everywhere'}; supports hold or move all "
                f"of it, so {effect}; free a component there, or leave the condition out"
            )


def _acts_along(condition: Condition) -> tuple[bool, bool]:
    """Return whether a load or an initial velocity acts along x and y; a support along neither."""
    match condition:
        case InitialVelocity():
            vector = condition.velocity
        case Traction():
            vector = condition.traction
        case PointForce():
            vector = condition.force
        case BodyForce():
            vector = condition.acceleration
        case Pressure():
            vector = (condition.pressure, condition.pressure)  # the normal turns with the side
        case Foundation():
            return "x" in condition.components, "y" in condition.components
        case _:
            return False, False
    x, y = vector
    return x != 0.0, y != 0.0


def _normal_component(mesh: skfem.Mesh, condition: Symmetry) -> int:
    """Return the component, 0 or 1, of the displacement across a straight boundary.

    Raises:
        InputError: the boundary is not straight along x or y.
    """
    width = np.ptp(mesh.p.T[nodes_on(mesh, condition.on, "symmetry.on")], axis=0)
    rounding = max(1e-9 * width.max(), 2.0 * precision(mesh))
    if width.min() > rounding:
        raise InputError(
            f"{label(condition)}.on: {condition.on}; a symmetry must be straight along x or along y"
        )
    return int(width.argmin())
