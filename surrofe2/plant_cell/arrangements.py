"""Particles of any periodic arrangement of plant cells: walls along edges, fluid in polygons.

Each edge is one line of wall particles, its vertices and evenly spaced ones between, with springs
as near as can be to those of the square cell's side; at least one. Fluid fills the polygons with
as many particles as their areas ask for, the total being that of equal plant cells. Particle 0
is a vertex and lies at the origin; walls come first, fluid after them, one plant cell after the
other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.geometry import even_positions
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import (
    Edge,
    Shift,
    Tessellation,
    centroid,
    edge_of,
    hexagon_tessellation,
    square_tessellation,
    voronoi_tessellation,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Wall = tuple[int, Shift]
"""A wall particle and the lattice shift of its image."""

LLOYD_STEPS = 3
_INSET = 0.82
"""Fluid starts within polygons shrunk by this factor."""
_GRID, _SPREADING_STEPS = 2000, 30


@dataclass(frozen=True, slots=True)
class Arrangement:
    """Walls of a periodic arrangement of plant cells.

    Attributes:
        tessellation: polygons of the plant cells.
        wall_position: (walls, 2) where wall particles start, µm; the first at the origin.
        bonds: pairs of wall particles, with the shift of the second.
        rims: wall particles around each plant cell.
        fluid_counts: fluid particles of each plant cell.
        wall_group: (walls,) number of the edge that each wall particle is counted to.
    """

    tessellation: Tessellation
    wall_position: Array
    bonds: tuple[tuple[int, int, Shift], ...]
    rims: tuple[tuple[Wall, ...], ...]
    fluid_counts: tuple[int, ...]
    wall_group: Ints

    @property
    def walls(self) -> int:
        """Number of wall particles."""
        return len(self.wall_position)

    @property
    def fluid_start(self) -> Ints:
        """(cells + 1,) first fluid particle of each plant cell, counted from the first of all."""
        return np.concatenate([[0], np.cumsum(self.fluid_counts)]).astype(np.int32)

    @property
    def particles(self) -> int:
        """Number of all particles."""
        return self.walls + sum(self.fluid_counts)


@lru_cache(maxsize=32)
def make_arrangement(cell: CellParameters) -> Arrangement:
    """The arrangement that `cell` names."""
    tessellation = _tessellation(cell)
    spring = cell.cell_side / cell.wall_springs_per_side
    lines, position, group = _lines(tessellation, spring)
    bonds = [
        (i, j, (t[0] - s[0], t[1] - s[1]))
        for line in lines.values()
        for (i, s), (j, t) in pairwise(line)
    ]
    rims = tuple(_rim(tessellation, k, lines) for k in range(len(tessellation.polygons)))
    counts = _shares(tessellation.areas, cell.fluid_particles * cell.cells)
    origin = position[0].copy()
    moved = Tessellation(
        tessellation.lattice,
        tessellation.vertices - origin,
        tessellation.polygons,
        tessellation.edges,
    )
    return Arrangement(moved, position - origin, tuple(bonds), rims, counts, group)


def mean_mass(cell: CellParameters) -> float:
    """Mass of a plant cell of an arrangement on average, ng."""
    arrangement = make_arrangement(cell)
    fluid = sum(arrangement.fluid_counts)
    return (arrangement.walls * cell.wall_particle_mass + fluid * cell.fluid_mass) / cell.cells


def start_positions(cell: CellParameters, rng: np.random.Generator) -> Array:
    """(n, 2) particles to relax from, µm; `rng` places the fluid of Voronoi plant cells."""
    arrangement = make_arrangement(cell)
    fluid = [
        _fluid(cell, arrangement.tessellation.corners(k), count, rng)
        for k, count in enumerate(arrangement.fluid_counts)
    ]
    return np.concatenate([arrangement.wall_position, *fluid])


def random_positions(cell: CellParameters, rng: np.random.Generator) -> Array:
    """As `start_positions`, with fluid at random in every arrangement."""
    arrangement = make_arrangement(cell)
    fluid = [
        spread_points(arrangement.tessellation.corners(k), count, rng, steps=3)
        for k, count in enumerate(arrangement.fluid_counts)
    ]
    return np.concatenate([arrangement.wall_position, *fluid])


def spread_points(
    corners: Array, count: int, rng: np.random.Generator, steps: int = _SPREADING_STEPS
) -> Array:
    """(count, 2) points within a convex polygon that keep away from each other and its sides.

    From random places, `steps` of Lloyd's iteration on a cloud of points in the shrunk polygon.
    """
    middle = centroid(corners)
    cloud = middle + _INSET * (_points_within(corners, rng) - middle)
    points = cloud[rng.choice(len(cloud), count, replace=False)]
    for _ in range(steps):
        nearest = np.argmin(((cloud[:, None] - points) ** 2).sum(axis=2), axis=1)
        points = np.array(
            [cloud[nearest == k].mean(axis=0) if (nearest == k).any() else points[k]
             for k in range(count)]
        )  # fmt: skip
    return points


def _tessellation(cell: CellParameters) -> Tessellation:
    area = cell.cell_side**2
    if cell.arrangement == "square":
        return square_tessellation(cell.cell_side, isqrt(cell.cells))
    if cell.arrangement == "hexagon":
        return hexagon_tessellation(area, isqrt(cell.cells))
    return voronoi_tessellation(area, cell.cells, cell.arrangement_seed, LLOYD_STEPS)


def _lines(tessellation: Tessellation, spring: float) -> tuple[dict[Edge, list[Wall]], Array, Ints]:
    """Wall particles along each edge, all their positions, the edge each is counted to."""
    positions = list(tessellation.vertices)
    groups = [-1] * len(positions)
    lines: dict[Edge, list[Wall]] = {}
    for number, edge in enumerate(tessellation.edges):
        v, w, shift = edge
        start = tessellation.vertices[v]
        way = tessellation.vertices[w] + tessellation.lattice @ np.array(shift) - start
        springs = max(1, round(tessellation.length(edge) / spring))
        first = len(positions)
        positions += [start + way * k / springs for k in range(1, springs)]
        groups += [number] * (springs - 1)
        inner: list[Wall] = [(k, (0, 0)) for k in range(first, len(positions))]
        lines[edge] = [(v, (0, 0)), *inner, (w, shift)]
        groups[v] = groups[v] if groups[v] >= 0 else number
        groups[w] = groups[w] if groups[w] >= 0 else number
    return lines, np.array(positions), np.array(groups, dtype=np.int32)


def _rim(
    tessellation: Tessellation, polygon: int, lines: dict[Edge, list[Wall]]
) -> tuple[Wall, ...]:
    corners = tessellation.polygons[polygon]
    rim: list[Wall] = []
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        edge, (sx, sy), turned = edge_of(a, b)
        there = [(i, (s[0] + sx, s[1] + sy)) for i, s in lines[edge]]
        rim += (there[::-1] if turned else there)[:-1]
    return tuple(rim)


def _shares(areas: Array, total: int) -> tuple[int, ...]:
    """Whole numbers that add up to `total`, in proportion to the areas by largest remainder."""
    exact = areas * total / areas.sum()
    # areas that are equal but for rounding get equal shares
    counts = np.floor(exact + 1e-6).astype(int)
    order = np.argsort(counts - exact, kind="stable")
    counts[order[: total - counts.sum()]] += 1
    return tuple(int(count) for count in counts)


def _fluid(cell: CellParameters, corners: Array, count: int, rng: np.random.Generator) -> Array:
    if cell.arrangement == "square":
        walls = 2 * cell.wall_springs_per_side - 1
        return even_positions(cell)[walls:] + corners.min(axis=0)
    if cell.arrangement == "hexagon":
        return _hexagon_rings(corners, count)
    return spread_points(corners, count, rng)


def _hexagon_rings(corners: Array, count: int) -> Array:
    """The middle and rings of 6, 12, … points that a hexagon's symmetry maps onto themselves."""
    middle = corners.mean(axis=0)
    rings = 0
    while 3 * rings * (rings + 1) + 1 < count:
        rings += 1
    points = [middle]
    for ring in range(1, rings + 1):
        edge = middle + 0.7 * ring / rings * (corners - middle)
        points += [
            a + (b - a) * k / ring
            for a, b in zip(edge, np.roll(edge, -1, axis=0), strict=True)
            for k in range(ring)
        ]
    return np.array(points)


def _points_within(corners: Array, rng: np.random.Generator) -> Array:
    """Random points of a convex counter-clockwise polygon, evenly, by its triangles."""
    tips = np.roll(corners, -1, axis=0)
    middle = centroid(corners)
    (ax, ay), (bx, by) = (corners - middle).T, (tips - middle).T
    weight = ax * by - ay * bx
    triangle = rng.choice(len(corners), _GRID, p=weight / weight.sum())
    u, v = rng.random((2, _GRID, 1))
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    return middle + u * (corners[triangle] - middle) + v * (tips[triangle] - middle)
