"""Where the particles of one square plant cell sit in a tissue, and which of them interact.

A `Patch` holds the particles of one periodic unit and the images of particles that they
interact with. Kernels see local particles only: first the unit's own, then the images; a pair
(i, j) needs no shift. All patches of one topology share the pair lists, so they can be SIMD lanes.

    wall 10..18 │            │ image of 10..18 by a₁
                │   fluid    │
                │  19 .. 34  │
    corner 0 ───┴── wall 1..9┴── image of 0 by a₁
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters

Ints = NDArray[np.int32]
Pair = tuple[int, int, tuple[int, int]]
"""Particle i, particle j, integer image shift of j."""


@dataclass(frozen=True, slots=True)
class Patch:
    """Particles of a periodic unit, images, and who interacts with whom (local indices).

    Attributes:
        position: (n, 2) reference positions of the unit's own particles, µm.
        mass: (n,) ng.
        walls: number of wall particles; they come first, fluid after them.
        owner: (g,) own particle of each image; image k has the local index n + k.
        shift: (g, 2) integer lattice shift of each image.
        bonds, contacts, fluid_pairs: (·, 2) local indices i, j.
        reach: reference distance (µm) up to which contacts are listed.
        fluid_start: (cells + 1,) first fluid particle of each plant cell, counted from the first
            of all; their pairs are listed in that order.
    """

    position: NDArray[np.float64]
    mass: NDArray[np.float64]
    walls: int
    lattice: NDArray[np.float64]
    owner: Ints
    shift: Ints
    bonds: Ints
    contacts: Ints
    fluid_pairs: Ints
    reach: float
    fluid_start: Ints

    @property
    def particles(self) -> int:
        """Number of the unit's own particles."""
        return len(self.position)

    @property
    def area(self) -> float:
        """Reference area of the unit, µm²."""
        (xx, xy), (yx, yy) = self.lattice.tolist()
        return float(abs(xx * yy - xy * yx))


def square_patch(
    cell: CellParameters, position: NDArray[np.float64] | None = None, *, reach: float
) -> Patch:
    """The periodic unit of a tissue of square cells: one cell.

    Args:
        position: (n, 2) reference positions; None: walls evenly spaced, fluid on a square grid.
        reach: contacts are listed for pairs up to this distance in `position`, µm.
    """
    side, per_side = cell.cell_side, cell.wall_springs_per_side
    if position is None:
        position = even_positions(cell)
    walls = 2 * per_side - 1
    fluid = range(walls, len(position))
    bonds = list(_wall_bonds(per_side))
    bonded = {_normalised(pair) for pair in bonds}
    lattice = side * np.eye(2)
    unbonded = [p for p in _wall_pairs(walls, lattice, reach) if _normalised(p) not in bonded]
    touching = [(f, wall, shift) for wall, shift in _rim(per_side) for f in fluid]
    contacts = [p for p in unbonded + touching if _distance(p, position, lattice) <= reach]
    fluid_pairs = [(i, j, (0, 0)) for i in fluid for j in fluid if i < j]
    mass = np.full(len(position), cell.fluid_particle_mass)
    mass[:walls] = cell.wall_particle_mass
    fluid_start = np.array([0, len(fluid)], dtype=np.int32)
    return localised(
        position, mass, walls, lattice, bonds, contacts, fluid_pairs, reach, fluid_start
    )


def even_positions(cell: CellParameters) -> NDArray[np.float64]:
    """(n, 2) corner, bottom wall, left wall evenly spaced; fluid on a square grid, µm."""
    side, per_side, fluid = (
        cell.cell_side,
        cell.wall_springs_per_side,
        cell.fluid_particles_per_side,
    )
    along = side * np.arange(1, per_side) / per_side
    zeros = np.zeros_like(along)
    inset = 0.7 * side / fluid
    grid = np.linspace(inset, side - inset, fluid) if fluid > 1 else np.array([0.5 * side])
    grid_x, grid_y = np.meshgrid(grid, grid, indexing="ij")
    return np.concatenate(
        [
            np.zeros((1, 2)),
            np.stack([along, zeros], axis=1),
            np.stack([zeros, along], axis=1),
            np.stack([grid_x.ravel(), grid_y.ravel()], axis=1),
        ]
    )


def _wall_bonds(per_side: int) -> Iterable[Pair]:
    bottom = [0, *range(1, per_side)]
    left = [0, *range(per_side, 2 * per_side - 1)]
    for line, end in ((bottom, (1, 0)), (left, (0, 1))):
        yield from ((i, j, (0, 0)) for i, j in pairwise(line))
        yield line[-1], 0, end


def _rim(per_side: int) -> list[tuple[int, tuple[int, int]]]:
    """The wall particles around one cell, with the shift of each."""
    bottom = range(1, per_side)
    left = range(per_side, 2 * per_side - 1)
    corners = [(0, (0, 0)), (0, (1, 0)), (0, (0, 1)), (0, (1, 1))]
    sides = [(w, s) for w in bottom for s in ((0, 0), (0, 1))]
    sides += [(w, s) for w in left for s in ((0, 0), (1, 0))]
    return corners + sides


def _wall_pairs(walls: int, lattice: NDArray[np.float64], reach: float) -> Iterable[Pair]:
    """Every pair of wall particles with every image that may be within reach, once."""
    images = int(np.ceil(reach / np.linalg.norm(lattice, axis=0).min())) + 1
    shifts = [(a, b) for a in range(-images, images + 1) for b in range(-images, images + 1)]
    for i in range(walls):
        for j in range(i, walls):
            for shift in shifts:
                if i < j or shift > (0, 0):
                    yield i, j, shift


def _normalised(pair: Pair) -> Pair:
    """The same pair with i ≤ j, or with a positive shift for a particle and its own image."""
    i, j, (a, b) = pair
    return pair if i < j or (i == j and (a, b) > (0, 0)) else (j, i, (-a, -b))


def _distance(pair: Pair, position: NDArray[np.float64], lattice: NDArray[np.float64]) -> float:
    i, j, shift = pair
    return float(np.linalg.norm(position[j] - position[i] + lattice @ np.array(shift)))


def localised(
    position: NDArray[np.float64],
    mass: NDArray[np.float64],
    walls: int,
    lattice: NDArray[np.float64],
    bonds: list[Pair],
    contacts: list[Pair],
    fluid_pairs: list[Pair],
    reach: float,
    fluid_start: Ints,
) -> Patch:
    """Replace every shifted partner by a local image particle."""
    images: dict[tuple[int, tuple[int, int]], int] = {}

    def local(pairs: list[Pair]) -> Ints:
        rows = []
        for i, j, shift in sorted(pairs):
            if shift != (0, 0):
                j = images.setdefault((j, shift), len(position) + len(images))
            rows.append((i, j))
        return np.array(rows, dtype=np.int32).reshape(-1, 2)

    local_bonds, local_contacts, local_fluid = local(bonds), local(contacts), local(fluid_pairs)
    return Patch(
        position=position,
        mass=mass,
        walls=walls,
        lattice=lattice,
        owner=np.array([i for i, _ in images], dtype=np.int32),
        shift=np.array([s for _, s in images], dtype=np.int32).reshape(-1, 2),
        bonds=local_bonds,
        contacts=local_contacts,
        fluid_pairs=local_fluid,
        reach=reach,
        fluid_start=fluid_start,
    )
