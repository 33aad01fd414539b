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
    """Components of displacement that stay zero."""

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
    """Components of displacement that follow an amplitude; None leaves a component free."""

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
    """Dead load: force per unloaded length, of fixed direction."""

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
    """Force per mass (g in eq. 58)."""

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
_ON_POINTS = (Fixed, PrescribedMotion, PointForce)
