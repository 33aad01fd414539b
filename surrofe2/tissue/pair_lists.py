"""Pairs of particles of a tissue that interact, their constants, and lists of those near now.

A pair kind is (i, j, shift): own particle i of any period with own particle j of the period `shift`
columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice. Wall
particles a spring apart are bonded; all others touch, and SPH fluid touches the walls around its
own cell. Pairs on one straight wall share that wall (docs/theory.md, walls at a free boundary).

A wall between two plant cells has the sum of both halves: mean stiffness and damping, and the rest
length Σ k l₀/Σ k at which both balance. A wall particle has the mean repulsion and contact damping
of the plant cells around it, and a contact the mean of its two particles. FE² knows no walls of two
types: there each type begins where the other ends.

A pair kind is listed for a tile if in any of its lanes the two particles are within the list's
reach: the cut-off and a skin. Partners in other periods become images, local particles that follow
the own ones; they are gathered before forces are summed, and what they feel is folded back to their
owners by a list that each owner reads alone, so that threads never meet. Walls around plant cells
of a uniform fluid are always among them.

With ū the mean displacement of a period's own particles since the listing, and d the largest
|u − ū| anywhere, particles of neighbouring periods A and B have moved against one another by at
most 2 d + |ū_B − ū_A|. While that is within the skin everywhere, and as particles of periods k
columns or rows apart are listed up to the cut-off and k skins, no unlisted pair is within the
cut-off.
"""

from __future__ import annotations

from collections import namedtuple
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy  # scipy.spatial is loaded where a tissue is
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import pair_law
from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import TILE, load, pack, unpack
from surrofe2.plant_cell.arrangement import Arrangement
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.tissue.layout import (
    Members,
    Tissue,
    Walls,
    fluid_masses,
    members_of,
    rest_areas,
    walls_of,
)

RINGS = 2
"""Most columns or rows between two periods whose particles may interact."""
_NO_LINE = -1
"""Row of `Lines` of a contact that is not along a straight wall."""
_NO_WALL = -1
"""Number of the wall of a bond along which walls may not bend."""
_STRAIGHT = 1e-6
"""Sine of the angle below which two bonds are one straight wall."""
_NOT_ZERO = 1e-60
"""Least stiffness by which is divided."""
_REPULSION = Constants._fields.index("repulsion")
_DAMPING = Constants._fields.index("contact_damping")
"""Columns of a table of `Constants`."""


def _shifts() -> Index:
    """Return columns and rows (s, 2) up to `RINGS`: (0, 0), others that do not lead back, the rest.

    A shift leads back if it is to an earlier column, or to an earlier row of the same one.
    """
    around = range(-RINGS, RINGS + 1)
    every = sorted(product(around, around))
    ahead = [shift for shift in every if shift >= (0, 0)]
    back = [shift for shift in every if shift < (0, 0)]
    return np.array(ahead + back)


SHIFTS = _shifts()
_RINGS_OF = abs(SHIFTS).max(axis=1)
_AHEAD = len(SHIFTS) // 2 + 1
"""Number of `SHIFTS`, the first ones, that do not lead back."""
_NUMBER = np.empty((2 * RINGS + 1, 2 * RINGS + 1), dtype=np.int64)
# a shift to its index, by column and row counted from −RINGS
_NUMBER[tuple((SHIFTS + RINGS).T)] = np.arange(len(SHIFTS))


def number_of(shift: Index) -> Index:
    """Return the index into `SHIFTS` of shifts (…, 2)."""
    return np.asarray(_NUMBER[tuple(np.moveaxis(shift + RINGS, -1, 0))])


def _lead_back(shift: Index) -> Flags:
    """Return (k,) whether shifts (k, 2) lead back, see `_shifts`."""
    columns, rows = shift.T
    return np.asarray((columns < 0) | ((columns == 0) & (rows < 0)))


class Lines(NamedTuple):
    """Contacts along straight walls, and the plant cells on both sides of these walls.

    Attributes:
        key: (k,) `PairKinds.key` of each contact, ascending.
        row: (k,) row of each contact in `cell` and `shift`.
        cell: (rows, 2) plant cells on both sides.
        shift: (rows, 2, 2) columns and rows from their periods to that of the contact's particle i.
    """

    key: Index
    row: Index
    cell: Index
    shift: Index


class _Step(NamedTuple):
    """A bond as a step from one particle to another.

    to: the other particle. shift: columns and rows to its period.
    bond: number of the bond. base: columns and rows to the period that the bond is numbered in.
    """

    to: int
    shift: tuple[int, int]
    bond: int
    base: tuple[int, int]


class PairKinds:
    """Pair kinds that are bonds, contacts along straight walls, or fluid with walls around it.

    Attributes:
        bonds: (b, 3) i, j and index into `SHIFTS` of each bond, ascending.
        walls: the plant cells on both sides of each bond.
        lines: contacts along straight walls.
    """

    def __init__(self, arrangement: Arrangement) -> None:
        self._own = arrangement.particles
        walls = walls_of(arrangement)
        i, j, columns, rows = walls.bonds.T
        bonds = np.stack([i, j, number_of(np.stack([columns, rows], axis=1))], axis=1)
        order = np.lexsort((bonds[:, 2], j, i))
        self.bonds = bonds[order]
        self.walls = Walls(walls.bonds[order], walls.cell[order], walls.shift[order])
        self._bonded = np.sort(self.key(*self.bonds.T))
        self._touching = self._fluid_with_walls(members_of(arrangement), arrangement)
        self.lines = self._straight(arrangement)

    def key(self, i: Index, j: Index, shift: Index) -> Index:
        """Return a number for each pair kind; `shift` is an index into `SHIFTS`."""
        return (i * self._own + j) * len(SHIFTS) + shift

    def are_bonds(self, key: Index) -> Flags:
        """Return (k,) whether pair kinds are bonds."""
        return _is_among(key, self._bonded)

    def may_touch(self, key: Index) -> Flags:
        """Return (k,) whether pair kinds of fluid and wall are of one plant cell."""
        return _is_among(key, self._touching)

    def line(self, key: Index) -> Index:
        """Return (k,) the row of `Lines` of pair kinds, `_NO_LINE` off straight walls."""
        if not len(self.lines.key):
            return np.full(len(key), _NO_LINE)
        # a key behind all others finds no place; the last one stands in, and is not equal
        nearest = np.minimum(np.searchsorted(self.lines.key, key), len(self.lines.key) - 1)
        return np.where(self.lines.key[nearest] == key, self.lines.row[nearest], _NO_LINE)

    def _fluid_with_walls(self, members: Members, arrangement: Arrangement) -> Index:
        """Return the keys of all pairs of a fluid particle with a wall around it, ascending."""
        is_wall = members.particle < arrangement.walls
        keys = [np.empty(0, dtype=np.int64)]
        for cell in range(len(arrangement.fluid_counts)):
            is_of_cell = members.cell == cell
            fluid = members.particle[~is_wall & is_of_cell][:, None]
            wall = members.particle[is_wall & is_of_cell]
            shift = members.shift[is_wall & is_of_cell]
            # the particle whose shift to the other does not lead back comes first
            back = _lead_back(shift)
            forth = ~back
            keys.append(self.key(fluid, wall[forth], number_of(shift[forth])).ravel())
            keys.append(self.key(wall[back], fluid, number_of(-shift[back])).ravel())
        return np.sort(np.concatenate(keys))

    def _straight(self, arrangement: Arrangement) -> Lines:
        """Return the contacts along straight walls: from each particle along bonds in one line."""
        position = arrangement.wall_position
        lattice = arrangement.tessellation.lattice
        wall = self._wall_of(arrangement)
        steps: dict[int, list[_Step]] = {}
        for bond, (i, j, a, b) in enumerate(self.walls.bonds.tolist()):
            steps.setdefault(i, []).append(_Step(j, (a, b), bond, (0, 0)))
            steps.setdefault(j, []).append(_Step(i, (-a, -b), bond, (-a, -b)))
        # a row for each bond (and period) with which such a wall begins
        rows: dict[tuple[int, int, int], int] = {}
        row_of_contact: dict[int, int] = {}
        for i, first_steps in steps.items():
            for first in first_steps:
                direction = position[first.to] + lattice @ first.shift - position[i]
                for j, shift in _ahead(steps, position, lattice, wall, first, direction):
                    # the other direction of this pair is met from j
                    if (shift, j) > ((0, 0), i):
                        row = rows.setdefault((first.bond, *first.base), len(rows))
                        number = number_of(np.array(shift))
                        key = int(self.key(np.array(i), np.array(j), number))
                        row_of_contact[key] = row
        keys = np.array(sorted(row_of_contact), dtype=np.int64)
        row_of_key = np.array([row_of_contact[key] for key in keys.tolist()], dtype=np.int64)
        first_bonds = np.array([*rows], dtype=np.int64).reshape(-1, 3)
        bonds = first_bonds[:, 0]
        base = first_bonds[:, None, 1:]
        return Lines(
            key=keys,
            row=row_of_key,
            cell=self.walls.cell[bonds],
            shift=self.walls.shift[bonds] - base,
        )

    def _wall_of(self, arrangement: Arrangement) -> list[int]:
        """Return the number of the wall along which each bond may bend, or `_NO_WALL`."""
        if arrangement.wall_of_bond is None:
            return [_NO_WALL] * len(self.bonds)
        ends = map(tuple, arrangement.bonds[:, :2].tolist())
        wall = dict(zip(ends, arrangement.wall_of_bond.tolist(), strict=True))
        return [wall[i, j] for i, j in self.bonds[:, :2].tolist()]


def _ahead(
    steps: dict[int, list[_Step]],
    position: Array,
    lattice: Array,
    wall: list[int],
    first: _Step,
    direction: Array,
) -> list[tuple[int, tuple[int, int]]]:
    """Return the particles and shifts that a wall leads to beyond its first bond, within `RINGS`.

    A wall leads on where it is straight, and along a wall of an image where it bends, too.

    Args:
        steps: bonds from each particle.
        wall: wall of each bond, see `PairKinds._wall_of`.
        direction: (2,) vector along the first bond, µm.
    """
    along: list[tuple[int, tuple[int, int]]] = []
    bond = first.bond
    particle = first.to
    shift = first.shift
    while True:
        for step in steps[particle]:
            vector = position[step.to] + lattice @ step.shift - position[particle]
            turn = direction[0] * vector[1] - direction[1] * vector[0]
            size = np.linalg.norm(direction) * np.linalg.norm(vector)
            is_straight = direction @ vector > 0.0 and abs(turn) < _STRAIGHT * size
            is_other_bond = step.bond != bond
            bends = is_other_bond and wall[bond] != _NO_WALL and wall[step.bond] == wall[bond]
            if is_straight or bends:
                bond = step.bond
                particle = step.to
                shift = (shift[0] + step.shift[0], shift[1] + step.shift[1])
                break
        else:
            return along
        # a straight wall through all periods would have no end, and come back to its beginning
        if max(abs(shift[0]), abs(shift[1])) > RINGS or (particle, shift) in along:
            return along
        along.append((particle, shift))


def _is_among(key: Index, ascending: Index) -> Flags:
    """Return (k,) whether keys are among ascending ones."""
    if not len(ascending):
        return np.zeros(len(key), dtype=np.bool_)
    nearest = np.minimum(np.searchsorted(ascending, key), len(ascending) - 1)
    return np.asarray(ascending[nearest] == key)


Factors = tuple[float, float]
"""Factors on the elastic and on the damping part of all forces between particles."""
WHOLE: Factors = (1.0, 1.0)
ELASTIC: Factors = (1.0, 0.0)
DAMPING: Factors = (0.0, 1.0)


class PairConstants(NamedTuple):
    """Constants of all listed pairs, lanes last, with the weights of walls on the boundary.

    Attributes:
        bonds: (bonds, 3, TILE) a `Bond` each.
        contacts: (rows, 2, TILE) repulsion and contact damping.
        row: (contacts,) row of each contact; contacts that are alike share one, which then stays in
            the processor's cache.
        fluid: (tiles, 4, TILE) `FluidConstants`; (1, 4, TILE) for all if there is one type of cell.
        sap: (tiles, cells, 6, TILE) a `Sap` for each plant cell.
        cutoff: distance beyond which contacts exert no force, µm.
    """

    bonds: Array
    contacts: Array
    row: Index
    fluid: Array
    sap: Array
    cutoff: float

    def times(self, factors: Factors) -> PairConstants:
        """Return the constants with factors on elastic ones and on those of dashpots, viscosity."""
        # one row for each field of `Bond`, `Contact`, `FluidConstants` and `Sap`; where an elastic
        # force is a product of two constants, one of them takes the factor
        elastic, damping = factors
        return self._replace(
            bonds=self.bonds * np.array([[elastic], [1.0], [damping]]),
            contacts=self.contacts * np.array([[elastic], [damping]]),
            fluid=self.fluid * np.array([[1.0], [1.0], [elastic], [damping]]),
            sap=self.sap * np.array([[1.0], [elastic], [elastic], [1.0], [damping], [1.0]]),
        )


# Constants as pair laws take them, every field as lanes: of a bond, of a contact, and of the SPH
# fluid in a tile. Their names are those of `pair_laws.Constants`.
Bond = namedtuple("Bond", "wall_stiffness rest_length wall_damping")
Contact = namedtuple("Contact", "repulsion contact_damping cutoff")
FluidConstants = namedtuple(
    "FluidConstants", "smoothing_length fluid_mass sound_speed_squared viscosity"
)
# Constants of the uniform fluid of a plant cell; `is_there` is 1, or 0 where the cell is missing.
Sap = namedtuple("Sap", "fluid_mass sound_speed_squared sap_modulus rest_area viscosity is_there")


@pair_law
def bond_at(rows, k):
    """Return the `Bond` of row k of `PairConstants.bonds`."""
    return Bond(load(rows, k, 0), load(rows, k, 1), load(rows, k, 2))


@pair_law
def contact_at(constants, k):
    """Return the `Contact` of the listed contact k."""
    rows = constants.contacts
    row = constants.row[k]
    return Contact(load(rows, row, 0), load(rows, row, 1), constants.cutoff)


@pair_law
def fluid_at(rows, t):
    """Return the `FluidConstants` of row t of `PairConstants.fluid`."""
    return FluidConstants(load(rows, t, 0), load(rows, t, 1), load(rows, t, 2), load(rows, t, 3))


@pair_law
def sap_at(rows, t, c):
    """Return the `Sap` of plant cell c of tile t, of `PairConstants.sap`."""
    return Sap(
        load(rows, t, c, 0), load(rows, t, c, 1), load(rows, t, c, 2), load(rows, t, c, 3),
        load(rows, t, c, 4), load(rows, t, c, 5),
    )  # fmt: skip


class Cells(NamedTuple):
    """Periods and their neighbours, as far as no list of pairs changes them.

    Attributes:
        place: (tiles, shifts, TILE) place of the period at each of `SHIFTS`, or −1.
        next_shifts: indices of the shifts to the next column or row, one of two opposite ones.
        exists: (tiles, own, TILE) 1.0 where there is a particle, else 0.
        per_count: (tiles, TILE) 1/(number of own particles), or 0 where there is none.
        particles, walls: number of own particles, and of walls, which come first among them.
        fluid_pairs: (·, 2) pairs of SPH particles in one plant cell.
        rim_start: (cells + 1,) where the walls around each plant cell of a period begin in
            `PairLists.rim`; (1,) with SPH fluid.
        fluid_tiles: number of tiles, the first ones, that have fluid.
        order: (tiles,) order in which threads take the tiles: those with and without fluid are
            evenly mixed, so that equal parts take equal time.
        skin: distance that particles of neighbouring periods may move against one another, µm.
    """

    place: Index
    next_shifts: Index
    exists: Array
    per_count: Array
    particles: int
    walls: int
    fluid_pairs: NDArray[np.int32]
    rim_start: Index
    fluid_tiles: int
    order: Index
    skin: float


OF_IMAGES, OF_BONDS, OF_CONTACTS, OF_FOLDS = range(4)
"""Columns of `PairLists.starts`."""


class PairLists(NamedTuple):
    """Lists of images, bonds, contacts and folds, each with those of all tiles one after another.

    Entries of tile t are starts[t, COLUMN] to starts[t + 1, COLUMN], with a column for each list:
    OF_IMAGES, OF_BONDS, OF_CONTACTS, OF_FOLDS. Flat indices are into arrays
    (tiles + 1, 2, local, TILE), to x components.

    Attributes:
        starts: (tiles + 1, 4) where the entries of each tile begin.
        source: (images, TILE) flat index of the owner of each image.
        bonds, contacts: (·, 2) local particles.
        rim: (fluid tiles, ·) local particles around the plant cells with a uniform fluid.
        fold: (folds,) own particle to which the force on an image is added.
        fold_source: (folds, TILE) flat index of this force.
        local: most local particles of a tile.
    """

    starts: Index
    source: Index
    bonds: NDArray[np.int32]
    contacts: NDArray[np.int32]
    rim: NDArray[np.int32]
    fold: Index
    fold_source: Index
    local: int


class _Contacts(NamedTuple):
    """Listed contacts, (k,) each.

    tile: tile of a contact. i, j: own particles. shift: index into `SHIFTS` of the period of j.
    line: row of `Lines`, or `_NO_LINE`.
    """

    tile: Index
    i: Index
    j: Index
    shift: Index
    line: Index


class PairLister:
    """Maker of `PairLists` for one tissue, and of the constants of their pairs.

    Args:
        skin: distance beyond the cut-off up to which pairs of neighbouring periods are listed, µm.
    """

    def __init__(self, tissue: Tissue, skin: float) -> None:
        self._tissue = tissue
        self._skin = skin
        self._kinds = PairKinds(tissue.arrangement)
        place = tissue.places_at(SHIFTS)
        exists = (tissue.mass > 0.0).astype(np.float64)
        counts = np.array(tissue.arrangement.fluid_counts, dtype=np.int64)
        first = tissue.walls + np.append(0, np.cumsum(counts))
        fluid_pairs = [
            start + np.stack(np.triu_indices(count, 1), axis=1)
            for start, count in zip(first, counts, strict=False)
        ]
        fluid_tiles = tissue.fluid_tiles
        # each group of tiles is spread evenly over (0, 1); sorted, the two are mixed
        positions = []
        for count in (fluid_tiles, tissue.tiles - fluid_tiles):
            positions.append((np.arange(count) + 0.5) / max(count, 1))
        rims = tissue.arrangement.rims if tissue.cell.has_uniform_fluid else ()
        around = np.concatenate([np.empty((0, 3), dtype=np.int64), *rims])
        self._around = around[:, 0]
        self._around_shift = number_of(around[:, 1:])
        self.cells = Cells(
            place=pack(place),
            next_shifts=np.flatnonzero((_RINGS_OF == 1) & (np.arange(len(SHIFTS)) < _AHEAD)),
            exists=exists,
            per_count=exists.any(axis=1) / np.maximum(exists.sum(axis=1), 1.0),
            particles=tissue.particles_per_period,
            walls=tissue.walls,
            fluid_pairs=np.concatenate([np.empty((0, 2)), *fluid_pairs]).astype(np.int32),
            rim_start=np.cumsum([0, *map(len, rims)]),
            fluid_tiles=fluid_tiles,
            order=np.argsort(np.concatenate(positions), kind="stable"),
            skin=skin,
        )
        self._set_constants()

    def _set_constants(self) -> None:
        """Set all constants that do not depend on which contacts are listed."""
        tissue = self._tissue
        kinds = self._kinds
        # one more type, the last, for plant cells that are not there: NONE refers to it
        table = np.array([*tissue.constants, np.zeros(len(Constants._fields))])
        by_name = dict(zip(Constants._fields, table.T, strict=True))
        self._set_bonds(by_name)
        # Weights of contacts along straight walls, ½ `outer_wall` on the boundary, (lines + 1,
        # tiles, TILE). The last row is for all others: `_NO_LINE` refers to it.
        beside = tissue.kinds_at(kinds.lines.cell, kinds.lines.shift)
        along = np.where((beside >= 0).all(axis=2), 1.0, 0.5 * tissue.cell.outer_wall)
        weight = np.append(along, np.ones_like(along[:, :1]), axis=1)
        self._weight = weight.T.reshape(-1, tissue.tiles, TILE)
        cells = np.arange(tissue.kind.shape[2])
        kinds_of_cells = tissue.kinds_at(cells, np.zeros((len(cells), 2), dtype=np.int64))
        # places without fluid get constants of some, so that kernels may divide
        some_kind = np.maximum(kinds_of_cells.max(axis=1), 0)
        fluid = np.stack([by_name[name][some_kind] for name in FluidConstants._fields], axis=1)
        self._fluid = pack(fluid if len(tissue.types) > 1 else fluid[:TILE])
        self._sap = self._saps(kinds_of_cells, by_name)
        # repulsion and contact damping of particles, (places, own, 2): the mean of their cells
        shares = [tissue.shares(tissue.kind == k) for k in range(len(tissue.types))]
        part = np.stack(shares, axis=2)
        part[part.sum(axis=2) == 0.0] = 1.0  # particles that do not exist get constants, too
        part /= part.sum(axis=2, keepdims=True)
        self._particles = part @ table[:-1, [_REPULSION, _DAMPING]]

    def _set_bonds(self, by_name: dict[str, Array]) -> None:
        """Set the constants of bonds: the sum of both halves, or one half times `outer_wall`.

        by_name: constants by name, one for each type, then 0 where there is no plant cell.
        """
        tissue = self._tissue
        walls = self._kinds.walls
        both = tissue.kinds_at(walls.cell, walls.shift)  # (places, bonds, 2)
        half = 0.5 * np.where((both >= 0).all(axis=2), 1.0, tissue.cell.outer_wall)
        stiffness = by_name["wall_stiffness"][both]
        total = stiffness.sum(axis=2)
        rest = (stiffness * by_name["rest_length"][both]).sum(axis=2)
        rest = rest / np.maximum(total, _NOT_ZERO)
        damping = by_name["wall_damping"][both].sum(axis=2)
        # a longer piece of the same wall is softer, and its rest length is longer
        relative = self._relative_lengths()
        total = total / relative
        rest = rest * relative
        damping = damping / relative
        bonds = pack(np.stack([half * total, rest, half * damping], axis=2))
        self._bond_tile, self._bond = np.nonzero((bonds[:, :, 0] > 0.0).any(axis=2))
        self._bonds = np.ascontiguousarray(bonds[self._bond_tile, self._bond])

    def _relative_lengths(self) -> Array:
        """Return the length of each spring over that of a straight wall, (bonds,).

        It is 1 unless walls follow the outlines of an image.
        """
        arrangement = self._tissue.arrangement
        bonds = self._kinds.bonds
        if arrangement.wall_of_bond is None:
            return np.ones(len(bonds))
        i, j = bonds[:, :2].T
        vectors = arrangement.wall_position[j] - arrangement.wall_position[i]
        return np.linalg.norm(vectors, axis=1) / self._tissue.cell.spring_length

    def _saps(self, kind: Index, by_name: dict[str, Array]) -> Array:
        """Return a `Sap` for each plant cell of types `kind` (places, cells).

        They are (tiles, cells, 6, TILE); with SPH fluid there are none. by_name: see `_set_bonds`.
        """
        tissue = self._tissue
        if not tissue.cell.has_uniform_fluid:
            return np.zeros((tissue.tiles, 0, len(Sap._fields), TILE))
        cells = np.arange(kind.shape[1])
        areas = []
        masses = []
        for cell, reference in zip(tissue.types, tissue.references, strict=True):
            areas.append(rest_areas(cell, reference, tissue.arrangement))
            masses.append(fluid_masses(cell, tissue.arrangement))
        # where there is no plant cell, 1, by which kernels may divide
        areas.append(np.ones(len(cells)))
        masses.append(np.ones(len(cells)))
        values = {
            "fluid_mass": np.array(masses)[kind, cells],
            "rest_area": np.array(areas)[kind, cells],
            "is_there": (kind >= 0).astype(np.float64),
        }
        for name in ("sound_speed_squared", "sap_modulus", "viscosity"):
            values[name] = by_name[name][kind]
        return pack(np.stack([values[name] for name in Sap._fields], axis=2))

    def make(self, x: Array) -> tuple[PairLists, PairConstants]:
        """Make lists at positions x (tiles, 2, own, TILE), µm, and the constants of their pairs.

        Raises:
            SimulationError: positions are not finite, or periods with two others between them come
                so close that lists could miss a pair.
        """
        tissue = self._tissue
        per_period = tissue.particles_per_period
        self._check_apart(x)
        contacts = self._contacts(x)
        bonded = self._kinds.bonds[self._bond]
        rim_tile, rim = np.divmod(
            np.arange(tissue.fluid_tiles * len(self._around)), max(len(self._around), 1)
        )
        # second particles of bonds and contacts, and walls around fluid, one after the other
        tile = np.concatenate([self._bond_tile, contacts.tile, rim_tile])
        j = np.concatenate([bonded[:, 1], contacts.j, self._around[rim]])
        shift = np.concatenate([bonded[:, 2], contacts.shift, self._around_shift[rim]])
        # those of other periods become images, each of which a tile has once
        is_image = shift > 0  # shift 0 is (0, 0)
        shape = tissue.tiles, len(SHIFTS), per_period
        key = np.ravel_multi_index((tile, shift, j), shape)[is_image]
        images, number = np.unique(key, return_inverse=True)
        image_tile, image_shift, owner = np.unravel_index(images, shape)
        image_starts = self._starts(image_tile)
        image = per_period + np.arange(len(images)) - image_starts[image_tile]
        j[is_image] = image[number]
        j_bond, j_contact, local_rims = np.split(j, np.cumsum([len(bonded), len(contacts.j)]))
        local = per_period + int(np.diff(image_starts).max())
        # flat index of the tile behind all: particles that stay where they are, and a force that
        # is always zero
        nowhere = tissue.tiles * 2 * local * TILE
        place = self.cells.place[image_tile, image_shift]
        owner_tile, owner_lane = np.divmod(place, TILE)
        source = (owner_tile * 2 * local + owner[:, None]) * TILE + owner_lane
        force = (image_tile * 2 * local + image)[:, None] * TILE + np.arange(TILE)
        exists = (place >= 0) & (self.cells.exists[owner_tile, owner[:, None], owner_lane] > 0.0)
        particle = (owner_tile * per_period + owner[:, None]) * TILE + owner_lane
        row, fold_source = _folded(particle[exists], force[exists], nowhere)
        fold_tile, fold = np.divmod(row, per_period)
        starts = np.empty((tissue.tiles + 1, 4), dtype=np.int64)
        starts[:, OF_IMAGES] = image_starts
        starts[:, OF_BONDS] = self._starts(self._bond_tile)
        starts[:, OF_CONTACTS] = self._starts(contacts.tile)
        starts[:, OF_FOLDS] = self._starts(fold_tile)
        lists = PairLists(
            starts=starts,
            source=np.where(place < 0, nowhere, source),
            bonds=np.stack([bonded[:, 0], j_bond], axis=1).astype(np.int32),
            contacts=np.stack([contacts.i, j_contact], axis=1).astype(np.int32),
            rim=local_rims.reshape(tissue.fluid_tiles, -1).astype(np.int32),
            fold=fold,
            fold_source=fold_source,
            local=local,
        )
        return lists, self._constants(contacts)

    def _contacts(self, x: Array) -> _Contacts:
        """List the contacts that any lane has within reach, along straight walls first."""
        tissue = self._tissue
        kinds = self._kinds
        walls = tissue.walls
        tile, particle, lane = tissue.address.T
        place = tile * TILE + lane
        position = tissue.to_particles(x)
        # pairs of particles p, q that may be within reach
        # the largest reach that any two rings have; each pair is measured against its own below
        farthest = tissue.cell.repulsion_cutoff + RINGS * self._skin
        pairs = scipy.spatial.cKDTree(position).query_pairs(farthest, output_type="ndarray")
        both_fluid = (particle[pairs] >= walls).all(axis=1)
        p, q = pairs[~both_fluid].T
        # turned so that the shift does not lead back, and within a place fluid comes before walls,
        # and of two walls the lower one first
        shift = tissue.column_row[place[q]] - tissue.column_row[place[p]]
        rank = np.where(particle >= walls, -1, particle)
        is_same_place = (shift == 0).all(axis=1)
        is_turned = _lead_back(shift) | (is_same_place & (rank[p] > rank[q]))
        first = np.where(is_turned, q, p)
        second = np.where(is_turned, p, q)
        shift[is_turned] *= -1
        rings = abs(shift).max(axis=1)
        distance = np.hypot(*(position[first] - position[second]).T)
        reach = tissue.cell.repulsion_cutoff + self._skin * np.maximum(rings, 1)
        is_near = (rings <= RINGS) & (distance <= reach)
        first = first[is_near]
        i = particle[first]
        j = particle[second[is_near]]
        key = kinds.key(i, j, number_of(shift[is_near]))
        has_fluid = (i >= walls) | (j >= walls)
        acts = np.where(has_fluid, kinds.may_touch(key), ~kinds.are_bonds(key))
        key = key[acts]
        tile_of_contact = tile[first][acts]
        # once for each tile, ordered by tile, then along straight walls or not, then by key
        is_off_line = kinds.line(key) == _NO_LINE
        per_period = tissue.particles_per_period
        kinds_of_pairs = per_period**2 * len(SHIFTS)
        every = np.unique((2 * tile_of_contact + is_off_line) * kinds_of_pairs + key)
        shape = tissue.tiles, 2, per_period, per_period, len(SHIFTS)
        tile_of_contact, _, i, j, number = np.unravel_index(every, shape)
        return _Contacts(tile_of_contact, i, j, number, kinds.line(every % kinds_of_pairs))

    def _starts(self, tile: Index) -> Index:
        """Return (tiles + 1,) where each tile begins in a list with these ascending tiles."""
        return np.searchsorted(tile, np.arange(self._tissue.tiles + 1))

    def _constants(self, contacts: _Contacts) -> PairConstants:
        """Return the constants of listed contacts, in their order, and of bonds and fluid."""
        tile = contacts.tile
        line = contacts.line
        place_of_i = tile[:, None] * TILE + np.arange(TILE)
        place_of_j = self.cells.place[tile, contacts.shift]
        sums = self._particles[place_of_i, contacts.i[:, None]]
        sums = sums + self._particles[place_of_j, contacts.j[:, None]]
        values = np.moveaxis(0.5 * sums, 1, 2) * self._weight[line, tile, None]
        row = np.arange(len(tile))
        off_line = np.flatnonzero(line == _NO_LINE)
        if len(self._tissue.types) == 1 and len(off_line):  # off straight walls all are alike
            row[off_line] = off_line[0]
        return PairConstants(
            bonds=self._bonds,
            contacts=np.ascontiguousarray(values),
            row=row,
            fluid=self._fluid,
            sap=self._sap,
            cutoff=self._tissue.cell.repulsion_cutoff,
        )

    def _check_apart(self, x: Array) -> None:
        """Raise SimulationError if periods more than `RINGS` apart could be within reach.

        Their distance is bounded by that of the boxes around their particles.
        """
        cells = self.cells
        tissue = self._tissue
        if not np.isfinite(x).all():
            raise SimulationError("tissue: positions are not finite")
        filled = tissue.column_row[:, 0] >= 0
        column_row = tissue.column_row[filled]
        exists = cells.exists[:, None] > 0.0
        low = unpack(np.where(exists, x, np.inf).min(axis=2), len(filled))[filled]
        high = unpack(np.where(exists, x, -np.inf).max(axis=2), len(filled))[filled]
        # no two periods are more rings apart than the tissue has columns or rows
        reach = tissue.cell.repulsion_cutoff + cells.skin * column_row.max()
        farthest = reach + float(np.hypot(*(high - low).T).max())
        tree = scipy.spatial.cKDTree(0.5 * (low + high))
        i, j = tree.query_pairs(farthest, output_type="ndarray").T
        rings = abs(column_row[i] - column_row[j]).max(axis=1)
        between = np.maximum(np.maximum(low[i] - high[j], low[j] - high[i]), 0.0)
        reach_of_pair = tissue.cell.repulsion_cutoff + cells.skin * rings
        is_near = np.hypot(*between.T) < reach_of_pair
        if is_near[rings > RINGS].any():
            raise SimulationError(
                f"tissue: plant cells with {RINGS} others between them come within reach of each "
                "other; the tissue has collapsed"
            )


def _folded(particle: Index, force: Index, nowhere: int) -> tuple[Index, Index]:
    """List the folds: for each own particle, the forces on its images, lane by lane.

    A particle has a fold for each of its images: its r-th fold holds, in each lane, the r-th image
    that exists there. Lanes with fewer images read a force that is always zero.

    Args:
        particle: (k,) own particle that each image is of, as (tile · own + particle) · TILE + lane.
        force: (k,) flat index of the force on the image.
        nowhere: flat index of a force that is always zero.

    Returns:
        tile · own + particle of each fold, ascending, and `PairLists.fold_source`.
    """
    order = np.argsort(particle, kind="stable")
    particle = particle[order]
    force = force[order]
    rank = np.arange(len(particle)) - np.searchsorted(particle, particle)
    most = int(rank.max(initial=0)) + 1
    fold, number = np.unique(particle // TILE * most + rank, return_inverse=True)
    source = np.full((len(fold), TILE), nowhere)
    source[number, particle % TILE] = force
    return fold // most, source
