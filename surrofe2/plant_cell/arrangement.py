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
from dataclasses import dataclass, replace
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
"""Factor by which polygons are shrunk, within which the fluid of irregular cells starts: next to a
wall contacts would push it away with a force that grows as r⁻⁶."""
_SQUARE_INSET = 0.7
"""Distance of a square's outer rows of fluid from its sides, in spacings of equal rows."""
_HEXAGON_INSET = 0.7
"""Distance of a hexagon's outer ring of fluid from the middle, as a fraction of the corners'."""
_CLOUD = 2000
"""Random points of a polygon, whose clusters are where fluid particles start."""
_SPREADING_STEPS = 30
"""Steps of Lloyd's iteration that spread fluid evenly; more would change its places little."""
_FEW_STEPS = 3
"""Steps that leave starts random and yet keep particles apart."""
_LEVEL = 1e-9
"""Relative difference up to which two heights are the same, but for rounding."""
_LOWER_SIDE = 1
_UPPER_SIDE = 2
"""Marks of wall particles along a slab's free sides in `Arrangement.outer`."""


@dataclass(frozen=True, slots=True)
class Arrangement:
    """Walls of a periodic arrangement of plant cells.

    Attributes:
        tessellation: polygons of the plant cells.
        wall_position: (walls, 2) where wall particles start, µm; the first at the origin.
        bonds: (b, 4) pairs of wall particles i, j, and the lattice shift (a, b) of j.
        rims: wall particles around each plant cell, and their shifts (a, b), (k, 3) each.
        fluid_counts: SPH particles of each plant cell; empty with a uniform fluid.
        wall_edge: (walls,) number of the edge that each wall particle is counted to.
        outer: (walls,) `_LOWER_SIDE` or `_UPPER_SIDE` along the free sides of a slab, else 0.
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
        """First fluid particle of each plant cell (cells + 1,), counted from the first of all."""
        return np.concatenate([[0], np.cumsum(self.fluid_counts)]).astype(np.int32)

    @property
    def particles(self) -> int:
        """Number of all particles."""
        return self.walls + sum(self.fluid_counts)


@lru_cache(maxsize=32)
def make_arrangement(cell: CellParameters) -> Arrangement:
    """Make the arrangement that `cell` names."""
    return _arrange(cell, cell.tessellation, cell.cells)


@lru_cache(maxsize=32)
def make_slab_arrangement(cell: CellParameters, rows: int, gap: float) -> Arrangement:
    """Make a column of square plant cells between two free sides.

    gap: distance of the images above, µm.
    """
    arrangement = _arrange(cell, squares(cell.cell_side, 1, rows, gap), rows)
    height = arrangement.wall_position[:, 1]
    top = rows * cell.cell_side
    # plant cells stand on y = 0; the gap is above them
    outer = np.zeros(len(height), dtype=np.int32)
    outer[np.abs(height) < _LEVEL * top] = _LOWER_SIDE
    outer[np.abs(height - top) < _LEVEL * top] = _UPPER_SIDE
    return replace(arrangement, outer=outer)


def _arrange(cell: CellParameters, tessellation: Tessellation, cells: int) -> Arrangement:
    """Put wall particles along the edges of a tessellation, and count the fluid of its polygons."""
    lines, position, wall_edge = _wall_lines(tessellation, cell.spring_length)
    bonds = []
    for line in lines.values():
        for (i, shift_i), (j, shift_j) in pairwise(line):
            bonds.append((i, j, shift_j[0] - shift_i[0], shift_j[1] - shift_i[1]))
    fluid_counts: tuple[int, ...] = ()
    if not cell.has_uniform_fluid:
        fluid_counts = _shares(tessellation.areas, cell.fluid_particles * cells)
    # particle 0 comes to lie at the origin
    return Arrangement(
        tessellation=replace(tessellation, vertices=tessellation.vertices - position[0]),
        wall_position=position - position[0],
        bonds=np.array(bonds, dtype=np.int32),
        rims=tuple(_rim(corners, lines) for corners in tessellation.polygons),
        fluid_counts=fluid_counts,
        wall_edge=wall_edge,
        outer=np.zeros_like(wall_edge),
    )


def start_positions(cell: CellParameters, number: int = 0, *, at_random: bool = False) -> Array:
    """Return particles (n, 2) to relax from, µm, the same for the same parameters and `number`.

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
    """Divide each edge into springs.

    Returns:
        Wall particles along each edge, all their positions (walls, 2), and the edge that each is
        counted to (walls,): of a vertex, the first one that ends there.
    """
    positions = list(tessellation.vertices)
    no_edge = -1
    wall_edge = [no_edge] * len(positions)
    lines: dict[Edge, list[Wall]] = {}
    for number, edge in enumerate(tessellation.edges):
        v, w, shift = edge
        start = tessellation.vertices[v]
        vector = tessellation.vector(edge)
        springs = tessellation.springs(edge, length)
        first = len(positions)
        for k in range(1, springs):
            positions.append(start + vector * k / springs)
            wall_edge.append(number)
        inner: list[Wall] = [(k, (0, 0)) for k in range(first, len(positions))]
        lines[edge] = [(v, (0, 0)), *inner, (w, shift)]
        for vertex in (v, w):
            if wall_edge[vertex] == no_edge:
                wall_edge[vertex] = number
    return lines, np.array(positions), np.array(wall_edge, dtype=np.int32)


def _rim(corners: tuple[tuple[int, Shift], ...], lines: dict[Edge, list[Wall]]) -> Ints:
    """Return wall particles around a polygon and their shifts, (k, 3), counter-clockwise."""
    rim: list[tuple[int, int, int]] = []
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        edge, (sx, sy), turned = edge_of(a, b)
        side = [(i, shift[0] + sx, shift[1] + sy) for i, shift in lines[edge]]
        if turned:
            side.reverse()
        rim += side[:-1]  # the last one is the first of the next side
    return np.array(rim, dtype=np.int32)


def rim_areas(rims: tuple[Ints, ...], position: Array, lattice: Array) -> Array:
    """Return areas (…, cells) of the polygons through the wall particles around plant cells, µm².

    Args:
        position: (…, n, 2) positions of all particles.
        lattice: (…, 2, 2), its columns the periods.
    """
    areas = []
    for rim in rims:
        corner = position[..., rim[:, 0], :] + rim[:, 1:] @ np.swapaxes(lattice, -1, -2)
        following = np.roll(corner, -1, axis=-2)
        cross = corner[..., 0] * following[..., 1] - corner[..., 1] * following[..., 0]
        areas.append(0.5 * cross.sum(axis=-1))
    return np.stack(areas, axis=-1)


def _shares(areas: Array, total: int) -> tuple[int, ...]:
    """Share `total` particles out in proportion to the areas, by largest remainder."""
    exact = areas * total / areas.sum()
    # areas that are equal but for rounding get equal shares
    counts = np.floor(exact + 1e-6).astype(int)
    largest_remainder_first = np.argsort(counts - exact, kind="stable")
    lacking = total - counts.sum()
    counts[largest_remainder_first[:lacking]] += 1
    return tuple(int(count) for count in counts)


def _square_grid(cell: CellParameters) -> Array:
    """Return the fluid (k, 2) of a square plant cell, from its corner, in rows and columns."""
    side = cell.cell_side
    rows = cell.fluid_particles_per_side
    inset = _SQUARE_INSET * side / rows
    if rows > 1:
        grid = np.linspace(inset, side - inset, rows)
    else:
        grid = np.array([0.5 * side])
    return np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)


def _hexagon_rings(corners: Array, count: int) -> Array:
    """Return the middle of a hexagon and rings of 6, 12, … points around it, `count` in all.

    The hexagon's symmetry maps them onto themselves.
    """
    middle = corners.mean(axis=0)
    # k rings have 3 k (k + 1) points
    rings = next(k for k in range(count) if 3 * k * (k + 1) + 1 >= count)
    points = [middle]
    for ring in range(1, rings + 1):
        corners_of_ring = middle + _HEXAGON_INSET * ring / rings * (corners - middle)
        following = np.roll(corners_of_ring, -1, axis=0)
        for a, b in zip(corners_of_ring, following, strict=True):
            for k in range(ring):
                points.append(a + (b - a) * k / ring)
    return np.array(points)


def _spread_points(corners: Array, count: int, rng: np.random.Generator, steps: int) -> Array:
    """Return points (count, 2) in a convex polygon, away from each other and from its sides.

    They are moved from random places by `steps` of Lloyd's iteration, each to the mean of those
    points of a cloud in the shrunk polygon that are nearest to it.
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
    """Draw `_CLOUD` points (_CLOUD, 2) evenly from a convex, counter-clockwise polygon (k, 2).

    The polygon is cut into triangles from its middle to each side. A point is drawn from a triangle
    chosen in proportion to its area.
    """
    following = np.roll(corners, -1, axis=0)
    middle = centroid(corners)
    ax, ay = (corners - middle).T
    bx, by = (following - middle).T
    twice_area = ax * by - ay * bx
    triangle = rng.choice(len(corners), _CLOUD, p=twice_area / twice_area.sum())
    u, v = rng.random((2, _CLOUD, 1))
    # u a + v b is even in the parallelogram of a and b; points of its far half, u + v > 1, are
    # reflected into the triangle
    is_beyond = u + v > 1.0
    u = np.where(is_beyond, 1.0 - u, u)
    v = np.where(is_beyond, 1.0 - v, v)
    return middle + u * (corners[triangle] - middle) + v * (following[triangle] - middle)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceState:
    """A stable equilibrium at F = I without stress, as plain data.

    Attributes:
        fingerprint: fingerprint of the `CellParameters` that it belongs to.
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
        """Return one array for each field; the fingerprint as its 16 character codes."""
        return {
            "fingerprint": np.frombuffer(self.fingerprint.encode("ascii"), dtype=np.uint8).copy(),
            "position": self.position.copy(),
            "lattice": self.lattice.copy(),
            "rest_length": np.array([self.rest_length]),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ReferenceState:
        """Return the state whose `to_arrays` returned `arrays`.

        Raises:
            InputError: an array is missing, has another shape or is not finite.
        """
        nothing = np.empty(0)
        letters = np.asarray(arrays.get("fingerprint", nothing))
        position = np.array(arrays.get("position", nothing), np.float64, order="C")
        lattice = np.array(arrays.get("lattice", nothing), np.float64, order="C")
        length = np.array(arrays.get("rest_length", nothing), np.float64, order="C")
        has_shapes = (
            letters.size == 16
            and position.shape[1:] == (2,)
            and lattice.shape == (2, 2)
            and length.size == 1
        )
        is_finite = all(np.isfinite(values).all() for values in (position, lattice, length))
        if not (has_shapes and is_finite):
            raise InputError(
                "reference: arrays are missing, not finite or of other shapes; compute it again"
            )
        fingerprint = letters.astype(np.uint8).tobytes().decode("ascii", "replace")
        return cls(fingerprint, position, lattice, float(length.item()))
