"""Periodic tessellations of the plane: polygons that share vertices and edges across images.

Vertices are numbered once per periodic unit; a corner of a polygon is a vertex and the integer
lattice shift of the image that the polygon has there. An edge (v, w, s) runs from vertex v to the
image of w shifted by s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isqrt

import numpy as np
import scipy  # scipy.spatial is loaded where irregular cells need it

from surrofe2.base.arrays import Array

Shift = tuple[int, int]
Corner = tuple[int, Shift]
Edge = tuple[int, int, Shift]

LLOYD_STEPS = 3
"""Voronoi points move so often to the centroids of their polygons."""
_SHORTEST = 1e-3
_IMAGES = np.array([(a, b) for a in range(-2, 3) for b in range(-2, 3)])


@dataclass(frozen=True, slots=True)
class Tessellation:
    """A periodic unit of polygons.

    Attributes:
        lattice: (2, 2) µm, its columns the lattice vectors.
        vertices: (v, 2) µm.
        polygons: corners of each polygon, counter-clockwise.
        edges: every edge once.
    """

    lattice: Array
    vertices: Array
    polygons: tuple[tuple[Corner, ...], ...]
    edges: tuple[Edge, ...]

    def corners(self, polygon: int) -> Array:
        """(k, 2) corners of a polygon where it lies, µm."""
        index = [v for v, _ in self.polygons[polygon]]
        shifts = np.array([s for _, s in self.polygons[polygon]])
        return self.vertices[index] + shifts @ self.lattice.T

    @property
    def areas(self) -> Array:
        """(polygons,) µm²."""
        return np.array([polygon_area(self.corners(k)) for k in range(len(self.polygons))])

    def vector(self, edge: Edge) -> Array:
        """(2,) from one end of an edge to the other, µm."""
        v, w, shift = edge
        return self.vertices[w] + self.lattice @ np.array(shift) - self.vertices[v]

    def springs(self, edge: Edge, length: float) -> int:
        """Into how many springs, as near as can be of `length`, µm, an edge is divided."""
        return max(1, round(float(np.linalg.norm(self.vector(edge))) / length))

    def wall_particles(self, length: float) -> int:
        """Number of vertices, and of particles between springs of about `length`, µm."""
        return len(self.vertices) + sum(self.springs(edge, length) - 1 for edge in self.edges)


@lru_cache(maxsize=32)
def make_tessellation(arrangement: str, side: float, cells: int, seed: int) -> Tessellation:
    """`cells` polygons of side² µm² on average: "square", "hexagon" or "voronoi" (by `seed`)."""
    if arrangement == "square":
        return squares(side, isqrt(cells), isqrt(cells))
    if arrangement == "hexagon":
        return _hexagons(side**2, isqrt(cells))
    return _voronoi(side**2, cells, seed)


def polygon_area(corners: Array) -> float:
    """Area of a polygon (k, 2), positive when counter-clockwise."""
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def centroid(corners: Array) -> Array:
    """(2,) centre of area of a polygon (k, 2)."""
    there = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * there[:, 1] - there[:, 0] * corners[:, 1]
    return np.asarray((corners + there).T @ cross / (3.0 * cross.sum()))


def edge_of(a: Corner, b: Corner) -> tuple[Edge, Shift, bool]:
    """Edge between two corners of a polygon, the shift of its first vertex, whether turned."""
    (v, s), (w, t) = a, b
    there = (t[0] - s[0], t[1] - s[1])
    forward, back = (v, w, there), (w, v, (-there[0], -there[1]))
    turned = _order(back) < _order(forward)
    return (back, t, True) if turned else (forward, s, False)


def _order(edge: Edge) -> tuple[int, ...]:
    """Edges are sorted by this; of the two directions of one, the lesser is meant."""
    v, w, (a, b) = edge
    return (v, w, -a, -b) if v == w else (v, w, a, b)


def squares(side: float, n: int, m: int, gap: float = 0.0) -> Tessellation:
    """n × m squares in a box taller by `gap`, µm, which then hold tissue between free sides."""
    base = side * np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float64)
    places = side * np.array([*np.ndindex(n, m)], dtype=np.float64)
    lattice = np.diag([n * side, m * side + gap])
    return _from_polygons(lattice, [base + place for place in places])


def _hexagons(area: float, n: int) -> Tessellation:
    """n × n regular hexagons of that area on the rhombic lattice, two sides along y."""
    step = np.sqrt(2.0 * area / np.sqrt(3.0))
    lattice = step * np.array([[1.0, 0.5], [0.0, np.sqrt(0.75)]])
    angle = np.pi / 6.0 + np.pi / 3.0 * np.arange(6)
    base = step / np.sqrt(3.0) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = [lattice @ (a, b) for a in range(n) for b in range(n)]
    return _from_polygons(n * lattice, [base + place for place in places])


def _voronoi(area: float, cells: int, seed: int) -> Tessellation:
    """Voronoi polygons of random points in a square of `cells` times the area.

    After each of `LLOYD_STEPS` the points move to the centroids of their polygons, which makes
    the polygons rounder and more alike, as the paper's picture of tissue has them.
    """
    side = np.sqrt(area * cells)
    lattice = side * np.eye(2)
    points = side * np.random.default_rng(seed).random((cells, 2))
    for _ in range(LLOYD_STEPS):
        points = np.array([centroid(p) for p in _voronoi_polygons(points, lattice)])
    return _from_polygons(lattice, _voronoi_polygons(points, lattice))


def _voronoi_polygons(points: Array, lattice: Array) -> list[Array]:
    """The polygon of each point among all periodic images, counter-clockwise."""
    every = (points + (_IMAGES @ lattice.T)[:, None]).reshape(-1, 2)
    diagram = scipy.spatial.Voronoi(every)
    first = int(np.flatnonzero((_IMAGES == 0).all(axis=1))[0]) * len(points)
    polygons = []
    for k, point in enumerate(points):
        corners = diagram.vertices[diagram.regions[diagram.point_region[first + k]]]
        corners = corners[np.argsort(np.arctan2(*(corners - point).T[::-1]))]
        # where four polygons meet, a corner comes twice
        gap = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        polygons.append(corners[gap > _SHORTEST])
    return polygons


def _from_polygons(lattice: Array, polygons: Sequence[Array]) -> Tessellation:
    """Number the corners of counter-clockwise polygons (k, 2) that tile the plane periodically."""
    vertices: list[Array] = []
    numbered = []
    for polygon in polygons:
        fractions = np.linalg.solve(lattice, polygon.T).T
        numbered.append(tuple(_numbered(vertices, corner, lattice) for corner in fractions))
    edges = {
        edge_of(a, b)[0]
        for corners in numbered
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    }
    return Tessellation(
        lattice, np.array(vertices) @ lattice.T, tuple(numbered), tuple(sorted(edges, key=_order))
    )


def _numbered(vertices: list[Array], corner: Array, lattice: Array) -> Corner:
    """The vertex at a corner in lattice coordinates, which is added if it is new."""
    for index, known in enumerate(vertices):
        shift = np.round(corner - known)
        if np.abs(lattice @ (corner - known - shift)).max() < _SHORTEST:
            return index, (int(shift[0]), int(shift[1]))
    vertices.append(corner)
    return len(vertices) - 1, (0, 0)
