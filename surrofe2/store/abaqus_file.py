"""Reads the mesh of an Abaqus input file: plane elements, sets of elements and nodes, surfaces.

Element sets are groups of surfaces, or of trusses and beams along sides, as Gmsh writes curves.
Node sets, and surfaces of element sides, become boundaries. Abaqus/CAE writes both sets of one name
for a part of the geometry. Of a face the node set holds all nodes of the elements, and the element
set says it; of an edge the elements are those beside it, and the node set says it. Names are the
same in capitals and small letters.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from surrofe2.store.plane_mesh import SURFACES, Array, Group, Index, MeshError, StoredMesh

_T = TypeVar("_T")

# Families of elements in a plane, shells and membranes; then the number of nodes, and variants.
_PLANE = re.compile(r"(?:CPS|CPEG|CPE|S|STRI|M3D|R3D|SFM3D|DS|DC2D|AC2D|F2D)(\d)")
# Families of trusses, beams and rigid lines; B21 and B31 have two nodes.
_ALONG = re.compile(r"(?:T2D|T3D|B2|B3|R2D|RB2D|RB3D)(\d)")
# Families of elements that are no part of a mesh, and are left out.
_APART = re.compile(r"(?:SPRING|DASHPOT|CONN|MASS|ROTARY|DCOUP|GAP)")
# Kinds of plane elements by the number of nodes in Abaqus's types.
_KINDS = {"3": "triangle", "4": "quad", "6": "triangle6", "8": "quad8", "9": "quad9"}


class _Sets(dict[str, list[int]]):
    """Numbers by name, whichever letters are capitals; the first spelling counts."""

    def named(self, name: str) -> str:
        """Return the name as it was first written."""
        for known in self:
            if known.upper() == name.upper():
                return known
        return name

    def add(self, name: str, members: list[int]) -> None:
        """Add members to the set of that name."""
        self.setdefault(self.named(name), []).extend(members)


@dataclass
class _Contents:
    """The nodes, elements and sets of a file.

    Attributes:
        tags: numbers of nodes, in parts as they stand in the file.
        points: positions of these nodes, (n, 3) in each part.
        elements: rows of the number of an element and its nodes, in parts, by kind; of lines the
            nodes are both ends.
        apart: numbers of elements that are left out.
        element_sets: numbers of elements by name.
        node_sets: numbers of nodes by name.
        internal: names of element sets that only surfaces use.
        surfaces: sides of each surface by name: an element set, or the number of an element, and a
            side such as "S2".
    """

    tags: list[Index] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    elements: dict[str, list[Index]] = field(default_factory=dict)
    apart: set[int] = field(default_factory=set)
    element_sets: _Sets = field(default_factory=_Sets)
    node_sets: _Sets = field(default_factory=_Sets)
    internal: set[str] = field(default_factory=set)
    surfaces: dict[str, list[tuple[str, str]]] = field(default_factory=dict)


def read_abaqus(path: str) -> StoredMesh:
    """Read the mesh in a file.

    Raises:
        ValueError: it is damaged.
        MeshError: it has several parts, or elements that are not read.
    """
    contents = _Contents()
    scope = ""  # PART, INSTANCE or ASSEMBLY around a keyword; numbers count within it
    parts = 0
    instances = 0
    for keyword, options, lines in _blocks(Path(path).read_bytes().decode("utf-8-sig", "replace")):
        match keyword:
            case "PART" | "INSTANCE" | "ASSEMBLY":
                scope = keyword
                parts += keyword == "PART"
                instances += keyword == "INSTANCE"
                if max(parts, instances) > 1:
                    raise MeshError("it has several parts; write a file of one part")
                if keyword == "INSTANCE" and any(_number(word) for line in lines for word in line):
                    raise MeshError("its instance is moved; write it where it is drawn")
            case "END PART":
                scope = ""
            case "END INSTANCE":
                scope = "ASSEMBLY"
            case "INCLUDE":
                raise MeshError("it includes another file; write all of it into one")
            case _ if scope == "ASSEMBLY" and "INSTANCE" not in options and keyword != "SURFACE":
                pass  # reference points, which have numbers of their own, and their sets
            case "NODE":
                _read_nodes(contents, options, lines)
            case "ELEMENT":
                _read_elements(contents, options, lines)
            case "ELSET":
                _read_set(contents.element_sets, options["ELSET"], options, lines)
                if "INTERNAL" in options:
                    contents.internal.add(options["ELSET"])
            case "NSET" if "INTERNAL" not in options:
                _read_set(contents.node_sets, options["NSET"], options, lines)
            case "SURFACE" if options.get("TYPE", "ELEMENT").upper() == "ELEMENT":
                sides = [(line[0], line[1].upper()) for line in lines if len(line) > 1]
                contents.surfaces[options["NAME"]] = sides
    return _stored(contents)


def _blocks(text: str) -> list[tuple[str, dict[str, str], list[list[str]]]]:
    """Return keyword, options by name and lines of data of each block.

    Keywords and names of options are in capitals.
    """
    blocks: list[tuple[str, dict[str, str], list[list[str]]]] = []
    continues = False
    for line in text.splitlines():
        if line.startswith("**") or not line.strip():
            continue
        words = [word.strip() for word in line.split(",")]
        if line.startswith("*"):
            keyword = " ".join(words[0][1:].upper().split())
            blocks.append((keyword, dict(_option(word) for word in words[1:] if word), []))
            continues = not words[-1]
        elif continues:
            blocks[-1][1].update(_option(word) for word in words if word)
            continues = not words[-1]
        elif blocks:
            blocks[-1][2].append(words)
    return blocks


def _option(word: str) -> tuple[str, str]:
    """Return name and value of an option NAME=VALUE."""
    name, _, value = word.partition("=")
    return name.strip().upper(), value.strip().strip('"')


def _number(word: str) -> float:
    """Return a number; what is left out is 0."""
    return float(word) if word else 0.0


def _read_nodes(contents: _Contents, options: dict[str, str], lines: list[list[str]]) -> None:
    """Read the lines of *NODE: tag and coordinates of each, and the set that they make."""
    if not lines:
        return
    # a tag and three coordinates; those that are left out are 0
    rows = np.array([[_number(word) for word in [*line, "", "", ""][:4]] for line in lines])
    contents.tags.append(rows[:, 0].astype(np.int64))
    contents.points.append(rows[:, 1:])
    if "NSET" in options:
        contents.node_sets.add(options["NSET"], rows[:, 0].astype(int).tolist())


def _read_elements(contents: _Contents, options: dict[str, str], lines: list[list[str]]) -> None:
    """Read the lines of *ELEMENT: tag and nodes each, which may continue on further lines."""
    stated = options.get("TYPE", "").upper()
    numbers = [int(word) for line in lines for word in line if word]
    plane = _PLANE.match(stated)
    along = _ALONG.match(stated)
    if _APART.match(stated):
        contents.apart.update(int(line[0]) for line in lines)
        return
    if plane and plane[1] in _KINDS:
        kind = _KINDS[plane[1]]
        count = SURFACES[kind]
    elif along:
        kind = "line"
        # nodes: trusses and beams of these types have one in the middle
        count = 3 if stated.startswith(("T2D3", "T3D3", "B22", "B32")) else 2
    else:
        raise MeshError(
            f"{len(lines)} elements of type {stated or '(none)'}; they must be plane, such as "
            "CPS3, CPS4R, CPE6, CPE8R or S4R"
        )
    if len(numbers) % (1 + count):
        raise ValueError(f"an element of type {stated} must have {count} nodes")
    rows = np.array(numbers, dtype=np.int64).reshape(-1, 1 + count)
    if count == 3 and kind == "line":
        rows = rows[:, [0, 1, 3]]  # the second node is in the middle
    contents.elements.setdefault(kind, []).append(rows)
    if "ELSET" in options:
        contents.element_sets.add(options["ELSET"], rows[:, 0].tolist())


def _read_set(sets: _Sets, name: str, options: dict[str, str], lines: list[list[str]]) -> None:
    """Read a set: numbers, ranges where the option GENERATE is there, or names of other sets."""
    members: list[int] = []
    for line in lines:
        words = [word for word in line if word]
        if "GENERATE" in options:
            first, last, *step = map(int, words)
            members.extend(range(first, last + 1, *step))
            continue
        for word in words:
            plain = word.rpartition(".")[2]  # INSTANCE.NAME
            if plain.isdigit():
                members.append(int(plain))
            elif sets.named(plain) in sets:
                members.extend(sets[sets.named(plain)])
            else:
                raise ValueError(f"set {name}: there is no set {word}")
    sets.add(name, members)


def _stored(contents: _Contents) -> StoredMesh:
    """Return cells by kind, with nodes and elements by their place and not their number."""
    if not contents.tags:
        raise ValueError("it has no *NODE")
    tags = np.concatenate(contents.tags).tolist()
    node_at = {tag: k for k, tag in enumerate(tags)}
    if len(node_at) < len(tags):
        raise ValueError("two nodes have one number")
    cells: dict[str, Index] = {}
    element_at: dict[int, tuple[str, int]] = {}
    for kind, blocks in contents.elements.items():
        rows = np.concatenate(blocks)
        nodes = [_place(node_at, node, "an element: node") for node in rows[:, 1:].ravel().tolist()]
        cells[kind] = np.array(nodes, dtype=np.int64).reshape(len(rows), -1)
        element_at |= {tag: (kind, k) for k, tag in enumerate(rows[:, 0].tolist())}
    node_sets: dict[str, Index] = {}
    for name, members in contents.node_sets.items():
        places = [_place(node_at, tag, f"set {name}: node") for tag in members]
        node_sets[name] = np.unique(np.array(places, dtype=np.int64))
    groups = _groups_of_sets(contents, element_at, cells, node_sets)
    groups += _groups_of_surfaces(contents, element_at, cells)
    return StoredMesh(np.concatenate(contents.points), cells, groups, node_sets)


def _groups_of_sets(
    contents: _Contents,
    element_at: Mapping[int, tuple[str, int]],
    cells: dict[str, Index],
    node_sets: dict[str, Index],
) -> list[Group]:
    """Make the groups of lines and of plane elements that the element sets state.

    Args:
        element_at: kind of each element, and its place in `cells` of that kind, by its tag.
        node_sets: nodes of each set; one that an element set makes needless is removed.
    """
    groups = []
    for name, members in contents.element_sets.items():
        if name in contents.internal:
            continue
        members_at = {
            _place(element_at, tag, f"set {name}: element")
            for tag in members
            if tag not in contents.apart
        }
        lines_of = np.array(sorted(k for kind, k in members_at if kind == "line"), dtype=np.int64)
        if lines_of.size:
            groups.append(Group(name, 1, {"line": lines_of}))
        group = Group(name, 2)
        for kind, k in sorted(members_at):
            if kind != "line":
                before = group.cells.get(kind, np.zeros(0, np.int64))
                group.cells[kind] = np.append(before, k)
        if group.cells and not _is_of_an_edge(group, cells, node_sets):
            groups.append(group)
    return groups


def _groups_of_surfaces(
    contents: _Contents, element_at: Mapping[int, tuple[str, int]], cells: dict[str, Index]
) -> list[Group]:
    """Make a group of lines for each surface, and add its lines to `cells`."""
    groups = []
    lines: list[list[int]] = cells.get("line", np.zeros((0, 2), np.int64)).tolist()
    for name, sides in contents.surfaces.items():
        begin = len(lines)
        for members_of, side in sides:  # an element's number, or the name of a set
            if members_of.isdigit():
                members = [int(members_of)]
            else:
                set_name = contents.element_sets.named(members_of)
                members = contents.element_sets.get(set_name, [])
            for tag in members:
                kind, k = _place(element_at, tag, f"surface {name}: element")
                lines.append(_ends(cells[kind][k], side, name))
        groups.append(Group(name, 1, {"line": np.arange(begin, len(lines))}))
    if lines:
        cells["line"] = np.array(lines, dtype=np.int64)
    return groups


def _is_of_an_edge(group: Group, cells: dict[str, Index], node_sets: dict[str, Index]) -> bool:
    """Return whether an element set is that beside an edge, which a node set of its name states.

    If the node set holds just the nodes of these elements, the element set states a face, and the
    node set is removed.
    """
    twin = next((name for name in node_sets if name.upper() == group.name.upper()), None)
    if twin is None:
        return False
    nodes = [cells[kind][of].ravel() for kind, of in group.cells.items()]
    beside = np.unique(np.concatenate([*nodes, np.zeros(0, np.int64)]))
    if np.array_equal(beside, node_sets[twin]):
        del node_sets[twin]
        return False
    return bool(np.isin(node_sets[twin], beside).all())


def _ends(nodes: Index, side: str, name: str) -> list[int]:
    """Return both ends of a side "S1" to "S4", or "E1" to "E4" of a shell."""
    corners = 3 if len(nodes) in (3, 6) else 4
    if not re.fullmatch(r"[SE][1-4]", side) or int(side[1]) > corners:
        raise MeshError(f"surface {name}: {side}; it must be of sides S1 to S{corners} of elements")
    k = int(side[1]) - 1
    return [int(nodes[k]), int(nodes[(k + 1) % corners])]


def _place(places: Mapping[int, _T], tag: int, what: str) -> _T:
    """Return the place of a tag; a `ValueError` where it is not there."""
    if tag not in places:
        raise ValueError(f"{what} {tag} is not there")
    return places[tag]
