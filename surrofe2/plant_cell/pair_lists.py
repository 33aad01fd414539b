"""Who interacts with whom in an arrangement of plant cells: bonds, contacts, fluid pairs.

Contacts: fluid with the walls around its plant cell, and wall particles that are not bonded to
each other, wherever they are. A `Patch` lists those within a distance in the reference, and tells
beside them what it leaves out, for a check against the cut-off.

Kernels see local particles only: first the unit's own, then images of those that they interact
with; a pair (i, j) needs no shift. All RVEs of one arrangement share the lists, so that they can
be SIMD lanes. Until then a pair is a row (i, j, a, b): own particles, and the lattice shift of j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.arrangement import Arrangement, make_arrangement
from surrofe2.plant_cell.block_pattern import make_pattern, sparse_pays
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import Topology

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

LEVELS = ((1.2, 1.2), (1.4, 1.4), (3.0, 1.4))
"""Reach of lists in cut-offs: of pairs in one plant cell, and of wall pairs in none together."""
WHOLE_CELLS = ((np.inf, 1.4),)
"""One list that serves wherever the fluid of a plant cell is."""
FARTHEST = 3.0
"""What is farther apart than so many cut-offs in the reference is not looked at again."""
_SHIFTS = 128
"""Lattice shifts are smaller than half of this."""


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
class Patch:
    """Particles of a periodic unit and who interacts with whom.

    Attributes:
        position: (n, 2) reference positions of the unit's own particles, µm; walls come first.
        mass: (n,) ng.
        lattice: (2, 2) µm, its columns the periods.
        shift: (g, 2) integer lattice shift of each image.
        topology: images and pair lists.
        reach: reference distance (µm) up to which all contacts are listed.
        unlisted: the contacts beyond.
    """

    position: Array
    mass: Array
    lattice: Array
    shift: Ints
    topology: Topology
    reach: float
    unlisted: Unlisted


def make_patches(
    cell: CellParameters,
    position: Array,
    lattice: Array,
    levels: tuple[tuple[float, float], ...] = LEVELS,
    *,
    sparse: bool | None = None,
    arrangement: Arrangement | None = None,
) -> tuple[Patch, ...]:
    """Pair lists of an arrangement, one for each of the `levels`.

    Args:
        position: (n, 2) reference positions, µm.
        lattice: (2, 2), its columns the lattice vectors, µm.
        levels: reach in cut-offs, of contacts in one plant cell and of others; see `LEVELS`.
        sparse: whether matrices have blocks of interacting groups alone; None: where that pays.
        arrangement: instead of the cell's own, such as a slab.
    """
    arrangement, particles = arrangement or make_arrangement(cell), len(position)
    walls, cutoff = arrangement.walls, cell.repulsion_cutoff
    every, distance, common = _contacts(arrangement, position, lattice, FARTHEST * cutoff)
    mass = np.full(particles, cell.fluid_mass)
    share = 0.5 * cell.outer_wall
    mass[:walls] = cell.wall_particle_mass * np.where(arrangement.outer > 0, share, 1.0)
    counts = np.array(arrangement.fluid_counts)
    fluid = np.concatenate(
        [first + np.stack(np.triu_indices(count, 1), axis=1)
         for first, count in zip(walls + arrangement.fluid_start, counts, strict=False)]
    )  # fmt: skip
    inside = np.pad(fluid, ((0, 0), (0, 2))).astype(np.int32)
    within = [distance <= np.where(common, near * cutoff, far * cutoff) for near, far in levels]
    pattern = make_pattern(*interacting_groups(arrangement, every[within[-1]]))
    if not (sparse or (sparse is None and sparse_pays(pattern))):
        pattern = make_pattern(np.zeros(particles, dtype=np.int32), [])
    patches = []
    for level, listed in zip(levels, within, strict=True):
        central = (arrangement.bonds, every[listed])
        lists = [_sorted(pairs[~_is_outer(arrangement, pairs)]) for pairs in central]
        lists += [_sorted(pairs[_is_outer(arrangement, pairs)]) for pairs in central] + [inside]
        owner, shift, (bonds, contacts, outer, touching, fluid_pairs) = _localised(lists, particles)
        topology = Topology(
            bonds=bonds,
            contacts=contacts,
            fluid_pairs=fluid_pairs,
            outer_bonds=outer,
            outer_contacts=touching,
            outer_share=share,
            owner=owner,
            image_offset=np.ascontiguousarray(shift @ lattice.T),
            particles=particles,
            walls=walls,
            fluid_start=arrangement.fluid_start,
            fluid_pair_start=np.append(0, np.cumsum(counts * (counts - 1) // 2)).astype(np.int32),
            area=abs(float(np.linalg.det(lattice))),
            **pattern._asdict(),
        )
        rest, reach = every[~listed], min(level) * cutoff
        ends = np.ascontiguousarray(rest[:, :2])
        unlisted = Unlisted(ends, rest[:, 2:] @ lattice.T, FARTHEST * cutoff)
        patches.append(Patch(position, mass, lattice, shift, topology, reach, unlisted))
    return tuple(patches)


def interacting_groups(
    arrangement: Arrangement, contacts: Ints
) -> tuple[Ints, set[tuple[int, int]]]:
    """(n,) group of each particle, the walls of an edge or a plant cell's fluid; coupled groups.

    contacts: (k, 2) or more columns, the first two the particles that may touch, by their owners.
    """
    first = int(arrangement.wall_edge.max()) + 1
    counts = arrangement.fluid_counts
    labels = np.concatenate(
        [arrangement.wall_edge, first + np.repeat(np.arange(len(counts)), counts)]
    )
    pairs = set()
    for k, rim in enumerate(arrangement.rims):
        around = {*labels[rim[:, 0]].tolist(), first + k}
        pairs |= {(g, h) for g in around for h in around}
    for listed in (arrangement.bonds, contacts):
        pairs |= {(g, h) for g, h in np.unique(labels[listed[:, :2]], axis=0).tolist()}
    return labels, pairs


def _contacts(
    arrangement: Arrangement, position: Array, lattice: Array, reach: float
) -> tuple[Ints, Array, NDArray[np.bool_]]:
    """Possible contacts (k, 4), their distances, µm, and whether one plant cell holds both.

    Walls are listed within `reach` of each other; fluid and the walls around it at any distance:
    fluid may flow.
    """
    walls = arrangement.walls
    pairs = _wall_pairs(position[:walls], lattice, reach)
    pairs = pairs[~np.isin(_keys(pairs), _keys(arrangement.bonds))]
    common = np.isin(_keys(pairs), np.concatenate([_keys(_all_pairs(r)) for r in arrangement.rims]))
    fluid = walls + arrangement.fluid_start
    touching = []
    for first, last, rim in zip(fluid[:-1], fluid[1:], arrangement.rims, strict=True):
        inside = np.repeat(np.arange(first, last), len(rim))[:, None]
        touching.append(np.hstack([inside, np.tile(rim, (last - first, 1))]))
    every = np.concatenate([pairs, *touching]).astype(np.int32)
    i, j, shift = every[:, 0], every[:, 1], every[:, 2:]
    distance = np.linalg.norm(position[j] + shift @ lattice.T - position[i], axis=1)
    near = (distance <= reach) | (i >= walls)
    common = np.concatenate([common, np.ones(len(every) - len(pairs), dtype=np.bool_)])
    return every[near], distance[near], common[near]


def _wall_pairs(position: Array, lattice: Array, reach: float) -> NDArray[np.int64]:
    """(k, 4) pairs of wall particles within reach, each once."""
    height = abs(np.linalg.det(lattice)) / np.linalg.norm(lattice, axis=0)[::-1]
    extent = np.ptp(np.linalg.solve(lattice, position.T), axis=1)
    most = np.ceil(reach / height + extent).astype(int)
    found = []
    for a in range(-most[0], most[0] + 1):
        for b in range(-most[1], most[1] + 1):
            r = position[None] + lattice @ np.array([a, b]) - position[:, None]
            i, j = np.nonzero((r**2).sum(axis=2) <= reach**2)
            once = (i < j) | ((i == j) & ((a, b) > (0, 0)))
            i, j = i[once], j[once]
            found.append(np.stack([i, j, np.full_like(i, a), np.full_like(i, b)], axis=1))
    return np.concatenate(found)


def _all_pairs(rim: Ints) -> Ints:
    """(k, 4) pairs of different wall particles, by their images, around one plant cell."""
    p, q = np.nonzero(~np.eye(len(rim), dtype=np.bool_))
    return np.column_stack([rim[p, 0], rim[q, 0], rim[q, 1:] - rim[p, 1:]])


def _keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """One number for each pair (k, 4), the same whichever of the two comes first."""
    i, j, a, b = pairs.T.astype(np.int64)
    turned = (i > j) | ((i == j) & ((a < 0) | ((a == 0) & (b < 0))))
    i, j = np.where(turned, j, i), np.where(turned, i, j)
    a, b = np.where(turned, -a, a), np.where(turned, -b, b)
    # i, j, a, b side by side in 64 bits; shifts are raised by half of `_SHIFTS` to be positive
    return ((i << 32) | j) * _SHIFTS**2 + (a + _SHIFTS // 2) * _SHIFTS + b + _SHIFTS // 2


def _is_outer(arrangement: Arrangement, pairs: Ints) -> NDArray[np.bool_]:
    """(k,) whether both particles of pairs (k, 4) lie along one outer wall."""
    of = np.pad(arrangement.outer, (0, arrangement.particles - arrangement.walls))
    along: NDArray[np.bool_] = (of[pairs[:, 0]] > 0) & (of[pairs[:, 0]] == of[pairs[:, 1]])
    return along


def _sorted(pairs: Ints) -> Ints:
    return pairs[np.lexsort(pairs.T[::-1])]


def _localised(lists: list[Ints], particles: int) -> tuple[Ints, Ints, list[Ints]]:
    """Owner and shift of the images in `lists`, numbered as they first appear; local pairs."""
    every = np.concatenate(lists)
    shifted = every[:, 2:].any(axis=1)
    kinds, first, number = np.unique(
        every[shifted, 1:], axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    local = every[:, :2].copy()
    local[shifted, 1] = particles + rank[number.reshape(-1)]
    images = kinds[order].astype(np.int32)
    ends = np.cumsum([len(pairs) for pairs in lists])
    return (
        np.ascontiguousarray(images[:, 0]),
        np.ascontiguousarray(images[:, 1:]),
        [np.ascontiguousarray(part) for part in np.split(local, ends[:-1])],
    )
