"""Meshes from files by scikit-fem's bridge to meshio, and a sentence for each that is wrong.

Physical groups of Gmsh, and named sets of elements of other formats, become subdomains (surfaces)
and boundaries (lines).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError
from surrofe2.store.store import read_bytes

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Groups = dict[str, tuple[Index, ...]]
"""Cells of each block by the name of a group."""

UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
"""µm in each unit of length that a file may have."""

_MOST = 2**28
"""Bytes of a file."""
_SURFACES = ("quad", "triangle", "triangle6")
_LINES = ("line", "line3")


def read_mesh(path: Path, length_unit: str = "µm") -> skfem.Mesh:
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

    read_bytes(path, _MOST)  # a file, and no more than that
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


def _converted(stored: Any, unit: float) -> skfem.Mesh:
    import meshio
    from skfem.io.meshio import from_meshio

    blocks = [(block.type, np.asarray(block.data, np.int64)) for block in stored.cells]
    kind = _kind_of_elements([name for name, _ in blocks], [len(cells) for _, cells in blocks])
    groups = _groups(stored, blocks)
    elements = np.concatenate([cells for name, cells in blocks if name == kind])
    points = _in_plane(np.asarray(stored.points, np.float64), elements)
    # Points of lines and vertices alone go; a point of no cell stays, for the mesh to refuse it.
    # Corners come first: scikit-fem finds the sides of six-node triangles by these numbers.
    alone = np.setdiff1d(np.arange(len(points)), np.concatenate([np.ravel(c) for _, c in blocks]))
    corners = np.unique(elements[:, : 4 if kind == "quad" else 3])
    order = np.concatenate([corners, alone, np.setdiff1d(elements, corners)])
    number = np.full(len(points), -1)
    number[order] = np.arange(len(order))
    cells = [(kind, number[each]) if name == kind else ("line", number[each[:, :2]])
             for name, each in blocks if name in (kind, *_LINES)]  # fmt: skip
    used = [k for k, (name, _) in enumerate(blocks) if name in (kind, *_LINES)]
    sets = {name: [parts[k] for k in used] for name, parts in groups.items()}
    plain = meshio.Mesh(unit * points[order], cells, cell_sets=sets)
    mesh = from_meshio(plain, force_meshio_type=kind, ignore_orientation=True)
    outer = {*map(tuple, np.sort(mesh.facets[:, mesh.boundary_facets()].T, axis=1).tolist())}
    for name, parts in groups.items():
        for k in used:
            for line in blocks[k][1][parts[k], :2] if blocks[k][0] in _LINES else ():
                if tuple(sorted(number[line].tolist())) not in outer:
                    raise InputError(
                        f"boundary {name}: the line from {_at(points[line[0]])} to "
                        f"{_at(points[line[1]])} is no outer side of an element"
                    )
    boundaries, subdomains = (
        {name: facets for name, facets in (found or {}).items() if len(facets)}
        for found in (mesh.boundaries, mesh.subdomains)
    )
    return type(mesh)(mesh.p, mesh.t, boundaries or None, subdomains or None)


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


def _at(point: Array) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
