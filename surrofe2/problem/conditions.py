"""Conditions on a tissue: supports, motion, loads, foundations, initial velocity, surface tension.

Each condition names the boundary or region it acts `on`; None is the whole mesh. Some act on the
node at a point, too. Conditions with an amplitude state their largest value, which the amplitude
multiplies in time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

from surrofe2.base.arrays import Index
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import build, build_kind, check_settings, check_value, setting
from surrofe2.base.units import ACCELERATION, FORCE, LENGTH
from surrofe2.law.surface_law import SurfaceLaw
from surrofe2.problem.amplitude import IN_TIME, ONE, Amplitude
from surrofe2.problem.mesh import NodeAt

SPEED = "µm/µs"
LINE_FORCE = "µN/µm"
FREE: Final = "free"
PLACES: Final = "boundary or region, or the node at a point"
EVERYWHERE: Final = "boundary or region; left out: everywhere"


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """The base of all conditions.

    Attributes:
        on: name of the boundary or region, or the node, on which it acts; None: everywhere.
        name: name by which results call it; by default its kind and where it acts.
    """

    on: str | NodeAt | None = setting(None, EVERYWHERE)
    name: str | None = setting(None, "by which results call it")

    def __post_init__(self) -> None:
        read = self.__dataclass_fields__["on"].metadata.get("read")
        if read is not None:
            object.__setattr__(self, "on", read(f"{self.kind()}.on", self.on))
        check_settings(self, self.kind())

    @classmethod
    def kind(cls) -> str:
        """Return the name of this kind in recipes: that of the class in lower case, body_force."""
        letters = (f"_{letter.lower()}" if letter.isupper() else letter for letter in cls.__name__)
        return "".join(letters).removeprefix("_")

    @staticmethod
    def read(where: str, entry: Any, name: str | None = None) -> Condition:
        """Read the condition that a recipe states at `where`.

        Args:
            where: place of the entry in the recipe, for messages.
            name: name of its section, which names the condition; None: it may have an entry `name`.
        """
        kinds = {condition.kind(): condition for condition in CONDITIONS}
        if isinstance(entry, Mapping) and isinstance(entry.get("on"), Mapping):
            _check_takes_point(kinds, entry, f"{where}.on")
        if name is None:
            return build_kind(kinds, entry, where)
        if isinstance(entry, Mapping) and "name" in entry:
            raise InputError(f"{where}.name", f"{quoted(entry['name'])}; its section names it")
        return build_kind(kinds, entry, where, name=name)

    def entry(self) -> dict[str, Any]:
        """Return the table that states this condition in a recipe, under its name."""
        entries = {"kind": self.kind(), **asdict(self)}
        del entries["name"]
        return entries


def _check_takes_point(
    kinds: Mapping[str, type[Condition]], entry: Mapping[str, Any], where: str
) -> None:
    """Reject a point in a recipe where the kind of condition acts on sides or elements alone."""
    taking = [name for name, kind in kinds.items() if issubclass(kind, _ON_POINTS)]
    kind = entry.get("kind")
    # what is no name of a kind is refused where the condition is built
    if isinstance(kind, str) and kind in kinds and kind not in taking:
        raise InputError(
            where, f"{quoted(entry['on'])}; {kind} does not act on a point; {', '.join(taking)} do"
        )


def _place(where: str, entry: Any) -> str | NodeAt:
    """Read where a condition acts: the name of a boundary or region, or { point = [x, y] }.

    Raises:
        InputError: it is neither.
    """
    if isinstance(entry, str):
        return entry
    if not isinstance(entry, NodeAt | Mapping):
        raise InputError(
            where,
            f"{quoted(entry)}; it must be the name of a boundary or region, "
            "or { point = [x, y] }, µm",
        )
    return _node(where, entry)


def _node(where: str, entry: Any) -> NodeAt:
    """Read the node on which a condition acts, { point = [x, y] }.

    Raises:
        InputError: it is no such table.
    """
    if isinstance(entry, NodeAt):
        return entry
    if not isinstance(entry, Mapping):
        raise InputError(where, f"{quoted(entry)}; it must be {{ point = [x, y] }}, µm")
    return build(NodeAt, entry, where)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivenCondition(Condition):
    """A condition that follows an amplitude in time."""

    amplitude: Amplitude = setting(ONE, IN_TIME)

    def entry(self) -> dict[str, Any]:
        return super(DrivenCondition, self).entry() | {"amplitude": self.amplitude.entry()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Fixed(Condition):
    """Components of displacement that stay zero.

    Examples:
        A side that is glued, and one that slides along x; `entry` is how a recipe states it:

        >>> from surrofe2 import Fixed
        >>> glued = Fixed(on="left")
        >>> sliding = Fixed(on="bottom", components="y")
        >>> sliding.entry()
        {'kind': 'fixed', 'on': 'bottom', 'components': 'y'}
    """

    on: str | NodeAt = setting(about=PLACES, read=_place)
    components: Literal["x", "y", "xy"] = setting("xy", "components that are held")


@dataclass(frozen=True, slots=True, kw_only=True)
class Symmetry(Condition):
    """A straight boundary along x or y that is a mirror: its normal component stays zero."""

    on: str = setting(about="boundary")


def _components_of(where: str, entry: Any) -> tuple[float | None, float | None]:
    """Read the components of a displacement, µm; a component that is "free" becomes None."""
    if isinstance(entry, list | tuple):
        entry = [None if component == "free" else component for component in entry]
    components: tuple[float | None, float | None] = check_value(
        where, entry, tuple[float | None, float | None], {"unit": LENGTH}
    )
    return components


@dataclass(frozen=True, slots=True, kw_only=True)
class PrescribedMotion(DrivenCondition):
    """Components of displacement that follow an amplitude; None leaves a component free.

    Examples:
        A grip moves by 60 µm to the right within 100 µs and is free along y:

        >>> from surrofe2 import PrescribedMotion, Ramp
        >>> pull = Ramp(end=100.0, smooth=True)
        >>> grip = PrescribedMotion(on="right", displacement=(60.0, None), amplitude=pull)
        >>> grip.displacement
        (60.0, None)
        >>> factor, rate, acceleration = grip.amplitude.at(50.0, within=50.0)
        >>> print(f"{60.0 * factor:.0f} µm at {60.0 * rate:.3f} µm/µs")
        30 µm at 1.125 µm/µs
    """

    on: str | NodeAt = setting(about=PLACES, read=_place)
    displacement: tuple[float | None, float | None] = setting(
        about='largest displacement in x and y; "free": not prescribed', unit=LENGTH,
        read=_components_of,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super(PrescribedMotion, self).__post_init__()
        if self.displacement == (None, None):
            raise InputError(
                "prescribed_motion.displacement",
                f"both components are free; one must be a number ({LENGTH})",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Traction(DrivenCondition):
    """Dead load: force per unloaded length, of fixed direction.

    Examples:
        A strip of apple flesh, 2 mm long, under 0.5 µN/µm, which is 0.05 MPa in a layer of 10 µm,
        becomes longer by this stress over its Young's modulus of 3.75 MPa:

        >>> from surrofe2 import Fixed, Problem, RveLaw, Symmetry, Traction, find_rest, rectangle
        >>> pull = Traction(on="right", traction=(0.5, 0.0))
        >>> sides = (Symmetry(on="left"), Symmetry(on="bottom"))
        >>> strip = Problem(
        ...     mesh=rectangle(2000.0, 500.0, (4, 1)),
        ...     conditions=(*sides, pull),
        ...     watched={"end": (2000.0, 0.0)},
        ... )
        >>> rest = find_rest(strip, RveLaw("apple"))
        >>> print(f"{rest.watched[0] / 2000.0:.2%}")
        1.34%
    """

    on: str = setting(about="boundary")
    traction: tuple[float, float] = setting(about="force per unloaded length", unit=LINE_FORCE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pressure(DrivenCondition):
    """Follower load: force per current length against the outward normal."""

    on: str = setting(about="boundary")
    pressure: float = setting(about="force per current length", unit=LINE_FORCE)


@dataclass(frozen=True, slots=True, kw_only=True)
class PointForce(DrivenCondition):
    """Dead load on one node: force on the layer of tissue, of fixed direction.

    Where elements become smaller, the displacement of the node grows without bound, as the
    logarithm of their size; forces that balance, or the tissue's reaction elsewhere, converge.
    """

    on: NodeAt = setting(about="the node at a point", read=_node)
    force: tuple[float, float] = setting(about="force on the layer of tissue", unit=FORCE)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyForce(DrivenCondition):
    """Force per mass (g in eq. 58).

    Examples:
        The weight of a column of apple flesh, 10 mm high, shortens it:

        >>> from surrofe2 import BodyForce, Problem, RveLaw, Symmetry, find_rest, rectangle
        >>> weight = BodyForce(acceleration=(0.0, -9.81e-6))  # µm/µs², gravity
        >>> column = Problem(
        ...     mesh=rectangle(2000.0, 10000.0, (1, 5)),
        ...     conditions=(Symmetry(on="left"), Symmetry(on="bottom"), weight),
        ...     watched={"top": (0.0, 10000.0)},
        ... )
        >>> rest = find_rest(column, RveLaw("apple"))
        >>> print(f"{rest.watched[1]:.2f} µm")
        -0.11 µm
    """

    on: str | None = setting(None, "region; left out: everywhere")
    acceleration: tuple[float, float] = setting(about="force per mass", unit=ACCELERATION)


@dataclass(frozen=True, slots=True, kw_only=True)
class Foundation(Condition):
    """Springs and dashpots along a boundary to a base that does not move."""

    on: str = setting(about="boundary")
    stiffness: float = setting(0.0, "spring per unloaded length", "µN/µm²", least=0.0)
    damping: float = setting(0.0, "dashpot per unloaded length", "µN µs/µm²", least=0.0)
    components: Literal["x", "y", "xy"] = setting("xy", "components that it holds")

    def __post_init__(self) -> None:
        super(Foundation, self).__post_init__()
        if not (self.stiffness or self.damping):
            raise InputError(
                "foundation", "stiffness 0 and damping 0; one of them must be positive"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialVelocity(Condition):
    """Velocity at t = 0 of all nodes that are not held."""

    on: str | None = setting(None, EVERYWHERE)
    velocity: tuple[float, float] = setting(about="velocity at t = 0", unit=SPEED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """The free sides of a tissue that have a surface law.

    Attributes:
        law: one law for all sides, or laws by the name of the region whose elements have the sides.
        on: names of boundaries; "free": all outer sides but those that a condition or a body names.
        regions: elements of each law by its name; None: the mesh's regions of these names.
    """

    law: SurfaceLaw | Mapping[str, SurfaceLaw]
    on: tuple[str, ...] | Literal["free"] = FREE
    regions: Mapping[str, Index] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "on", checked_sides(self.on))


def checked_sides(on: Any) -> tuple[str, ...] | Literal["free"]:
    """Return `Surface.on` as a tuple of names, or "free".

    Raises:
        InputError: it is neither "free" nor a list of names.
    """
    is_list = isinstance(on, tuple | list) and len(on) > 0
    if is_list and all(isinstance(name, str) for name in on):
        return tuple(on)
    if on != FREE:
        raise InputError("surface.on", f'{quoted(on)}; it must be names of boundaries, or "{FREE}"')
    return FREE


CONDITIONS: tuple[type[Condition], ...] = (
    Fixed,
    Symmetry,
    PrescribedMotion,
    Traction,
    Pressure,
    PointForce,
    BodyForce,
    Foundation,
    InitialVelocity,
)
_ON_POINTS = (Fixed, PrescribedMotion, PointForce)  # those that act on the node at a point, too
