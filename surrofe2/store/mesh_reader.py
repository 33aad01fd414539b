"""Reads a mesh by meshio in a process of its own, which may take so much memory and time.

    python -P mesh_reader.py FORMAT FILE MEMORY SECONDS

writes the mesh to standard output as NumPy archive, or one line to standard error, with exit code
1 where meshio does not read the file and 2 where it is no mesh for us. It imports nothing of the
package, so that it starts soon. Physical groups of Gmsh, and named sets of elements of other
formats, become subdomains (surfaces) and boundaries (lines).
"""

from __future__ import annotations

import io
import os
import resource
import sys
from collections import Counter
from typing import Any

import meshio
import numpy as np
import skfem
from skfem.io.meshio import from_meshio

from surrofe2.base.arrays import Array, Index

Groups = dict[str, tuple[Index, ...]]
"""Cells of each block by the name of a group."""

_SURFACES = ("quad", "triangle", "triangle6")
_LINES = ("line", "line3")


class MeshError(Exception):
    """A mesh that meshio reads and we do not take."""


def converted(stored: meshio.Mesh) -> skfem.Mesh:
    """The mesh in the plane, with named boundaries and subdomains, or a MeshError."""
    _check(stored)
    blocks = [(block.type, np.asarray(block.data, np.int64)) for block in stored.cells]
    kind = _kind_of_elements(blocks)
    groups = _groups(stored)
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
    plain = meshio.Mesh(points[order], cells, cell_sets=sets)
    mesh = from_meshio(plain, force_meshio_type=kind, ignore_orientation=True)
    outer = {*map(tuple, np.sort(mesh.facets[:, mesh.boundary_facets()].T, axis=1).tolist())}
    for name, parts in groups.items():
        for k in used:
            for line in blocks[k][1][parts[k], :2] if blocks[k][0] in _LINES else ():
                if tuple(sorted(number[line].tolist())) not in outer:
                    raise MeshError(
                        f"boundary {name}: the line from {_at(points[line[0]])} to "
                        f"{_at(points[line[1]])} is no outer side of an element"
                    )
    boundaries, subdomains = (
        {name: facets for name, facets in (found or {}).items() if len(facets)}
        for found in (mesh.boundaries, mesh.subdomains)
    )
    return type(mesh)(mesh.p, mesh.t, boundaries or None, subdomains or None)


def _kind_of_elements(blocks: list[tuple[str, Index]]) -> str:
    """The one kind of elements among the blocks."""
    found = Counter[str]()
    for name, cells in blocks:
        if name not in (*_LINES, "vertex") and len(cells):
            found[name] += len(cells)
    foreign = [name for name in found if name not in _SURFACES]
    if foreign:
        raise MeshError(
            f"{found[foreign[0]]} elements of kind {foreign[0]}; they must be one of "
            f"{', '.join(_SURFACES)}"
        )
    if not found:
        raise MeshError(f"no element; it must have elements of kind {', '.join(_SURFACES)}")
    if len(found) > 1:
        mixed = " and ".join(f"{count} of kind {name}" for name, count in found.items())
        raise MeshError(f"mixed elements, {mixed}; all must be of one kind")
    return next(iter(found))


def _in_plane(points: Array, elements: Index) -> Array:
    """(n, 2) points of which those of elements lie at one z."""
    used = points[np.unique(elements)]
    if not np.isfinite(used).all():
        node = int(np.argwhere(~np.isfinite(points).all(axis=1))[0, 0])
        raise MeshError(f"point {node} at {points[node].tolist()}; coordinates must be finite")
    if points.shape[1] == 3:
        low, high = used[:, 2].min(), used[:, 2].max()
        if high - low > 1e-9 * np.ptp(used, axis=0).max():
            raise MeshError(
                f"z from {low:.6g} to {high:.6g}; the mesh must lie in a plane of constant z"
            )
    return points[:, :2].copy()


def _check(stored: meshio.Mesh) -> None:
    """Refuse numbers that numpy would count from the end, or that are of no point or cell."""
    cells = [(block.data, len(stored.points), "points") for block in stored.cells]
    groups = [
        (part, len(block.data), "elements in a group")
        for parts in stored.cell_sets.values()
        for part, block in zip(parts, stored.cells, strict=True)
    ]
    for numbers, count, what in cells + groups:
        index = np.asarray([] if numbers is None else numbers)
        if index.size and not 0 <= index.min() <= index.max() < count:
            raise ValueError(f"cells of {what} that are not there; there are {count}")


def _groups(stored: meshio.Mesh) -> Groups:
    """Named groups of lines and surfaces; a physical one, of cells by number, must have a name."""
    named = {(int(dim), int(tag)): name for name, (tag, dim) in stored.field_data.items()}
    tagged = [
        (1 if each.type in _LINES else 0 if each.type == "vertex" else 2, np.asarray(tags))
        for each, tags in zip(stored.cells, stored.cell_data.get("gmsh:physical", []), strict=False)
    ]
    for dimension, tags in tagged:
        for tag in np.unique(tags):
            if tag > 0 and dimension > 0 and (dimension, int(tag)) not in named:
                what = "Curve" if dimension == 1 else "Surface"
                raise MeshError(
                    f"physical group {tag} of {what.lower()}s has no name; give it one in Gmsh: "
                    f'Physical {what}("name", {tag}) = …'
                )
    groups: Groups = {}
    for (dimension, tag), name in named.items() if tagged else ():
        groups[name] = tuple(np.flatnonzero((d == dimension) & (of == tag)) for d, of in tagged)
    for name, parts in stored.cell_sets.items():
        if not name.startswith("gmsh:"):
            groups[name] = tuple(np.asarray([] if p is None else p, np.int64) for p in parts)
    for name, parts in groups.items():
        dimension = int(stored.field_data[name][1]) if name in stored.field_data else 0
        if dimension in (1, 2) and not any(map(len, parts)):
            what = "line" if dimension == 1 else "element"
            raise MeshError(f"physical group {name}: it has no {what}")
        kinds = {block.type in _LINES for block, part in zip(stored.cells, parts, strict=True)
                 if len(part) and block.type != "vertex"}  # fmt: skip
        if len(kinds) > 1:
            raise MeshError(f"group {name}: it has lines and surfaces; name them apart")
    return groups


def _at(point: Array) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"


def read(kind: str, path: str) -> bytes:
    """The mesh in a file: its class, p, t, and what its names number."""
    mesh = converted(getattr(meshio, kind).read(path))
    arrays: dict[str, Any] = {"kind": type(mesh).__name__, "p": mesh.p, "t": mesh.t}
    for group, named in (("boundaries", mesh.boundaries), ("subdomains", mesh.subdomains)):
        arrays[group] = np.array([*(named or {})], dtype=str)
        arrays |= {f"{group}.{k}": each for k, each in enumerate((named or {}).values())}
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    return archive.getvalue()


def main() -> None:
    """Read what the command line names."""
    kind, path, memory, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 1))
    out, messages = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(2), "w", errors="replace")
    for stream in (1, 2):  # meshio, and HDF5, print what they think of a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    code = 1
    try:
        content = read(kind, path)
    except MeshError as error:
        code, reason = 2, str(error)
    except MemoryError:
        reason = f"reading it takes more than {int(memory) / 1e9:.3g} GB"
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
    except SystemExit:
        reason = "meshio ended"
    else:
        out.write(content)
        out.close()
        return
    messages.write(reason[:500])
    messages.close()
    os._exit(code)


if __name__ == "__main__":
    main()
