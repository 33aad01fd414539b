"""Which plant cells and particles a tissue has, and where they lie in tiles.

A tissue is cut from the RVE's own pattern, repeated: each period may have all of its plant cells,
some or none. A period owns the particles that `plant_cell.arrangement` numbers. Walls around a
plant cell may be owned by the next periods, so that some have walls only. Of square plant cells::

    top walls only       ┌──┬──┬·
    plant cells          ├──┼──┼·    · right walls only
    (n × m)              ├──┼──┼·
                         └──┴──┴·

Periods are lanes of tiles, called places: those with plant cells first, then those with walls only,
each group filled up to whole tiles with empty places. A particle that does not exist lies far away,
where it meets no one.

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
"""What all types of plant cells of a tissue must share, so that their walls meet."""

NOWHERE = 1e6
"""Where particles lie that do not exist, µm; far beyond every cut-off."""


class Members(NamedTuple):
    """Plant cells that the particles of a period belong to.

    Attributes:
        particle: (k,) own. cell: (k,) number within its period.
        shift: (k, 2) a particle at a place belongs to that plant cell of the period so many columns
            and rows before.
    """

    particle: Index
    cell: Index
    shift: Index


class Walls(NamedTuple):
    """Bonds of a period and the two plant cells that each lies between.

    Attributes:
        bonds: (b, 4) i, j, columns and rows from i to j, of two opposite ways the one that does not
            lead back.
        cell: (b, 2) plant cells on the left and on the right of the way from i to j.
        shift: (b, 2, 2) as of `Members`, seen from the place of i.
    """

    bonds: Index
    cell: Index
    shift: Index


@dataclass(frozen=True, slots=True)
class Tissue:
    """Plant cells with single walls at the boundary.

    Attributes:
        types: of plant cells; references: their reference states; constants: of their pair laws.
        arrangement: of the plant cells of a period.
        kind: (columns, rows, cells) type of each plant cell of each period, −1 where there is none.
        origin: (2,) column and row of kind[0, 0] in the plane.
        lowest: (2,) column and row of the first place, counted from there.
        column_row: (places, 2) of the period in each lane, from the first, −1 for an empty place.
        place: (columns, rows) the place of each, −1 where there is none.
        start: (tiles, 2, own, TILE) positions from the repeated reference state, µm.
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
    def own(self) -> int:
        """Number of particles that a period owns."""
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
    def laid_out(self) -> Array:
        """(particles, 2) where wall particles are laid out, stretched as the lattice at rest is,
        µm; infinite for fluid."""
        lattice = self.references[0].lattice
        at = (self.column_row + self.lowest + self.origin) @ lattice.T
        places = np.full((len(at), 2, self.own), np.inf)
        walls = self.arrangement.wall_position @ stretch_of(self.arrangement, lattice).T
        places[..., : self.walls] = walls.T + at[:, :, None]
        return self.to_particles(pack(places))

    @property
    def middles(self) -> Array:
        """(columns, rows, cells, 2) middles of plant cells, as `middles_of` has them, µm."""
        return middles_of(self.arrangement, self.references[0], self.origin, self.kind.shape[:2])

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

    @property
    def number(self) -> Index:
        """(places, own) number of each particle, −1 where there is none."""
        tile, own, lane = self.address.T
        number = np.full((len(self.column_row), self.own), -1)
        number[tile * TILE + lane, own] = np.arange(len(self.address))
        return number

    def kinds_at(self, cell: Index, shift: Index) -> Index:
        """(places, …) type of the plant cells `cell` (…) in the periods `shift` (…, 2) before each
        place, −1 where there is none."""
        return _kinds_at(self.kind, self.column_row, self.lowest, cell, shift)

    def places_at(self, shift: Index) -> Index:
        """(places, …) places `shift` (…, 2) columns and rows further, −1 where there is none."""
        at = self.column_row.reshape(-1, *np.ones(shift.ndim - 1, int), 2) + shift
        found = _looked_up(self.place, at)
        found[self.column_row[:, 0] < 0] = -1
        return found

    @property
    def fluid_tiles(self) -> int:
        """How many tiles, the first ones, have plant cells."""
        return tiles_for(int((self.kind >= 0).any(axis=2).sum()))

    def shares(self, filled: Flags) -> Array:
        """(places, own) part of a particle that plant cells `filled` have; 0 where none has.

        Args:
            filled: (columns, rows, cells).
        """
        kind = np.where(filled, 0, -1)
        return _shares(self.arrangement, kind, self.column_row, self.lowest)

    def bonds(self) -> Index:
        """(b, 2) numbers of the particles that wall springs join."""
        i, j, kinds = self._joined()
        return np.stack([i, j], axis=-1)[(kinds >= 0).any(axis=2)]

    def outline(self) -> Index:
        """(k, 2) bonds along the outline, the tissue on their left."""
        i, j, kinds = self._joined()
        pairs = np.stack([i, j], axis=-1)
        is_filled = kinds >= 0
        forth = pairs[is_filled[..., 0] & ~is_filled[..., 1]]
        back = pairs[is_filled[..., 1] & ~is_filled[..., 0]]
        return np.concatenate([forth, back[:, ::-1]])

    def _joined(self) -> tuple[Index, Index, Index]:
        """(places, b) particles of each bond, (places, b, 2) types of the cells on both sides."""
        walls = walls_of(self.arrangement)
        number = self.number
        there = self.places_at(walls.bonds[:, 2:])
        j = np.where(there >= 0, number[there, walls.bonds[:, 1]], -1)
        return number[:, walls.bonds[:, 0]], j, self.kinds_at(walls.cell, walls.shift)


def members_of(arrangement: Arrangement) -> Members:
    """The plant cells of all particles: walls by the rims, fluid by its plant cell."""
    rows = [np.insert(rim, 1, cell, axis=1) for cell, rim in enumerate(arrangement.rims)]
    counts = np.array(arrangement.fluid_counts, dtype=np.int64)
    fluid = np.zeros((counts.sum(), 4), dtype=np.int64)
    fluid[:, 0] = arrangement.walls + np.arange(len(fluid))
    fluid[:, 1] = np.repeat(np.arange(len(counts)), counts)
    every = np.concatenate([*rows, fluid]).astype(np.int64)
    return Members(every[:, 0], every[:, 1], every[:, 2:])


def walls_of(arrangement: Arrangement) -> Walls:
    """Bonds and the plant cells on both sides of each."""
    sides: dict[tuple[int, ...], dict[int, tuple[int, ...]]] = {}
    # Two rims have each bond: on the left of its way from i to j, and on the right, the other way.
    for cell, rim in enumerate(arrangement.rims):
        for (i, *s), (j, *t) in zip(rim.tolist(), np.roll(rim, -1, axis=0).tolist(), strict=True):
            forth = (t[0] - s[0], t[1] - s[1], j) > (0, 0, i)
            way = (t[0] - s[0], t[1] - s[1]) if forth else (s[0] - t[0], s[1] - t[1])
            bond = (i, j, *way) if forth else (j, i, *way)
            sides.setdefault(bond, {})[0 if forth else 1] = (cell, *(s if forth else t))
    bonds = sorted(sides)
    every = np.array([[sides[bond][0], sides[bond][1]] for bond in bonds])
    return Walls(np.array(bonds), every[:, :, 0], every[:, :, 1:])


def stretch_of(arrangement: Arrangement, lattice: Array) -> Array:
    """(2, 2) by which the lattice as it is laid out has become that at rest."""
    return np.asarray(lattice @ np.linalg.inv(arrangement.tessellation.lattice))


def middles_of(
    arrangement: Arrangement, reference: ReferenceState, origin: Index, periods: Sequence[int]
) -> Array:
    """(columns, rows, cells, 2) middles of plant cells, laid out and stretched as the lattice at
    rest is, µm, from column and row `origin` on."""
    tessellation = arrangement.tessellation
    every = range(len(tessellation.polygons))
    within = np.array([centroid(tessellation.corners(k)) for k in every])
    columns, rows = periods
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1)
    within = within @ stretch_of(arrangement, reference.lattice).T
    return np.asarray(((at + origin) @ reference.lattice.T)[:, :, None] + within)


def make_tissue(
    types: Sequence[CellParameters],
    references: Sequence[ReferenceState],
    kind: Index,
    origin: Sequence[int] = (0, 0),
    arrangement: Arrangement | None = None,
) -> Tissue:
    """A tissue whose plant cell c of the period (a, b) is of the type kind[a, b, c].

    Args:
        references: of each type, free of stress as part of a tissue.
        kind: (columns, rows, cells), or (columns, rows) of periods with one plant cell; −1: none.
        origin: column and row of kind[0, 0].
        arrangement: of the plant cells of a period; None: that of the types.

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
    lowest, highest = (of(members.shift, axis=0, initial=0) for of in (np.min, np.max))
    shape = np.array(kind.shape[:2]) + highest - lowest
    # rows of periods run along the lanes
    every = np.array([(a, b) for b in range(shape[1]) for a in range(shape[0])])
    cells = np.arange(kind.shape[2])
    here = _kinds_at(kind, every, lowest, cells, np.zeros((len(cells), 2), dtype=np.int64))
    has_cells = (here >= 0).any(axis=1)
    has_walls = (_shares(arrangement, kind, every, lowest) > 0.0).any(axis=1)
    groups = every[has_cells], every[has_walls & ~has_cells]
    empty = np.full((TILE, 2), -1)
    column_row = np.concatenate(
        [each for group in groups for each in (group, empty[: -len(group) % TILE])]
    )
    filled = np.flatnonzero(column_row[:, 0] >= 0)
    place = np.full(shape, -1)
    place[tuple(column_row[filled].T)] = filled

    walls = arrangement.walls
    own = arrangement.particles
    mass = _masses(types, arrangement, members, kind, column_row, lowest)
    types_of = _kinds_at(kind, column_row, lowest, members.cell, members.shift)
    of_place = np.zeros((len(column_row), own), dtype=np.int64)
    # a wall between two types starts where that of the first of its plant cells does
    for row in reversed(range(len(members.particle))):
        is_there = types_of[:, row] >= 0
        of_place[is_there, members.particle[row]] = types_of[is_there, row]
    at_rest = np.stack([reference.position for reference in references])
    shift = (column_row + lowest + np.array(origin)) @ references[0].lattice.T
    start = at_rest[of_place, np.arange(own)] + shift[:, None]
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


def fluid_masses(cell: CellParameters, arrangement: Arrangement) -> Array:
    """(cells,) uniform fluid of the plant cells of a period, ng; none with SPH."""
    areas = arrangement.tessellation.areas
    return cell.fluid_density * areas if cell.has_uniform_fluid else np.zeros(0)


def rest_areas(cell: CellParameters, reference: ReferenceState, arrangement: Arrangement) -> Array:
    """(cells,) areas of the plant cells of a period at rest, µm²; none with SPH."""
    rims = arrangement.rims if cell.has_uniform_fluid else ()
    if not rims:
        return np.zeros(0)
    return rim_areas(rims, reference.position, reference.lattice)


def _check_alike(cell: CellParameters, first: CellParameters) -> None:
    for name in _ALIKE:
        here = cell.to_dict()[name]
        there = first.to_dict()[name]
        if here != there:
            both = f"{here} and {there}" if isinstance(here, str) else f"{here:g} and {there:g}"
            raise InputError(f"cell.{name}: {both}; plant cells of one tissue must share it")


def _masses(
    types: Sequence[CellParameters],
    arrangement: Arrangement,
    members: Members,
    kind: Index,
    column_row: Index,
    lowest: Index,
) -> Array:
    """(places, own) ng."""
    is_wall = np.arange(arrangement.particles) < arrangement.walls
    mass = np.zeros((len(column_row), arrangement.particles))
    for k, each in enumerate(types):
        masses = np.where(is_wall, each.wall_particle_mass, each.fluid_mass)
        mass += _shares(arrangement, np.where(kind == k, k, -1), column_row, lowest) * masses
    whole = _shares(arrangement, kind, column_row, lowest)
    on_outline = is_wall & (whole > 0.0) & (whole < 1.0)
    mass[on_outline] *= types[0].outer_wall
    if types[0].has_uniform_fluid:
        around = np.array([len(rim) for rim in arrangement.rims])
        nothing = np.zeros(len(around))  # where there is no plant cell
        of_fluid = np.array(
            [*(fluid_masses(each, arrangement) / around for each in types), nothing]
        )
        here = _kinds_at(kind, column_row, lowest, members.cell, members.shift)
        mass += of_fluid[here, members.cell] @ _belongs(arrangement, members)
    return mass


def _kinds_at(kind: Index, column_row: Index, lowest: Index, cell: Index, shift: Index) -> Index:
    """See `Tissue.kinds_at`."""
    at = column_row.reshape(-1, *np.ones(shift.ndim - 1, int), 2) + lowest - shift
    found = _looked_up(kind, at, cell)
    found[column_row[:, 0] < 0] = -1
    return found


def _looked_up(table: Index, at: Index, *further: Index) -> Index:
    """table[at, further], −1 outside; `at` (…, 2)."""
    inside = np.asarray(((at >= 0) & (at < table.shape[:2])).all(axis=-1))
    a, b = np.moveaxis(np.where(inside[..., None], at, 0), -1, 0)
    return np.where(inside, table[(a, b, *further)], -1)


def _shares(arrangement: Arrangement, kind: Index, column_row: Index, lowest: Index) -> Array:
    """See `Tissue.shares`."""
    members = members_of(arrangement)
    is_there = _kinds_at(kind, column_row, lowest, members.cell, members.shift) >= 0
    belongs = _belongs(arrangement, members)
    return np.asarray((is_there @ belongs) / belongs.sum(axis=0))


def _belongs(arrangement: Arrangement, members: Members) -> scipy.sparse.csr_array:
    """(members, own) 1 where a member is of that particle."""
    count = len(members.particle)
    at = np.arange(count), members.particle
    return scipy.sparse.csr_array((np.ones(count), at), shape=(count, arrangement.particles))
