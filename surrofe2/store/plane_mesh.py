"""Turns a stored mesh into one kind of element in the plane, with named sides and regions.

Cells of the second order and mixed ones become six-node triangles: those use all nodes of a file,
bend better than quadrilaterals, and meet without hanging nodes. It knows no format of a file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LINES = {"line": 2, "line3": 3}
# Nodes of each kind that is read: corners, then middles of sides in their order, then a centre.
SURFACES = {"triangle": 3, "quad": 4, "triangle6": 6, "quad8": 8, "quad9": 9}
_CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
# Fraction of the mesh's extent by which z may vary: files of single precision or few digits.
IN_PLANE = 1e-6


class MeshError(Exception):
    """A mesh that was read and cannot be taken; its message is for the user."""


@dataclass
class Group:
    """A named set of lines (dimension 1) or of surfaces (dimension 2).

    Attributes:
        cells: numbers of its cells among those of a kind, by the kind.
    """

    name: str
    dimension: int
    cells: dict[str, Index] = field(default_factory=dict)


@dataclass
class StoredMesh:
    """A mesh as a file has it.

    Attributes:
        points: (n, 2) or (n, 3).
        cells: (m, k) nodes by kind, as meshio calls kinds and orders nodes.
        groups: named sets of cells.
        node_sets: by name numbers of points; the outer sides that they hold become a boundary.
        remedy: what helps where no surface is there.
        notes: what is odd about it, for the user.
    """

    points: Array
    cells: dict[str, Index]
    groups: list[Group] = field(default_factory=list)
    node_sets: dict[str, Index] = field(default_factory=dict)
    remedy: str = ""
    notes: list[str] = field(default_factory=list)


@dataclass
class PlaneMesh:
    """A mesh of elements of one kind in the plane.

    Attributes:
        points: (n, 2), corners first.
        elements: (m, 3), (m, 4) or (m, 6) nodes.
        boundaries: by name (s, 2) ends of sides of elements.
        regions: by name numbers of elements.
        notes: what was changed, for the user.
    """

    points: Array
    elements: Index
    boundaries: dict[str, Index]
    regions: dict[str, Index]
    notes: list[str]


def plane_mesh(stored: StoredMesh) -> PlaneMesh:
    """Return the mesh with one kind of element, or raise a `MeshError`."""
    _check_kinds(stored)
    _check_numbers(stored)
    points, elements, first_of, notes = _one_kind(stored)
    points = _in_plane(points, elements)
    points, elements, number = _renumbered(points, elements)
    if elements.shape[1] == 6:
        _check_middles(points, elements)
    sides = _sides(elements)
    boundaries: dict[str, Index] = {}
    regions: dict[str, Index] = {}
    for group in stored.groups:
        if group.dimension == 2:
            parts = [first_of[kind][of] for kind, of in group.cells.items() if kind in first_of]
            regions[group.name] = np.unique(_joined(parts))
        else:
            ends = [
                stored.cells[kind][of][:, :2] for kind, of in group.cells.items() if kind in LINES
            ]
            lines = np.concatenate([*ends, np.zeros((0, 2), np.int64)])
            boundaries[group.name] = _lines_of(group.name, lines, number, sides, stored.points)
    for name, nodes in stored.node_sets.items():
        if name not in boundaries:
            boundaries[name] = _held_sides(nodes, number, sides, elements)
    return PlaneMesh(points, elements, boundaries, regions, stored.notes + notes)


class Label(NamedTuple):
    """Cells that have a number for a name.

    Attributes:
        prefix: text before the number in the name.
        dimension: 1 of lines, 2 of surfaces.
        number: the number.
        kind: kind of the cells.
        cells: their numbers among those of the kind.
    """

    prefix: str
    dimension: int
    number: int
    kind: str
    cells: Index


def numbered_groups(labels: Iterable[Label]) -> list[Group]:
    """Make a group for each number, called by it.

    A number that both lines and surfaces have is called "curve 1" and "surface 1".
    """
    groups: dict[tuple[str, int, int], Group] = {}
    for label in labels:
        key = (label.prefix, label.dimension, label.number)
        group = groups.setdefault(key, Group(f"{label.prefix}{label.number}", label.dimension))
        group.cells[label.kind] = label.cells
    for (prefix, dimension, number), group in groups.items():
        if (prefix, 3 - dimension, number) in groups:
            group.name = f"{prefix}{'curve' if dimension == 1 else 'surface'} {number}"
    return [*groups.values()]


def _check_kinds(stored: StoredMesh) -> None:
    """Check that there are surfaces, and no cells but lines and surfaces that are read."""
    counts = {kind: len(cells) for kind, cells in stored.cells.items() if len(cells)}
    known = ", ".join(SURFACES)
    for kind, count in counts.items():
        if kind in ("vertex", *LINES, *SURFACES):
            continue
        if kind.startswith(("line", "triangle", "quad")):
            raise MeshError(
                f"{count} cells of kind {kind}; they must be of order 1 or 2, which are {known} "
                "(in Gmsh: -order 2)"
            )
        raise MeshError(f"{count} elements of kind {kind}; they must be one of {known}")
    if not any(kind in SURFACES for kind in counts):
        remedy = stored.remedy or f"it must have elements of kind {known}"
        raise MeshError(f"no element; {remedy}")


def _check_numbers(stored: StoredMesh) -> None:
    """Reject numbers that numpy would count from the end, or that are of no point or cell."""
    count = len(stored.points)
    for nodes in [*stored.cells.values(), *stored.node_sets.values()]:
        if nodes.size and not 0 <= nodes.min() <= nodes.max() < count:
            raise MeshError(f"cells of points that are not there; there are {count}")
    for group in stored.groups:
        for kind, of in group.cells.items():
            cells = len(stored.cells.get(kind, ()))
            if of.size and not 0 <= of.min() <= of.max() < cells:
                raise MeshError(
                    f"group {group.name}: elements that are not there; there are {cells}"
                )


def _one_kind(stored: StoredMesh) -> tuple[Array, Index, dict[str, Index], list[str]]:
    """Return points, elements of one kind, the elements that each cell became, and notes.

    The third is by kind, (m, 1) or (m, 2): a quadrilateral may become two triangles.
    """
    points = stored.points
    surfaces = {kind: stored.cells[kind] for kind in SURFACES if len(stored.cells.get(kind, ()))}
    if len(surfaces) == 1:
        ((kind, cells),) = surfaces.items()
        if kind in ("quad", "triangle", "triangle6"):
            return points, cells, {kind: np.arange(len(cells))[:, None]}, []
    is_first_order = set(surfaces) <= {"quad", "triangle"}
    width = 3 if is_first_order else 6
    elements: list[Index] = []
    first_of: dict[str, Index] = {}
    count = 0
    for kind, cells in surfaces.items():
        if kind == "quad8":
            points, cells = _with_centres(points, cells)
        if not is_first_order and kind in ("quad", "triangle"):
            raise MeshError(
                f"{len(cells)} cells of kind {kind} among {', '.join(set(surfaces) - {kind})}; "
                "all must be of one order"
            )
        if _CORNERS[kind] == 3:
            elements.append(cells)
            first_of[kind] = count + np.arange(len(cells))[:, None]
        else:
            halves = _halves(points, cells)
            elements.append(halves.reshape(-1, width))
            first_of[kind] = count + np.arange(2 * len(cells)).reshape(-1, 2)
        count += len(elements[-1])
    what = " and ".join(f"{len(cells)} of kind {kind}" for kind, cells in surfaces.items())
    note = f"{what}; each quadrilateral becomes two triangles, and all elements have six nodes"
    if is_first_order:
        note += " (for quadrilaterals alone, in Gmsh: Mesh.RecombinationAlgorithm = 3)"
    return points, np.concatenate(elements), first_of, [note]


def _with_centres(points: Array, cells: Index) -> tuple[Array, Index]:
    """Give quadrilaterals a ninth node, where the shape functions of eight put it."""
    centres = 0.5 * points[cells[:, 4:]].sum(axis=1) - 0.25 * points[cells[:, :4]].sum(axis=1)
    numbers = len(points) + np.arange(len(cells))
    return np.concatenate([points, centres]), np.column_stack([cells, numbers])


def _halves(points: Array, cells: Index) -> Index:
    """Cut quadrilaterals of 4 or 9 nodes along the shorter diagonal: (m, 2, 3) or (m, 2, 6)."""
    corners = points[cells[:, :4]]
    first = np.linalg.norm(corners[:, 2] - corners[:, 0], axis=1)
    second = np.linalg.norm(corners[:, 3] - corners[:, 1], axis=1)
    # From corner 0 to 2, or from 1 to 3: sides and their middles follow in the same turn.
    along_first = [[0, 1, 2, 4, 5, 8], [0, 2, 3, 8, 6, 7]]
    along_second = [[1, 2, 3, 5, 6, 8], [1, 3, 0, 8, 7, 4]]
    width = 3 if cells.shape[1] == 4 else 6
    which = np.where(
        (first <= second)[:, None, None],
        np.array(along_first)[:, :width],
        np.array(along_second)[:, :width],
    )
    rows = np.arange(len(cells))[:, None, None]
    return cells[rows, which]


def _in_plane(points: Array, elements: Index) -> Array:
    """Return points (n, 2); those of elements must be finite and lie at one z."""
    used = points[np.unique(elements)]
    if not np.isfinite(used).all():
        numbers = np.unique(elements)
        node = int(numbers[~np.isfinite(used).all(axis=1)][0])
        raise MeshError(f"point {node} at {points[node].tolist()}; coordinates must be finite")
    if points.shape[1] == 3:
        low = used[:, 2].min()
        high = used[:, 2].max()
        if high - low > IN_PLANE * np.ptp(used[:, :2], axis=0).max():
            raise MeshError(
                f"z from {low:.6g} to {high:.6g}; the mesh must lie in a plane of constant z"
            )
    return points[:, :2].copy()


def _renumbered(points: Array, elements: Index) -> tuple[Array, Index, Index]:
    """Return the points of elements alone, corners first, and the elements by their new numbers.

    The third is the new number of each old point, −1 of one that no element has.

    scikit-fem finds the sides of six-node triangles by the numbers of corners.
    """
    corners = np.unique(elements[:, : 4 if elements.shape[1] == 4 else 3])
    order = np.concatenate([corners, np.setdiff1d(elements, corners)])
    number = np.full(len(points), -1)
    number[order] = np.arange(len(order))
    return points[order], number[elements], number


def _sides(elements: Index) -> Index:
    """Return the ends (m, k, 2) of the sides of each element, the lower number first."""
    corners = elements[:, : 4 if elements.shape[1] == 4 else 3]
    return np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2)


def _key(ends: Index) -> Index:
    """Return a number for each pair of ends, of which the lower is first."""
    return ends[..., 0] * (1 << 31) + ends[..., 1]


def _check_middles(points: Array, elements: Index) -> None:
    """Check that each side has one middle node, which is no corner and of no other side."""
    keys = _key(_sides(elements)).ravel()
    middles = elements[:, 3:].ravel()
    corner = np.isin(middles, elements[:, :3])
    if corner.any():
        point = points[middles[corner.argmax()]]
        raise MeshError(
            f"the node at {_at(point)} hangs: it is a corner of one element and the middle of a "
            "side of another; make the mesh conforming"
        )
    by_side = np.lexsort([middles, keys])
    same_side = np.diff(keys[by_side]) == 0
    other_middle = np.diff(middles[by_side]) != 0
    apart = np.flatnonzero(same_side & other_middle)
    if apart.size:
        point = points[middles[by_side[apart[0]]]]
        raise MeshError(
            f"two nodes in the middle of the side at {_at(point)}; glue them (in Gmsh: Coherence "
            "Mesh)"
        )


def _lines_of(name: str, lines: Index, number: Index, sides: Index, points: Array) -> Index:
    """Return the ends (s, 2) of a group's lines; each must be a side of an element."""
    ends = np.sort(number[lines], axis=1)
    is_side = np.isin(_key(ends), _key(sides)) & (ends[:, 0] >= 0)
    if not is_side.all():
        a, b = points[lines[is_side.argmin()]]
        raise MeshError(
            f"boundary {name}: the line from {_at(a)} to {_at(b)} is no side of an element"
        )
    return np.unique(ends, axis=0)


def _held_sides(nodes: Index, number: Index, sides: Index, elements: Index) -> Index:
    """Return the ends (s, 2) of the outer sides all of whose nodes are among these."""
    is_held = np.zeros(len(number) + 1, dtype=bool)  # the last is of points without a number
    is_held[number[nodes]] = True
    is_held[-1] = False
    held = is_held[sides].all(axis=2)
    if elements.shape[1] == 6:
        held &= is_held[elements[:, 3:]]
    _, first, count = np.unique(_key(sides), return_index=True, return_counts=True)
    outer = np.zeros(sides.shape[:2], dtype=bool)
    outer.ravel()[first[count == 1]] = True
    return sides[held & outer]


def _joined(parts: list[Index]) -> Index:
    """Return all numbers of some arrays in one row."""
    return np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in parts)])


def _at(point: Array) -> str:
    """Write a point (2,) for a message."""
    return f"({point[0]:.6g}, {point[1]:.6g})"
