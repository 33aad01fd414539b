"""Particles of any periodic arrangement of plant cells: walls along edges, fluid in polygons.

Each edge is one line of wall particles, its vertices and evenly spaced ones between, with springs
as near as can be to those of the square cell's side; at least one. Fluid fills the polygons with
as many particles as their areas ask for, the total being that of equal plant cells; a uniform fluid
has none. Particle 0
is a vertex and lies at the origin; walls come first, fluid after them, one plant cell after the
other. Of one square plant cell::

    wall 10..18 │            │ image of 10..18 by a₁
                │   fluid    │
                │  19 .. 34  │
    corner 0 ───┴── wall 1..9┴── image of 0 by a₁

Where particles rest, free of stress, is costly to find for irregular cells: as a `ReferenceState`
it can be kept, and handed to a law or a tissue again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import Edge, Shift, Tessellation, centroid, edge_of, squares

Ints = NDArray[np.int32]
Wall = tuple[int, Shift]
"""A wall particle and the lattice shift of its image."""

_INSET = 0.82
"""Fluid of irregular cells starts within polygons shrunk by this factor."""
_GRID, _SPREADING_STEPS, _FEW_STEPS = 2000, 30, 3
_LEVEL = 1e-9


@dataclass(frozen=True, slots=True)
class Arrangement:
    """Walls of a periodic arrangement of plant cells.

    Attributes:
        tessellation: polygons of the plant cells.
        wall_position: (walls, 2) where wall particles start, µm; the first at the origin.
        bonds: (b, 4) pairs of wall particles i, j, and the lattice shift (a, b) of j.
        rims: for each plant cell (k, 3) wall particles around it, and their shifts (a, b).
        fluid_counts: SPH particles of each plant cell; empty with a uniform fluid.
        wall_edge: (walls,) number of the edge that each wall particle is counted to.
        outer: (walls,) of a slab 1 along its lower side, 2 along its upper one, else 0.
        wall_of_bond: (b,) number of the wall that each bond is part of, where walls follow the
            outlines of an image: they bend, and springs differ in length. None: walls are straight.
    """

    tessellation: Tessellation
    wall_position: Array
    bonds: Ints
    rims: tuple[Ints, ...]
    fluid_counts: tuple[int, ...]
    wall_edge: Ints
    outer: Ints
    wall_of_bond: Ints | None = None

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
    return _arrange(cell, cell.tessellation, cell.cells)


@lru_cache(maxsize=32)
def make_slab_arrangement(cell: CellParameters, rows: int, gap: float) -> Arrangement:
    """A column of square plant cells between two free sides; images above are `gap`, µm, away."""
    made = _arrange(cell, squares(cell.cell_side, 1, rows, gap), rows)
    height, top = made.wall_position[:, 1], rows * cell.cell_side
    lower, upper = np.abs(height) < _LEVEL * top, np.abs(height - top) < _LEVEL * top
    return replace(made, outer=(lower + 2 * upper).astype(np.int32))


def _arrange(cell: CellParameters, tessellation: Tessellation, cells: int) -> Arrangement:
    lines, position, wall_edge = _wall_lines(tessellation, cell.spring_length)
    bonds = [
        (i, j, t[0] - s[0], t[1] - s[1])
        for line in lines.values()
        for (i, s), (j, t) in pairwise(line)
    ]
    return Arrangement(
        replace(tessellation, vertices=tessellation.vertices - position[0]),
        position - position[0],
        np.array(bonds, dtype=np.int32),
        tuple(_rim(corners, lines) for corners in tessellation.polygons),
        () if cell.has_uniform_fluid else _shares(tessellation.areas, cell.fluid_particles * cells),
        wall_edge,
        np.zeros_like(wall_edge),
    )


def start_positions(cell: CellParameters, number: int = 0, *, at_random: bool = False) -> Array:
    """(n, 2) particles to relax from, µm, the same for the same parameters and `number`.

    Regular plant cells start with regular fluid, whatever the number, unless `at_random`.
    """
    arrangement = make_arrangement(cell)
    rng = np.random.default_rng([cell.arrangement_seed, number])
    fluid = []
    for k, count in enumerate(arrangement.fluid_counts):
        corners = arrangement.tessellation.corners(k)
        if at_random:
            fluid.append(_spread_points(corners, count, rng, _FEW_STEPS))
        elif cell.arrangement == "square":
            fluid.append(_square_grid(cell) + corners.min(axis=0))
        elif cell.arrangement == "hexagon":
            fluid.append(_hexagon_rings(corners, count))
        else:
            fluid.append(_spread_points(corners, count, rng, _SPREADING_STEPS))
    return np.concatenate([arrangement.wall_position, *fluid])


def _wall_lines(
    tessellation: Tessellation, length: float
) -> tuple[dict[Edge, list[Wall]], Array, Ints]:
    """Wall particles along each edge, all their positions, the edge each is counted to."""
    positions = list(tessellation.vertices)
    wall_edge = [-1] * len(positions)
    lines: dict[Edge, list[Wall]] = {}
    for number, edge in enumerate(tessellation.edges):
        v, w, shift = edge
        start, way = tessellation.vertices[v], tessellation.vector(edge)
        springs = tessellation.springs(edge, length)
        first = len(positions)
        positions += [start + way * k / springs for k in range(1, springs)]
        wall_edge += [number] * (springs - 1)
        inner: list[Wall] = [(k, (0, 0)) for k in range(first, len(positions))]
        lines[edge] = [(v, (0, 0)), *inner, (w, shift)]
        for end in (v, w):
            wall_edge[end] = wall_edge[end] if wall_edge[end] >= 0 else number
    return lines, np.array(positions), np.array(wall_edge, dtype=np.int32)


def _rim(corners: tuple[tuple[int, Shift], ...], lines: dict[Edge, list[Wall]]) -> Ints:
    """(k, 3) wall particles around a polygon and their shifts, counter-clockwise."""
    rim: list[tuple[int, int, int]] = []
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        edge, (sx, sy), turned = edge_of(a, b)
        there = [(i, s[0] + sx, s[1] + sy) for i, s in lines[edge]]
        rim += (there[::-1] if turned else there)[:-1]
    return np.array(rim, dtype=np.int32)


def rim_areas(rims: tuple[Ints, ...], position: Array, lattice: Array) -> Array:
    """(…, cells) areas of the polygons through the wall particles around each plant cell, µm².

    Args:
        position: (…, n, 2) of all particles. lattice: (…, 2, 2), its columns the periods there.
    """
    areas = []
    for rim in rims:
        corner = position[..., rim[:, 0], :] + rim[:, 1:] @ np.swapaxes(lattice, -1, -2)
        following = np.roll(corner, -1, axis=-2)
        cross = corner[..., 0] * following[..., 1] - corner[..., 1] * following[..., 0]
        areas.append(0.5 * cross.sum(axis=-1))
    return np.stack(areas, axis=-1)


def _shares(areas: Array, total: int) -> tuple[int, ...]:
    """Whole numbers that add up to `total`, in proportion to the areas by largest remainder."""
    exact = areas * total / areas.sum()
    # areas that are equal but for rounding get equal shares
    counts = np.floor(exact + 1e-6).astype(int)
    order = np.argsort(counts - exact, kind="stable")
    counts[order[: total - counts.sum()]] += 1
    return tuple(int(count) for count in counts)


def _square_grid(cell: CellParameters) -> Array:
    """Fluid of a square plant cell in rows and columns."""
    side, fluid = cell.cell_side, cell.fluid_particles_per_side
    inset = 0.7 * side / fluid
    grid = np.linspace(inset, side - inset, fluid) if fluid > 1 else np.array([0.5 * side])
    return np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)


def _hexagon_rings(corners: Array, count: int) -> Array:
    """The middle and rings of 6, 12, … points that a hexagon's symmetry maps onto themselves."""
    middle = corners.mean(axis=0)
    rings = next(k for k in range(count) if 3 * k * (k + 1) + 1 >= count)
    points = [middle]
    for ring in range(1, rings + 1):
        edge = middle + 0.7 * ring / rings * (corners - middle)
        points += [
            a + (b - a) * k / ring
            for a, b in zip(edge, np.roll(edge, -1, axis=0), strict=True)
            for k in range(ring)
        ]
    return np.array(points)


def _spread_points(corners: Array, count: int, rng: np.random.Generator, steps: int) -> Array:
    """(count, 2) points within a convex polygon that keep away from each other and its sides.

    From random places, `steps` of Lloyd's iteration on a cloud of points in the shrunk polygon.
    """
    middle = centroid(corners)
    cloud = middle + _INSET * (_points_within(corners, rng) - middle)
    points = cloud[rng.choice(len(cloud), count, replace=False)]
    for _ in range(steps):
        nearest = np.argmin(((cloud[:, None] - points) ** 2).sum(axis=2), axis=1)
        for k in np.unique(nearest):
            points[k] = cloud[nearest == k].mean(axis=0)
    return points


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


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceState:
    """A stable equilibrium at F = I without stress, as plain data.

    Attributes:
        fingerprint: of the `CellParameters` that it belongs to.
        position: (n, 2) µm, walls first; particle 0 is a wall corner at the origin.
        lattice: (2, 2) µm, its columns the periods of the RVE.
        rest_length: wall rest length l₀, µm.
    """

    fingerprint: str
    position: Array
    lattice: Array
    rest_length: float

    def check_belongs_to(self, cell: CellParameters) -> None:
        """Raise MismatchError unless this is the reference state of `cell`."""
        if self.fingerprint != cell.fingerprint:
            raise MismatchError(
                f"reference: it belongs to plant cells {self.fingerprint}, not to "
                f"{cell.fingerprint}; take that of these parameters, or none to have it settled"
            )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """One array for each field; the fingerprint as its 16 character codes."""
        return {
            "fingerprint": np.frombuffer(self.fingerprint.encode("ascii"), dtype=np.uint8).copy(),
            "position": self.position.copy(),
            "lattice": self.lattice.copy(),
            "rest_length": np.array([self.rest_length]),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ReferenceState:
        """The state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: an array is missing, has another shape or is not finite.
        """
        letters, *values = (arrays.get(item.name, np.empty(0)) for item in fields(cls))
        position, lattice, length = (np.array(each, np.float64, order="C") for each in values)
        shapes = position.shape == (len(position), 2) and lattice.shape == (2, 2)
        finite = all(np.isfinite(each).all() for each in (position, lattice, length))
        if not (shapes and finite and len(letters) == 16 and length.size == 1):
            raise InputError(
                "reference: arrays are missing, not finite or of other shapes; compute it again"
            )
        name = np.asarray(letters).astype(np.uint8).tobytes().decode("ascii", "replace")
        return cls(name, position, lattice, float(length.item()))
