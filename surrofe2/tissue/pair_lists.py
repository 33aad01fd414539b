"""Which particles of which plant cells interact, by what constants, and lists of those near now.

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
"""Walls of periods up to this many columns or rows apart are looked at."""
_NO_LINE = -1
_STRAIGHT = 1e-6
"""Sine of the angle below which two bonds are one straight wall."""
_REPULSION, _DAMPING = map(Constants._fields.index, ("repulsion", "contact_damping"))


def _shifts() -> Index:
    """(s, 2) columns and rows up to `RINGS`: none, those that do not lead back, then others."""
    around = range(-RINGS, RINGS + 1)
    every = sorted(product(around, around))
    ahead = [shift for shift in every if shift >= (0, 0)]
    return np.array(ahead + [shift for shift in every if shift < (0, 0)])


SHIFTS = _shifts()
_RINGS_OF = abs(SHIFTS).max(axis=1)
_AHEAD = len(SHIFTS) // 2 + 1
"""How many of `SHIFTS` do not lead back."""
_NUMBER = np.empty((2 * RINGS + 1, 2 * RINGS + 1), dtype=np.int64)
_NUMBER[tuple((SHIFTS + RINGS).T)] = np.arange(len(SHIFTS))


def number_of(shift: Index) -> Index:
    """Index into `SHIFTS` of shifts (…, 2)."""
    return np.asarray(_NUMBER[tuple(np.moveaxis(shift + RINGS, -1, 0))])


class Lines(NamedTuple):
    """Contacts along straight walls, and the bonds whose plant cells such a contact lies between.

    Attributes:
        key: (k,) of each contact, ascending, see `PairKinds.key`.
        row: (k,) of each into `cell` and `shift`.
        cell, shift: (rows, 2) and (rows, 2, 2) as of `Walls`, seen from the place of i.
    """

    key: Index
    row: Index
    cell: Index
    shift: Index


class _Step(NamedTuple):
    """A bond from a particle to another: columns and rows there, and to the place of the bond."""

    to: int
    shift: tuple[int, int]
    bond: int
    base: tuple[int, int]


class PairKinds:
    """Which pair kinds are bonds, contacts along straight walls, or fluid with walls around it."""

    def __init__(self, arrangement: Arrangement) -> None:
        self._own = arrangement.particles
        self.walls: Walls = walls_of(arrangement)
        i, j, *shift = self.walls.bonds.T
        self.bonds = np.stack([i, j, number_of(np.stack(shift, axis=1))], axis=1)
        order = np.lexsort((self.bonds[:, 2], j, i))
        self.bonds = self.bonds[order]
        self.walls = Walls(*(each[order] for each in self.walls))
        self._bonded = np.sort(self.key(*self.bonds.T))
        self._touching = self._fluid_with_walls(members_of(arrangement), arrangement)
        self.lines = self._straight(arrangement)

    def key(self, i: Index, j: Index, shift: Index) -> Index:
        """A number for each pair kind; `shift` as an index into `SHIFTS`."""
        return (i * self._own + j) * len(SHIFTS) + shift

    def are_bonds(self, key: Index) -> Flags:
        """(k,) whether pair kinds are bonds."""
        return _is_among(key, self._bonded)

    def may_touch(self, key: Index) -> Flags:
        """(k,) whether pair kinds of fluid and wall are of one plant cell."""
        return _is_among(key, self._touching)

    def line(self, key: Index) -> Index:
        """(k,) row of `Lines` that pair kinds belong to, −1 off straight walls."""
        if not len(self.lines.key):
            return np.full(len(key), _NO_LINE)
        at = np.minimum(np.searchsorted(self.lines.key, key), len(self.lines.key) - 1)
        return np.where(self.lines.key[at] == key, self.lines.row[at], _NO_LINE)

    def _fluid_with_walls(self, members: Members, arrangement: Arrangement) -> Index:
        is_wall = members.particle < arrangement.walls
        keys = []
        for cell in range(len(arrangement.fluid_counts)):
            fluid = members.particle[~is_wall & (members.cell == cell)]
            around = is_wall & (members.cell == cell)
            wall, shift = members.particle[around], members.shift[around]
            leads_back = (shift[:, 0] < 0) | ((shift[:, 0] == 0) & (shift[:, 1] < 0))
            forth, back = ~leads_back, leads_back
            keys += [
                self.key(fluid[:, None], wall[forth], number_of(shift[forth])).ravel(),
                self.key(wall[back], fluid[:, None], number_of(-shift[back])).ravel(),
            ]
        return np.sort(np.concatenate([np.empty(0, dtype=np.int64), *keys]))

    def _straight(self, arrangement: Arrangement) -> Lines:
        """Contacts along straight walls: from each particle along its bonds while they turn not."""
        position, lattice = arrangement.wall_position, arrangement.tessellation.lattice
        steps: dict[int, list[_Step]] = {}
        wall = self._wall_of(arrangement)
        for bond, (i, j, a, b) in enumerate(self.walls.bonds.tolist()):
            steps.setdefault(i, []).append(_Step(j, (a, b), bond, (0, 0)))
            steps.setdefault(j, []).append(_Step(i, (-a, -b), bond, (-a, -b)))
        rows: dict[tuple[int, int, int], int] = {}
        contacts: dict[int, int] = {}
        for i, begins in steps.items():
            for first in begins:
                way = position[first.to] + lattice @ first.shift - position[i]
                for k, there in _ahead(steps, position, lattice, wall, first, way):
                    if (there, k) > ((0, 0), i):
                        row = rows.setdefault((first.bond, *first.base), len(rows))
                        number = int(number_of(np.array(there)))
                        contacts[int(self.key(np.array(i), np.array(k), np.array(number)))] = row
        keys = np.array(sorted(contacts), dtype=np.int64)
        row_of = np.array([contacts[key] for key in keys.tolist()], dtype=np.int64)
        begun = np.array([*rows], dtype=np.int64).reshape(-1, 3)
        bonds = begun[:, 0]
        shift = self.walls.shift[bonds] - begun[:, None, 1:]
        return Lines(keys, row_of, self.walls.cell[bonds], shift)

    def _wall_of(self, arrangement: Arrangement) -> list[int]:
        """Number of the wall that each bond is part of, along which it may bend; −1: it may not."""
        if arrangement.wall_of_bond is None:
            return [-1] * len(self.bonds)
        ends = map(tuple, arrangement.bonds[:, :2].tolist())
        wall = dict(zip(ends, arrangement.wall_of_bond.tolist(), strict=True))
        return [wall[i, j] for i, j in self.bonds[:, :2].tolist()]


def _ahead(
    steps: dict[int, list[_Step]],
    position: Array,
    lattice: Array,
    wall: list[int],
    first: _Step,
    way: Array,
) -> list[tuple[int, tuple[int, int]]]:
    """Particles and shifts that a wall leads to beyond its first bond, within `RINGS`.

    A wall leads on where it is straight, and along a wall of an image where it bends, too.
    """
    found: list[tuple[int, tuple[int, int]]] = []
    bond = first.bond
    at, shift = first.to, first.shift
    while True:
        for step in steps[at]:
            on = position[step.to] + lattice @ step.shift - position[at]
            turn = way[0] * on[1] - way[1] * on[0]
            size = np.linalg.norm(way) * np.linalg.norm(on)
            is_straight = way @ on > 0.0 and abs(turn) < _STRAIGHT * size
            bends = step.bond != bond and wall[step.bond] == wall[bond] >= 0
            if is_straight or bends:
                bond = step.bond
                at, shift = step.to, (shift[0] + step.shift[0], shift[1] + step.shift[1])
                break
        else:
            return found
        if max(abs(shift[0]), abs(shift[1])) > RINGS or (at, shift) in found:
            return found
        found.append((at, shift))


def _is_among(key: Index, known: Index) -> Flags:
    """(k,) whether keys are among ascending ones."""
    if not len(known):
        return np.zeros(len(key), dtype=np.bool_)
    at = np.minimum(np.searchsorted(known, key), len(known) - 1)
    return np.asarray(known[at] == key)


Factors = tuple[float, float]
"""On the elastic and on the damping part of all forces between particles."""
WHOLE: Factors = (1.0, 1.0)
ELASTIC: Factors = (1.0, 0.0)
DAMPING: Factors = (0.0, 1.0)


class PairConstants(NamedTuple):
    """Lanes last, weights included.

    Attributes:
        bonds: (bonds, 3, TILE) stiffness, rest length, damping.
        contacts: (rows, 2, TILE) repulsion and contact damping.
        row: (contacts,) of each; those that are alike share one, which then stays at hand.
        fluid: (tiles, 4, TILE) smoothing length, fluid mass, sound speed squared, viscosity; of
            one type of plant cell (1, 4, TILE) for all.
        sap: (tiles, cells, 6, TILE) of a uniform fluid, as `Sap` has it.
        cutoff: of contacts, µm.
    """

    bonds: Array
    contacts: Array
    row: Index
    fluid: Array
    sap: Array
    cutoff: float

    def times(self, factors: Factors) -> PairConstants:
        """With factors on elastic constants and on those of dashpots and viscosity."""
        elastic, damping = factors
        return self._replace(
            bonds=self.bonds * np.array([[elastic], [1.0], [damping]]),
            contacts=self.contacts * np.array([[elastic], [damping]]),
            fluid=self.fluid * np.array([[1.0], [1.0], [elastic], [damping]]),
            sap=self.sap * np.array([[1.0], [elastic], [elastic], [1.0], [damping], [1.0]]),
        )


# of a bond, a contact and the fluid in a tile, as `forces` takes them; lanes
Bond = namedtuple("Bond", "wall_stiffness rest_length wall_damping")
Contact = namedtuple("Contact", "repulsion contact_damping cutoff")
FluidConstants = namedtuple(
    "FluidConstants", "smoothing_length fluid_mass sound_speed_squared viscosity"
)
# of the uniform fluid of a plant cell; the last is 1, or 0 where there is none
Sap = namedtuple("Sap", "fluid_mass sound_speed_squared sap_modulus rest_area viscosity is_there")


@pair_law
def bond_at(rows, k):
    """The `Bond` of a row of `PairConstants.bonds`."""
    return Bond(load(rows, k, 0), load(rows, k, 1), load(rows, k, 2))


@pair_law
def contact_at(constants, k):
    """The `Contact` of a listed pair."""
    rows, row = constants.contacts, constants.row[k]
    return Contact(load(rows, row, 0), load(rows, row, 1), constants.cutoff)


@pair_law
def fluid_at(rows, t):
    """The `FluidConstants` of a row of `PairConstants.fluid`."""
    return FluidConstants(load(rows, t, 0), load(rows, t, 1), load(rows, t, 2), load(rows, t, 3))


@pair_law
def sap_at(rows, t, c):
    """The `Sap` of a plant cell of a tile, of `PairConstants.sap`."""
    return Sap(
        load(rows, t, c, 0), load(rows, t, c, 1), load(rows, t, c, 2), load(rows, t, c, 3),
        load(rows, t, c, 4), load(rows, t, c, 5),
    )  # fmt: skip


class Cells(NamedTuple):
    """What no list changes: plant cells and their neighbours.

    Attributes:
        place: (tiles, shifts, TILE) place of the period at each of `SHIFTS`, or −1.
        next_shifts: the shifts to the next column or row, of two opposite ones one.
        exists: (tiles, own, TILE) 1.0 where there is a particle, else 0.
        per_count: (tiles, TILE) 1/(number of own particles), or 0.
        particles: own, of which `walls` come first; fluid_pairs: (·, 2) of the others that are in
            one plant cell.
        rim_start: (cells + 1,) where the walls around each plant cell of a period begin in
            `PairLists.rim`; of a uniform fluid, else (1,).
        fluid_tiles: how many tiles, the first ones, have fluid.
        order: (tiles,) in which to go through them: those with and without fluid evenly mixed,
            so that equal parts of it cost threads the same.
        skin: how far particles of neighbouring periods may move against one another, µm.
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


class PairLists(NamedTuple):
    """Pairs of all tiles one after another; those of tile t are [starts[t, k], starts[t + 1, k]).

    Attributes:
        starts: (tiles + 1, 4) of images, bonds, contacts, folds.
        source: (images, TILE) flat index of the owner in (tiles + 1, 2, local, TILE).
        bonds, contacts: (·, 2) local particles.
        rim: (fluid tiles, ·) local particles around the plant cells with a uniform fluid.
        fold: (folds,) own particle; fold_source: (folds, TILE) flat index of the image force.
        local: local particles of a tile, at most.
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
    """Contacts of each tile (k,): particles, index into `SHIFTS`, row of `Lines` or −1."""

    tile: Index
    i: Index
    j: Index
    shift: Index
    line: Index


class PairLister:
    """Makes `PairLists` for one tissue, and the constants of their pairs."""

    def __init__(self, tissue: Tissue, skin: float) -> None:
        self._tissue, self._skin = tissue, skin
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
        parts = [
            (np.arange(n) + 0.5) / max(n, 1) for n in (fluid_tiles, tissue.tiles - fluid_tiles)
        ]
        rims = tissue.arrangement.rims if tissue.cell.has_uniform_fluid else ()
        around = np.concatenate([np.empty((0, 3), dtype=np.int64), *rims])
        self._around, self._around_shift = around[:, 0], number_of(around[:, 1:])
        self.cells = Cells(
            place=pack(place),
            next_shifts=np.flatnonzero((_RINGS_OF == 1) & (np.arange(len(SHIFTS)) < _AHEAD)),
            exists=exists,
            per_count=exists.any(axis=1) / np.maximum(exists.sum(axis=1), 1.0),
            particles=tissue.own,
            walls=tissue.walls,
            fluid_pairs=np.concatenate([np.empty((0, 2)), *fluid_pairs]).astype(np.int32),
            rim_start=np.cumsum([0, *map(len, rims)]),
            fluid_tiles=fluid_tiles,
            order=np.argsort(np.concatenate(parts), kind="stable"),
            skin=skin,
        )
        self._set_constants()

    def _set_constants(self) -> None:
        """Set those of bonds and fluid, and what contacts have by particles and straight walls."""
        tissue, kinds = self._tissue, self._kinds
        # one more type, the last, for plant cells that are not there
        table = np.array([*tissue.constants, np.zeros(len(Constants._fields))])
        of = dict(zip(Constants._fields, table.T, strict=True))
        both = tissue.kinds_at(kinds.walls.cell, kinds.walls.shift)  # (places, bonds, 2)
        half = 0.5 * np.where((both >= 0).all(axis=2), 1.0, tissue.cell.outer_wall)
        stiffness = of["wall_stiffness"][both]
        total = stiffness.sum(axis=2)
        rest = (stiffness * of["rest_length"][both]).sum(axis=2) / np.maximum(total, 1e-60)
        damping = of["wall_damping"][both].sum(axis=2)
        relative = self._relative_lengths()
        total = total / relative
        rest = rest * relative
        damping = damping / relative
        bonds = pack(np.stack([half * total, rest, half * damping], axis=2))
        self._bond_tile, self._bond = np.nonzero((bonds[:, :, 0] > 0.0).any(axis=2))
        self._bonds = np.ascontiguousarray(bonds[self._bond_tile, self._bond])
        # of contacts along a straight wall, ½ `outer_wall` on the boundary; the last: of others
        beside = tissue.kinds_at(kinds.lines.cell, kinds.lines.shift)
        along = np.where((beside >= 0).all(axis=2), 1.0, 0.5 * tissue.cell.outer_wall)
        self._weight = np.append(along, np.ones_like(along[:, :1]), axis=1).T.reshape(
            -1, tissue.tiles, TILE
        )
        cells = np.arange(tissue.kind.shape[2])
        here = tissue.kinds_at(cells, np.zeros((len(cells), 2), dtype=np.int64))
        # places without fluid have some, so that kernels may divide
        some = np.maximum(here.max(axis=1), 0)
        fluid = np.stack([of[name][some] for name in FluidConstants._fields], axis=1)
        self._fluid = pack(fluid if len(tissue.types) > 1 else fluid[:TILE])
        self._sap = self._saps(here, of)
        part = np.stack([tissue.shares(tissue.kind == k) for k in range(len(tissue.types))], axis=2)
        part[part.sum(axis=2) == 0.0] = 1.0  # particles that do not exist get constants, too
        part /= part.sum(axis=2, keepdims=True)
        self._particles = part @ table[:-1, [_REPULSION, _DAMPING]]  # (places, own, 2)

    def _relative_lengths(self) -> Array:
        """(bonds,) length of each spring over that of a straight wall's, if springs differ; else 1.

        A longer piece of the same wall is softer, and its rest length is longer.
        """
        arrangement, bonds = self._tissue.arrangement, self._kinds.bonds
        if arrangement.wall_of_bond is None:
            return np.ones(len(bonds))
        i, j = bonds[:, :2].T
        way = arrangement.wall_position[j] - arrangement.wall_position[i]
        return np.linalg.norm(way, axis=1) / self._tissue.cell.spring_length

    def _saps(self, kind: Index, of: dict[str, Array]) -> Array:
        """(tiles, cells, 6, TILE) `Sap` of plant cells of types `kind` (places, cells)."""
        tissue = self._tissue
        if not tissue.cell.has_uniform_fluid:
            return np.zeros((tissue.tiles, 0, len(Sap._fields), TILE))
        nothing, cells = np.ones(kind.shape[1]), np.arange(kind.shape[1])
        pairs = zip(tissue.types, tissue.references, strict=True)
        areas = np.array([*(rest_areas(*pair, tissue.arrangement) for pair in pairs), nothing])
        masses = np.array(
            [*(fluid_masses(each, tissue.arrangement) for each in tissue.types), nothing]
        )
        values = {
            "fluid_mass": masses[kind, cells],
            "rest_area": areas[kind, cells],
            "is_there": (kind >= 0).astype(np.float64),
        }
        rows = [values[name] if name in values else of[name][kind] for name in Sap._fields]
        return pack(np.stack(rows, axis=2))

    def make(self, x: Array) -> tuple[PairLists, PairConstants]:
        """Lists at positions x (tiles, 2, own, TILE), µm, and the constants of their pairs.

        Raises:
            SimulationError: positions are not finite, or periods with two others between them come
                so close that lists could miss a pair.
        """
        tissue, own = self._tissue, self._tissue.own
        self._check_apart(x)
        contacts = self._contacts(x)
        bonded = self._kinds.bonds[self._bond]
        rim_tile, rim = np.divmod(
            np.arange(tissue.fluid_tiles * len(self._around)), max(len(self._around), 1)
        )
        # bonds, contacts and walls around fluid, one after the other
        tile = np.concatenate([self._bond_tile, contacts.tile, rim_tile])
        j = np.concatenate([bonded[:, 1], contacts.j, self._around[rim]])
        shift = np.concatenate([bonded[:, 2], contacts.shift, self._around_shift[rim]])
        elsewhere = shift > 0
        shape = tissue.tiles, len(SHIFTS), own
        key = np.ravel_multi_index((tile, shift, j), shape)[elsewhere]
        images, number = np.unique(key, return_inverse=True)
        image_tile, image_shift, owner = np.unravel_index(images, shape)
        starts = [self._starts(each) for each in (image_tile, self._bond_tile, contacts.tile)]
        image = own + np.arange(len(images)) - starts[0][image_tile]
        j[elsewhere] = image[number]
        j_bond, j_contact, in_rims = np.split(j, np.cumsum([len(bonded), len(contacts.j)]))
        local = own + int(np.diff(starts[0]).max())
        # particles that stay where they are, and a force that is always zero
        nowhere = tissue.tiles * 2 * local * TILE
        place = self.cells.place[image_tile, image_shift]
        there, lane = np.divmod(place, TILE)
        source = (there * 2 * local + owner[:, None]) * TILE + lane
        felt = (image_tile * 2 * local + image)[:, None] * TILE + np.arange(TILE)
        exists = (place >= 0) & (self.cells.exists[there, owner[:, None], lane] > 0.0)
        particle = (there * own + owner[:, None]) * TILE + lane
        row, fold_source = _folded(particle[exists], felt[exists], nowhere)
        fold_tile, fold = np.divmod(row, own)
        lists = PairLists(
            starts=np.stack([*starts, self._starts(fold_tile)], axis=1),
            source=np.where(place < 0, nowhere, source),
            bonds=np.stack([bonded[:, 0], j_bond], axis=1).astype(np.int32),
            contacts=np.stack([contacts.i, j_contact], axis=1).astype(np.int32),
            rim=in_rims.reshape(tissue.fluid_tiles, -1).astype(np.int32),
            fold=fold,
            fold_source=fold_source,
            local=local,
        )
        return lists, self._constants(contacts)

    def _contacts(self, x: Array) -> _Contacts:
        """Contacts that any lane has within reach, along straight walls first."""
        tissue, kinds, walls = self._tissue, self._kinds, self._tissue.walls
        tile, own, lane = tissue.address.T
        at, place = tissue.to_particles(x), tile * TILE + lane
        farthest = tissue.cell.repulsion_cutoff + RINGS * self._skin
        p, q = scipy.spatial.cKDTree(at).query_pairs(farthest, output_type="ndarray").T
        both_fluid = (own[p] >= walls) & (own[q] >= walls)
        p, q = p[~both_fluid], q[~both_fluid]
        way = tissue.column_row[place[q]] - tissue.column_row[place[p]]
        # within a place fluid comes first, and of two walls the lower one
        rank = np.where(own >= walls, -1, own)
        turned = (way[:, 0] < 0) | ((way[:, 0] == 0) & (way[:, 1] < 0))
        turned |= (way == 0).all(axis=1) & (rank[p] > rank[q])
        p, q = np.where(turned, q, p), np.where(turned, p, q)
        way[turned] *= -1
        rings = abs(way).max(axis=1)
        distance = np.hypot(*(at[p] - at[q]).T)
        reach = tissue.cell.repulsion_cutoff + self._skin * np.maximum(rings, 1)
        near = (rings <= RINGS) & (distance <= reach)
        p, q, shift = p[near], q[near], number_of(way[near])
        i, j = own[p], own[q]
        key = kinds.key(i, j, shift)
        has_fluid = (i >= walls) | (j >= walls)
        acts = np.where(has_fluid, kinds.may_touch(key), ~kinds.are_bonds(key))
        key, where = key[acts], tile[p][acts]
        off_line = kinds.line(key) == _NO_LINE
        shape = tissue.tiles, 2, tissue.own, tissue.own, len(SHIFTS)
        size = tissue.own**2 * len(SHIFTS)
        every = np.unique((2 * where + off_line) * size + key)
        where, _, i, j, shift = np.unravel_index(every, shape)
        return _Contacts(where, i, j, shift, kinds.line(every % size))

    def _starts(self, tile: Index) -> Index:
        """(tiles + 1,) where each tile begins among rows whose ascending tiles are given."""
        return np.searchsorted(tile, np.arange(self._tissue.tiles + 1))

    def _constants(self, contacts: _Contacts) -> PairConstants:
        """For listed contacts, in order, and for bonds and fluid."""
        tile, line = contacts.tile, contacts.line
        here = tile[:, None] * TILE + np.arange(TILE)
        there = self.cells.place[tile, contacts.shift]
        sums = self._particles[here, contacts.i[:, None]]
        sums = sums + self._particles[there, contacts.j[:, None]]
        values = np.moveaxis(0.5 * sums, 1, 2) * self._weight[line, tile, None]
        row = np.arange(len(tile))
        inner = np.flatnonzero(line == _NO_LINE)
        if len(self._tissue.types) == 1 and len(inner):  # off straight walls all are alike
            row[inner] = inner[0]
        return PairConstants(
            bonds=self._bonds,
            contacts=np.ascontiguousarray(values),
            row=row,
            fluid=self._fluid,
            sap=self._sap,
            cutoff=self._tissue.cell.repulsion_cutoff,
        )

    def _check_apart(self, x: Array) -> None:
        """Periods further apart than RINGS must be out of each other's reach."""
        cells, tissue = self.cells, self._tissue
        if not np.isfinite(x).all():
            raise SimulationError("tissue: positions are not finite")
        # the box around the particles of each period
        filled = tissue.column_row[:, 0] >= 0
        at, exists = tissue.column_row[filled], cells.exists[:, None] > 0.0
        low, high = (
            unpack(of(np.where(exists, x, beyond), axis=2), len(filled))[filled]
            for of, beyond in ((np.min, np.inf), (np.max, -np.inf))
        )
        reach = tissue.cell.repulsion_cutoff + cells.skin * at.max()
        farthest = reach + float(np.hypot(*(high - low).T).max())
        tree = scipy.spatial.cKDTree(0.5 * (low + high))
        i, j = tree.query_pairs(farthest, output_type="ndarray").T
        rings = abs(at[i] - at[j]).max(axis=1)
        between = np.maximum(np.maximum(low[i] - high[j], low[j] - high[i]), 0.0)
        near = tissue.cell.repulsion_cutoff + cells.skin * rings
        if (np.hypot(*between.T) < near)[rings > RINGS].any():
            raise SimulationError(
                f"tissue: plant cells with {RINGS} others between them come within reach of each "
                "other; the tissue has collapsed"
            )


def _folded(particle: Index, felt: Index, nowhere: int) -> tuple[Index, Index]:
    """(tile, own particle) as a number of each fold, ascending, and fold_source of `PairLists`.

    Row r of an own particle holds, lane by lane, the r-th image of it that exists; lanes with
    fewer images read a force that is always zero.

    Args:
        particle: (k,) own particle, lane included, that each image is of.
        felt: (k,) flat index of the image's force.
    """
    order = np.argsort(particle, kind="stable")
    particle, felt = particle[order], felt[order]
    rank = np.arange(len(particle)) - np.searchsorted(particle, particle)
    most = int(rank.max(initial=0)) + 1
    row, number = np.unique(particle // TILE * most + rank, return_inverse=True)
    source = np.full((len(row), TILE), nowhere)
    source[number, particle % TILE] = felt
    return row // most, source
