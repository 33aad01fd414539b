"""Which plant cells and particles a tissue has, and where they lie in tiles.

Every square plant cell owns its lower left corner, bottom wall, left wall and fluid, as the
periodic unit of `plant_cell.arrangement` does. The walls along the right and the upper boundary
belong to further columns and rows of `walls only` places, which have no fluid::

    top walls only       ┌──┬──┬·
    plant cells          ├──┼──┼·    · right walls only
    (n × m)              ├──┼──┼·
                         └──┴──┴·

Places are lanes of tiles: plant cells first, then those with walls only, each group filled up to
whole tiles with empty places. A particle that does not exist lies far away, where it meets no one.

What two cells share is halved where one of them is missing (docs/theory.md, walls at a free
boundary): the mass of a wall particle is its share, (cells present)/(cells that share it), so a
quarter at the tissue's corners. Between plant cells of two types it is the sum of both shares.
`outer_wall` multiplies what is left along the boundary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, pack
from surrofe2.plant_cell.arrangement import ReferenceState
from surrofe2.plant_cell.pair_laws import Constants, make_constants
from surrofe2.plant_cell.parameters import CellParameters

_ALIKE = (
    "cell_side", "wall_springs_per_side", "fluid_particles_per_side", "repulsion_cutoff",
    "outer_wall",
)  # fmt: skip
"""What all types of plant cells of a tissue must share, so that their walls meet."""

NOWHERE = 1e6
"""Where particles lie that do not exist, µm; far beyond every cut-off."""


@dataclass(frozen=True, slots=True)
class Tissue:
    """n × m square plant cells with single walls at the boundary.

    Attributes:
        types: of plant cells; references: their reference states; constants: of their pair laws.
        kind: (n, m) type of each plant cell.
        column_row: (places, 2) of the plant cell in each lane, −1 for an empty place.
        place: (n + 1, m + 1) the place of each column and row.
        start: (tiles, 2, own, TILE) positions from the repeated reference cell, µm.
        mass: (tiles, own, TILE) ng; 0 where there is no particle.
        walls: number of a cell's own wall particles; they come first.
        address: (particles, 3) tile, own particle and lane; walls of all cells, then fluid.
    """

    types: tuple[CellParameters, ...]
    references: tuple[ReferenceState, ...]
    constants: tuple[Constants, ...]
    kind: Index
    column_row: Index
    place: Index
    start: Array
    mass: Array
    walls: int
    address: Index

    @property
    def cell(self) -> CellParameters:
        """The first type of plant cell, which has what all must share."""
        return self.types[0]

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return len(self.start)

    @property
    def own(self) -> int:
        """Number of particles that a plant cell owns."""
        return self.start.shape[2]

    @property
    def particles(self) -> int:
        """Number of particles of the whole tissue."""
        return len(self.address)

    @property
    def is_wall(self) -> Flags:
        """(particles,)."""
        return self.address[:, 1] < self.walls

    @property
    def outline(self) -> Array:
        """(particles, 2) places of wall particles on the grid of walls; infinite for fluid, µm."""
        at = self.cell.cell_side * wall_grid(self.cell, self.column_row)
        places = np.full((len(at), 2, self.own), np.inf)
        places[..., : self.walls] = at.swapaxes(1, 2) / self.cell.wall_springs_per_side
        return self.to_particles(pack(places))

    def to_particles(self, tiles: Array) -> Array:
        """(tiles, own, TILE) → (particles,), and (tiles, 2, own, TILE) → (particles, 2)."""
        tile, own, lane = self.address.T
        return np.ascontiguousarray(tiles[tile, ..., own, lane])

    def to_tiles(self, values: Array, missing: Array | float = 0.0) -> Array:
        """(particles, 2) → (tiles, 2, own, TILE) with `missing` where there is no particle."""
        tiles = np.empty(self.start.shape)
        tiles[:] = missing
        tile, own, lane = self.address.T
        tiles[tile, :, own, lane] = values
        return tiles


def check_cell_of_tissue(cell: CellParameters) -> None:
    """Refuse a plant cell of which no full tissue can be made.

    Raises:
        InputError: the RVE is not one square plant cell, or its fluid is uniform.
    """
    if not cell.is_one_square:
        raise InputError(
            f"cell.arrangement: {cell.cells} of {cell.arrangement}; a full tissue must be made of "
            "copies of one square plant cell"
        )
    if cell.has_uniform_fluid:
        raise InputError(
            'cell.fluid: uniform; a full tissue takes fluid = "sph" alone; set it, and make data '
            "set and surrogate of these RVEs again"
        )


def make_tissue(
    types: Sequence[CellParameters], references: Sequence[ReferenceState], kind: Index
) -> Tissue:
    """A tissue whose plant cell (a, b) is of the type kind[a, b].

    Args:
        references: of each type, one square plant cell, free of stress as part of a tissue.

    Raises:
        InputError: a type is not one square of SPH fluid, or not as large or as finely divided as
            the first.
        MismatchError: a reference is of another cell.
    """
    cell, (n, m) = types[0], kind.shape
    for each, reference in zip(types, references, strict=True):
        check_cell_of_tissue(each)
        for name in _ALIKE:
            here, there = each.to_dict()[name], cell.to_dict()[name]
            if here != there:
                raise InputError(
                    f"cell.{name}: {here:g} and {there:g}; plant cells of one tissue must share it"
                )
        reference.check_belongs_to(each)
    # rows of plant cells run along the lanes
    whole = [(a, b) for b in range(m) for a in range(n)]
    edge = [*((n, b) for b in range(m)), *((a, m) for a in range(n + 1))]
    column_row = np.array(
        [at for group in (whole, edge) for at in group + [(-1, -1)] * (-len(group) % TILE)]
    )
    filled = np.flatnonzero(column_row[:, 0] >= 0)
    place = np.empty((n + 1, m + 1), dtype=np.int64)
    place[tuple(column_row[filled].T)] = filled

    walls, own = 2 * cell.wall_springs_per_side - 1, len(references[0].position)
    is_wall = np.arange(own) < walls
    mass = np.zeros((len(column_row), own))
    for k, each in enumerate(types):
        masses = np.where(is_wall, each.wall_particle_mass, each.fluid_mass)
        mass += shares(cell, kind == k, column_row) * masses
    grid, ends = wall_grid(cell, column_row), cell.wall_springs_per_side * np.array([n, m])
    mass[:, :walls][((grid == 0) | (grid == ends)).any(axis=2)] *= cell.outer_wall

    at_rest = np.stack([reference.position for reference in references])
    of_place = kind[tuple(np.clip(column_row, 0, [n - 1, m - 1]).T)]
    start = at_rest[of_place] + cell.cell_side * column_row[:, None]
    missing = mass == 0.0
    start[missing] = -NOWHERE - 100.0 * np.arange(missing.sum())[:, None]  # nor near one another
    there, particle = np.nonzero(~missing)
    address = np.stack([there // TILE, particle, there % TILE], axis=1)
    return Tissue(
        types=tuple(types),
        references=tuple(references),
        constants=tuple(
            make_constants(each, reference.rest_length)
            for each, reference in zip(types, references, strict=True)
        ),
        kind=kind,
        column_row=column_row,
        place=place,
        start=pack(start.swapaxes(1, 2)),
        mass=pack(mass),
        walls=walls,
        address=address[np.argsort(particle >= walls, kind="stable")],
    )


def wall_grid(cell: CellParameters, column_row: Index) -> Index:
    """(places, walls, 2) where own wall particles lie on the grid of springs."""
    per_side = cell.wall_springs_per_side
    along = np.arange(1, per_side)
    own = np.zeros((2 * per_side - 1, 2), dtype=np.int64)
    own[1:per_side, 0], own[per_side:, 1] = along, along
    return per_side * column_row[:, None] + own


def shares(cell: CellParameters, filled: Flags, column_row: Index) -> Array:
    """(places, own) part of a particle that plant cells `filled` (n, m) have; 0 where none has."""
    present = np.pad(filled.astype(np.float64), 1)
    column, row = column_row.T
    here, left = present[column + 1, row + 1], present[column, row + 1]
    below, diagonal = present[column + 1, row], present[column, row]
    parts = [(here + left + below + diagonal) / 4, (here + below) / 2, (here + left) / 2, here]
    along = cell.wall_springs_per_side - 1  # wall particles besides the corner
    return np.repeat(parts, [1, along, along, cell.fluid_particles], axis=0).T
