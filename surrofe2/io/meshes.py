"""Meshes from files: any two-dimensional mesh that meshio reads, Gmsh's first.

Physical groups of Gmsh, and named sets of elements of other formats, become regions (surfaces) and
boundaries (lines). Elements are turned counter-clockwise, sides so that the tissue is on their
left, and triangles of three nodes get middles on their straight sides.
"""

from __future__ import annotations

import io
import os.path
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Groups = dict[str, tuple[Index, ...]]
"""Cells of each block by the name of a group."""

UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
"""µm in each unit of length that a file may have."""

_SURFACES = ("quad", "triangle", "triangle6")
_LINES = ("line", "line3")
_REVERSED = {4: [0, 3, 2, 1], 3: [0, 2, 1], 6: [0, 2, 1, 5, 4, 3]}


@dataclass(frozen=True, slots=True)
class StoredMesh:
    """What a file says of a mesh.

    Attributes:
        nodes: (n, 2) µm.
        elements: (n_el, 4) quadrilaterals or (n_el, 6) triangles, counter-clockwise; of a triangle
            the corners, then the middles of the sides 0-1, 1-2, 2-0.
        regions: elements by name. boundaries: (k, 2) or (k, 3) nodes of outer sides by name.
    """

    nodes: Array
    elements: Index
    regions: dict[str, Index]
    boundaries: dict[str, Index]


def read_mesh(path: Path, length_unit: str = "µm") -> StoredMesh:
    """Read a mesh whose coordinates are in `length_unit`, a key of `UNITS`.

    Raises:
        FileError: it is not there, or meshio cannot read it.
        InputError: it is no mesh of quadrilaterals or triangles in a plane, or a group has no name
            or no place in it.
    """
    if length_unit not in UNITS:
        raise InputError(f"length_unit: {length_unit!r}; it must be one of {', '.join(UNITS)}")
    stored = _read(path)
    try:
        return _converted(stored, UNITS[length_unit])
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _read(path: Path) -> Any:
    import meshio  # takes a third of a second, which recipes without a file do not spend

    if not os.path.isfile(path):  # False, too, of what no file can be called
        raise FileError(f"{path}: cannot be read: no such file")
    told = io.StringIO()
    try:
        # meshio prints what it thinks of a file and ends the process.
        with redirect_stdout(told), redirect_stderr(told):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()) if isinstance(error, Exception) else ""
        if "gmsh:physical" in reason:
            reason = (
                "some elements have physical groups and others none: export from Gmsh with "
                "Mesh.SaveAll = 0"
            )
        raise FileError(
            f"{path}: not a mesh that meshio reads{f' ({reason})' if reason else ''}"
        ) from None


def _converted(stored: Any, unit: float) -> StoredMesh:
    blocks = [(block.type, np.asarray(block.data, np.int64)) for block in stored.cells]
    kind = _kind_of_elements([name for name, _ in blocks], [len(cells) for _, cells in blocks])
    elements = np.concatenate([cells for name, cells in blocks if name == kind])
    nodes = _in_plane(np.asarray(stored.points, np.float64), elements)
    surfaces = [k for k, (name, _) in enumerate(blocks) if name == kind]
    lines = [k for k, (name, _) in enumerate(blocks) if name in _LINES]
    groups = _groups(stored, blocks)
    elements = _counter_clockwise(nodes, elements)
    first = dict(
        zip(surfaces, np.cumsum([0, *(len(blocks[k][1]) for k in surfaces)]), strict=False)
    )
    regions, borders = {}, {}
    for name, parts in groups.items():
        of_surfaces = [parts[k] + first[k] for k in surfaces]
        of_lines = [blocks[k][1][parts[k]][:, :2] for k in lines]
        if any(map(len, of_surfaces)):
            regions[name] = np.unique(np.concatenate(of_surfaces))
        if any(map(len, of_lines)):
            borders[name] = np.unique(np.sort(np.concatenate(of_lines), axis=1), axis=0)
    nodes, elements = _six_nodes(nodes, elements) if kind == "triangle" else (nodes, elements)
    outer = _outer_sides(nodes, elements)
    boundaries = {name: _sides_along(ends, outer, nodes, name) for name, ends in borders.items()}
    kept = np.ones(len(nodes), dtype=bool)
    for k, (_, cells) in enumerate(blocks):
        if k not in surfaces:
            kept[cells] = False
    kept[elements] = True  # a point of no cell stays, for the mesh to refuse it
    number = np.cumsum(kept) - 1
    return StoredMesh(
        nodes=unit * nodes[kept],
        elements=number[elements],
        regions=regions,
        boundaries={name: number[sides] for name, sides in boundaries.items()},
    )


def _kind_of_elements(names: list[str], counts: list[int]) -> str:
    """The one kind of elements among the blocks."""
    found: dict[str, int] = {}
    for name, count in zip(names, counts, strict=True):
        if name not in (*_LINES, "vertex") and count:
            found[name] = found.get(name, 0) + count
    foreign = [name for name in found if name not in _SURFACES]
    if foreign:
        raise InputError(
            f"{found[foreign[0]]} elements of kind {foreign[0]}; they must be one of "
            f"{', '.join(_SURFACES)}"
        )
    if not found:
        raise InputError(f"no element; it must have elements of kind {', '.join(_SURFACES)}")
    if len(found) > 1:
        told = " and ".join(f"{count} of kind {name}" for name, count in found.items())
        raise InputError(f"mixed elements, {told}; all must be of one kind")
    return next(iter(found))


def _in_plane(points: Array, elements: Index) -> Array:
    """(n, 2) points of which those of elements lie at one z."""
    used = points[np.unique(elements)]
    if not np.isfinite(used).all():
        node = int(np.argwhere(~np.isfinite(points).all(axis=1))[0, 0])
        raise InputError(f"point {node} at {points[node].tolist()}; coordinates must be finite")
    if points.shape[1] == 3:
        low, high = used[:, 2].min(), used[:, 2].max()
        if high - low > 1e-9 * np.ptp(used, axis=0).max():
            raise InputError(
                f"z from {low:.6g} to {high:.6g}; the mesh must lie in a plane of constant z"
            )
    return points[:, :2].copy()


def _groups(stored: Any, blocks: list[tuple[str, Index]]) -> Groups:
    """Named groups of lines and surfaces."""
    groups = {
        name: tuple(np.asarray([] if part is None else part, np.int64) for part in parts)
        for name, parts in stored.cell_sets.items()
        if not name.startswith("gmsh:")
    }
    tags = stored.cell_data.get("gmsh:physical")
    if tags is not None:
        groups |= {name: parts for name, parts in _physical_groups(stored, blocks, tags)
                   if name not in groups}  # fmt: skip
    for name, parts in groups.items():
        dimension = stored.field_data.get(name, (0, 0))[1]
        if dimension in (1, 2) and not any(map(len, parts)):
            what = "line" if dimension == 1 else "element"
            raise InputError(f"physical group {name}: it has no {what}")
        kinds = {blocks[k][0] in _LINES for k, part in enumerate(parts)
                 if len(part) and blocks[k][0] != "vertex"}  # fmt: skip
        if len(kinds) > 1:
            raise InputError(f"group {name}: it has lines and surfaces; name them apart")
    return groups


def _physical_groups(
    stored: Any, blocks: list[tuple[str, Index]], tags: Any
) -> Iterator[tuple[str, tuple[Index, ...]]]:
    """Groups by the number that each cell has; one without a name is refused."""
    named = {(int(dim), int(tag)): name for name, (tag, dim) in stored.field_data.items()}
    dimensions = [1 if kind in _LINES else 0 if kind == "vertex" else 2 for kind, _ in blocks]
    for dimension, of_block in zip(dimensions, tags, strict=True):
        for tag in np.unique(of_block):
            if tag > 0 and dimension > 0 and (dimension, int(tag)) not in named:
                what = "Curve" if dimension == 1 else "Surface"
                raise InputError(
                    f"physical group {tag} of {what.lower()}s has no name; give it one in Gmsh: "
                    f'Physical {what}("name", {tag}) = …'
                )
    for (dimension, tag), name in named.items():
        both = zip(dimensions, tags, strict=True)
        yield name, tuple(np.flatnonzero((d == dimension) & (of == tag)) for d, of in both)


def _counter_clockwise(nodes: Array, elements: Index) -> Index:
    """The elements, clockwise ones turned round."""
    corners = nodes[elements[:, : 4 if elements.shape[1] == 4 else 3]]
    x, y = corners[..., 0], corners[..., 1]
    doubled = (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)
    turned = elements[:, _REVERSED[elements.shape[1]]]
    return np.where(doubled[:, None] < 0.0, turned, elements)


def _six_nodes(nodes: Array, triangles: Index) -> tuple[Array, Index]:
    """Nodes and elements with the middles of the sides, numbered after the nodes."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    ends, of_side = np.unique(sides, axis=0, return_inverse=True)
    middles = nodes[ends].mean(axis=1)
    numbers = len(nodes) + of_side.reshape(-1, 3)
    return np.concatenate([nodes, middles]), np.concatenate([triangles, numbers], axis=1)


def _outer_sides(nodes: Array, elements: Index) -> Index:
    """(k, 2) or (k, 3) nodes of the sides of one element, the tissue on their left."""
    quads = elements.shape[1] == 4
    places = [[0, 1], [1, 2], [2, 3], [3, 0]] if quads else [[0, 1, 3], [1, 2, 4], [2, 0, 5]]
    sides = elements[:, places].reshape(-1, len(places[0]))
    ends = np.sort(sides[:, :2], axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    if count.max() > 2:
        side = sides[first[count.argmax()]]
        raise InputError(
            f"{count.max()} elements share the side at {_at(nodes[side[:2]].mean(axis=0))}; "
            "elements must not lie on one another"
        )
    return sides[np.sort(first[count == 1])]


def _sides_along(ends: Index, outer: Index, nodes: Array, name: str) -> Index:
    """The outer sides with these ends (k, 2), sorted in each row."""
    of_outer = {(min(a, b), max(a, b)): k for k, (a, b) in enumerate(outer[:, :2].tolist())}
    found = [of_outer.get((a, b), -1) for a, b in ends.tolist()]
    if -1 in found:
        line = nodes[ends[found.index(-1)]]
        raise InputError(
            f"boundary {name}: the line from {_at(line[0])} to {_at(line[1])} is no outer side of "
            "an element"
        )
    return outer[np.sort(found)]


def _at(point: Array) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
