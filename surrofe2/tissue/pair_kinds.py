"""Which particles of which plant cells interact: the rules of eqs. (1) and (2), for lanes.

A pair kind is (i, j, shift): own particle i of any plant cell with own particle j of the cell
`shift` columns and rows further. Of two opposite shifts one is kept, so that no pair counts twice.

Wall particles sit on the lines of a grid of springs. Those a spring apart are bonded; all others
touch. Two on one wall line share that line's wall, so at the tissue's boundary their contact is
halved like their bonds; across a corner they touch through one plant cell and are not. Fluid
touches the walls around its own cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters

Ints = NDArray[np.int64]

RINGS = 2
"""Walls of plant cells up to this many columns or rows apart are looked at."""


@dataclass(frozen=True, slots=True)
class PairKinds:
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
    per_side = cell.wall_springs_per_side
    shifts = _half_of_the_shifts()
    rows = [*_wall_kinds(per_side, shifts), *_rim_kinds(cell, shifts)]
    table = np.array(sorted(rows), dtype=np.int64)
    kind = table[:, 0]
    return PairKinds(
        i=table[:, 1],
        j=table[:, 2],
        shift=table[:, 3],
        shifts=np.array(shifts),
        line=table[:, 4:],
        bonds=int((kind == 0).sum()),
        lines=int((kind == 1).sum()),
    )


def _half_of_the_shifts() -> list[tuple[int, int]]:
    around = range(-RINGS, RINGS + 1)
    return [(a, b) for a in around for b in around if (a, b) >= (0, 0)]


def _grid(particle: int, per_side: int) -> tuple[int, int]:
    """Column and row of a wall particle on the grid of springs of its cell."""
    return (particle, 0) if particle < per_side else (0, particle - per_side + 1)


def _wall_kinds(per_side: int, shifts: list[tuple[int, int]]) -> list[tuple[int, ...]]:
    walls = range(2 * per_side - 1)
    rows: list[tuple[int, ...]] = []
    for number, (a, b) in enumerate(shifts):
        for i in walls:
            for j in walls:
                if (a, b) == (0, 0) and j <= i:
                    continue
                at_i, there = _grid(i, per_side), _grid(j, per_side)
                at_j = there[0] + a * per_side, there[1] + b * per_side
                line = _common_line(at_i, at_j, per_side)
                spring_apart = abs(at_i[0] - at_j[0]) + abs(at_i[1] - at_j[1]) == 1
                kind = 0 if spring_apart else 1 if line[0] >= 0 else 2
                rows.append((kind, i, j, number, *line))
    return rows


def _common_line(at_i: tuple[int, int], at_j: tuple[int, int], per_side: int) -> tuple[int, int]:
    for axis in (0, 1):
        across = at_i[1 - axis]
        if across == at_j[1 - axis] and across % per_side == 0:
            return axis, across // per_side
    return -1, 0


def _rim_kinds(cell: CellParameters, shifts: list[tuple[int, int]]) -> list[tuple[int, ...]]:
    per_side = cell.wall_springs_per_side
    walls = 2 * per_side - 1
    fluid = range(walls, walls + cell.fluid_particles_per_side**2)
    rows: list[tuple[int, ...]] = []
    for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
        for wall in range(walls):
            column, row = _grid(wall, per_side)
            if column + a * per_side <= per_side and row + b * per_side <= per_side:
                rows += [(2, f, wall, shifts.index((a, b)), -1, 0) for f in fluid]
    return rows
