"""Sections of a recipe that state a problem: mesh, conditions, bodies, watched points, time.

What they say is checked when the recipe is loaded, all but what needs the mesh itself; that is read
and made when a command asks for the problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import skfem

from surrofe2.base.errors import FileError, InputError, quoted
from surrofe2.base.settings import Faults, build, check_settings, check_table, check_value, setting
from surrofe2.base.units import LENGTH, TIME
from surrofe2.macro.discretisation import make_discretisation
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import BodyForce, Condition, Foundation, Pressure, Traction
from surrofe2.problem.entries import (
    Point,
    body_of,
    condition_of,
    entries_of_part,
    part_of,
    sections_of,
)
from surrofe2.problem.mesh import (
    boundary,
    check_mesh,
    nodes_on,
    rectangle,
    region,
)
from surrofe2.problem.problem import Problem, label
from surrofe2.problem.regions import Part
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.store.meshes import read_mesh
from surrofe2.store.store import digest

SECTIONS = ("mesh", "conditions", "bodies", "watch", "time")
"""Those that state a problem."""

_PARTS_OF_MESH = ("boundaries", "regions")
_ON_BOUNDARIES = (Traction, Pressure, Foundation)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshSettings:
    """A rectangle [0, width] × [0, height] of equal quadrilaterals, or a file."""

    width: float | None = setting(None, "extent in x", LENGTH, above=0.0)
    height: float | None = setting(None, "extent in y", LENGTH, above=0.0)
    elements: tuple[int, int] | None = setting(None, "elements in x and in y", least=1)
    file: str | None = setting(None, "mesh file, relative to the recipe")
    length_unit: Literal["µm", "um", "mm", "m"] | None = setting(None, "of the file; µm")

    def __post_init__(self) -> None:
        check_settings(self, "mesh")
        numbers = {"width": self.width, "height": self.height, "elements": self.elements}
        for name, value in numbers.items():
            if self.file is None and value is None:
                raise InputError(
                    f"mesh.{name}", "missing; a rectangle or a mesh.file must be given"
                )
            if self.file is not None and value is not None:
                raise InputError(f"mesh.{name}", f"{quoted(value)}; a mesh from a file has its own")
        if self.file is None and self.length_unit is not None:
            raise InputError(
                "mesh.length_unit", f"{quoted(self.length_unit)}; it is of a mesh.file"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSettings:
    """How long, and how often results are kept."""

    duration: float = setting(250.0, "length of the run", TIME, above=0.0)
    output_interval: float | None = setting(
        None, "time between rows of results; a five-hundredth of the duration", TIME, above=0.0
    )
    frames: int | None = setting(None, "whole fields kept; as macro.frames", least=2)

    def __post_init__(self) -> None:
        check_settings(self, "time")
        if self.output_interval is None:
            object.__setattr__(self, "output_interval", self.duration / 500.0)
        elif self.output_interval > self.duration:
            raise InputError(
                "time.output_interval",
                f"{self.output_interval}; it must be at most the duration, {self.duration} µs",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedProblem:
    """A problem as a recipe states it.

    Attributes:
        sha256: of the mesh file.
        section: that states its extent, "mesh" or "load".
    """

    mesh: MeshSettings
    boundaries: Mapping[str, Part]
    regions: Mapping[str, Part]
    conditions: tuple[Condition, ...]
    bodies: tuple[RigidBody, ...]
    watched: Mapping[str, Point]
    time: TimeSettings
    sha256: str | None
    section: str = "mesh"

    def problem(self, folder: Path) -> Problem:
        """The problem; its files lie relative to `folder`.

        Raises:
            InputError: the mesh is none, or has not what the sections name.
        """
        problem = Problem(
            mesh=self._mesh(folder),
            conditions=self.conditions,
            bodies=self.bodies,
            duration=self.time.duration,
            output_interval=self.time.output_interval or self.time.duration,
            watched=self.watched,
            boundaries=self.boundaries,
            regions=self.regions,
        )
        mesh, space = problem.mesh, make_discretisation(problem.mesh)
        for condition in self.conditions:
            where = f"conditions.{label(condition)}.on"
            if isinstance(condition, BodyForce):
                region(mesh, condition.on, where)
            elif isinstance(condition, _ON_BOUNDARIES):
                boundary(mesh, condition.on, where)
            else:
                nodes_on(mesh, condition.on, where)
        for body in self.bodies:
            boundary(mesh, body.on, f"bodies.{body.name}.on")
        for name, at in self.watched.items():
            space.locate(np.array(at), f"watch.{name}")
        return problem

    def _mesh(self, folder: Path) -> skfem.Mesh:
        """The mesh with the boundaries and regions that it has by itself."""
        given = self.mesh
        if given.file is not None:
            try:
                mesh = load_mesh(folder / given.file, given.length_unit or "µm")
            except InputError as error:
                raise InputError("mesh.file", str(error)) from None
        else:
            assert given.width is not None
            assert given.height is not None
            assert given.elements is not None
            mesh = rectangle(given.width, given.height, given.elements)
        for kind, known, more in (
            ("boundaries", mesh.boundaries or {}, self.boundaries),
            ("regions", mesh.subdomains or {}, self.regions),
        ):
            for name in known.keys() & more.keys():
                raise InputError(
                    f"mesh.{kind}.{name}", "the mesh has one of that name; take another"
                )
        return mesh

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """The sections, defaults filled in; conditions by the names that results have."""
        mesh = {**asdict(self.mesh), "sha256": self.sha256}
        mesh["boundaries"] = {name: entries_of_part(part) for name, part in self.boundaries.items()}
        mesh["regions"] = {name: entries_of_part(part) for name, part in self.regions.items()}
        acts = sections_of(self.conditions, self.bodies, self.watched)
        return {"mesh": mesh, **acts, "time": asdict(self.time)}


def load_mesh(path: str | Path, length_unit: str = "µm") -> skfem.Mesh:
    """The mesh of a file whose lengths are in µm ("µm", "um"), mm or m.

    Raises:
        FileError: it is not there, or meshio cannot read it.
        InputError: it is no mesh of quadrilaterals or triangles in a plane, or has no such unit.
    """
    stored = read_mesh(Path(path), length_unit)
    try:
        return check_mesh(stored)
    except InputError as error:
        raise InputError(f"{Path(path).name}: {error}") from None


def stated_problem(
    table: Mapping[str, Any], folder: Path, elements: tuple[int, int]
) -> StatedProblem:
    """The problem of a recipe's tables; without any of `SECTIONS`, the bar of [load].

    Args:
        elements: of the bar, in x and in y.

    Raises:
        InputError: naming the entry that is not what it must be.
        FileError: there is no such mesh file.
    """
    sections = [name for name in SECTIONS if name in table]
    if sections and "load" in table:
        raise InputError(
            "load", f"[load] states the paper's bar, [{sections[0]}] another problem; leave one out"
        )
    if sections:
        return _stated(table, folder)
    load = build(LoadSettings, table.get("load", {}), "load")
    return replace(_stated(load.sections(elements), folder), section="load")


def _stated(table: Mapping[str, Any], folder: Path) -> StatedProblem:
    faults, sections = Faults(), dict[str, Any]()
    for name in SECTIONS:
        sections[name] = table.get(name, {})
        lists = (list, dict) if name == "conditions" else dict
        if not isinstance(sections[name], lists):
            with faults.noted():
                raise InputError(name, f"{quoted(sections[name])}; it must be a section [{name}]")
            sections[name] = {}
    if "mesh" not in table:
        first = next(name for name in SECTIONS if name in table)
        with faults.noted():
            raise InputError("mesh", f"missing; [{first}] needs the section [mesh]")
    mesh, parts = dict(sections["mesh"]), dict[str, dict[str, Part]]()
    for kind in _PARTS_OF_MESH:
        stated = mesh.pop(kind, {})
        parts[kind] = {}
        with faults.noted():
            check_table(f"mesh.{kind}", stated)
            parts[kind] = {
                name: faults.take(part_of, f"mesh.{kind}.{name}", one)
                for name, one in stated.items()
            }
    made, sha256 = None, None
    if isinstance(table.get("mesh"), dict):
        with faults.noted():
            made = build(MeshSettings, mesh, "mesh", _PARTS_OF_MESH)
            sha256 = _digest_of(made, folder)
    conditions, bodies = sections["conditions"], sections["bodies"]
    if not table.get("conditions") and not table.get("bodies"):
        with faults.noted():
            raise InputError("conditions", "missing; something must hold or move the tissue")
    if isinstance(conditions, dict):
        named = [(f"conditions.{name}", one, name) for name, one in conditions.items()]
    else:
        named = [(f"conditions[{k}]", one, None) for k, one in enumerate(conditions)]
    acting = dict[str, Condition]()
    for where, one, name in named:
        with faults.noted():
            condition = condition_of(where, one, name)
            called = label(condition)
            if called in acting:
                raise InputError(where, f"a second one called {called}; give it another name")
            acting[called] = condition
    watched = {
        name: faults.take(check_value, f"watch.{name}", at, Point, {"unit": LENGTH})
        for name, at in sections["watch"].items()
    }
    moving = tuple(faults.take(body_of, name, one) for name, one in bodies.items())
    time = faults.take(build, TimeSettings, sections["time"], "time")
    faults.check()
    assert made is not None
    return StatedProblem(
        mesh=made,
        boundaries=parts["boundaries"],
        regions=parts["regions"],
        conditions=tuple(acting.values()),
        bodies=moving,
        watched=watched,
        time=time,
        sha256=sha256,
    )


def _digest_of(mesh: MeshSettings, folder: Path) -> str | None:
    """SHA-256 of the mesh file, if there is one."""
    if mesh.file is None:
        return None
    path = folder / mesh.file
    try:
        return digest(path)
    except FileError as error:
        raise FileError(f"mesh.file: {error}") from None
