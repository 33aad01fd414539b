"""Which particles of which plant cells interact, by what constants, and lists of those near now.

A pair kind is (i, j, shift): own particle i of any plant cell with own particle j of the cell
`shift` columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice.
Wall particles a spring apart are bonded; all others touch, and fluid touches the walls around its
own cell. Pairs on one wall line share that line's wall (docs/theory.md, walls at a free boundary).

A wall between two plant cells has the sum of both halves: mean stiffness and damping, and the rest
length Σ k l₀/Σ k at which both balance. A wall particle has the mean repulsion and contact damping
of the plant cells around it, and a contact the mean of its two particles. FE² knows no walls of two
types: there each type begins where the other ends.

A pair kind is listed for a tile if in any of its lanes the two particles are within the list's
reach: the cut-off and a skin. Partners in other plant cells become images, local particles that
follow the own ones; they are gathered before forces are summed, and what they feel is folded back
to their owners by a list that each owner reads alone, so that threads never meet.

With ū the mean displacement of a cell's own particles since the listing, and d the largest
|u − ū| anywhere, particles of neighbouring cells A and B have moved against one another by at most
2 d + |ū_B − ū_A|. While that is within the skin everywhere, and as particles of cells k columns or
rows apart are listed up to the cut-off and k skins, no unlisted pair is within the cut-off.
"""

from __future__ import annotations

from collections import namedtuple
from itertools import product
from typing import NamedTuple

import numba
import numpy as np
import scipy  # scipy.spatial is loaded where a tissue is
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import pair_law, parallel_kernel
from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import TILE, load, pack, tiles_for, unpack
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.tissue.layout import Tissue, shares, wall_grid

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""
_ALONG_X, _ALONG_Y, _NO_LINE = 0, 1, -1
_REPULSION, _DAMPING = map(Constants._fields.index, ("repulsion", "contact_damping"))


class PairKinds(NamedTuple):
    """Pair kinds in the order bonds, contacts along one wall line, other contacts.

    Attributes:
        i, j: (kinds,) own particles.
        shift: (kinds,) index into `shifts`.
        shifts: (s, 2) columns and rows; the first are none.
        axis: (kinds,) which wall line of the cell of i both lie on: 0 the one along x, 1 the one
            along y, −1 none.
        bonds: how many kinds are bonds.
    """

    i: Index
    j: Index
    shift: Index
    shifts: Index
    axis: Index
    bonds: int


def make_pair_kinds(cell: CellParameters) -> PairKinds:
    """All pair kinds of a tissue of such square cells."""
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    around = range(-RINGS, RINGS + 1)
    shifts = np.array([shift for shift in product(around, around) if shift >= (0, 0)])
    at = wall_grid(cell, shifts[:1])[0]
    number, i, j = np.indices((len(shifts), walls, walls)).reshape(3, -1)
    number, i, j = np.stack([number, i, j])[:, (number > 0) | (j > i)]
    there = at[j] + per_side * shifts[number]
    in_column, in_row = ((at[i] == there) & (at[i] == 0)).T
    axis = np.where(in_row, _ALONG_X, np.where(in_column, _ALONG_Y, _NO_LINE))
    is_bond = abs(there - at[i]).sum(axis=1) == 1

    ends = at + per_side * shifts[:, None]
    place, wall = np.nonzero(((ends >= 0) & (ends <= per_side)).all(axis=2))
    fluid, touching = np.divmod(np.arange(cell.fluid_particles * len(wall)), len(wall))
    i, j = np.append(i, walls + fluid), np.append(j, wall[touching])
    number = np.append(number, place[touching])
    axis = np.pad(axis, (0, len(fluid)), constant_values=_NO_LINE)
    is_bond = np.pad(is_bond, (0, len(fluid)))
    order = np.lexsort((number, j, i, axis == _NO_LINE, ~is_bond))
    i, j, number, axis = (each[order] for each in (i, j, number, axis))
    return PairKinds(i, j, number, shifts, axis, int(is_bond.sum()))


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
        cutoff: of contacts, µm.
    """

    bonds: Array
    contacts: Array
    row: Index
    fluid: Array
    cutoff: float

    def times(self, factors: Factors) -> PairConstants:
        """With factors on elastic constants and on those of dashpots and viscosity."""
        elastic, damping = factors
        return self._replace(
            bonds=self.bonds * np.array([[elastic], [1.0], [damping]]),
            contacts=self.contacts * np.array([[elastic], [damping]]),
            fluid=self.fluid * np.array([[1.0], [1.0], [elastic], [damping]]),
        )


# of a bond, a contact and the fluid in a tile, as `forces` takes them; lanes
Bond = namedtuple("Bond", "wall_stiffness rest_length wall_damping")
Contact = namedtuple("Contact", "repulsion contact_damping cutoff")
FluidConstants = namedtuple(
    "FluidConstants", "smoothing_length fluid_mass sound_speed_squared viscosity"
)


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


class Cells(NamedTuple):
    """What no list changes: plant cells and their neighbours.

    Attributes:
        place: (tiles, shifts, TILE) place of the cell at each of `PairKinds.shifts`, or −1.
        next_shifts: the shifts to the next column or row.
        exists: (tiles, own, TILE) 1.0 where there is a particle, else 0.
        per_count: (tiles, TILE) 1/(number of own particles), or 0.
        particles: own, of which `walls` come first; fluid_pairs: (·, 2) of the others.
        fluid_tiles: how many tiles, the first ones, have fluid.
        order: (tiles,) in which to go through them: those with and without fluid evenly mixed,
            so that equal parts of it cost threads the same.
        skin: how far particles of neighbouring cells may move against one another, µm.
    """

    place: Index
    next_shifts: Index
    exists: Array
    per_count: Array
    particles: int
    walls: int
    fluid_pairs: NDArray[np.int32]
    fluid_tiles: int
    order: Index
    skin: float


class PairLists(NamedTuple):
    """Pairs of all tiles one after another; those of tile t are [starts[t, k], starts[t + 1, k]).

    Attributes:
        starts: (tiles + 1, 4) of images, bonds, contacts, folds.
        source: (images, TILE) flat index of the owner in (tiles + 1, 2, local, TILE).
        bonds, contacts: (·, 2) local particles.
        fold: (folds,) own particle; fold_source: (folds, TILE) flat index of the image force.
        local: local particles of a tile, at most.
    """

    starts: Index
    source: Index
    bonds: NDArray[np.int32]
    contacts: NDArray[np.int32]
    fold: Index
    fold_source: Index
    local: int


class PairLister:
    """Makes `PairLists` for one tissue, and the constants of their pairs."""

    def __init__(self, tissue: Tissue, skin: float) -> None:
        self._tissue = tissue
        kinds = self._kinds = make_pair_kinds(tissue.cell)
        rings = abs(kinds.shifts).max(axis=1)
        self._reach = tissue.cell.repulsion_cutoff + skin * np.maximum(rings, 1)[kinds.shift]
        there = tissue.column_row[:, None] + kinds.shifts + RINGS
        place = np.pad(tissue.place, RINGS, constant_values=-1)[tuple(np.moveaxis(there, 2, 0))]
        place[tissue.column_row[:, 0] < 0] = -1
        exists = (tissue.mass > 0.0).astype(np.float64)
        fluid_pairs = np.stack(np.triu_indices(tissue.own - tissue.walls, 1), axis=1)
        fluid_tiles = tiles_for(tissue.kind.size)
        parts = [
            (np.arange(n) + 0.5) / max(n, 1) for n in (fluid_tiles, tissue.tiles - fluid_tiles)
        ]
        self.cells = Cells(
            place=pack(place),
            next_shifts=np.flatnonzero(rings == 1),
            exists=exists,
            per_count=exists.any(axis=1) / np.maximum(exists.sum(axis=1), 1.0),
            particles=tissue.own,
            walls=tissue.walls,
            fluid_pairs=(tissue.walls + fluid_pairs).astype(np.int32),
            fluid_tiles=fluid_tiles,
            order=np.argsort(np.concatenate(parts), kind="stable"),
            skin=skin,
        )
        self._set_constants()

    def _set_constants(self) -> None:
        """Those of bonds and fluid, and what contacts have by their particles and wall lines."""
        tissue, kinds = self._tissue, self._kinds
        # one more type, the last, for plant cells that are not there
        table = np.array([*tissue.constants, np.zeros(len(Constants._fields))])
        of = dict(zip(Constants._fields, table.T, strict=True))
        here, (column, row) = np.pad(tissue.kind, 1, constant_values=-1), tissue.column_row.T
        own = here[column + 1, row + 1]
        # the plant cells on both sides of the wall along x, and of the one along y
        both = np.array([[own, here[column + 1, row]], [own, here[column, row + 1]]])
        between = (both >= 0).all(axis=1)
        half = 0.5 * np.where(between, 1.0, tissue.cell.outer_wall)
        stiffness = of["wall_stiffness"][both]
        total = stiffness.sum(axis=1)
        rest = (stiffness * of["rest_length"][both]).sum(axis=1) / np.maximum(total, 1e-60)
        damping = of["wall_damping"][both].sum(axis=1)
        walls = np.stack([half * total, rest, half * damping], axis=2)
        bonds = pack(np.stack([walls[axis] for axis in kinds.axis[: kinds.bonds]], axis=1))
        self._bonds = bonds.reshape(-1, 3, TILE)
        # by axis, of pairs along such a wall: ½ `outer_wall` on the boundary; of others
        along = np.where(between, 1.0, half)
        self._weight = np.append(along, np.ones_like(along[:1]), axis=0).reshape(3, -1, TILE)
        # places without fluid have some, so that kernels may divide
        fluid = np.stack([of[name][np.maximum(own, 0)] for name in FluidConstants._fields], axis=1)
        self._fluid = pack(fluid if len(tissue.types) > 1 else fluid[:TILE])
        part = np.stack(
            [shares(tissue.cell, tissue.kind == k, tissue.column_row)
             for k in range(len(tissue.types))], axis=2,
        )  # fmt: skip
        part[part.sum(axis=2) == 0.0] = 1.0  # particles that do not exist get constants, too
        part /= part.sum(axis=2, keepdims=True)
        self._particles = part @ table[:-1, [_REPULSION, _DAMPING]]  # (places, own, 2)

    def make(self, x: Array) -> tuple[PairLists, PairConstants]:
        """Lists at positions x (tiles, 2, own, TILE), µm, and the constants of their pairs.

        Raises:
            SimulationError: positions are not finite, or plant cells with two others between
                them come so close that lists could miss a pair.
        """
        tissue, kinds, own = self._tissue, self._kinds, self._tissue.own
        self._check_apart(x)
        close = np.zeros((len(x), len(kinds.i)), dtype=np.bool_)
        mark_close(x, kinds, self._reach, self.cells, close)
        close[:, : kinds.bonds] = True
        tile, kind = np.nonzero(close)
        j, shift, is_bond = kinds.j[kind], kinds.shift[kind], kind < kinds.bonds
        elsewhere = shift > 0
        shape = tissue.tiles, len(kinds.shifts), own
        key = np.ravel_multi_index((tile, shift, j), shape)[elsewhere]
        images, number = np.unique(key, return_inverse=True)
        image_tile, image_shift, owner = np.unravel_index(images, shape)
        starts = [self._starts(each) for each in (image_tile, tile[is_bond], tile[~is_bond])]
        image = own + np.arange(len(images)) - starts[0][image_tile]
        j[elsewhere] = image[number]
        pairs = np.stack([kinds.i[kind], j], axis=1).astype(np.int32)
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
            bonds=pairs[is_bond],
            contacts=pairs[~is_bond],
            fold=fold,
            fold_source=fold_source,
            local=local,
        )
        return lists, self._constants(tile[~is_bond], kind[~is_bond])

    def _starts(self, tile: Index) -> Index:
        """(tiles + 1,) where each tile begins among rows whose ascending tiles are given."""
        return np.searchsorted(tile, np.arange(self._tissue.tiles + 1))

    def _constants(self, tile: Index, kind: Index) -> PairConstants:
        """For listed contacts, which follow the bonds: the kind of each in its tile, in order."""
        kinds, here = self._kinds, tile[:, None] * TILE + np.arange(TILE)
        there = self.cells.place[tile, kinds.shift[kind]]
        sums = self._particles[here, kinds.i[kind, None]]
        sums = sums + self._particles[there, kinds.j[kind, None]]
        contacts = np.moveaxis(0.5 * sums, 1, 2) * self._weight[kinds.axis[kind], tile, None]
        row = np.arange(len(kind))
        inner = np.flatnonzero(kinds.axis[kind] == _NO_LINE)
        if len(self._tissue.types) == 1 and len(inner):  # off wall lines all are alike
            row[inner] = inner[0]
        return PairConstants(
            bonds=self._bonds,
            contacts=np.ascontiguousarray(contacts),
            row=row,
            fluid=self._fluid,
            cutoff=self._tissue.cell.repulsion_cutoff,
        )

    def _check_apart(self, x: Array) -> None:
        """Plant cells further apart than RINGS must be out of each other's reach."""
        cells, tissue = self.cells, self._tissue
        if not np.isfinite(x).all():
            raise SimulationError("tissue: positions are not finite")
        centre = (x * (cells.exists * cells.per_count[:, None])[:, None]).sum(axis=2)
        from_there = (x - centre[:, :, None]) * cells.exists[:, None]
        extent = np.hypot(from_there[:, 0], from_there[:, 1]).max()
        filled = tissue.column_row[:, 0] >= 0
        centres, at = unpack(centre, len(filled))[filled], tissue.column_row[filled]
        near = tissue.cell.repulsion_cutoff + 2.0 * extent
        tree = scipy.spatial.cKDTree(centres)
        i, j = tree.query_pairs(near + cells.skin * at.max(), output_type="ndarray").T
        rings = abs(at[i] - at[j]).max(axis=1)
        distance = np.hypot(*(centres[i] - centres[j]).T)
        if (distance < near + cells.skin * rings)[rings > RINGS].any():
            raise SimulationError(
                f"tissue: plant cells with {RINGS} others between them come within reach of each "
                "other; the tissue has collapsed"
            )


def bonded_particles(tissue: Tissue) -> Index:
    """(b, 2) numbers of the particles that wall springs join: neighbours on the grid of springs."""
    walls = tissue.outline[tissue.is_wall]
    at = np.rint(walls / tissue.cell.spring_length).astype(np.int64)
    number = np.full(at.max(axis=0) + 2, -1)
    number[tuple(at.T)] = np.arange(len(at))
    ahead = np.concatenate([number[tuple(at.T + step)] for step in ([[1], [0]], [[0], [1]])])
    pairs = np.stack([np.tile(np.arange(len(at)), 2), ahead], axis=1)
    return pairs[ahead >= 0]


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


@parallel_kernel
def mark_close(x, kinds, reach, cells, close):
    """close (tiles, kinds): whether any lane has that pair within its `reach`."""
    for t in numba.prange(x.shape[0]):
        for k in range(kinds.i.shape[0]):
            i, j, s = kinds.i[k], kinds.j[k], kinds.shift[k]
            for lane in range(TILE):
                there = cells.place[t, s, lane]
                if there < 0:
                    continue
                tile, other = there // TILE, there % TILE
                rx = x[tile, 0, j, other] - x[t, 0, i, lane]
                ry = x[tile, 1, j, other] - x[t, 1, i, lane]
                if rx * rx + ry * ry <= reach[k] * reach[k]:
                    close[t, k] = True
                    break
