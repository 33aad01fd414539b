"""Patches of any arrangement of plant cells: who interacts with whom.

Contacts: fluid with the walls around its plant cell, and wall particles that are not bonded to
each other, wherever they are. Lists of different reach hold the pairs within that distance in the
reference; what a list leaves out is told beside it, for a check against the cut-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.arrangements import Arrangement
from surrofe2.plant_cell.geometry import Pair, Patch, localised
from surrofe2.plant_cell.parameters import CellParameters

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Unlisted:
    """Contacts that a patch does not list, up to a distance `reach` in the reference.

    Attributes:
        pairs: (k, 2) own particles i, j.
        offset: (k, 2) µm in the reference, of the image of j that is meant.
        reach: µm; what is farther is in neither list.
    """

    pairs: Ints
    offset: Array
    reach: float


@dataclass(frozen=True, slots=True)
class Candidates:
    """All pairs that may come into contact: own i, own j, shift of j, distance, common cell.

    `common`: whether a plant cell holds both, by these images.
    """

    pairs: Ints
    shift: Ints
    distance: Array
    common: NDArray[np.bool_]


def candidates(
    arrangement: Arrangement, position: Array, lattice: Array, reach: float
) -> Candidates:
    """Every possible contact of walls within `reach` of each other at `position` (n, 2), µm.

    Fluid and the walls around it are listed at any distance: fluid may flow.
    """
    walls = arrangement.walls
    pairs, shifts = _wall_pairs(position[:walls], lattice, reach)
    bonded = {_normalised(i, j, s) for i, j, s in arrangement.bonds}
    shared = _sharing(arrangement)
    keys = [
        (int(i), int(j), (int(a), int(b))) for (i, j), (a, b) in zip(pairs, shifts, strict=True)
    ]
    kept = np.array([key not in bonded for key in keys], dtype=bool)
    common = np.array([key in shared for key in keys], dtype=bool)[kept]
    starts = walls + arrangement.fluid_start
    touching = [
        (f, wall, shift)
        for k, rim in enumerate(arrangement.rims)
        for wall, shift in rim
        for f in range(starts[k], starts[k + 1])
    ]
    pairs = np.concatenate([pairs[kept], np.array([t[:2] for t in touching], dtype=np.int32)])
    shifts = np.concatenate([shifts[kept], np.array([t[2] for t in touching], dtype=np.int32)])
    common = np.concatenate([common, np.ones(len(touching), dtype=bool)])
    distance = np.linalg.norm(
        position[pairs[:, 1]] + shifts @ lattice.T - position[pairs[:, 0]], axis=1
    )
    near = distance <= reach
    near[len(near) - len(touching) :] = True
    return Candidates(pairs[near], shifts[near], distance[near], common[near])


def arranged_patch(
    cell: CellParameters,
    arrangement: Arrangement,
    position: Array,
    lattice: Array,
    every: Candidates,
    reach: float,
    reach_apart: float,
) -> tuple[Patch, Unlisted]:
    """The patch with contacts up to `reach` of particles of one plant cell, else `reach_apart`.

    Args:
        position: (n, 2) reference positions, µm.
        lattice: (2, 2), its columns the lattice vectors, µm.
        every: all contacts up to some longer reach.
    """
    walls = arrangement.walls
    listed = every.distance <= np.where(every.common, reach, reach_apart)
    contacts: list[Pair] = [
        (int(i), int(j), (int(a), int(b)))
        for (i, j), (a, b) in zip(every.pairs[listed], every.shift[listed], strict=True)
    ]
    starts = walls + arrangement.fluid_start
    fluid_pairs: list[Pair] = [
        (i, j, (0, 0))
        for first, last in pairwise(starts)
        for i in range(first, last)
        for j in range(i + 1, last)
    ]
    mass = np.full(len(position), cell.fluid_mass)
    mass[:walls] = cell.wall_particle_mass
    bonds: list[Pair] = list(arrangement.bonds)
    patch = localised(
        position, mass, walls, lattice, bonds, contacts, fluid_pairs, min(reach, reach_apart),
        arrangement.fluid_start,
    )  # fmt: skip
    rest = Unlisted(
        np.ascontiguousarray(every.pairs[~listed]),
        np.ascontiguousarray(every.shift[~listed] @ lattice.T),
        float(every.distance.max(initial=0.0)),
    )
    return patch, rest


def _wall_pairs(position: Array, lattice: Array, reach: float) -> tuple[Ints, Ints]:
    """Pairs (k, 2) of wall particles within reach and shifts (k, 2) of the second, each once."""
    height = abs(np.linalg.det(lattice)) / np.linalg.norm(lattice, axis=0)[::-1]
    extent = np.ptp(np.linalg.solve(lattice, position.T), axis=1)
    most = np.ceil(reach / height + extent).astype(int)
    pairs, shifts = [], []
    for a in range(-most[0], most[0] + 1):
        for b in range(-most[1], most[1] + 1):
            r = position[None] + lattice @ np.array([a, b]) - position[:, None]
            i, j = np.nonzero((r**2).sum(axis=2) <= reach**2)
            once = (i < j) | ((i == j) & ((a, b) > (0, 0)))
            pairs.append(np.stack([i[once], j[once]], axis=1))
            shifts.append(np.broadcast_to([a, b], (once.sum(), 2)))
    return np.concatenate(pairs).astype(np.int32), np.concatenate(shifts).astype(np.int32)


def _sharing(arrangement: Arrangement) -> set[Pair]:
    """All pairs of wall particles, by their images, that bound a common plant cell."""
    return {
        _normalised(i, j, (t[0] - s[0], t[1] - s[1]))
        for rim in arrangement.rims
        for i, s in rim
        for j, t in rim
        if (i, s) != (j, t)
    }


def _normalised(i: int, j: int, shift: tuple[int, int]) -> Pair:
    """The same pair with i < j, or with a positive shift for a particle and its own image."""
    a, b = shift
    return (i, j, (a, b)) if i < j or (i == j and (a, b) > (0, 0)) else (j, i, (-a, -b))
