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
from typing import NamedTuple

import numpy as np
import scipy  # scipy.spatial and scipy.optimize are loaded where irregular cells need them

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError

Shift = tuple[int, int]
Corner = tuple[int, Shift]
Edge = tuple[int, int, Shift]

LLOYD_STEPS = 3
"""Voronoi points move so often to the centroids of their polygons."""
_MOST_STEPS = 200
_APART = -0.1
"""Moves of points after which a variation of areas is out of reach; the fraction of the way to
their centroids by which they move if areas are to differ more."""
_MOST_STRETCH = 40.0
_CLOSE = 1e-6
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

    @property
    def area_variation(self) -> float:
        """Coefficient of variation of the areas."""
        return float(self.areas.std() / self.areas.mean())

    @property
    def elongation(self) -> float:
        """Mean aspect ratio of the polygons."""
        return mean_aspect([self.corners(k) for k in range(len(self.polygons))])

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


class Shape(NamedTuple):
    """What Voronoi polygons are to be like; see `CellParameters`."""

    area_variation: float = 0.0
    elongation: float = 1.0
    direction: float = 0.0


AS_THEY_COME = Shape()


@lru_cache(maxsize=32)
def make_tessellation(
    arrangement: str, side: float, cells: int, seed: int, shape: Shape = AS_THEY_COME
) -> Tessellation:
    """`cells` polygons of side² µm² on average: "square", "hexagon" or "voronoi" (by `seed`)."""
    if arrangement == "square":
        return squares(side, isqrt(cells), isqrt(cells))
    if arrangement == "hexagon":
        return _hexagons(side**2, isqrt(cells))
    return _voronoi(side**2, cells, seed, shape)


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
    v, s = a
    w, t = b
    there = (t[0] - s[0], t[1] - s[1])
    forward = (v, w, there)
    back = (w, v, (-there[0], -there[1]))
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


def _voronoi(area: float, cells: int, seed: int, shape: Shape) -> Tessellation:
    """Voronoi polygons of random points in a square of `cells` times the area.

    After each of `LLOYD_STEPS` the points move to the centroids of their polygons, which makes
    the polygons rounder and more alike, as the paper's picture of tissue has them. If their areas
    are to vary by so much, points move until they do. Stretched polygons have a stretched lattice.
    """
    side = np.sqrt(area * cells)
    lattice = side * np.eye(2)
    points = side * np.random.default_rng(seed).random((cells, 2))
    if shape.area_variation > 0.0:
        points = _with_variation(points, lattice, shape.area_variation)
    else:
        for _ in range(LLOYD_STEPS):
            points = _moved(points, lattice, 1.0)
    polygons = _voronoi_polygons(points, lattice)
    if shape.elongation > 1.0:
        stretch = _stretch_to(polygons, shape)
        polygons = [polygon @ stretch.T for polygon in polygons]
        lattice = stretch @ lattice
    return _from_polygons(lattice, polygons)


def _moved(points: Array, lattice: Array, part: float) -> Array:
    """Points moved by a part of the way to the centroids of their polygons; negative: away."""
    centroids = np.array([centroid(polygon) for polygon in _voronoi_polygons(points, lattice)])
    return points + part * (centroids - points)


def _variation(points: Array, lattice: Array) -> float:
    areas = np.array([polygon_area(polygon) for polygon in _voronoi_polygons(points, lattice)])
    return float(areas.std() / areas.mean())


def _with_variation(points: Array, lattice: Array, wanted: float) -> Array:
    """Points whose polygons' areas have the variation `wanted`.

    They move to centroids, or away from them, until it is passed; the last move is shortened.
    """
    reached = _variation(points, lattice)
    too_much = reached > wanted
    part = 1.0 if too_much else _APART
    for _ in range(_MOST_STEPS):
        after = _moved(points, lattice, part)
        reached = _variation(after, lattice)
        if (reached > wanted) != too_much:
            break
        points = after
    else:
        raise InputError(
            "cell.area_variation",
            f"{wanted}; these Voronoi points reach {reached:.3g}: take another arrangement_seed "
            "or more cells",
        )

    def excess(fraction: float) -> float:
        return _variation(_moved(points, lattice, fraction * part), lattice) - wanted

    fraction = scipy.optimize.brentq(excess, 0.0, 1.0, xtol=_CLOSE)
    return _moved(points, lattice, fraction * part)


def aspect_ratio(corners: Array) -> float:
    """Square root of the ratio of a polygon's principal second moments of area, at least 1."""
    r = corners - centroid(corners)
    there = np.roll(r, -1, axis=0)
    cross = r[:, 0] * there[:, 1] - there[:, 0] * r[:, 1]
    both = r + there
    moments = np.einsum("k,ka,kb->ab", cross, r, r) + np.einsum("k,ka,kb->ab", cross, there, there)
    moments += np.einsum("k,ka,kb->ab", cross, both, both)
    least, most = np.linalg.eigvalsh(moments)
    return float(np.sqrt(most / least))


def mean_aspect(polygons: Sequence[Array]) -> float:
    """Mean of the polygons' `aspect_ratio`."""
    return float(np.mean([aspect_ratio(polygon) for polygon in polygons]))


def _stretch_to(polygons: Sequence[Array], shape: Shape) -> Array:
    """(2, 2) that stretches along the direction to the aspect ratio wanted and keeps areas."""
    angle = np.deg2rad(shape.direction)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def along(ratio: float) -> Array:
        return np.asarray(turn @ np.diag([np.sqrt(ratio), 1.0 / np.sqrt(ratio)]) @ turn.T)

    def excess(ratio: float) -> float:
        return mean_aspect([polygon @ along(ratio).T for polygon in polygons]) - shape.elongation

    if excess(1.0) > 0.0:
        raise InputError(
            "cell.elongation",
            f"{shape.elongation}; Voronoi cells have {excess(1.0) + shape.elongation:.3g} without "
            "being stretched: give more, or 1 to leave them as they are",
        )
    return along(scipy.optimize.brentq(excess, 1.0, _MOST_STRETCH, xtol=_CLOSE))


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
