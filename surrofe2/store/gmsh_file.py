"""Reads mesh files of Gmsh: formats 2.2, 4.0 and 4.1, text and binary, partitioned or not.

Physical groups of surfaces and curves are groups; one without a name is called by its number, and
the sign of a reversed curve does not matter. Physical points are left out. The formats are those of
the chapter "MSH file format" of Gmsh's manual and of the files that Gmsh 4.15 writes.
"""

from __future__ import annotations

import codecs
import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.store.plane_mesh import (
    SURFACES,
    Array,
    Group,
    Index,
    Label,
    MeshError,
    StoredMesh,
    numbered_groups,
)

# Name and number of nodes of Gmsh's kinds of elements, by their number.
_KINDS = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4), 4: ("tetra", 4), 5: ("hexahedron", 8),
    6: ("wedge", 6), 7: ("pyramid", 5), 8: ("line3", 3), 9: ("triangle6", 6), 10: ("quad9", 9),
    11: ("tetra10", 10), 12: ("hexahedron27", 27), 13: ("wedge18", 18), 14: ("pyramid14", 14),
    15: ("vertex", 1), 16: ("quad8", 8), 17: ("hexahedron20", 20), 18: ("wedge15", 15),
    19: ("pyramid13", 13), 20: ("triangle9", 9), 21: ("triangle10", 10), 22: ("triangle12", 12),
    23: ("triangle15", 15), 24: ("triangle15", 15), 25: ("triangle21", 21), 26: ("line4", 4),
    27: ("line5", 5), 28: ("line6", 6), 36: ("quad16", 16), 37: ("quad25", 25), 38: ("quad36", 36),
    39: ("quad12", 12), 40: ("quad16", 16), 41: ("quad20", 20),
}  # fmt: skip
# Gmsh writes format 4.0 as "4".
_VERSIONS = {"2": 2, "2.0": 2, "2.1": 2, "2.2": 2, "4": 40, "4.0": 40, "4.1": 41}
_NO_SURFACE = (
    "Gmsh leaves out surfaces that are in no physical group as soon as there is one: add Physical "
    'Surface("tissue") = {…}, or set Mesh.SaveAll = 1 and write format 4.1; mesh by gmsh -2'
)
_LOST_GROUPS = (
    "no element is in one of its physical groups: format 2.2 loses them with Mesh.SaveAll = 1; "
    "write format 4.1"
)


@dataclass
class _Contents:
    """The content of a file, which its sections fill one after the other.

    Attributes:
        names: names of physical groups by dimension and number.
        physical: numbers of physical groups by dimension and number of an entity.
        partitions: partitions that an entity is in, by its dimension and number.
        n_partitions: that of the whole mesh.
        tags: (n,) numbers of the nodes.
        points: (n, 3) positions of the nodes.
        blocks: dimension, entity, kind and nodes (m, k) of elements; in format 2.2 the entity is
            the physical group.
    """

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    physical: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    partitions: dict[tuple[int, int], set[int]] = field(default_factory=dict)
    n_partitions: int = 1
    tags: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    blocks: list[tuple[int, int, str, Index]] = field(default_factory=list)


class _Numbers:
    """Numbers of a section, one after the other: text, or bytes of C's int, size_t and double."""

    def __init__(self, content: bytes, begin: int, end: int, order: str) -> None:
        self.content = content
        self.at = begin
        """Place of the next number: a byte of the file, or a token of a text."""
        self.end = end
        self.order = order
        """Order of bytes, "<" or ">"; empty in a text."""
        self.tokens = np.zeros(0)
        if not order:
            self.tokens = _parsed(content[begin:end])
            self.at = 0

    def _take(self, kind: str, count: int) -> NDArray[Any]:
        """Take the next `count` numbers of a kind, such as "i4"."""
        begin = self.at
        if self.order:
            self.at += count * int(kind[1])
            if not 0 <= count <= self.end or self.at > self.end:
                raise ValueError("it ends too early")
            return np.frombuffer(self.content, f"{self.order}{kind}", count, begin)
        self.at += count
        if count < 0 or self.at > len(self.tokens):
            raise ValueError("it ends too early")
        taken = self.tokens[begin : self.at]
        return taken if kind == "f8" else taken.astype(np.int64)

    def ints(self, count: int) -> Index:
        """Take the next `count` of C's int."""
        return self._take("i4", count).astype(np.int64)

    def sizes(self, count: int) -> Index:
        """Take the next `count` of C's size_t or unsigned long."""
        return self._take("i8", count).astype(np.int64)

    def doubles(self, count: int) -> Array:
        """Take the next `count` of C's double."""
        return self._take("f8", count).astype(np.float64)

    def records(self, count: int, ints: int, doubles: int) -> tuple[Index, Array]:
        """Take rows that each have ints, then doubles: (count, ints) and (count, doubles)."""
        if not self.order:
            width = ints + doubles
            rows = self._take("f8", count * width).reshape(count, width)
            return rows[:, :ints].astype(np.int64), rows[:, ints:]
        row = np.dtype([("i", f"{self.order}i4", (ints,)), ("d", f"{self.order}f8", (doubles,))])
        raw = self._take("u1", count * row.itemsize).view(row)
        return (
            raw["i"].astype(np.int64),
            raw["d"].astype(np.float64),
        )

    def count_line(self) -> int:
        """Take the number on a line of its own with which sections of format 2.2 begin."""
        if not self.order:
            return int(self.sizes(1)[0])
        end = self.content.index(b"\n", self.at)
        count = int(self.content[self.at : end])
        self.at = end + 1
        return count


def read_gmsh(path: str) -> StoredMesh:
    """Read the mesh in a file.

    Raises:
        ValueError: it is damaged, or of another format.
        MeshError: it holds a part of a mesh, or none.
    """
    content = Path(path).read_bytes().removeprefix(codecs.BOM_UTF8)
    contents = _Contents()
    version = 0
    order = ""
    place = 0
    heading = re.compile(rb"^\$(\w+)[ \t\r]*\n", re.MULTILINE)
    while True:
        match = heading.search(content, place)
        if match is None:
            break
        name = match[1].decode()
        begin = match.end()
        if name == "MeshFormat":
            version, order = _format(content[begin : begin + 64])
        read = _readers(version).get(name)
        closing = b"$End" + match[1]
        if read is None:
            place = content.find(closing, begin)
        elif name == "PhysicalNames":
            place = content.find(closing, begin)
            contents.names = _names(content[begin:place])
        elif order:
            # bytes of numbers may look like a heading, so the end is looked for behind them
            numbers = _Numbers(content, begin, len(content), order)
            read(numbers, contents)
            place = content.find(closing, numbers.at)
        else:
            place = content.find(closing, begin)
            if place >= 0:
                read(_Numbers(content, begin, place, order), contents)
        if place < 0:
            raise ValueError(f"its section ${name} has no end")
        place += len(closing)
    if not version:
        raise ValueError("it has no $MeshFormat")
    if b"$ParametricNodes" in content:
        raise ValueError("format 2.2 with parametric nodes; write 4.1, or Mesh.SaveParametric = 0")
    if not len(contents.points):
        raise ValueError("it has no $Nodes")
    _check_partitions(contents)
    return _stored(contents, version)


def _readers(version: int) -> dict[str, Any]:
    """Return the functions that read the sections of a format, by the sections' names."""
    if version == 2:
        return {"PhysicalNames": _names, "Nodes": _nodes_2, "Elements": _elements_2}
    readers = {"PhysicalNames": _names, "Nodes": _nodes_40, "Elements": _elements_40}
    if version == 41:
        readers |= {"Nodes": _nodes_41, "Elements": _elements_41}

    def entities(numbers: _Numbers, contents: _Contents) -> None:
        """Read $Entities."""
        _entities(numbers, contents, version, is_partitioned=False)

    def partitioned(numbers: _Numbers, contents: _Contents) -> None:
        """Read $PartitionedEntities."""
        _entities(numbers, contents, version, is_partitioned=True)

    return readers | {"Entities": entities, "PartitionedEntities": partitioned}


def _format(body: bytes) -> tuple[int, str]:
    """Return the version of a file, and the order of bytes of a binary one."""
    line, _, rest = body.partition(b"\n")
    version, is_binary, size = line.decode("ascii", "replace").split()
    if version not in _VERSIONS:
        raise ValueError(
            f"MSH version {version}; 2.2, 4.0 and 4.1 are read: gmsh FILE -save -format msh41"
        )
    if is_binary == "0":
        return _VERSIONS[version], ""
    if size != "8":
        raise ValueError(f"size_t of {size} bytes; binary files must have 8, or save it as text")
    return _VERSIONS[version], "<" if rest[:4] == b"\1\0\0\0" else ">"


def _parsed(text: bytes) -> Array:
    """Return the numbers of a text."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, np.float64, sep=" ")
        except DeprecationWarning:
            raise ValueError("it has a word where a number must be") from None


def _names(body: bytes) -> dict[tuple[int, int], str]:
    """Return the names of physical groups by their dimension and number."""
    lines = re.findall(rb'^\s*(\d+)\s+(-?\d+)\s+"(.*)"\s*$', body, re.MULTILINE)
    return {
        (int(dimension), abs(int(tag))): name.decode("utf-8", "replace")
        for dimension, tag, name in lines
    }


def _entities(
    numbers: _Numbers, contents: _Contents, version: int, *, is_partitioned: bool
) -> None:
    """Read physical groups of points, curves, surfaces and volumes, or of their parts."""
    if is_partitioned:
        contents.n_partitions = int(numbers.sizes(1)[0])
        ghosts = int(numbers.sizes(1)[0])
        numbers.ints(2 * ghosts)  # tag and partition of each
    counts = numbers.sizes(4).tolist()
    for dimension, count in enumerate(counts):
        for _ in range(count):
            tag = int(numbers.ints(1)[0])
            if is_partitioned:
                numbers.ints(2)  # dimension and tag of the entity that it is a part of
                parts = numbers.ints(int(numbers.sizes(1)[0])).tolist()
                contents.partitions[dimension, tag] = set(parts)
            # the position of a point, in format 4.1, or the corners of a bounding box
            numbers.doubles(3 if dimension == 0 and version == 41 else 6)
            physical = numbers.ints(int(numbers.sizes(1)[0]))
            contents.physical[dimension, tag] = abs(physical).tolist()  # negative: turned round
            if dimension:
                numbers.ints(int(numbers.sizes(1)[0]))  # tags of those that bound it


def _nodes_41(numbers: _Numbers, contents: _Contents) -> None:
    """Read the nodes of format 4.1."""
    blocks = int(numbers.sizes(4)[0])  # then the number of nodes, their lowest and highest tag
    tags = [contents.tags]
    points = [contents.points]
    for _ in range(blocks):
        dimension, _entity, is_parametric = numbers.ints(3).tolist()
        count = int(numbers.sizes(1)[0])
        width = 3 + (dimension if is_parametric else 0)
        tags.append(numbers.sizes(count))
        points.append(numbers.doubles(count * width).reshape(count, width)[:, :3])
    contents.tags = np.concatenate(tags)
    contents.points = np.concatenate(points)


def _nodes_40(numbers: _Numbers, contents: _Contents) -> None:
    """Read the nodes of format 4.0."""
    blocks = int(numbers.sizes(2)[0])  # then the number of nodes
    tags = [contents.tags]
    points = [contents.points]
    for _ in range(blocks):
        _entity, dimension, is_parametric = numbers.ints(3).tolist()
        count = int(numbers.sizes(1)[0])
        width = 3 + (dimension if is_parametric else 0)
        rows, positions = numbers.records(count, 1, width)
        tags.append(rows[:, 0])
        points.append(positions[:, :3])
    contents.tags = np.concatenate(tags)
    contents.points = np.concatenate(points)


def _nodes_2(numbers: _Numbers, contents: _Contents) -> None:
    """Read the nodes of format 2.2."""
    rows, contents.points = numbers.records(numbers.count_line(), 1, 3)
    contents.tags = rows[:, 0]


def _elements_41(numbers: _Numbers, contents: _Contents) -> None:
    """Read the elements of format 4.1."""
    blocks = int(numbers.sizes(4)[0])
    for _ in range(blocks):
        dimension, entity, number = numbers.ints(3).tolist()
        kind, width = _kind(number)
        count = int(numbers.sizes(1)[0])
        rows = numbers.sizes(count * (1 + width)).reshape(count, 1 + width)
        contents.blocks.append((dimension, entity, kind, rows[:, 1:]))


def _elements_40(numbers: _Numbers, contents: _Contents) -> None:
    """Read the elements of format 4.0."""
    blocks = int(numbers.sizes(2)[0])
    for _ in range(blocks):
        entity, dimension, number = numbers.ints(3).tolist()
        kind, width = _kind(number)
        count = int(numbers.sizes(1)[0])
        rows = numbers.ints(count * (1 + width)).reshape(count, 1 + width)
        contents.blocks.append((dimension, entity, kind, rows[:, 1:]))


def _elements_2(numbers: _Numbers, contents: _Contents) -> None:
    """Read the elements of format 2.2 with their tags: the physical group first, 0 for none."""
    count = numbers.count_line()
    while count > 0:
        if numbers.order:
            number, rows, n_tags = numbers.ints(3).tolist()
            kind, width = _kind(number)
            width += 1 + n_tags  # the number of the element and its tags come first
            table = numbers.ints(rows * width).reshape(rows, width)[:, 1:]
        else:
            table, number, n_tags = _alike(numbers, count)
            kind, width = _kind(number)
        if not len(table):
            raise ValueError("it ends too early")
        count -= len(table)
        groups = abs(table[:, 0]) if n_tags else np.zeros(len(table), np.int64)
        for group in np.unique(groups).tolist():
            nodes = table[groups == group, n_tags:]
            contents.blocks.append((_dimension(kind), group, kind, nodes))


def _alike(numbers: _Numbers, most: int) -> tuple[Index, int, int]:
    """Take the next elements that are of one kind.

    Returns:
        Tags and nodes of the elements (m, tags + nodes), the number of their kind, and how many
        tags each has.
    """
    tokens = numbers.tokens
    first = numbers.at
    if first + 3 > len(tokens):
        raise ValueError("it ends too early")
    number = int(tokens[first + 1])
    n_tags = int(tokens[first + 2])
    if not 0 <= n_tags < 1000:
        raise ValueError(f"an element of {n_tags} tags")
    _, n_nodes = _kind(number)
    width = 3 + n_tags + n_nodes
    rows = 0
    tried = 16
    while rows < most:
        # Some more at a time: rows of another kind may follow, which are of another width.
        tried = min(2 * tried, most - rows, (len(tokens) - first) // width - rows)
        if tried <= 0:
            break
        begin = first + rows * width
        more = tokens[begin : begin + tried * width].reshape(tried, width)
        is_alike = (more[:, 1] == number) & (more[:, 2] == n_tags)
        alike = tried if is_alike.all() else int(is_alike.argmin())
        rows += alike
        if alike < tried:
            break
    numbers.at = first + rows * width
    table = tokens[first : numbers.at].reshape(rows, width)
    return table[:, 3:].astype(np.int64), number, n_tags


def _kind(number: int) -> tuple[str, int]:
    """Return name and number of nodes of a kind of elements; a MeshError at an unknown one."""
    if number not in _KINDS:
        raise MeshError(
            f"elements of Gmsh's kind {number}; they must be triangles or quadrilaterals of order "
            "1 or 2: gmsh -2 -order 2"
        )
    return _KINDS[number]


def _dimension(kind: str) -> int:
    """Return the dimension of elements of a kind."""
    if kind == "vertex":
        return 0
    if kind.startswith("line"):
        return 1
    return 2 if kind.startswith(("triangle", "quad")) else 3


def _check_partitions(contents: _Contents) -> None:
    """Reject one of several files that each hold a part of a partitioned mesh."""
    partitions = [
        contents.partitions[dimension, entity]
        for dimension, entity, _, nodes in contents.blocks
        if dimension == 2 and len(nodes) and (dimension, entity) in contents.partitions
    ]
    parts = set().union(*partitions)
    if partitions and len(parts) < contents.n_partitions:
        raise MeshError(
            f"it holds {len(parts)} of the {contents.n_partitions} parts of a partitioned mesh; "
            "write all of it into one file: Mesh.PartitionSplitMeshFiles = 0"
        )


def _stored(contents: _Contents, version: int) -> StoredMesh:
    """Return cells by kind, with points by their place and not their number, and groups of them."""
    order = np.argsort(contents.tags, kind="stable")
    sorted_tags = contents.tags[order]
    if (np.diff(sorted_tags) == 0).any():
        twice = int(sorted_tags[:-1][np.diff(sorted_tags) == 0][0])
        raise ValueError(f"node {twice} is there twice")
    cells: dict[str, list[Index]] = {}
    counts: dict[str, int] = {}
    members: dict[tuple[int, int], dict[str, list[Index]]] = {}
    for dimension, entity, kind, nodes in contents.blocks:
        place = np.minimum(np.searchsorted(sorted_tags, nodes), len(order) - 1)
        if not (sorted_tags[place] == nodes).all():
            missing = int(nodes[sorted_tags[place] != nodes][0])
            raise ValueError(f"an element has node {missing}, which is not there")
        begin = counts.get(kind, 0)
        counts[kind] = begin + len(nodes)
        cells.setdefault(kind, []).append(order[place])
        if version == 2:
            physical = [entity] if entity else []
        else:
            physical = contents.physical.get((dimension, entity), [])
        for tag in physical:
            parts = members.setdefault((dimension, tag), {})
            parts.setdefault(kind, []).append(np.arange(begin, counts[kind]))
    joined = {kind: np.concatenate(parts) for kind, parts in cells.items()}
    groups = {
        key: {kind: np.concatenate(of) for kind, of in parts.items()}
        for key, parts in members.items()
    }
    notes = []
    if version == 2:
        _merge_repeated(joined, groups)
        if contents.names and not groups:
            notes.append(_LOST_GROUPS)
    return StoredMesh(
        points=contents.points,
        cells=joined,
        groups=_named(contents.names, groups),
        remedy=_NO_SURFACE if groups else "",
        notes=notes,
    )


def _merge_repeated(
    cells: dict[str, Index], groups: dict[tuple[int, int], dict[str, Index]]
) -> None:
    """Make one element of those that format 2.2 repeats for each of their physical groups."""
    for kind in SURFACES:
        nodes = cells.get(kind)
        if nodes is None:
            continue
        group_of = np.zeros(len(nodes), np.int64)
        for (_, tag), parts in groups.items():
            group_of[parts.get(kind, [])] = tag
        _, first, same = np.unique(
            np.sort(nodes, axis=1), axis=0, return_index=True, return_inverse=True
        )
        same = same.ravel()
        # The same element twice in one group is a fault of the mesh, which is reported later.
        _, counts = np.unique(np.column_stack([same, group_of]), axis=0, return_counts=True)
        if len(first) == len(nodes) or (counts > 1).any():
            continue
        by_place = np.argsort(first)
        number = np.empty(len(first), np.int64)
        number[by_place] = np.arange(len(first))
        cells[kind] = nodes[first[by_place]]
        for parts in groups.values():
            if kind in parts:
                parts[kind] = np.unique(number[same[parts[kind]]])


def _named(
    names: dict[tuple[int, int], str], groups: dict[tuple[int, int], dict[str, Index]]
) -> list[Group]:
    """Return groups of curves and surfaces by their names, or by numbers where they have none."""
    named: dict[tuple[int, str], Group] = {}
    for (dimension, _), name in names.items():
        if dimension in (1, 2):  # without a cell, too: where it is used, that is said
            named[dimension, name] = Group(name, dimension)
    for (dimension, tag), parts in groups.items():
        if dimension not in (1, 2) or (dimension, tag) not in names:
            continue
        group = named[dimension, names[dimension, tag]]
        for kind, of in parts.items():
            group.cells[kind] = np.union1d(group.cells.get(kind, np.zeros(0, np.int64)), of)
    unnamed = [
        Label("", dimension, tag, kind, of)
        for (dimension, tag), parts in groups.items()
        for kind, of in parts.items()
        if dimension in (1, 2) and (dimension, tag) not in names
    ]
    return [*named.values(), *numbered_groups(unnamed)]
