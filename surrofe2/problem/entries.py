"""Regions, conditions, amplitudes and rigid bodies from the entries of a recipe, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import check_value, from_table, unknown
from surrofe2.base.units import LENGTH
from surrofe2.problem.amplitude import KINDS, Amplitude, Constant
from surrofe2.problem.conditions import CONDITIONS, Condition, DrivenCondition, PrescribedMotion
from surrofe2.problem.problem import label
from surrofe2.problem.regions import Box, Disc, HalfPlane, Part
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody, Shape

Point = tuple[float, float]
_SHAPES: dict[str, type] = {"plane": Plane, "circle": Circle, "corner": Corner}
_PARTS: dict[str, type] = {"half_plane": HalfPlane, "circle": Disc}


def parts_of(section: str, table: Any) -> dict[str, Part]:
    """Parts of the plane by name.

    Raises:
        InputError: naming the entry that is not what it must be; so all functions here.
    """
    _check_table(section, table)
    return {name: _part(f"{section}.{name}", one) for name, one in table.items()}


def _part(where: str, table: Any) -> Part:
    """A box, a half plane or a circle."""
    kind, given = _one_of(where, table, ("box", *_PARTS))
    if kind == "box":
        box = tuple[float, float, float, float]
        given = check_value(f"{where}.box", given, box, {"unit": LENGTH, "inf": True})
        if given[0] > given[2] or given[1] > given[3]:
            raise InputError(
                f"{where}.box: {list(given)}; it must be [x0, y0, x1, y1], low to high"
            )
        return Box(given[:2], given[2:])
    part: Part = _within(f"{where}.{kind}", kind, _PARTS[kind], given)
    return part


def condition_of(where: str, table: Any, name: str | None) -> Condition:
    """A condition of the `name` of its section, or of its own."""
    kinds = {each.kind(): each for each in CONDITIONS}
    kind, given = _of_kind(where, table, kinds)
    if name is not None:
        if "name" in given:
            raise InputError(f"{where}.name: {quoted(given['name'])}; its section names it")
        given["name"] = name
    if "amplitude" in given and issubclass(kinds[kind], DrivenCondition):
        given["amplitude"] = _amplitude(f"{where}.amplitude", given["amplitude"])
    motion = given.get("displacement")
    if kinds[kind] is PrescribedMotion and isinstance(motion, list):
        given["displacement"] = [None if each == "free" else each for each in motion]
    return _within(where, kind, kinds[kind], given)


def _amplitude(where: str, given: Any) -> Amplitude:
    """A number, a list of (time, factor), or a table with its kind."""
    if isinstance(given, list):
        given = {"kind": "table", "points": given}
    if not isinstance(given, dict):
        return Constant(value=check_value(where, given, float, {}))
    kind, rest = _of_kind(where, given, KINDS)
    return _within(where, "amplitude", KINDS[kind], rest)


def body_of(name: str, table: Any) -> RigidBody:
    """The rigid body of a section."""
    where = f"bodies.{name}"
    _check_table(where, table)
    given = dict(table)
    shapes = {key: given.pop(key) for key in _SHAPES if key in given}
    kind, outline = _one_of(where, shapes, tuple(_SHAPES))
    shape: Shape = _within(f"{where}.{kind}", kind, _SHAPES[kind], outline)
    for key in ("name", "shape"):
        if key in given:
            raise InputError(f"{where}.{key}: {quoted(given[key])}; the section has name and shape")
    if "amplitude" in given:
        if "displacement" not in given:
            raise InputError(
                f"{where}.amplitude: {quoted(given['amplitude'])}; it is of a displacement, which "
                "is missing"
            )
        given["amplitude"] = _amplitude(f"{where}.amplitude", given["amplitude"])
    return from_table(where, RigidBody, {**given, "name": name, "shape": shape}, _SHAPES)


def _within(where: str, own: str, kind: type, table: Any) -> Any:
    """The settings of a table within another; what `own` says of itself is said of `where`."""
    _check_table(where, table)
    try:
        return from_table(where, kind, table, () if own in _SHAPES | _PARTS else ("kind",))
    except InputError as error:
        told = str(error)
        if told.startswith((f"{own}.", f"{own}:")):
            told = where + told.removeprefix(own)
        raise InputError(told) from None


def _of_kind(where: str, table: Any, kinds: Mapping[str, type]) -> tuple[str, dict[str, Any]]:
    """The kind that a table states, and its other entries."""
    _check_table(where, table)
    others = dict(table)
    kind = others.pop("kind", None)
    if kind is None:
        raise InputError(f"{where}.kind: missing; it must be one of {', '.join(kinds)}")
    if not isinstance(kind, str) or kind not in kinds:
        raise InputError(
            unknown(f"{where}.kind: {quoted(kind)}", quoted(kind).strip("'"), "kind", kinds)
        )
    return kind, others


def _one_of(where: str, table: Any, known: tuple[str, ...]) -> tuple[str, Any]:
    """The one key of a table that has exactly one of the known."""
    _check_table(where, table)
    for key in table:
        if key not in known:
            raise InputError(unknown(f"{where}.{key}", key, "key", known))
    if len(table) != 1:
        found = " and ".join(table) if table else "none of them"
        raise InputError(f"{where}: {found}; it must have exactly one of {', '.join(known)}")
    return next(iter(table.items()))


def _check_table(where: str, given: Any) -> None:
    if not isinstance(given, dict):
        raise InputError(f"{where}: {quoted(given)}; it must be a table of entries")


def entries_of(stated: Condition | RigidBody) -> dict[str, Any]:
    """A condition or body as a recipe has it, without its name."""
    plain: dict[str, Any] = asdict(stated)
    plain.pop("name")
    if isinstance(stated, DrivenCondition | RigidBody):
        plain["amplitude"] = _with_kind(stated.amplitude, KINDS)
    if isinstance(stated, RigidBody):
        shape = _with_kind(stated.shape, _SHAPES)
        del plain["shape"]
        plain[shape.pop("kind")] = shape
    return plain


def sections_of(
    conditions: tuple[Condition, ...], bodies: tuple[RigidBody, ...], watched: Mapping[str, Point]
) -> dict[str, dict[str, Any]]:
    """What acts on a tissue and what is watched, as a recipe has it."""
    return {
        "conditions": {
            label(each): {"kind": each.kind(), **entries_of(each)} for each in conditions
        },
        "bodies": {body.name: entries_of(body) for body in bodies},
        "watch": dict(watched),
    }


def _with_kind(stated: Any, kinds: Mapping[str, type]) -> dict[str, Any]:
    """Kind and entries; of a class that recipes do not know, its name alone."""
    name = next((name for name, kind in kinds.items() if isinstance(stated, kind)), None)
    return {"kind": type(stated).__name__} if name is None else {"kind": name, **asdict(stated)}


def entries_of_part(part: Part) -> dict[str, Any]:
    """A part as a recipe has it."""
    if isinstance(part, Box):
        return {"box": [*part.low, *part.high]}
    entries = _with_kind(part, _PARTS)
    return {entries.pop("kind"): entries}
