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

from surrofe2.base.compilation import kernel, pair_law, parallel_kernel
from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import TILE, load
from surrofe2.plant_cell.forces import Constants
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.tissue.layout import Tissue, shares, tiled, wall_grid

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""
_BOND, _ON_LINE, _ELSEWHERE = 0, 1, 2
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

    i: Ints
    j: Ints
    shift: Ints
    shifts: Ints
    axis: Ints
    bonds: int


def make_pair_kinds(cell: CellParameters) -> PairKinds:
    """All pair kinds of a tissue of such square cells."""
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    around = range(-RINGS, RINGS + 1)
    shifts = np.array([shift for shift in product(around, around) if shift >= (0, 0)])
    at = wall_grid(cell, shifts[:1, 0], shifts[:1, 1])[0]

    number, i, j = np.indices((len(shifts), walls, walls)).reshape(3, -1)
    number, i, j = np.stack([number, i, j])[:, (number > 0) | (j > i)]
    there = at[j] + per_side * shifts[number]
    in_column, in_row = ((at[i] == there) & (at[i] == 0)).T
    axis = np.where(in_row, _ALONG_X, np.where(in_column, _ALONG_Y, _NO_LINE))
    kind = np.where(axis == _NO_LINE, _ELSEWHERE, _ON_LINE)
    kind[abs(there - at[i]).sum(axis=1) == 1] = _BOND

    rim = np.flatnonzero(shifts.min(axis=1) >= 0)
    around_cell = (at + per_side * shifts[rim, None] <= per_side).all(axis=2)
    place, wall = np.nonzero(around_cell)
    fluid = np.arange(walls, walls + cell.fluid_particles_per_side**2)
    inside = np.repeat(fluid, len(wall))
    touching = np.array([_ELSEWHERE, 0, 0, 0, _NO_LINE])[:, None] + np.zeros_like(inside)
    touching[1:4] = inside, np.tile(wall, len(fluid)), np.tile(rim[place], len(fluid))

    table = np.hstack([[kind, i, j, number, axis], touching])
    kind, i, j, number, axis = np.ascontiguousarray(table[:, np.lexsort(table[3::-1])])
    return PairKinds(i, j, number, shifts, axis, int((kind == _BOND).sum()))


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
    row: Ints
    fluid: Array
    cutoff: float

    def times(self, factors: Factors) -> PairConstants:
        """With factors on elastic constants and on those of dashpots and viscosity."""
        elastic, damping = factors
        both = np.array(factors)[:, None]
        return PairConstants(
            self.bonds * np.array([elastic, 1.0, damping])[:, None],
            self.contacts * both,
            self.row,
            self.fluid * np.array([1.0, 1.0, elastic, damping])[:, None],
            self.cutoff,
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
def contact_at(rows, k, cutoff):
    """The `Contact` of a row of `PairConstants.contacts`."""
    return Contact(load(rows, k, 0), load(rows, k, 1), cutoff)


@pair_law
def fluid_at(rows, t):
    """The `FluidConstants` of a row of `PairConstants.fluid`."""
    return FluidConstants(load(rows, t, 0), load(rows, t, 1), load(rows, t, 2), load(rows, t, 3))


class Grid(NamedTuple):
    """Neighbouring places.

    Attributes:
        place: (tiles, shifts, TILE) place of the cell at each of `PairKinds.shifts`, or −1.
        exists: (tiles, own, TILE) 1.0 where there is a particle, else 0.
        per_count: (tiles, TILE) 1/(number of own particles), or 0.
        next_shifts: the shifts to the next column or row.
    """

    place: Ints
    exists: Array
    per_count: Array
    next_shifts: Ints


class PairLists(NamedTuple):
    """Pairs of all tiles one after another; those of tile t are [starts[t, k], starts[t + 1, k]).

    Attributes:
        starts: (tiles + 1, 4) of images, bonds, contacts, folds.
        source: (images, TILE) flat index of the owner in (tiles + 1, 2, local, TILE).
        bonds, contacts: (·, 2) local particles.
        fold: (folds,) own particle; fold_source: (folds, TILE) flat index of the image force.
        order: (tiles,) in which to go through them: those with and without fluid evenly mixed,
            so that equal parts of it cost threads the same.
        local: local particles of a tile, at most.
        fluid_tiles: how many tiles, the first ones, have fluid.
        skin: how far particles of neighbouring cells may move against one another, µm.
    """

    starts: Ints
    source: Ints
    bonds: NDArray[np.int32]
    contacts: NDArray[np.int32]
    fold: Ints
    fold_source: Ints
    order: Ints
    local: int
    fluid_tiles: int
    skin: float


class PairLister:
    """Makes `PairLists` for one tissue, and the constants of their pairs."""

    def __init__(self, tissue: Tissue, skin: float) -> None:
        self._tissue, self._skin = tissue, skin
        kinds = self._kinds = make_pair_kinds(tissue.cell)
        rings = abs(kinds.shifts).max(axis=1)
        self._reach = tissue.cell.repulsion_cutoff + skin * np.maximum(rings, 1)[kinds.shift]
        ends = np.array(tissue.place.shape)
        at = np.stack([tissue.column, tissue.row], axis=1)
        there = at[:, None] + kinds.shifts
        inside = ((there >= 0) & (there < ends)).all(axis=2) & (at[:, :1] >= 0)
        place = tissue.place[tuple(np.where(inside[..., None], there, 0).T)].T
        exists = tissue.exists.astype(np.float64)
        count = exists.sum(axis=1)
        self.grid = Grid(
            place=tiled(np.where(inside, place, -1)),
            exists=exists,
            per_count=np.where(count > 0, 1.0 / np.maximum(count, 1.0), 0.0),
            next_shifts=np.flatnonzero(rings == 1),
        )
        self._set_constants()

    def _set_constants(self) -> None:
        """Those of bonds and fluid, and what contacts have by their particles and wall lines."""
        tissue, kinds = self._tissue, self._kinds
        column, row = tissue.column, tissue.row
        # one more type, the last, for plant cells that are not there
        table = np.array([*tissue.constants, np.zeros(len(Constants._fields))])
        of = dict(zip(Constants._fields, table.T, strict=True))
        here = np.pad(tissue.kind, 1, constant_values=-1)
        own = here[column + 1, row + 1]
        # the plant cells on both sides of the wall along x, and of the one along y
        both = np.array([[own, here[column + 1, row]], [own, here[column, row + 1]]])
        half = 0.5 * np.where((both >= 0).all(axis=1), 1.0, tissue.cell.outer_wall)
        stiffness = of["wall_stiffness"][both]
        total = stiffness.sum(axis=1)
        rest = (stiffness * of["rest_length"][both]).sum(axis=1) / np.maximum(total, 1e-60)
        damping = of["wall_damping"][both].sum(axis=1)
        walls = np.stack([half * total, rest, half * damping], axis=2)
        bonds = tiled(np.stack([walls[axis] for axis in kinds.axis[: kinds.bonds]], axis=1))
        self._bonds = bonds.reshape(-1, 3, TILE)
        # by axis, of pairs along such a wall: ½ `outer_wall` on the boundary; of others
        along = np.where((both >= 0).all(axis=1), 1.0, half)
        self._weight = np.append(along, np.ones_like(along[:1]), axis=0).reshape(3, -1, TILE)
        # places without fluid have some, so that kernels may divide
        fluid = np.stack([of[name][np.maximum(own, 0)] for name in FluidConstants._fields], axis=1)
        self._fluid = tiled(fluid) if len(tissue.types) > 1 else tiled(fluid)[:1]
        part = np.stack(
            [shares(tissue.cell, tissue.kind == k, column, row) for k in range(len(tissue.types))],
            axis=2,
        )
        part /= np.maximum(part.sum(axis=2, keepdims=True), 1e-3)
        self._particles = part @ table[:-1, [_REPULSION, _DAMPING]]  # (places, own, 2)

    def make(self, x: Array) -> tuple[PairLists, PairConstants]:
        """Lists at positions x (tiles, 2, own, TILE), µm, and the constants of their pairs.

        Raises:
            SimulationError: positions are not finite, or plant cells with two others between
                them come so close that lists could miss a pair.
        """
        tissue, kinds, grid = self._tissue, self._kinds, self.grid
        self._check_apart(x)
        close = np.zeros((len(x), len(kinds.i)), dtype=np.bool_)
        mark_close(x, kinds, self._reach, grid, close)
        close[:, : kinds.bonds] = True
        tile, kind = np.nonzero(close)
        j, shift = kinds.j[kind].copy(), kinds.shift[kind]
        elsewhere = shift > 0
        key = ((tile * len(kinds.shifts) + shift) * tissue.own + j)[elsewhere]
        images, number = np.unique(key, return_inverse=True)
        shift_of_image, owner = np.divmod(images, tissue.own)
        tile_of_image, shift_of_image = np.divmod(shift_of_image, len(kinds.shifts))
        image_starts = _starts(tissue, tile_of_image)
        j[elsewhere] = tissue.own + number - image_starts[tile[elsewhere]]
        local = tissue.own + int(np.diff(image_starts).max())
        pairs = np.stack([kinds.i[kind], j], axis=1).astype(np.int32)
        is_bond = kind < kinds.bonds
        place = grid.place[tile_of_image, shift_of_image]
        counts = tissue.fluid_tiles, tissue.tiles - tissue.fluid_tiles
        spots = [(np.arange(n) + 0.5) / max(n, 1) for n in counts]
        fold, fold_source, fold_starts = _folds(tissue, place, owner, image_starts, local)
        there, lane = np.divmod(place, TILE)
        source = (there * 2 * local + owner[:, None]) * TILE + lane
        pair_starts = (_starts(tissue, tile[which]) for which in (is_bond, ~is_bond))
        starts = np.stack([image_starts, *pair_starts, fold_starts], axis=1)
        lists = PairLists(
            starts=np.ascontiguousarray(starts),
            source=np.where(place < 0, _nowhere(tissue, local), source),
            bonds=pairs[is_bond],
            contacts=pairs[~is_bond],
            fold=fold,
            fold_source=fold_source,
            # tiles with and without fluid mixed, so that equal parts of the order cost the same
            order=np.argsort(np.concatenate(spots), kind="stable"),
            local=local,
            fluid_tiles=tissue.fluid_tiles,
            skin=self._skin,
        )
        return lists, self._constants(tile[~is_bond], kind[~is_bond])

    def _constants(self, tile: Ints, kind: Ints) -> PairConstants:
        """For listed contacts, which follow the bonds: the kind of each in its tile, in order."""
        kinds, here = self._kinds, tile[:, None] * TILE + np.arange(TILE)
        there = self.grid.place[tile, kinds.shift[kind]]
        sums = self._particles[here, kinds.i[kind, None]]
        sums = sums + self._particles[there, kinds.j[kind, None]]
        contacts = np.moveaxis(0.5 * sums, 1, 2) * self._weight[kinds.axis[kind], tile, None]
        row = np.arange(len(kind))
        inner = np.flatnonzero(kinds.axis[kind] == len(self._weight) - 1)
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
        grid, tissue = self.grid, self._tissue
        if not np.isfinite(x).all():
            raise SimulationError("tissue: positions are not finite")
        weight = grid.exists * grid.per_count[:, None]
        centre = (x * weight[:, None]).sum(axis=2)
        extent = np.hypot(*np.moveaxis((x - centre[:, :, None]) * grid.exists[:, None], 1, 0)).max()
        there = tissue.column >= 0
        centres = np.moveaxis(centre, 1, 2).reshape(-1, 2)[there]
        at = np.stack([tissue.column, tissue.row], axis=1)[there]
        near = tissue.cell.repulsion_cutoff + 2.0 * extent
        tree = scipy.spatial.cKDTree(centres)
        i, j = tree.query_pairs(near + self._skin * at.max(), output_type="ndarray").T
        rings = abs(at[i] - at[j]).max(axis=1)
        distance = np.hypot(*(centres[i] - centres[j]).T)
        if (distance < near + self._skin * rings)[rings > RINGS].any():
            raise SimulationError(
                f"tissue: plant cells with {RINGS} others between them come within reach of each "
                "other; the tissue has collapsed"
            )


def bonded_particles(tissue: Tissue) -> Ints:
    """(b, 2) numbers of the particles that wall springs join: neighbours on the grid of springs."""
    walls = tissue.outline[: tissue.wall_particles]
    at = np.rint(walls / tissue.cell.spring_length).astype(np.int64)
    number = np.full(at.max(axis=0) + 2, -1)
    number[tuple(at.T)] = np.arange(len(at))
    ahead = np.concatenate([number[tuple(at.T + step)] for step in ([[1], [0]], [[0], [1]])])
    pairs = np.stack([np.tile(np.arange(len(at)), 2), ahead], axis=1)
    return pairs[ahead >= 0]


def _starts(tissue: Tissue, tile: Ints) -> Ints:
    """(tiles + 1,) where each tile begins among rows whose ascending tiles are given."""
    return np.searchsorted(tile, np.arange(tissue.tiles + 1))


def _nowhere(tissue: Tissue, local: int) -> int:
    """Flat index of particles that stay where they are and of a force that is always zero."""
    return tissue.tiles * 2 * local * TILE


def _folds(
    tissue: Tissue, place: Ints, owner: Ints, image_starts: Ints, local: int
) -> tuple[Ints, Ints, Ints]:
    """fold and fold_source of `PairLists`, and where each tile's folds start.

    Row r of an own particle holds, lane by lane, the r-th image of it that exists; lanes with
    fewer images read a force that is always zero.

    Args:
        place: (images, TILE) of the cells whose own particles `owner` (images,) have the images.
    """
    there, lane = np.divmod(place, TILE)
    key = (there * tissue.own + owner[:, None]) * TILE + lane
    exists = (place >= 0) & tissue.exists.reshape(-1)[np.where(place < 0, 0, key)]
    image, lane = np.nonzero(exists)
    tile = np.searchsorted(image_starts, image, side="right") - 1
    number = tissue.own + image - image_starts[tile]
    source = (tile * 2 * local + number) * TILE + lane
    key = key[exists]
    order = np.argsort(key, kind="stable")
    key, source = key[order], source[order]
    rank = np.arange(len(key)) - np.searchsorted(key, key, side="left")
    particle, at_lane = np.divmod(key, TILE)
    rows, row = np.unique(np.stack([particle, rank], axis=1), axis=0, return_inverse=True)
    fold_source = np.full((len(rows), TILE), _nowhere(tissue, local))
    fold_source[row.reshape(-1), at_lane] = source
    own_tile, fold = np.divmod(rows[:, 0], tissue.own)
    return fold, fold_source, _starts(tissue, own_tile)


@parallel_kernel
def mark_close(x, kinds, reach, grid, close):
    """close (tiles, kinds): whether any lane has that pair within its `reach`."""
    for t in numba.prange(x.shape[0]):
        _mark_close_in_tile(t, x, kinds, reach, grid, close)


@kernel
def _mark_close_in_tile(t, x, kinds, reach, grid, close):
    for k in range(kinds.i.shape[0]):
        i, j, s = kinds.i[k], kinds.j[k], kinds.shift[k]
        for lane in range(TILE):
            there = grid.place[t, s, lane]
            if there < 0:
                continue
            tile, other = there // TILE, there % TILE
            rx = x[tile, 0, j, other] - x[t, 0, i, lane]
            ry = x[tile, 1, j, other] - x[t, 1, i, lane]
            if rx * rx + ry * ry <= reach[k] * reach[k]:
                close[t, k] = True
                break
