"""A mesh of quadrilaterals or six-node triangles with named regions and boundaries."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SIDES = {4: ((0, 1), (1, 2), (2, 3), (3, 0)), 6: ((0, 1, 3), (1, 2, 4), (2, 0, 5))}
"""Nodes of each side by the nodes of an element: both ends, then the middle of a triangle's."""


MOST_ELEMENTS = 10_000_000


class Part(Protocol):
    """A part of the plane that picks nodes."""

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether each of the points (n, 2) is in it."""


@dataclass(frozen=True, slots=True)
class Box:
    """x from low[0] to high[0], y from low[1] to high[1], edges included, µm."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """As of `Part`; rounding of 1e-9 of the box is forgiven."""
        low, high = np.array(self.low), np.array(self.high)
        width = high - low
        slack = 1e-9 * np.max(width[np.isfinite(width)], initial=1.0)
        return ((points >= low - slack) & (points <= high + slack)).all(axis=1)


@dataclass(frozen=True, slots=True)
class HalfPlane:
    """All points p with (p − through)·normal ≥ 0, µm."""

    through: tuple[float, float]
    normal: tuple[float, float]

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """As of `Part`."""
        slack = 1e-9 * abs(points).max(initial=1.0)
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (points - np.array(self.through)) @ normal >= -slack


@dataclass(frozen=True, slots=True)
class Disc:
    """All points at most `radius` from the centre, µm."""

    centre: tuple[float, float]
    radius: float

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """As of `Part`."""
        distance = np.linalg.norm(points - np.array(self.centre), axis=1)
        return distance <= self.radius * (1.0 + 1e-9)


@dataclass(frozen=True, slots=True)
class Mesh:
    """Nodes, elements of one kind, and what parts of it are called.

    Attributes:
        nodes: (n, 2) reference positions, µm.
        elements: (n_el, 4) quadrilaterals or (n_el, 6) triangles, counter-clockwise; of a triangle
            the corners, then the middles of the sides 0–1, 1–2, 2–0.
        regions: (k,) elements by name.
        boundaries: (k, 2) or (k, 3) nodes of outer sides by name, the tissue on their left.

    Raises:
        InputError: an element is inverted or degenerate, a node has no element, or there are
            several pieces.
    """

    nodes: Array
    elements: Index
    regions: Mapping[str, Index] = field(default_factory=dict)
    boundaries: Mapping[str, Index] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.elements.ndim != 2 or self.elements.shape[1] not in SIDES:
            raise InputError(
                f"mesh.elements: shape {self.elements.shape}; it must be (n, 4) for quadrilaterals "
                "or (n, 6) for triangles"
            )
        _check_orphans(self.nodes, self.elements)
        _check_orientation(self.nodes, self.elements)
        _check_pieces(self.nodes, self.elements)

    def __repr__(self) -> str:
        kind = "quadrilaterals" if self.elements.shape[1] == 4 else "triangles"
        return (
            f"<Mesh: {len(self.elements)} {kind}, {len(self.nodes)} nodes; boundaries "
            f"{', '.join(self.boundaries) or 'none'}; regions {', '.join(self.regions) or 'none'}>"
        )

    @classmethod
    def rectangle(cls, width: float, height: float, elements: tuple[int, int]) -> Mesh:
        """[0, width] × [0, height] µm in equal quadrilaterals, numbered along y, then x.

        Its sides are the boundaries left, right, bottom and top.
        """
        nx, ny = elements
        if not (min(nx, ny) >= 1 and nx * ny <= MOST_ELEMENTS):
            raise InputError(
                f"mesh.elements: [{nx}, {ny}]; there must be at least 1 each way and "
                f"{MOST_ELEMENTS} in all at most"
            )
        if not (0.0 < width < np.inf and 0.0 < height < np.inf):
            raise InputError(
                f"mesh.width, mesh.height: {width}, {height}; they must be positive and finite (µm)"
            )
        x, y = np.linspace(0.0, width, nx + 1), np.linspace(0.0, height, ny + 1)
        nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        number = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
        corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        quads = np.stack([corner.ravel() for corner in corners], axis=1)
        return cls(nodes, quads).with_boundaries(
            left=Box((0.0, 0.0), (0.0, height)),
            right=Box((width, 0.0), (width, height)),
            bottom=Box((0.0, 0.0), (width, 0.0)),
            top=Box((0.0, height), (width, height)),
        )

    def with_boundaries(self, **parts: Part) -> Mesh:
        """The mesh with more boundaries: the outer sides whose nodes all lie in a part.

        Raises:
            InputError: there is none.
        """
        outer = outer_sides(self.elements)
        named = dict(self.boundaries)
        for name, part in parts.items():
            inside = part.holds(self.nodes)[outer].all(axis=1)
            if not inside.any():
                raise InputError(
                    f"mesh.boundaries.{name}: {part}; it must hold both ends of an outer side"
                )
            named[name] = outer[inside]
        return replace(self, boundaries=named)

    def with_regions(self, **parts: Part) -> Mesh:
        """The mesh with more regions: the elements whose centre lies in a part.

        Raises:
            InputError: there is none.
        """
        centres = self.nodes[self.elements].mean(axis=1)
        named = dict(self.regions)
        for name, part in parts.items():
            inside = np.flatnonzero(part.holds(centres))
            if not inside.size:
                raise InputError(
                    f"mesh.regions.{name}: {part}; it must hold the centre of an element"
                )
            named[name] = inside
        return replace(self, regions=named)

    def boundary(self, name: str, where: str = "boundary") -> Index:
        """(k, 2) or (k, 3) nodes of the sides of a boundary.

        Raises:
            InputError: there is no boundary of that name; `where` says who asked.
        """
        return _named(self.boundaries, name, where, "boundary")

    def region(self, name: str | None, where: str = "region") -> Index:
        """(k,) elements of a region; of None, all.

        Raises:
            InputError: there is no region of that name; `where` says who asked.
        """
        if name is None:
            return np.arange(len(self.elements))
        return _named(self.regions, name, where, "region")

    def nodes_of(self, name: str | None, where: str = "on") -> Index:
        """(k,) nodes of a boundary or a region; of None, all.

        Raises:
            InputError: there is neither of that name; `where` says who asked.
        """
        if name is None or name in self.regions:
            return np.unique(self.elements[self.region(name)])
        if name in self.boundaries:
            return np.unique(self.boundaries[name])
        known = {**self.boundaries, **self.regions}
        return _named(known, name, where, "boundary or region")

    @property
    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest x and y, µm."""
        return self.nodes.min(axis=0), self.nodes.max(axis=0)


def outer_sides(elements: Index) -> Index:
    """(k, 2) or (k, 3) nodes of the sides that belong to one element, the tissue on their left."""
    sides = np.concatenate([elements[:, side] for side in SIDES[elements.shape[1]]])
    ends = np.sort(sides[:, :2], axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    return sides[np.sort(first[count == 1])]


def _named(known: Mapping[str, Index], name: str, where: str, what: str) -> Index:
    if name in known:
        return known[name]
    if not known:
        raise InputError(f"{where}: {name}; the mesh has no {what} with a name; name parts of it")
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise InputError(f"{where}: {name}; no such {what}; {hint}known are {', '.join(known)}")


def _check_orphans(nodes: Array, elements: Index) -> None:
    if elements.size == 0:
        raise InputError("mesh: it has no element; it must have at least one")
    if elements.min() < 0 or elements.max() >= len(nodes):
        raise InputError(
            f"mesh.elements: node {elements.max()}; nodes are numbered from 0 to {len(nodes) - 1}"
        )
    twice, count = np.unique(np.sort(elements, axis=1), axis=0, return_counts=True)
    if count.max() > 1:
        at = nodes[twice[count.argmax()]].mean(axis=0)
        raise InputError(f"mesh: {count.max()} elements of the same nodes at {_at(at)}; keep one")
    alone = np.setdiff1d(np.arange(len(nodes)), elements)
    if alone.size:
        raise InputError(
            f"mesh: {alone.size} nodes without an element, the first is {alone[0]} at "
            f"{_at(nodes[alone[0]])}; remove them"
        )


def _check_orientation(nodes: Array, elements: Index) -> None:
    """The corners of every element must turn left, and the middles lie near their sides."""
    corners = elements[:, :4] if elements.shape[1] == 4 else elements[:, :3]
    x = nodes[corners]
    ahead = np.roll(x, -1, axis=1) - x
    behind = np.roll(ahead, 1, axis=1)
    turn = behind[..., 0] * ahead[..., 1] - behind[..., 1] * ahead[..., 0]
    size = np.linalg.norm(ahead, axis=2).max(axis=1)
    flat = turn.min(axis=1) / np.maximum(size, np.finfo(float).tiny) ** 2
    if elements.shape[1] == 6:
        middle = 0.5 * (x + np.roll(x, -1, axis=1))
        away = np.linalg.norm(nodes[elements[:, 3:]] - middle, axis=2).max(axis=1)
        flat = np.where(away > 0.25 * size, -1.0, flat)
    worst = int(flat.argmin())
    if flat[worst] <= 1e-6:
        what = "inverted" if flat[worst] < -1e-6 else "degenerate"
        raise InputError(
            f"mesh: element {worst} at {_at(x[worst].mean(axis=0))} is {what}; its corners must go "
            "round counter-clockwise and bulge outward"
        )


def _check_pieces(nodes: Array, elements: Index) -> None:
    """Every node takes the lowest label around it until none changes."""
    label = np.arange(len(nodes))
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, elements, label[elements].min(axis=1, keepdims=True))
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            break
        label = lowest
    names, sizes = np.unique(label, return_counts=True)
    if names.size > 1:
        node = int(names[sizes.argmin()])
        raise InputError(
            f"mesh: {names.size} pieces that do not touch, the smallest of {sizes.min()} nodes "
            f"at {_at(nodes[node])}; it must be one"
        )


def _at(point: Array) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g}) µm"
