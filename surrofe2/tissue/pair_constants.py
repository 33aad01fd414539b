"""Which particles of which plant cells interact, and by what constants; for lanes.

A pair kind is (i, j, shift): own particle i of any plant cell with own particle j of the cell
`shift` columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice.

Wall particles sit on the lines of a grid of springs. Those a spring apart are bonded; all others
touch. Two on one wall line share that line's wall, so at the tissue's boundary their contact is
halved like their bonds, times `outer_wall`; across a corner they touch through one plant cell and
are not. Fluid touches the walls around its own cell.

A wall between two plant cells is made of half a wall of each, so its bonds have the sum of both
halves: mean stiffness k and damping, and the rest length Σ k l₀/Σ k at which both halves balance. A
wall particle has the mean repulsion and contact damping of the plant cells around it, and a contact
the mean of its two particles. Fluid has the constants of its plant cell. Every mean is over plant
cells that are there; at the tissue's boundary, where one is missing, the weight of a pair halves
it. FE² knows no walls of two types: there each type begins where the other ends.
"""

from __future__ import annotations

from collections import namedtuple
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import pair_law
from surrofe2.base.simd import TILE, load
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import Constants
from surrofe2.tissue.layout import Tissue, shares, tiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""
_BOND, _ON_LINE, _ELSEWHERE = 0, 1, 2
_ALONG_X, _ALONG_Y, _NO_LINE = 0, 1, -1
_REPULSION, _DAMPING = map(Constants._fields.index, ("repulsion", "contact_damping"))


class PairKinds(NamedTuple):
    """Pair kinds in the order bonds, contacts along one line, other contacts.

    Attributes:
        i, j: (kinds,) own particles.
        shift: (kinds,) index into `shifts`.
        shifts: (s, 2) columns and rows; the first are none.
        axis: (kinds,) which wall line of the cell of i both lie on: 0 the one along x, 1 the one
            along y, −1 none.
        bonds, lines: how many kinds are bonds, and how many contacts along one line follow.
    """

    i: Ints
    j: Ints
    shift: Ints
    shifts: Ints
    axis: Ints
    bonds: int
    lines: int


def make_pair_kinds(cell: CellParameters) -> PairKinds:
    """All pair kinds of a tissue of such square cells."""
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    around = range(-RINGS, RINGS + 1)
    shifts = np.array([shift for shift in product(around, around) if shift >= (0, 0)])
    along = np.arange(1, per_side)
    at = np.zeros((walls, 2), dtype=np.int64)  # column and row on the grid of springs
    at[1:per_side, 0], at[per_side:, 1] = along, along

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
    bonds, lines = int((kind == _BOND).sum()), int((kind == _ON_LINE).sum())
    return PairKinds(i, j, number, shifts, axis, bonds, lines)


Factors = tuple[float, float]
"""On the elastic and on the damping part of all forces between particles."""
WHOLE: Factors = (1.0, 1.0)
ELASTIC: Factors = (1.0, 0.0)
DAMPING: Factors = (0.0, 1.0)


class PairConstants(NamedTuple):
    """Lanes last, weights included.

    Attributes:
        bonds: (bonds, 3, TILE) stiffness, rest length, damping.
        lines, contacts: (·, 2, TILE) repulsion and contact damping.
        fluid: (tiles, 4, TILE) smoothing length, fluid mass, sound speed squared, viscosity; of
            one type of plant cell fluid and contacts have one row, which serves all.
        cutoff: of contacts, µm.
    """

    bonds: Array
    lines: Array
    contacts: Array
    fluid: Array
    cutoff: float

    def times(self, factors: Factors) -> PairConstants:
        """With factors on elastic constants and on those of dashpots and viscosity."""
        elastic, damping = factors
        both = np.array(factors)[:, None]
        return PairConstants(
            self.bonds * np.array([elastic, 1.0, damping])[:, None],
            self.lines * both,
            self.contacts * both,
            self.fluid * np.array([1.0, 1.0, elastic, damping])[:, None],
            self.cutoff,
        )


# of a bond, a contact and the fluid in a tile, as `pair_laws` takes them; lanes
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
    """The `Contact` of a row of `PairConstants.lines` or `contacts`."""
    return Contact(load(rows, k, 0), load(rows, k, 1), cutoff)


@pair_law
def fluid_at(rows, t):
    """The `FluidConstants` of a row of `PairConstants.fluid`."""
    return FluidConstants(load(rows, t, 0), load(rows, t, 1), load(rows, t, 2), load(rows, t, 3))


class ConstantsMaker:
    """Makes the `PairConstants` of a tissue for any of its pair lists.

    Args:
        place: (tiles, shifts, TILE) of the plant cell at each of `PairKinds.shifts`, or −1.
    """

    def __init__(self, tissue: Tissue, kinds: PairKinds, place: Ints) -> None:
        self._tissue, self._kinds, self._place = tissue, kinds, place
        # one more type, the last, for plant cells that are not there
        table = np.array([*tissue.constants, np.zeros(len(Constants._fields))])
        of = dict(zip(Constants._fields, table.T, strict=True))
        here, column, row = np.pad(tissue.kind, 1, constant_values=-1), tissue.column, tissue.row
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
        # by axis, of pairs along such a wall: ½ `outer_wall` on the boundary
        self._weight = np.where((both >= 0).all(axis=1), 1.0, half).reshape(2, -1, TILE)
        # places without fluid have some, so that kernels may divide
        fluid = np.stack([of[name][np.maximum(own, 0)] for name in FluidConstants._fields], axis=1)
        self._fluid = tiled(fluid if len(tissue.types) > 1 else fluid[:TILE])
        part = np.stack(
            [shares(tissue.cell, tissue.kind == k, column, row) for k in range(len(tissue.types))],
            axis=2,
        )
        part /= np.maximum(part.sum(axis=2, keepdims=True), 1e-3)
        self._particles = part @ table[:-1, [_REPULSION, _DAMPING]]  # (places, own, 2)

    def make(self, tile: Ints, kind: Ints) -> PairConstants:
        """For listed contacts, which follow the bonds: the kind of each in its tile, in order."""
        is_line, axis = kind < self._kinds.bonds + self._kinds.lines, self._kinds.axis[kind]
        lines = self._contacts(tile[is_line], kind[is_line])
        return PairConstants(
            bonds=self._bonds,
            lines=lines * self._weight[axis[is_line], tile[is_line], None],
            contacts=self._contacts(tile[~is_line], kind[~is_line]),
            fluid=self._fluid,
            cutoff=self._tissue.cell.repulsion_cutoff,
        )

    def _contacts(self, tile: Ints, kind: Ints) -> Array:
        """(n, 2, TILE) means of the two particles of each contact; (1, 2, TILE) of one type."""
        if len(self._tissue.types) == 1:
            (only,) = self._tissue.constants
            return np.tile([[[only.repulsion], [only.contact_damping]]], TILE)
        here, there = (
            tile[:, None] * TILE + np.arange(TILE),
            self._place[tile, self._kinds.shift[kind]],
        )
        sums = self._particles[here, self._kinds.i[kind, None]]
        sums = sums + self._particles[there, self._kinds.j[kind, None]]
        return np.ascontiguousarray(np.moveaxis(0.5 * sums, 1, 2))
