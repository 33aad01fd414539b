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
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, tiles_for
from surrofe2.plant_cell.arrangement import ReferenceState
from surrofe2.plant_cell.forces import Constants, make_constants
from surrofe2.plant_cell.parameters import CellParameters

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

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
        column, row: (places,) of the plant cell in each lane, −1 for an empty place.
        fluid_tiles: how many tiles, the first ones, hold plant cells with fluid.
        place: (n + 1, m + 1) the place of each column and row.
        start: (tiles, 2, own, TILE) positions from the repeated reference cell, µm.
        mass: (tiles, own, TILE) ng; 0 where there is no particle.
        walls: number of a cell's own wall particles; they come first.
        where: (particles,) flat index into (tiles, own, TILE), walls of all cells, then fluid.
    """

    types: tuple[CellParameters, ...]
    references: tuple[ReferenceState, ...]
    constants: tuple[Constants, ...]
    kind: Ints
    column: Ints
    row: Ints
    fluid_tiles: int
    place: Ints
    start: Array
    mass: Array
    walls: int
    where: Ints

    @property
    def cell(self) -> CellParameters:
        """The first type of plant cell, which has what all must share."""
        return self.types[0]

    @property
    def cells(self) -> tuple[int, int]:
        """(n, m) plant cells in x and y."""
        n, m = self.kind.shape
        return n, m

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
        return len(self.where)

    @property
    def wall_particles(self) -> int:
        """How many of the particles are walls; they come first."""
        return int((self.where // TILE % self.own < self.walls).sum())

    @property
    def exists(self) -> NDArray[np.bool_]:
        """(tiles, own, TILE) whether there is a particle."""
        return self.mass > 0.0

    @property
    def outline(self) -> Array:
        """(particles, 2) places of wall particles on the grid of walls; infinite for fluid, µm."""
        at = wall_grid(self.cell, self.column, self.row)
        places = np.full((len(self.column), self.own, 2), np.inf)
        places[:, : self.walls] = self.cell.cell_side * at / self.cell.wall_springs_per_side
        return self.to_particles(np.moveaxis(tiled(places), 2, 1))

    def each(self, tiles: Array) -> Array:
        """(tiles, own, TILE) → (particles,)."""
        values: Array = tiles.reshape(-1)[self.where]
        return values

    def to_particles(self, tiled: Array) -> Array:
        """(tiles, 2, own, TILE) → (particles, 2)."""
        by_axis = np.moveaxis(tiled, 1, 0).reshape(2, -1)
        return np.ascontiguousarray(by_axis[:, self.where].T)

    def to_tiles(self, values: Array, missing: Array | float = 0.0) -> Array:
        """(particles, 2) → (tiles, 2, own, TILE) with `missing` where there is no particle."""
        by_axis = np.empty((2, self.mass.size))
        by_axis[:] = np.moveaxis(np.broadcast_to(missing, self.start.shape), 1, 0).reshape(2, -1)
        by_axis[:, self.where] = values.T
        tiled = by_axis.reshape(2, self.tiles, self.own, TILE)
        return np.ascontiguousarray(np.moveaxis(tiled, 0, 1))


def make_tissue(
    types: Sequence[CellParameters], references: Sequence[ReferenceState], kind: Ints
) -> Tissue:
    """A tissue whose plant cell (a, b) is of the type kind[a, b].

    Args:
        references: of each type, one square plant cell, free of stress as part of a tissue.

    Raises:
        InputError: a type is not one square, or not as large or as finely divided as the first.
        MismatchError: a reference is of another cell.
    """
    cell, n, m = types[0], *kind.shape
    for each, reference in zip(types, references, strict=True):
        if not each.is_one_square:
            raise InputError(
                f"cell.arrangement: {each.cells} of {each.arrangement}; a tissue must be made of "
                "copies of one square plant cell"
            )
        for name in _ALIKE:
            here, there = each.to_dict()[name], cell.to_dict()[name]
            if here != there:
                raise InputError(
                    f"cell.{name}: {here:g} and {there:g}; plant cells of one tissue must share it"
                )
        reference.check_belongs_to(each)
    walls, own = 2 * cell.wall_springs_per_side - 1, len(references[0].position)
    column, row = _places((n, m))
    is_wall = np.arange(own) < walls
    mass = np.zeros((len(column), own))
    for k, each in enumerate(types):
        share = shares(cell, kind == k, column, row)
        mass += share * np.where(is_wall, each.wall_particle_mass, each.fluid_mass)
    at, ends = wall_grid(cell, column, row), cell.wall_springs_per_side * np.array([n, m])
    mass[:, :walls][((at == 0) | (at == ends)).any(axis=2)] *= cell.outer_wall
    exists = mass > 0.0
    place = np.full((column.max() + 1, row.max() + 1), -1)
    there = column >= 0
    place[column[there], row[there]] = np.flatnonzero(there)
    of_place = kind[np.clip(column, 0, n - 1), np.clip(row, 0, m - 1)]
    at_rest = np.stack([reference.position for reference in references])
    start = at_rest[of_place] + cell.cell_side * np.stack([column, row], axis=1)[:, None]
    missing = np.arange(int((~exists).sum()))  # far from one another, too
    start[~exists] = np.stack([-NOWHERE - 100.0 * missing, np.full(len(missing), -NOWHERE)], axis=1)
    start = np.moveaxis(tiled(start), 2, 1)
    return Tissue(
        types=tuple(types),
        references=tuple(references),
        constants=tuple(
            make_constants(each, reference.rest_length)
            for each, reference in zip(types, references, strict=True)
        ),
        kind=kind,
        column=column,
        row=row,
        fluid_tiles=tiles_for(n * m),
        place=place,
        start=np.ascontiguousarray(start),
        mass=tiled(mass),
        walls=walls,
        where=_order(exists, walls),
    )


def _places(cells: tuple[int, int]) -> tuple[Ints, Ints]:
    """Column and row of each place, rows of plant cells running along the lanes."""
    n, m = cells
    whole = [(a, b) for b in range(m) for a in range(n)]
    edge = [*((n, b) for b in range(m)), *((a, m) for a in range(n + 1))]
    filled = [group + [(-1, -1)] * (-len(group) % TILE) for group in (whole, edge)]
    column, row = np.array(filled[0] + filled[1]).T
    return column, row


def wall_grid(cell: CellParameters, column: Ints, row: Ints) -> Ints:
    """(places, walls, 2) where own wall particles lie on the grid of springs."""
    per_side = cell.wall_springs_per_side
    along = np.arange(1, per_side)
    own = np.zeros((2 * per_side - 1, 2), dtype=np.int64)
    own[1:per_side, 0], own[per_side:, 1] = along, along
    return per_side * np.stack([column, row], axis=1)[:, None] + own


def shares(cell: CellParameters, filled: NDArray[np.bool_], column: Ints, row: Ints) -> Array:
    """(places, own) part of a particle that plant cells `filled` (n, m) have; 0 where none has."""
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    present = np.pad(filled.astype(np.float64), 1)
    here, left = present[column + 1, row + 1], present[column, row + 1]
    below, diagonal = present[column + 1, row], present[column, row]
    share = np.zeros((len(column), walls + cell.fluid_particles))
    share[:, 0] = (here + left + below + diagonal) / 4
    share[:, 1:per_side] = ((here + below) / 2)[:, None]
    share[:, per_side:walls] = ((here + left) / 2)[:, None]
    share[:, walls:] = here[:, None]
    share[column < 0] = 0.0
    return share


def tiled(values: NDArray) -> NDArray:
    """(places, …) → (tiles, …, TILE)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(-1, TILE, *values.shape[1:]), 1, -1))


def _order(exists: NDArray[np.bool_], walls: int) -> Ints:
    """Flat indices into (tiles, own, TILE) of all particles, walls first, place by place."""
    place, particle = np.nonzero(exists)
    order = np.lexsort((particle, place, particle >= walls))
    place, particle = place[order], particle[order]
    return (place // TILE * exists.shape[1] + particle) * TILE + place % TILE
