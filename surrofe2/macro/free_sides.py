"""Free sides of a tissue: which they are, beside which element, and whose law they take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.law.surface_law import SurfaceLaw
from surrofe2.problem.conditions import FREE, Surface
from surrofe2.problem.mesh import boundary, element_nodes, facet_nodes, region
from surrofe2.problem.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ALONG = 1.0
"""Degrees off the rows of plant cells up to which a side runs along them."""


@dataclass(frozen=True, slots=True)
class FreeSides:
    """Sides with a surface law.

    Attributes:
        nodes: (m, 2) or (m, 3) nodes of each, as of `facet_nodes`.
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
        parts = [boundary(mesh, name, "surface.on") for name in names]
    facets, of_boundary = (
        np.concatenate(parts),
        np.repeat(np.arange(len(parts)), [*map(len, parts)]),
    )
    _, first = np.unique(facets, return_index=True)
    first.sort()  # a side of two boundaries counts once
    facets, of_boundary = facets[first], of_boundary[first]
    nodes, elements = facet_nodes(mesh, facets), mesh.f2t[0, facets].astype(np.int64)
    laws, law = _laws(surface, mesh, elements)
    along = np.diff(mesh.p.T[nodes[:, :2]], axis=1)[:, 0]
    angle = np.degrees(np.arctan2(*np.sort(abs(along), axis=1).T))
    oblique = np.where(angle > _ALONG, angle, 0.0)
    return FreeSides(nodes, elements, names, of_boundary, laws, law, oblique)


def _unnamed(problem: Problem) -> Index:
    """Outer facets that no condition and no body names."""
    mesh, places = problem.mesh, {*problem.places()}
    named = [facets for name, facets in (mesh.boundaries or {}).items() if name in places]
    return np.setdiff1d(mesh.boundary_facets(), np.concatenate([[], *named])).astype(np.int64)


def _laws(
    surface: Surface, mesh: skfem.Mesh, elements: Index
) -> tuple[tuple[SurfaceLaw, ...], Index]:
    """The laws, and (m,) which of them each side takes."""
    if not isinstance(surface.law, Mapping):
        return (surface.law,), np.zeros(len(elements), np.int64)
    law, claims = np.zeros((2, mesh.nelements), np.int64)
    known = surface.regions
    for k, name in enumerate(surface.law):
        own = region(mesh, name, "surface.law") if known is None else known[name]
        law[own], claims[own] = k, claims[own] + 1
    wrong = np.flatnonzero(claims[elements] != 1)
    if wrong.size:
        x, y = mesh.p[:, element_nodes(mesh)[elements[wrong[0]]]].mean(axis=1)
        raise InputError(
            f"surface.law: the element at ({x:.6g}, {y:.6g}) µm is in "
            f"{claims[elements[wrong[0]]]} of {', '.join([*surface.law])}; it must be in one"
        )
    return tuple(surface.law.values()), law[elements]
