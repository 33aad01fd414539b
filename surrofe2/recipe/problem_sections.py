"""Sections of a recipe that state a problem: mesh, conditions, bodies, watched points, time.

What they say is checked when the recipe is loaded, all but what needs the mesh itself; that is read
and made when a command needs the problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import skfem

from surrofe2.base.errors import FileError, InputError, quoted
from surrofe2.base.settings import Faults, build, check_settings, check_value, setting
from surrofe2.base.units import LENGTH, TIME
from surrofe2.macro.elements import make_discretisation
from surrofe2.problem.bar import LoadSettings
from surrofe2.problem.conditions import BodyForce, Condition, Foundation, Pressure, Traction
from surrofe2.problem.mesh import Part, boundary, check_mesh, nodes_on, rectangle, region
from surrofe2.problem.problem import Point, Problem, label, sections_of
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.store.meshes import read_mesh
from surrofe2.store.store import digest

SECTIONS = ("mesh", "conditions", "watch", "bodies", "time")
"""Those that state a problem."""

_ON_BOUNDARIES = (Traction, Pressure, Foundation)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshSettings:
    """A rectangle [0, width] × [0, height] of equal quadrilaterals, or a file."""

    width: float | None = setting(None, "extent in x", LENGTH, above=0.0)
    height: float | None = setting(None, "extent in y", LENGTH, above=0.0)
    elements: tuple[int, int] | None = setting(None, "elements in x and in y", least=1)
    file: str | None = setting(None, "mesh file, relative to the recipe")
    length_unit: Literal["µm", "um", "mm", "m"] | None = setting(None, "of the file; µm")
    boundaries: Mapping[str, Part] | None = setting(
        None, "parts of the plane that hold outer sides"
    )
    regions: Mapping[str, Part] | None = setting(
        None, "parts of the plane that hold elements' centres"
    )

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

    def mesh(self, folder: Path) -> skfem.Mesh:
        """The mesh with the boundaries and regions that it has by itself."""
        if self.file is None:
            assert self.width is not None
            assert self.height is not None
            assert self.elements is not None
            mesh = rectangle(self.width, self.height, self.elements)
        else:
            try:
                mesh = load_mesh(folder / self.file, self.length_unit or "µm")
            except InputError as error:
                raise InputError("mesh.file", str(error)) from None
        for kind, known, more in (
            ("boundaries", mesh.boundaries, self.boundaries),
            ("regions", mesh.subdomains, self.regions),
        ):
            for name in {*(known or ())} & {*(more or ())}:
                raise InputError(
                    f"mesh.{kind}.{name}", "the mesh has one of that name; take another"
                )
        return mesh

    def to_dict(self) -> dict[str, Any]:
        """The section, defaults filled in."""
        parts = {
            kind: {name: part.entry() for name, part in (stated or {}).items()}
            for kind, stated in (("boundaries", self.boundaries), ("regions", self.regions))
        }
        return asdict(self) | parts


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


def _conditions(where: str, entry: Any) -> tuple[Condition, ...]:
    """Conditions by name, or in a list."""
    if not isinstance(entry, list | dict):
        raise InputError(where, f"{quoted(entry)}; it must be a section [{where}]")
    if isinstance(entry, dict):
        named = [(f"{where}.{name}", one, name) for name, one in entry.items()]
    else:
        named = [(f"{where}[{k}]", one, None) for k, one in enumerate(entry)]
    acting, faults = dict[str, Condition](), Faults()
    for place, one, name in named:
        with faults.noted():
            condition = Condition.read(place, one, name)
            if label(condition) in acting:
                raise InputError(
                    place, f"a second one called {label(condition)}; give it another name"
                )
            acting[label(condition)] = condition
    faults.check()
    return tuple(acting.values())


def _bodies(where: str, entry: Any) -> tuple[RigidBody, ...]:
    return tuple(check_value(where, entry, Mapping[str, RigidBody], {}).values())


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedProblem:
    """A problem as a recipe states it.

    Attributes:
        sha256: of the mesh file.
        section: that states its extent, "mesh" or "load".
    """

    mesh: MeshSettings = setting(about="the tissue")
    conditions: tuple[Condition, ...] = setting((), "what holds and loads it", read=_conditions)
    watch: Mapping[str, Point] | None = setting(None, "points by name", LENGTH)
    bodies: tuple[RigidBody, ...] = setting((), "that it touches", read=_bodies)
    time: TimeSettings = setting(TimeSettings(), "of the run")
    sha256: str | None = None
    section: str = "mesh"

    @property
    def watched(self) -> Mapping[str, Point]:
        """Watched points by name, µm."""
        return self.watch or {}

    def problem(self, folder: Path) -> Problem:
        """The problem; its files lie relative to `folder`.

        Raises:
            InputError: the mesh is none, or has not what the sections name.
        """
        problem = Problem(
            mesh=self.mesh.mesh(folder),
            conditions=self.conditions,
            bodies=self.bodies,
            duration=self.time.duration,
            output_interval=self.time.output_interval or self.time.duration,
            watched=self.watched,
            boundaries=self.mesh.boundaries or {},
            regions=self.mesh.regions or {},
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
            try:
                space.locate(np.array(at), f"watch.{name}")
            except InputError as error:
                x, y = mesh.p[:, np.hypot(*(mesh.p.T - np.array(at)).T).argmin()]
                message = f"{error}, whose nearest node is at ({x:.6g}, {y:.6g}) µm"
                raise InputError(message) from None
        return problem

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """The sections, defaults filled in; conditions by the names that results have."""
        acts = sections_of(self.conditions, self.bodies, self.watched)
        mesh = self.mesh.to_dict() | {"sha256": self.sha256}
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
    """The problem of a recipe's tables; without any of `SECTIONS`, the bar of [load] on `elements`.

    Raises:
        InputError: naming the entry that is not what it must be.
        FileError: there is no such mesh file.
    """
    sections, section = {name: table[name] for name in SECTIONS if name in table}, "mesh"
    if sections and "load" in table:
        first = next(iter(sections))
        raise InputError(
            "load", f"[load] states the paper's bar, [{first}] another problem; leave one out"
        )
    if not sections:
        section = "load"
        sections = build(LoadSettings, table.get("load", {}), "load").sections(elements)
    faults, fixed = Faults(), dict[str, Any](section=section)
    if "mesh" not in sections:
        fixed["mesh"] = None
        with faults.noted():
            raise InputError("mesh", f"missing; [{next(iter(sections))}] needs the section [mesh]")
    stated = faults.take(partial(build, StatedProblem, sections, "", **fixed))
    if not any(sections.get(name, {}) not in ({}, []) for name in ("conditions", "bodies")):
        with faults.noted():
            raise InputError("conditions", "missing; something must hold or move the tissue")
    file = sections["mesh"].get("file") if isinstance(sections.get("mesh"), dict) else None
    sha256 = faults.take(_digest_of, folder / file) if isinstance(file, str) else None
    faults.check()
    return replace(stated, sha256=sha256)


def _digest_of(path: Path) -> str:
    """SHA-256 of a mesh file."""
    try:
        return digest(path)
    except FileError as error:
        raise FileError(f"mesh.file: {error}") from None
