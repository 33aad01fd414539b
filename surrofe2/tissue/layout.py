"""Plant cells and particles of a tissue, and the places where they lie in tiles.

A tissue is cut from the RVE's own pattern, repeated: each period may have all of its plant cells,
some or none. A period owns the particles that `plant_cell.arrangement` numbers. Walls around a
plant cell may be owned by the next periods, so that some have walls only. Of square plant cells::

    top walls only       ┌──┬──┬·
    plant cells          ├──┼──┼·    · right walls only
    (n × m)              ├──┼──┼·
                         └──┴──┴·

Each period is a lane of a tile, called its place: those with plant cells first, then those with
walls only, each group filled up to whole tiles with empty places. A particle that does not exist
lies far away, where it meets no other.

What two cells share is halved where one of them is missing (docs/theory.md, walls at a free
boundary): the mass of a wall particle is its share, (cells present)/(cells that share it), so a
quarter at the corners of square cells. Between plant cells of two types it is the sum of both
shares. `outer_wall` multiplies what is left along the boundary. A uniform fluid's mass is shared
out among the walls around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # scipy.sparse is loaded where a tissue is

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, pack, tiles_for
from surrofe2.plant_cell.arrangement import Arrangement, ReferenceState, make_arrangement, rim_areas
from surrofe2.plant_cell.pair_laws import Constants, make_constants
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import centroid

_ALIKE = (
    "cell_side", "wall_springs_per_side", "fluid_particles_per_side", "repulsion_cutoff",
    "outer_wall", "fluid", "arrangement", "cells", "arrangement_seed", "area_variation",
    "elongation", "elongation_direction",
)  # fmt: skip
"""Fields that all types of plant cells of a tissue must share, so that their walls meet."""

NOWHERE = 1e6
"""Coordinate of particles that do not exist, µm; far beyond every cut-off."""
_APART = 100.0
"""Distance between particles that do not exist, µm, so that these do not meet each other either."""
NONE = -1
"""Type of a plant cell that is missing, and number of a place or particle that is."""


class Members(NamedTuple):
    """Pairs of a particle and a plant cell that it belongs to, of the particles of one period.

    Attributes:
        particle: (k,) own particle of the period.
        cell: (k,) number of the plant cell within its own period.
        shift: (k, 2) columns and rows from the period of that plant cell to the particle's.
    """

    particle: Index
    cell: Index
    shift: Index


class Walls(NamedTuple):
    """Bonds of a period and the two plant cells that each lies between.

    Attributes:
        bonds: (b, 4) particles i and j, columns and rows from i to j. Of the two directions of a
            bond it is the one that does not lead back to earlier columns or rows.
        cell: (b, 2) plant cells on the left and on the right of the way from i to j.
        shift: (b, 2, 2) columns and rows from the periods of these plant cells to that of i.
    """

    bonds: Index
    cell: Index
    shift: Index


@dataclass(frozen=True, slots=True)
class Tissue:
    """Plant cells with single walls at the boundary, and the layout of their particles in tiles.

    Attributes:
        types: types of plant cells.
        references: reference state of each type.
        constants: constants of the pair laws of each type.
        arrangement: arrangement of the plant cells of a period.
        kind: (columns, rows, cells) type of each plant cell of each period, or NONE.
        origin: (2,) column and row of kind[0, 0] in the plane.
        lowest: (2,) column and row of the first place, counted from kind[0, 0].
        column_row: (places, 2) column and row of the period in each lane, counted from the first
            place; NONE for an empty place.
        place: (columns, rows) place of each period, or NONE.
        start: (tiles, 2, own, TILE) positions from the repeated reference state, µm; here and in
            all shapes of this package `own` stands for `particles_per_period`.
        mass: (tiles, own, TILE) ng; 0 where there is no particle.
        walls: number of a period's own wall particles; they come first.
        address: (particles, 3) tile, own particle and lane; walls of all cells, then fluid.
    """

    types: tuple[CellParameters, ...]
    references: tuple[ReferenceState, ...]
    constants: tuple[Constants, ...]
    arrangement: Arrangement
    kind: Index
    origin: Index
    lowest: Index
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
    def particles_per_period(self) -> int:
        """Number of particles that a period owns."""
        return self.start.shape[2]

    @property
    def particles(self) -> int:
        """Number of particles of the whole tissue."""
        return len(self.address)

    @property
    def is_wall(self) -> Flags:
        """True for wall particles, (particles,)."""
        return self.address[:, 1] < self.walls

    @property
    def laid_out(self) -> Array:
        """Places of wall particles as they are laid out, (particles, 2), µm; infinite for fluid.

        They are stretched as the lattice at rest is.
        """
        lattice = self.references[0].lattice
        period = (self.column_row + self.lowest + self.origin) @ lattice.T
        places = np.full((len(period), 2, self.particles_per_period), np.inf)
        walls = self.arrangement.wall_position @ stretch_of(self.arrangement, lattice).T
        places[..., : self.walls] = walls.T + period[:, :, None]
        return self.to_particles(pack(places))

    @property
    def middles(self) -> Array:
        """Middles of plant cells (columns, rows, cells, 2), as `middles_of` has them, µm."""
        return middles_of(self.arrangement, self.references[0], self.origin, self.kind.shape[:2])

    def to_particles(self, tiles: Array) -> Array:
        """Take values out of tiles: (tiles, own, TILE) becomes (particles,).

        (tiles, 2, own, TILE) becomes (particles, 2).
        """
        tile, particle, lane = self.address.T
        return np.ascontiguousarray(tiles[tile, ..., particle, lane])

    def to_tiles(self, values: Array, missing: Array | float = 0.0) -> Array:
        """Put values (particles, 2) into tiles (tiles, 2, own, TILE).

        missing: value where there is no particle.
        """
        tiles = np.empty(self.start.shape)
        tiles[:] = missing
        tile, particle, lane = self.address.T
        tiles[tile, :, particle, lane] = values
        return tiles

    @property
    def number(self) -> Index:
        """Number of each particle (places, own), NONE where there is none."""
        tile, particle, lane = self.address.T
        number = np.full((len(self.column_row), self.particles_per_period), NONE)
        number[tile * TILE + lane, particle] = np.arange(len(self.address))
        return number

    def kinds_at(self, cell: Index, shift: Index) -> Index:
        """Return types (places, …) of plant cells around each place, NONE where there is none.

        They are the plant cells `cell` (…) of the periods `shift` (…, 2) columns and rows before.
        """
        return _kinds_at(self.kind, self.column_row, self.lowest, cell, shift)

    def places_at(self, shift: Index) -> Index:
        """Return the places (places, …) `shift` (…, 2) columns and rows further on, or NONE."""
        column_row = self.column_row.reshape(-1, *np.ones(shift.ndim - 1, int), 2) + shift
        places = _looked_up(self.place, column_row)
        places[self.column_row[:, 0] < 0] = NONE
        return places

    @property
    def fluid_tiles(self) -> int:
        """Number of tiles, the first ones, that have plant cells."""
        return tiles_for(int((self.kind >= 0).any(axis=2).sum()))

    def shares(self, filled: Flags) -> Array:
        """Return which fraction of its plant cells a particle has in `filled`, (places, own).

        Args:
            filled: (columns, rows, cells).
        """
        kind = np.where(filled, 0, NONE)
        return _shares(self.arrangement, kind, self.column_row, self.lowest)

    def bonds(self) -> Index:
        """Return the numbers (b, 2) of particles that wall springs join."""
        i, j, kinds = self._joined()
        return np.stack([i, j], axis=-1)[(kinds >= 0).any(axis=2)]

    def outline(self) -> Index:
        """Return the bonds (k, 2) along the outline, the tissue on their left."""
        i, j, kinds = self._joined()
        pairs = np.stack([i, j], axis=-1)
        has_left = kinds[..., 0] >= 0
        has_right = kinds[..., 1] >= 0
        forth = pairs[has_left & ~has_right]
        back = pairs[has_right & ~has_left]
        return np.concatenate([forth, back[:, ::-1]])

    def _joined(self) -> tuple[Index, Index, Index]:
        """Return the particles i, j (places, b) of all bonds, and the types of cells beside them.

        The types are (places, b, 2), on the left and on the right of the way from i to j.
        """
        walls = walls_of(self.arrangement)
        i, j, *_ = walls.bonds.T
        number = self.number
        place_of_j = self.places_at(walls.bonds[:, 2:])
        number_of_j = np.where(place_of_j >= 0, number[place_of_j, j], NONE)
        return number[:, i], number_of_j, self.kinds_at(walls.cell, walls.shift)


def members_of(arrangement: Arrangement) -> Members:
    """Return the plant cells of all particles: of walls by the rims, of fluid its own."""
    # rows: particle, cell, columns, rows; those of a rim lack the cell
    rows = [np.insert(rim, 1, cell, axis=1) for cell, rim in enumerate(arrangement.rims)]
    counts = np.array(arrangement.fluid_counts, dtype=np.int64)
    fluid = np.zeros((counts.sum(), 4), dtype=np.int64)
    fluid[:, 0] = arrangement.walls + np.arange(len(fluid))
    fluid[:, 1] = np.repeat(np.arange(len(counts)), counts)
    every = np.concatenate([*rows, fluid]).astype(np.int64)
    return Members(every[:, 0], every[:, 1], every[:, 2:])


def walls_of(arrangement: Arrangement) -> Walls:
    """Return the bonds of a period and the plant cells on both sides of each."""
    # Each bond is in two rims, once from i to j, with that plant cell on its left, and once back.
    on_left: dict[tuple[int, ...], tuple[int, ...]] = {}
    on_right: dict[tuple[int, ...], tuple[int, ...]] = {}
    for cell, rim in enumerate(arrangement.rims):
        following = np.roll(rim, -1, axis=0)
        for (i, *shift_i), (j, *shift_j) in zip(rim.tolist(), following.tolist(), strict=True):
            columns = shift_j[0] - shift_i[0]
            rows = shift_j[1] - shift_i[1]
            leads_forth = (columns, rows, j) > (0, 0, i)
            if leads_forth:
                on_left[i, j, columns, rows] = (cell, *shift_i)
            else:
                on_right[j, i, -columns, -rows] = (cell, *shift_j)
    bonds = sorted(on_left)
    sides = np.array([[on_left[bond], on_right[bond]] for bond in bonds])
    return Walls(bonds=np.array(bonds), cell=sides[:, :, 0], shift=sides[:, :, 1:])


def stretch_of(arrangement: Arrangement, lattice: Array) -> Array:
    """Return the stretch (2, 2) that takes the lattice as it is laid out to that at rest."""
    return np.asarray(lattice @ np.linalg.inv(arrangement.tessellation.lattice))


def middles_of(
    arrangement: Arrangement, reference: ReferenceState, origin: Index, periods: Sequence[int]
) -> Array:
    """Return the middles of plant cells (columns, rows, cells, 2), µm.

    They are those as laid out, stretched as the lattice at rest is.

    Args:
        origin: (2,) column and row of the first period.
        periods: numbers of columns and rows.
    """
    tessellation = arrangement.tessellation
    every = range(len(tessellation.polygons))
    within = np.array([centroid(tessellation.corners(k)) for k in every])
    within = within @ stretch_of(arrangement, reference.lattice).T
    columns, rows = periods
    column_row = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1)
    return np.asarray(((column_row + origin) @ reference.lattice.T)[:, :, None] + within)


def make_tissue(
    types: Sequence[CellParameters],
    references: Sequence[ReferenceState],
    kind: Index,
    origin: Sequence[int] = (0, 0),
    arrangement: Arrangement | None = None,
) -> Tissue:
    """Make a tissue whose plant cell c of the period (a, b) is of the type kind[a, b, c].

    Args:
        types: types of plant cells.
        references: reference state of each type, free of stress as part of a tissue.
        kind: (columns, rows, cells), or (columns, rows) of periods with one plant cell; NONE where
            there is no plant cell.
        origin: column and row of kind[0, 0].
        arrangement: arrangement of the plant cells of a period; None: that of the types.

    Raises:
        InputError: a type is not arranged as the first, or not as large or as finely divided.
        MismatchError: a reference is of another cell.
    """
    cell = types[0]
    kind = kind.reshape(*kind.shape[:2], -1)
    for each, reference in zip(types, references, strict=True):
        _check_alike(each, cell)
        reference.check_belongs_to(each)
    if len(types) > 1 and cell.cells > 1 and not cell.has_uniform_fluid:
        raise InputError(
            f"cell.fluid: sph; a tissue of {len(types)} types with {cell.cells} plant cells per "
            "RVE takes a uniform fluid: set it, or take one type"
        )
    arrangement = arrangement or make_arrangement(cell)
    members = members_of(arrangement)
    # walls of a plant cell may be owned by periods around its own
    lowest = np.min(members.shift, axis=0, initial=0)
    highest = np.max(members.shift, axis=0, initial=0)
    shape = np.array(kind.shape[:2]) + highest - lowest
    column_row = _filled_places(arrangement, kind, lowest, shape)
    filled = np.flatnonzero(column_row[:, 0] >= 0)
    place = np.full(shape, NONE)
    place[tuple(column_row[filled].T)] = filled

    walls = arrangement.walls
    per_period = arrangement.particles
    mass = _masses(types, arrangement, members, kind, column_row, lowest)
    types_of = _kinds_at(kind, column_row, lowest, members.cell, members.shift)
    type_of_particle = np.zeros((len(column_row), per_period), dtype=np.int64)
    # a wall between two types starts where that of the first of its plant cells does
    # the first plant cell comes last here, so that it wins
    for row in reversed(range(len(members.particle))):
        is_there = types_of[:, row] >= 0
        type_of_particle[is_there, members.particle[row]] = types_of[is_there, row]
    at_rest = np.stack([reference.position for reference in references])
    shift = (column_row + lowest + np.array(origin)) @ references[0].lattice.T
    start = at_rest[type_of_particle, np.arange(per_period)] + shift[:, None]
    missing = mass == 0.0
    # on the other side than images of nothing, which `dynamics` puts at +NOWHERE
    start[missing] = -NOWHERE - _APART * np.arange(missing.sum())[:, None]
    place_of, particle = np.nonzero(~missing)
    address = np.stack([place_of // TILE, particle, place_of % TILE], axis=1)
    return Tissue(
        types=tuple(types),
        references=tuple(references),
        constants=tuple(
            make_constants(each, reference.rest_length)
            for each, reference in zip(types, references, strict=True)
        ),
        arrangement=arrangement,
        kind=kind,
        origin=np.array(origin),
        lowest=lowest,
        column_row=column_row,
        place=place,
        start=pack(start.swapaxes(1, 2)),
        mass=pack(mass),
        walls=walls,
        address=address[np.argsort(particle >= walls, kind="stable")],
    )


def _filled_places(arrangement: Arrangement, kind: Index, lowest: Index, shape: Index) -> Index:
    """Return column and row (places, 2) of the period in each place, NONE in an empty one.

    Periods with plant cells come first, then those with walls only; each group is filled up to
    whole tiles.

    Args:
        kind, lowest: as of `Tissue`. shape: numbers of columns and rows that may have particles.
    """
    columns, rows = shape
    # row after row, so that neighbouring lanes are neighbouring periods of a row
    every = np.array([(a, b) for b in range(rows) for a in range(columns)])
    cells = np.arange(kind.shape[2])
    no_shift = np.zeros((len(cells), 2), dtype=np.int64)
    has_cells = (_kinds_at(kind, every, lowest, cells, no_shift) >= 0).any(axis=1)
    has_walls = (_shares(arrangement, kind, every, lowest) > 0.0).any(axis=1)
    empty = np.full((TILE, 2), NONE)
    parts = []
    for group in (every[has_cells], every[has_walls & ~has_cells]):
        lacking = -len(group) % TILE
        parts += [group, empty[:lacking]]
    return np.concatenate(parts)


def fluid_masses(cell: CellParameters, arrangement: Arrangement) -> Array:
    """Return the mass of uniform fluid in each plant cell of a period, (cells,), ng.

    It is empty with SPH fluid.
    """
    areas = arrangement.tessellation.areas
    return cell.fluid_density * areas if cell.has_uniform_fluid else np.zeros(0)


def rest_areas(cell: CellParameters, reference: ReferenceState, arrangement: Arrangement) -> Array:
    """Return the area of each plant cell of a period at rest, (cells,), µm²; empty with SPH."""
    rims = arrangement.rims if cell.has_uniform_fluid else ()
    if not rims:
        return np.zeros(0)
    return rim_areas(rims, reference.position, reference.lattice)


def _check_alike(cell: CellParameters, first: CellParameters) -> None:
    """Raise InputError unless two types of plant cells share all that makes their walls meet."""
    for name in _ALIKE:
        value = cell.to_dict()[name]
        value_of_first = first.to_dict()[name]
        if value != value_of_first:
            both = f"{value} and {value_of_first}"
            if not isinstance(value, str):
                both = f"{value:g} and {value_of_first:g}"
            raise InputError(f"cell.{name}: {both}; plant cells of one tissue must share it")


def _masses(
    types: Sequence[CellParameters],
    arrangement: Arrangement,
    members: Members,
    kind: Index,
    column_row: Index,
    lowest: Index,
) -> Array:
    """Return the mass of each particle (places, own), ng; 0 where there is none.

    kind, column_row, lowest: as of `Tissue`.
    """
    is_wall = np.arange(arrangement.particles) < arrangement.walls
    mass = np.zeros((len(column_row), arrangement.particles))
    for k, cell in enumerate(types):
        masses = np.where(is_wall, cell.wall_particle_mass, cell.fluid_mass)
        of_this_type = np.where(kind == k, k, NONE)
        mass += _shares(arrangement, of_this_type, column_row, lowest) * masses
    present = _shares(arrangement, kind, column_row, lowest)
    on_outline = is_wall & (present > 0.0) & (present < 1.0)
    mass[on_outline] *= types[0].outer_wall
    if types[0].has_uniform_fluid:
        walls_around = np.array([len(rim) for rim in arrangement.rims])
        # mass for each wall particle; the last row, which NONE refers to, is of no plant cell
        of_fluid = [fluid_masses(cell, arrangement) / walls_around for cell in types]
        of_fluid.append(np.zeros(len(walls_around)))
        types_of = _kinds_at(kind, column_row, lowest, members.cell, members.shift)
        mass += np.array(of_fluid)[types_of, members.cell] @ _belongs(arrangement, members)
    return mass


def _kinds_at(kind: Index, column_row: Index, lowest: Index, cell: Index, shift: Index) -> Index:
    """Return what `Tissue.kinds_at` does, before there is a `Tissue`."""
    wanted = column_row.reshape(-1, *np.ones(shift.ndim - 1, int), 2) + lowest - shift
    types = _looked_up(kind, wanted, cell)
    types[column_row[:, 0] < 0] = NONE
    return types


def _looked_up(table: Index, column_row: Index, *further: Index) -> Index:
    """Return table[column, row, further], and NONE outside the table; column_row (…, 2)."""
    inside = np.asarray(((column_row >= 0) & (column_row < table.shape[:2])).all(axis=-1))
    column, row = np.moveaxis(np.where(inside[..., None], column_row, 0), -1, 0)
    return np.where(inside, table[(column, row, *further)], NONE)


def _shares(arrangement: Arrangement, kind: Index, column_row: Index, lowest: Index) -> Array:
    """Return, as `Tissue.shares`, which fraction of its plant cells each particle has in `kind`."""
    members = members_of(arrangement)
    is_there = _kinds_at(kind, column_row, lowest, members.cell, members.shift) >= 0
    belongs = _belongs(arrangement, members)
    return np.asarray((is_there @ belongs) / belongs.sum(axis=0))


def _belongs(arrangement: Arrangement, members: Members) -> scipy.sparse.csr_array:
    """Return a matrix (members, own) with a 1 where a member is of that particle.

    Its product with values of members sums them over those of each particle.
    """
    count = len(members.particle)
    rows = np.arange(count)
    entries = np.ones(count), (rows, members.particle)
    return scipy.sparse.csr_array(entries, shape=(count, arrangement.particles))
