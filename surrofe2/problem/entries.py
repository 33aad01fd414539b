"""Regions, conditions, amplitudes and rigid bodies from the entries of a recipe, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import (
    Faults,
    build,
    build_kind,
    check_table,
    check_value,
    only_key,
)
from surrofe2.base.units import LENGTH
from surrofe2.problem.amplitude import KINDS
from surrofe2.problem.conditions import CONDITIONS, Condition, DrivenCondition
from surrofe2.problem.problem import label
from surrofe2.problem.regions import Box, Disc, HalfPlane, Part
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody, Shape

Point = tuple[float, float]
SHAPES: dict[str, type[Shape]] = {"plane": Plane, "circle": Circle, "corner": Corner}
PARTS: dict[str, type[Part]] = {"half_plane": HalfPlane, "circle": Disc}
KINDS_OF_CONDITION: dict[str, type[Condition]] = {each.kind(): each for each in CONDITIONS}


def part_of(where: str, table: Any) -> Part:
    """A part of the plane: a box, a half plane or a circle.

    Raises:
        InputError: naming the entry that is not what it must be; so all functions here.
    """
    kind = only_key(table, where, ("box", *PARTS))
    if kind != "box":
        return build(PARTS[kind], table[kind], f"{where}.{kind}")
    box = tuple[float, float, float, float]
    given = check_value(f"{where}.box", table["box"], box, {"unit": LENGTH, "inf": True})
    if given[0] > given[2] or given[1] > given[3]:
        raise InputError(f"{where}.box", f"{list(given)}; it must be [x0, y0, x1, y1], low to high")
    return Box(given[:2], given[2:])


def condition_of(where: str, table: Any, name: str | None) -> Condition:
    """A condition of the `name` of its section, or of its own."""
    if name is None:
        return build_kind(KINDS_OF_CONDITION, table, where)
    if isinstance(table, Mapping) and "name" in table:
        raise InputError(f"{where}.name", f"{quoted(table['name'])}; its section names it")
    return build_kind(KINDS_OF_CONDITION, table, where, name=name)


def body_of(name: str, table: Any) -> RigidBody:
    """The rigid body of a section."""
    where, faults = f"bodies.{name}", Faults()
    check_table(where, table)
    shapes = {key: table[key] for key in SHAPES if key in table}
    given: dict[str, Any] = {"name": name, "shape": None}
    with faults.noted():
        kind = only_key(shapes, where, SHAPES)
        given["shape"] = build(SHAPES[kind], shapes[kind], f"{where}.{kind}")
    if "amplitude" in table and "displacement" not in table:
        with faults.noted():
            raise InputError(
                f"{where}.amplitude",
                f"{quoted(table['amplitude'])}; it is of a displacement, which is missing",
            )
    others = {key: value for key, value in table.items() if key not in SHAPES}
    with faults.noted():
        body = build(RigidBody, others, where, SHAPES, **given)
    faults.check()
    return body


def entries_of(stated: Condition | RigidBody) -> dict[str, Any]:
    """A condition or body as a recipe has it, without its name."""
    plain: dict[str, Any] = asdict(stated)
    plain.pop("name")
    if isinstance(stated, DrivenCondition | RigidBody):
        plain["amplitude"] = _with_kind(stated.amplitude, KINDS)
    if isinstance(stated, RigidBody):
        shape = _with_kind(stated.shape, SHAPES)
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
    entries = _with_kind(part, PARTS)
    return {entries.pop("kind"): entries}
