"""Which particles of which plant cells interact: the rules of eqs. (1) and (2), for lanes.

A pair kind is (i, j, shift): own particle i of any plant cell with own particle j of the cell
`shift` columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice.

Wall particles sit on the lines of a grid of springs. Those a spring apart are bonded; all others
touch. Two on one wall line share that line's wall, so at the tissue's boundary their contact is
halved like their bonds; across a corner they touch through one plant cell and are not. Fluid
touches the walls around its own cell.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters

Ints = NDArray[np.int64]
Shift = tuple[int, int]

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""
_BOND, _ON_LINE, _ELSEWHERE = 0, 1, 2


class PairKinds(NamedTuple):
    """Pair kinds in the order bonds, contacts along one line, other contacts.

    Attributes:
        i, j: (kinds,) own particles.
        shift: (kinds,) index into `shifts`.
        shifts: (s, 2) columns and rows.
        line: (kinds, 2) axis of the wall line that both lie on (0: it runs along x, 1: along y)
            or −1, and that line's column or row relative to the cell of i.
        bonds, lines: how many kinds are bonds, and how many contacts along one line follow.
    """

    i: Ints
    j: Ints
    shift: Ints
    shifts: Ints
    line: Ints
    bonds: int
    lines: int


def make_pair_kinds(cell: CellParameters) -> PairKinds:
    """All pair kinds of a tissue of such square cells."""
    around = range(-RINGS, RINGS + 1)
    shifts = [shift for shift in product(around, around) if shift >= (0, 0)]
    table = np.array(
        sorted([*_wall_kinds(cell.wall_springs_per_side, shifts), *_fluid_kinds(cell, shifts)])
    )
    kind, i, j, shift = np.ascontiguousarray(table[:, :4].T)
    return PairKinds(
        i, j, shift, np.array(shifts), table[:, 4:],
        int((kind == _BOND).sum()), int((kind == _ON_LINE).sum()),
    )  # fmt: skip


def _grid(particle: int, per_side: int) -> tuple[int, int]:
    """Column and row of a wall particle on the grid of springs of its cell."""
    return (particle, 0) if particle < per_side else (0, particle - per_side + 1)


def _wall_kinds(per_side: int, shifts: list[Shift]) -> list[tuple[int, ...]]:
    walls = range(2 * per_side - 1)
    rows: list[tuple[int, ...]] = []
    for (number, (a, b)), i, j in product(enumerate(shifts), walls, walls):
        if (a, b) == (0, 0) and j <= i:
            continue
        at_i, there = _grid(i, per_side), _grid(j, per_side)
        at_j = there[0] + a * per_side, there[1] + b * per_side
        line = _common_line(at_i, at_j, per_side)
        spring_apart = abs(at_i[0] - at_j[0]) + abs(at_i[1] - at_j[1]) == 1
        kind = _BOND if spring_apart else _ON_LINE if line[0] >= 0 else _ELSEWHERE
        rows.append((kind, i, j, number, *line))
    return rows


def _common_line(at_i: tuple[int, int], at_j: tuple[int, int], per_side: int) -> tuple[int, int]:
    for axis in (0, 1):
        across = at_i[1 - axis]
        if across == at_j[1 - axis] and across % per_side == 0:
            return axis, across // per_side
    return -1, 0


def _fluid_kinds(cell: CellParameters, shifts: list[Shift]) -> list[tuple[int, ...]]:
    """Fluid with the walls around its cell."""
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    fluid = range(walls, walls + cell.fluid_particles_per_side**2)
    rows: list[tuple[int, ...]] = []
    for (a, b), wall in product(product((0, 1), (0, 1)), range(walls)):
        column, row = _grid(wall, per_side)
        if column + a * per_side <= per_side and row + b * per_side <= per_side:
            rows += [(_ELSEWHERE, f, wall, shifts.index((a, b)), -1, 0) for f in fluid]
    return rows
