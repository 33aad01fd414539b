"""Free sides of a tissue: which they are, beside which element, and whose law they take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.macro.conditions import FREE, Surface
from surrofe2.macro.mesh import SIDES, Mesh, outer_sides
from surrofe2.macro.problem import Problem
from surrofe2.surface_law import SurfaceLaw

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ALONG = 1.0
"""Degrees off the rows of plant cells up to which a side runs along them."""


@dataclass(frozen=True, slots=True)
class FreeSides:
    """Sides with a surface law.

    Attributes:
        nodes: (m, 2) or (m, 3) nodes of each, as of `Mesh.boundaries`.
        elements: (m,) beside them.
        names: of the boundaries; boundary: (m,) which of them.
        laws: of the sides; law: (m,) which of them.
        oblique: (m,) degrees off the nearer direction of the plant cells' rows, x or y; 0 along it.
    """

    nodes: Index
    elements: Index
    names: tuple[str, ...]
    boundary: Index
    laws: tuple[SurfaceLaw, ...]
    law: Index
    oblique: Array


def free_sides(problem: Problem) -> FreeSides:
    """The sides that the surface of a problem names.

    Raises:
        InputError: a boundary or a region is not there, no side is free, or a side beside an
            element of no law or of two.
    """
    mesh, surface = problem.mesh, problem.surface
    assert surface is not None
    if surface.on == FREE:
        names: tuple[str, ...] = (FREE,)
        parts = [_unnamed(problem)]
        if not len(parts[0]):
            raise InputError("surface.on: free; every outer side has a condition: leave it out")
    else:
        names = tuple(surface.on)
        parts = [mesh.boundary(name, "surface.on") for name in names]
    nodes, boundary = np.concatenate(parts), np.repeat(np.arange(len(parts)), [*map(len, parts)])
    _, first = np.unique(_codes(nodes, mesh), return_index=True)
    first.sort()  # a side of two boundaries counts once
    nodes, boundary = nodes[first], boundary[first]
    elements = _beside(nodes, mesh)
    laws, law = _laws(surface, mesh, elements)
    along = np.diff(mesh.nodes[nodes[:, :2]], axis=1)[:, 0]
    angle = np.degrees(np.arctan2(*np.sort(abs(along), axis=1).T))
    oblique = np.where(angle > _ALONG, angle, 0.0)
    return FreeSides(nodes, elements, names, boundary, laws, law, oblique)


def _unnamed(problem: Problem) -> Index:
    """Outer sides that no condition and no body names."""
    mesh = problem.mesh
    named = {*problem.places()}
    taken = [sides for name, sides in mesh.boundaries.items() if name in named]
    sides = outer_sides(mesh.elements)
    codes = [np.zeros(0, np.int64), *(_codes(each, mesh) for each in taken)]
    return sides[~np.isin(_codes(sides, mesh), np.concatenate(codes))]


def _codes(sides: Index, mesh: Mesh) -> Index:
    """(m,) a number of each side by its ends."""
    low, high = np.sort(sides[:, :2], axis=1).T
    codes: Index = low * len(mesh.nodes) + high
    return codes


def _beside(sides: Index, mesh: Mesh) -> Index:
    """(m,) elements of outer sides."""
    of_elements = SIDES[mesh.elements.shape[1]]
    known = _codes(np.concatenate([mesh.elements[:, list(side)] for side in of_elements]), mesh)
    order = np.argsort(known)
    place = order[np.searchsorted(known, _codes(sides, mesh), sorter=order)]
    elements: Index = place % len(mesh.elements)
    return elements


def _laws(surface: Surface, mesh: Mesh, elements: Index) -> tuple[tuple[SurfaceLaw, ...], Index]:
    """The laws, and (m,) which of them each side takes."""
    if not isinstance(surface.law, Mapping):
        return (surface.law,), np.zeros(len(elements), np.int64)
    law, claims = np.zeros((2, len(mesh.elements)), np.int64)
    known = surface.regions
    for k, name in enumerate(surface.law):
        own = mesh.region(name, "surface.law") if known is None else known[name]
        law[own], claims[own] = k, claims[own] + 1
    wrong = np.flatnonzero(claims[elements] != 1)
    if wrong.size:
        x, y = mesh.nodes[mesh.elements[elements[wrong[0]]]].mean(axis=0)
        raise InputError(
            f"surface.law: the element at ({x:.6g}, {y:.6g}) µm is in "
            f"{claims[elements[wrong[0]]]} of {', '.join([*surface.law])}; it must be in one"
        )
    return tuple(surface.law.values()), law[elements]
