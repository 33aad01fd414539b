"""Which particles of which plant cells interact: the rules of eqs. (1) and (2), for lanes.

A pair kind is (i, j, shift): own particle i of any plant cell with own particle j of the cell
`shift` columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice.

Wall particles sit on the lines of a grid of springs. Those a spring apart are bonded; all others
touch. Two on one wall line share that line's wall, so at the tissue's boundary their contact is
halved like their bonds, times `outer_wall`; across a corner they touch through one plant cell and
are not. Fluid touches the walls around its own cell.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters

Ints = NDArray[np.int64]

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""
_BOND, _ON_LINE, _ELSEWHERE = 0, 1, 2
_ALONG_X, _ALONG_Y, _NO_LINE = 0, 1, -1


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
