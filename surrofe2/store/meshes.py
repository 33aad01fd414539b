"""Meshes from files by meshio, in a process of its own, and a sentence for each that is wrong.

Physical groups of Gmsh, and named sets of elements of other formats, become subdomains (surfaces)
and boundaries (lines).
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError, shortened
from surrofe2.store.store import read_bytes, reported

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Groups = dict[str, tuple[Index, ...]]
"""Cells of each block by the name of a group."""

UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
"""µm in each unit of length that a file may have."""

FORMATS = {
    ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".xmf": "xdmf",
    ".inp": "abaqus", ".mesh": "medit", ".meshb": "medit",
}  # fmt: skip
"""meshio's modules by the ends of names of files."""

_MOST = 2**28
"""Bytes of a file."""
_SURFACES = ("quad", "triangle", "triangle6")
_LINES = ("line", "line3")
_EMPTY = np.zeros(0, np.int64)


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


@dataclass(frozen=True, slots=True)
class _Block:
    """Cells (n, k) of one kind, as meshio calls it, and the number of the group of each."""

    type: str
    data: Index
    tags: Index | None


@dataclass(frozen=True, slots=True)
class _Stored:
    """What a file has; `sets` by block, `numbered` groups by name: number and dimension."""

    points: Array
    blocks: list[_Block]
    sets: Groups
    numbered: dict[str, tuple[int, int]]


def _read(path: Path) -> _Stored:
    """The content of a file, which a process of its own parses: libraries trust what they read."""
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise FileError(f"{path}: not a mesh file: its name must end in {', '.join(FORMATS)}")
    size = len(read_bytes(path, _MOST))  # a file, and no more than that
    memory, seconds = 2 * 10**9 + 20 * size, 20 + size // 10**6
    reader = [sys.executable, "-P", str(Path(__file__).with_name("mesh_reader.py"))]
    alone = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
    with reported(path, "read"):
        try:
            done = subprocess.run(
                [*reader, kind, str(path.absolute()), str(memory), str(seconds)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=3 * seconds,
                env=os.environ | alone,
                check=False,
            )
            reason = shortened(" ".join(done.stderr.decode("utf-8", "replace").split()), 150)
            is_late = done.returncode == -signal.SIGXCPU
        except subprocess.TimeoutExpired:
            is_late = True
    if is_late:
        reason = f"reading it takes more than {seconds} s"
    elif done.returncode < 0:
        reason = f"its reader ended by signal {-done.returncode}"
    elif done.returncode == 0:
        return _checked(path, done.stdout)
    if "gmsh:physical" in reason:
        reason = (
            "some elements have physical groups and others none: export from Gmsh with "
            "Mesh.SaveAll = 0"
        )
    raise FileError(f"{path}: not a mesh that meshio reads ({reason})")


def _checked(path: Path, content: bytes) -> _Stored:
    """What the reader wrote, whose numbers fit to each other."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    kinds, names, has_tags, numbered = json.loads(arrays["names"].tobytes())
    points = arrays["points"]
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FileError(f"{path}: points of shape {points.shape}; they must be (n, 2) or (n, 3)")
    blocks = []
    for k, kind in enumerate(kinds):
        cells, tags = arrays[f"cells.{k}"], arrays.get(f"tags.{k}")
        wrong = cells.ndim != 2 or (
            cells.size and not 0 <= cells.min() <= cells.max() < len(points)
        )
        if wrong or (has_tags and (tags is None or tags.shape != cells.shape[:1])):
            what = f"cells of kind {kind} have points, or groups, that are not there"
            raise FileError(f"{path}: {what}; the file has {len(points)} points")
        blocks.append(_Block(kind, cells, tags))
    sets = {}
    for k, name in enumerate(names):
        sets[name] = tuple(arrays.get(f"sets.{k}.{j}", _EMPTY) for j in range(len(blocks)))
        for part, block in zip(sets[name], blocks, strict=True):
            if part.ndim != 1 or (
                part.size and not 0 <= part.min() <= part.max() < len(block.data)
            ):
                raise FileError(
                    f"{path}: group {shortened(name, 60)}: it has cells beyond the last"
                )
    return _Stored(
        points, blocks, sets, {name: (tag, dim) for name, (tag, dim) in numbered.items()}
    )


def _converted(stored: _Stored, unit: float) -> skfem.Mesh:
    import meshio  # takes a third of a second, which recipes without a file do not spend
    from skfem.io.meshio import from_meshio

    blocks = [(block.type, block.data) for block in stored.blocks]
    kind = _kind_of_elements([name for name, _ in blocks], [len(cells) for _, cells in blocks])
    groups = _groups(stored)
    elements = np.concatenate([cells for name, cells in blocks if name == kind])
    points = _in_plane(stored.points, elements)
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


def _groups(stored: _Stored) -> Groups:
    """Named groups of lines and surfaces."""
    groups = dict(_physical_groups(stored)) | stored.sets
    for name, parts in groups.items():
        dimension = stored.numbered.get(name, (0, 0))[1]
        if dimension in (1, 2) and not any(map(len, parts)):
            what = "line" if dimension == 1 else "element"
            raise InputError(f"physical group {name}: it has no {what}")
        kinds = {block.type in _LINES for block, part in zip(stored.blocks, parts, strict=True)
                 if len(part) and block.type != "vertex"}  # fmt: skip
        if len(kinds) > 1:
            raise InputError(f"group {name}: it has lines and surfaces; name them apart")
    return groups


def _physical_groups(stored: _Stored) -> Iterator[tuple[str, tuple[Index, ...]]]:
    """Groups by the number that each cell has; one without a name is refused."""
    named = {(dim, tag): name for name, (tag, dim) in stored.numbered.items()}
    tagged = [
        (1 if each.type in _LINES else 0 if each.type == "vertex" else 2, each.tags)
        for each in stored.blocks
        if each.tags is not None
    ]
    for dimension, tags in tagged:
        for tag in np.unique(tags):
            if tag > 0 and dimension > 0 and (dimension, int(tag)) not in named:
                what = "Curve" if dimension == 1 else "Surface"
                raise InputError(
                    f"physical group {tag} of {what.lower()}s has no name; give it one in Gmsh: "
                    f'Physical {what}("name", {tag}) = …'
                )
    for (dimension, tag), name in named.items() if tagged else ():
        yield name, tuple(np.flatnonzero((d == dimension) & (of == tag)) for d, of in tagged)


def _at(point: Array) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
