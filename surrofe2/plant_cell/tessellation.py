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
"""Lattice vectors a₁ and a₂ by which an image is shifted."""
Corner = tuple[int, Shift]
"""A vertex, and the shift of its image."""
Edge = tuple[int, int, Shift]
"""The vertices at both ends, and the shift of the second."""

LLOYD_STEPS = 3
"""Number of times that Voronoi points move to the centroids of their polygons."""
_MOST_STEPS = 200
"""Moves of Voronoi points after which a variation of areas counts as out of reach."""
_APART = -0.1
"""Fraction of the way to their centroids by which points move if areas are to differ more;
negative, since they move away from them."""
_MOST_STRETCH = 40.0
"""Largest ratio of principal stretches at which an elongation, 10 at most, is sought."""
_CLOSE = 1e-6
"""Tolerance on the stretch, and on the length of the last move of points."""
_SHORTEST = 1e-3
"""Shortest edge, µm: corners that are nearer to each other are one vertex."""
_IMAGES = np.array([(a, b) for a in range(-2, 3) for b in range(-2, 3)])
"""Shifts of the images that polygons of a few Voronoi points may reach."""


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
        """Return the corners (k, 2) of a polygon where it lies, µm."""
        vertices = [vertex for vertex, _ in self.polygons[polygon]]
        shifts = np.array([shift for _, shift in self.polygons[polygon]])
        return self.vertices[vertices] + shifts @ self.lattice.T

    @property
    def areas(self) -> Array:
        """Areas of the polygons (polygons,), µm²."""
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
        """Return the vector (2,) from the first end of an edge to the second, µm."""
        v, w, shift = edge
        return self.vertices[w] + self.lattice @ np.array(shift) - self.vertices[v]

    def springs(self, edge: Edge, length: float) -> int:
        """Return the number of springs of about `length`, µm, into which an edge is divided."""
        return max(1, round(float(np.linalg.norm(self.vector(edge))) / length))

    def wall_particles(self, length: float) -> int:
        """Return the number of vertices and of particles between springs of `length`, µm."""
        return len(self.vertices) + sum(self.springs(edge, length) - 1 for edge in self.edges)


class Shape(NamedTuple):
    """Statistics that Voronoi polygons are to have; see `CellParameters`.

    area_variation: coefficient of variation of the areas; 0: as they come.
    elongation: mean aspect ratio; 1: as they come.
    direction: angle of the long axis from x to y, °.
    """

    area_variation: float = 0.0
    elongation: float = 1.0
    direction: float = 0.0


AS_THEY_COME = Shape()


@lru_cache(maxsize=32)
def make_tessellation(
    arrangement: str, side: float, cells: int, seed: int, shape: Shape = AS_THEY_COME
) -> Tessellation:
    """Make `cells` polygons of side² µm² on average: "square", "hexagon" or "voronoi" (by `seed`).

    cells: a square number for squares and hexagons.
    """
    if arrangement == "square":
        return squares(side, isqrt(cells), isqrt(cells))
    if arrangement == "hexagon":
        return _hexagons(side**2, isqrt(cells))
    return _voronoi(side**2, cells, seed, shape)


def polygon_area(corners: Array) -> float:
    """Return the area of a polygon (k, 2), positive when counter-clockwise."""
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def centroid(corners: Array) -> Array:
    """Return the centre of area (2,) of a polygon (k, 2)."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    return np.asarray((corners + following).T @ cross / (3.0 * cross.sum()))


def edge_of(a: Corner, b: Corner) -> tuple[Edge, Shift, bool]:
    """Return the edge between two corners of a polygon, its place and its direction.

    Returns:
        The edge, the shift of its first vertex as the polygon has it, and whether the edge leads
        from b to a: two polygons that share an edge walk it in opposite directions.
    """
    v, shift_v = a
    w, shift_w = b
    across = (shift_w[0] - shift_v[0], shift_w[1] - shift_v[1])
    forward = (v, w, across)
    back = (w, v, (-across[0], -across[1]))
    if _order(back) < _order(forward):
        return back, shift_w, True
    return forward, shift_v, False


def _order(edge: Edge) -> tuple[int, ...]:
    """Return the key by which edges are sorted; of an edge's two directions the lesser is used."""
    v, w, (a, b) = edge
    # from a vertex to its own image: the shift alone tells the directions apart, and the one to a
    # later column or row is to be the lesser
    if v == w:
        return (v, w, -a, -b)
    return (v, w, a, b)


def squares(side: float, n: int, m: int, gap: float = 0.0) -> Tessellation:
    """Make n × m squares in a box that is taller by `gap`, µm: a gap leaves two free sides."""
    base = side * np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float64)
    places = side * np.array([*np.ndindex(n, m)], dtype=np.float64)
    lattice = np.diag([n * side, m * side + gap])
    return _from_polygons(lattice, [base + place for place in places])


def _hexagons(area: float, n: int) -> Tessellation:
    """Make n × n regular hexagons of that area on the rhombic lattice, two sides along y."""
    step = np.sqrt(2.0 * area / np.sqrt(3.0))
    lattice = step * np.array([[1.0, 0.5], [0.0, np.sqrt(0.75)]])
    angle = np.pi / 6.0 + np.pi / 3.0 * np.arange(6)
    base = step / np.sqrt(3.0) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = [lattice @ (a, b) for a in range(n) for b in range(n)]
    return _from_polygons(n * lattice, [base + place for place in places])


def _voronoi(area: float, cells: int, seed: int, shape: Shape) -> Tessellation:
    """Make the Voronoi polygons of random points in a square of `cells` times the area.

    In each of `LLOYD_STEPS` the points move to the centroids of their polygons, which makes the
    polygons rounder and more alike, as the paper's picture of tissue has them. If a variation of
    areas is asked for, the points move until it is reached instead. If the polygons are to be
    elongated, they and their lattice are stretched.
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


def _moved(points: Array, lattice: Array, fraction: float) -> Array:
    """Return points moved by a fraction of the way to their centroids; negative: away from them."""
    centroids = np.array([centroid(polygon) for polygon in _voronoi_polygons(points, lattice)])
    return points + fraction * (centroids - points)


def _variation(points: Array, lattice: Array) -> float:
    """Return the coefficient of variation of the areas of the points' Voronoi polygons."""
    areas = np.array([polygon_area(polygon) for polygon in _voronoi_polygons(points, lattice)])
    return float(areas.std() / areas.mean())


def _with_variation(points: Array, lattice: Array, wanted: float) -> Array:
    """Return points whose polygons' areas have the variation `wanted`.

    They move to centroids, or away from them, until it is passed; the last move is shortened.
    """
    reached = _variation(points, lattice)
    is_too_large = reached > wanted
    # at their centroids points have polygons that are alike; away from them these differ more
    move = 1.0 if is_too_large else _APART
    for _ in range(_MOST_STEPS):
        after = _moved(points, lattice, move)
        reached = _variation(after, lattice)
        has_passed = (reached > wanted) != is_too_large
        if has_passed:
            break
        points = after
    else:
        raise InputError(
            "cell.area_variation",
            f"{wanted}; these Voronoi points reach {reached:.3g}: take another arrangement_seed "
            "or more cells",
        )

    def excess(fraction: float) -> float:
        """Return the variation above the wanted one after a fraction of the last move."""
        return _variation(_moved(points, lattice, fraction * move), lattice) - wanted

    fraction = scipy.optimize.brentq(excess, 0.0, 1.0, xtol=_CLOSE)
    return _moved(points, lattice, fraction * move)


def aspect_ratio(corners: Array) -> float:
    """Return the root of the ratio of a polygon's principal second moments of area, at least 1.

    corners: (k, 2). With r_k the corners from the centroid, the moments are, but for a factor,
    Σ r_k × r_(k+1) [r_k ⊗ r_k + r_(k+1) ⊗ r_(k+1) + (r_k + r_(k+1)) ⊗ (r_k + r_(k+1))].
    """
    r = corners - centroid(corners)
    following = np.roll(r, -1, axis=0)
    cross = r[:, 0] * following[:, 1] - following[:, 0] * r[:, 1]
    total = r + following
    weighted_squares = "k,ka,kb->ab"
    moments = np.einsum(weighted_squares, cross, r, r)
    moments = moments + np.einsum(weighted_squares, cross, following, following)
    moments += np.einsum(weighted_squares, cross, total, total)
    smaller, larger = np.linalg.eigvalsh(moments)
    return float(np.sqrt(larger / smaller))


def mean_aspect(polygons: Sequence[Array]) -> float:
    """Return the mean of the polygons' `aspect_ratio`."""
    return float(np.mean([aspect_ratio(polygon) for polygon in polygons]))


def _stretch_to(polygons: Sequence[Array], shape: Shape) -> Array:
    """Return the stretch (2, 2) along `shape.direction` that gives the polygons their elongation.

    It keeps areas.
    """
    angle = np.deg2rad(shape.direction)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def stretch_by(ratio: float) -> Array:
        """Return the stretch (2, 2) whose principal stretches have this ratio."""
        principal = np.diag([np.sqrt(ratio), 1.0 / np.sqrt(ratio)])
        return np.asarray(turn @ principal @ turn.T)

    def excess(ratio: float) -> float:
        """Return the elongation above the wanted one after such a stretch."""
        stretch = stretch_by(ratio)
        return mean_aspect([polygon @ stretch.T for polygon in polygons]) - shape.elongation

    if excess(1.0) > 0.0:
        raise InputError(
            "cell.elongation",
            f"{shape.elongation}; Voronoi cells have {excess(1.0) + shape.elongation:.3g} without "
            "being stretched: give more, or 1 to leave them as they are",
        )
    return stretch_by(scipy.optimize.brentq(excess, 1.0, _MOST_STRETCH, xtol=_CLOSE))


def _voronoi_polygons(points: Array, lattice: Array) -> list[Array]:
    """Return the polygon (k, 2) of each point among all periodic images, counter-clockwise."""
    every = (points + (_IMAGES @ lattice.T)[:, None]).reshape(-1, 2)
    diagram = scipy.spatial.Voronoi(every)
    # rows of `every` are image after image; the points themselves are the one without a shift
    first = int(np.flatnonzero((_IMAGES == 0).all(axis=1))[0]) * len(points)
    polygons = []
    for k, point in enumerate(points):
        corners = diagram.vertices[diagram.regions[diagram.point_region[first + k]]]
        x, y = (corners - point).T
        corners = corners[np.argsort(np.arctan2(y, x))]
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
    edges = set()
    for corners in numbered:
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            edge, _, _ = edge_of(a, b)
            edges.add(edge)
    return Tessellation(
        lattice=lattice,
        vertices=np.array(vertices) @ lattice.T,
        polygons=tuple(numbered),
        edges=tuple(sorted(edges, key=_order)),
    )


def _numbered(vertices: list[Array], corner: Array, lattice: Array) -> Corner:
    """Return the vertex at a corner, which is added to the vertices if it is new.

    corner, vertices: (2,) each, in lattice coordinates.
    """
    for index, vertex in enumerate(vertices):
        shift = np.round(corner - vertex)
        if np.abs(lattice @ (corner - vertex - shift)).max() < _SHORTEST:
            return index, (int(shift[0]), int(shift[1]))
    vertices.append(corner)
    return len(vertices) - 1, (0, 0)
