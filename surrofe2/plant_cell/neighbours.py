"""Who interacts with whom in an arrangement of plant cells: bonds, fluid pairs and contacts.

Contacts are fluid with the walls around its plant cell, and wall particles that are not bonded to
each other, wherever they are. `Neighbours` has all that can come about; `near` lists those within
the cut-off and a skin, which serve until particles have moved too far (`Near.covers`). A contact
that is left out exerts no force, so that a list never changes a result.

Kernels see local particles only: first the unit's own, then images of those that they interact
with; a pair (i, j) needs no shift. All RVEs of one call share a list, so that they can be SIMD
lanes. Until then a pair is a row (i, j, a, b): own particles, and the lattice shift of j.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, any_less, load, put_points, store, take_points, where_less
from surrofe2.plant_cell.arrangement import Arrangement, make_arrangement, rim_areas
from surrofe2.plant_cell.block_matrices import dense_pattern, factorisation_work, make_pattern
from surrofe2.plant_cell.parameters import CellParameters

Ints = NDArray[np.int32]

SKIN = 0.2
"""How much farther than the cut-off contacts are listed, in cut-offs."""
BESIDE = 1.4
BESIDE_UNIFORM = 1.2
FARTHEST = 3.0
"""Distances in the reference, in cut-offs, of walls that bound no plant cell of SPH fluid together:
up to the first, or the second with a uniform fluid, they have blocks in matrices; beyond the third
they are never listed."""
PIECE = 4
"""Wall particles of a group, at most, where the fluid is uniform."""
SPARSE_PAYS_BELOW = 0.8
"""Groups where they multiply less than this part of what a dense matrix does."""
_SHIFTS = 128
"""Lattice shifts are smaller than half of this."""


class Topology(NamedTuple):
    """Who interacts, by local indices; at its end, how matrices lie, which is a `Pattern`.

    Its fields are repeated here, for parallel kernels do not accept a tuple within a tuple.

    bonds, contacts, fluid_pairs: (·, 2) local i, j, the first an own particle.
    bond_weight, contact_weight: (·,) part of a pair's force and damping that acts: ½ where one of
        the two walls is missing, along a slab's outer walls.
    particles, of which `walls` come first: own.
    owner, image_offset: (g,) own particle of each image, (g, 2) µm from there to it; image k has
        the local index particles + k.
    fluid_start, fluid_pair_start: (cells + 1,) where each plant cell's fluid, counted from the
        first of all, and its pairs begin.
    rim, rim_start: (·,) local wall particles around the plant cells, one after the other, and
        (cells + 1,) where each begins; of a uniform fluid, else without plant cells.
    fluid_mass, rest_area: (cells,) of it, ng and µm² at rest.
    area: of the reference, µm².
    """

    bonds: Ints
    contacts: Ints
    fluid_pairs: Ints
    bond_weight: Array
    contact_weight: Array
    owner: Ints
    image_offset: Array
    particles: int
    walls: int
    fluid_start: Ints
    fluid_pair_start: Ints
    rim: Ints
    rim_start: Ints
    fluid_mass: Array
    rest_area: Array
    area: float
    group: Ints
    column: Ints
    first: Ints
    width: Ints
    start: Ints
    offset: Ints
    lower: Ints
    lower_start: Ints
    upper: Ints
    upper_start: Ints
    block: Ints
    stride: Ints
    size: int
    pressures: int


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """A topology with the contacts within `reach` of each other at positions z, x = F z.

    Attributes:
        F: (tiles, 2, 2, TILE). z: (tiles, 2, own, TILE) material positions, µm.
        every: the topology with all contacts. listed: (k,) which of these `topology` has.
    """

    topology: Topology
    every: Topology
    listed: Flags
    F: Array
    z: Array
    reach: float
    cutoff: float

    def covers(self, F: Array, z: Array, *, exactly: bool = False) -> Flags:
        """(tiles, TILE): whether all contacts that act at z (tiles, 2, n, TILE) are listed.

        A bound says so, and `exactly` each contact where the bound is too coarse. What is not
        listed has |r₀| > reach. With particles at most d from where they were listed,
        in material coordinates, and G = F F₀⁻¹: |r| ≥ s_min(G) (reach − 2 s_max(F₀) d).
        """
        covered = np.empty((len(F), TILE), dtype=np.bool_)
        mark_covered(F, z, self.F, self.z, self.reach, self.cutoff, covered)
        if exactly and not covered.all():
            every = self.every
            unlisted = self.every.contacts[~self.listed]
            mark_apart(F, z, unlisted, every.owner, every.image_offset, self.cutoff, covered)
        return covered

    def take(self, index: Index) -> Near:
        """The same list for some of the points it was made for."""
        return replace(self, F=take_points(self.F, index), z=take_points(self.z, index))

    def put(self, index: Index, part: Near, row: Index) -> Near | None:
        """The list of all points where that of the points `index` is `part`, of its points `row`.

        None: the two lists differ.
        """
        if not np.array_equal(part.listed, self.listed):
            return None
        F = self.F.copy()
        z = self.z.copy()
        put_points(F, index, part.F, row)
        put_points(z, index, part.z, row)
        return replace(self, F=F, z=z)


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Particles of a periodic unit and all that can interact.

    Attributes:
        topology: with every contact.
        mass: (n,) ng, walls first.
        lattice: (2, 2) µm, its columns the periods.
        shift: (g, 2) integer lattice shift of each image.
        cutoff: µm.
    """

    topology: Topology
    mass: Array
    lattice: Array
    shift: Ints
    cutoff: float

    def near(self, F: Array, z: Array, skin: float | None = None) -> Near:
        """The contacts that any RVE at F (tiles, 2, 2, TILE), z (tiles, 2, n, TILE) may soon have.

        Args:
            skin: µm beyond the cut-off; None: `SKIN`; infinite: every contact is listed.
        """
        every = self.topology
        reach = self.cutoff + (SKIN * self.cutoff if skin is None else skin)
        listed = np.empty(len(every.contacts), dtype=np.bool_)
        mark_near(F, z, every.contacts, every.owner, every.image_offset, reach, listed)
        return self._listing(F, z, listed, reach)

    def listing(self, F: Array, z: Array, listed: Flags) -> Near:
        """The list of these contacts (k,), which `near` once made at F and z."""
        return self._listing(F, z, listed, self.cutoff + SKIN * self.cutoff)

    def _listing(self, F: Array, z: Array, listed: Flags, reach: float) -> Near:
        every = self.topology
        particles = self.topology.particles
        contacts = every.contacts[listed]
        used = np.arange(particles + len(every.owner)) < particles
        used[contacts[:, 1]] = used[every.bonds[:, 1]] = used[every.rim] = True
        # images keep their order, so that sums over them are the same to the bit with every list
        number = (np.cumsum(used) - 1).astype(np.int32)
        images = used[particles:]
        topology = every._replace(
            contacts=number[contacts],
            contact_weight=every.contact_weight[listed],
            bonds=number[every.bonds],
            rim=number[every.rim],
            owner=every.owner[images],
            image_offset=every.image_offset[images],
        )
        return Near(topology, every, listed, F, z, reach, self.cutoff)


@kernel
def mark_near(F, z, pairs, owner, offset, reach, near):
    """near (k,): whether local particles i, j of `pairs` (k, 2) are within reach in any RVE."""
    for k in range(pairs.shape[0]):
        near[k] = False
        for t in range(z.shape[0]):
            if any_less(_square(F, z, t, pairs[k], owner, offset), reach * reach):
                near[k] = True
                break


@kernel
def mark_apart(F, z, pairs, owner, offset, cutoff, apart):
    """Set apart (tiles, TILE) in RVEs where no pair is within the cut-off."""
    for t in range(z.shape[0]):
        if apart[t].all():
            continue
        nearest = np.full((1, TILE), np.inf)
        for k in range(pairs.shape[0]):
            least = load(nearest, 0)
            square = _square(F, z, t, pairs[k], owner, offset)
            store(where_less(square, least, square, least), nearest, 0)
        for lane in range(TILE):
            apart[t, lane] |= nearest[0, lane] >= cutoff * cutoff


@kernel
def _square(F, z, t, pair, owner, offset):
    """Squared distance of a pair of local particles in the RVEs of tile t."""
    particles = z.shape[2]
    i = pair[0]
    j = pair[1]
    ox = 0.0
    oy = 0.0
    if j >= particles:
        image = j - particles
        j = owner[image]
        ox = offset[image, 0]
        oy = offset[image, 1]
    dx = load(z, t, 0, j) - load(z, t, 0, i)
    dy = load(z, t, 1, j) - load(z, t, 1, i)
    dx = dx + ox
    dy = dy + oy
    rx = load(F, t, 0, 0) * dx + load(F, t, 0, 1) * dy
    ry = load(F, t, 1, 0) * dx + load(F, t, 1, 1) * dy
    return rx * rx + ry * ry


@kernel
def mark_covered(F, z, listed_F, listed_z, reach, cutoff, covered):
    """See `Near.covers`."""
    moved = np.empty((1, TILE))
    for t in range(z.shape[0]):
        store(0.0, moved, 0)
        for i in range(z.shape[2]):
            dx = load(z, t, 0, i) - load(listed_z, t, 0, i)
            dy = load(z, t, 1, i) - load(listed_z, t, 1, i)
            farthest = load(moved, 0)
            square = dx * dx + dy * dy
            store(where_less(farthest, square, square, farthest), moved, 0)
        for k in range(TILE):
            xx = F[t, 0, 0, k]
            xy = F[t, 0, 1, k]
            yx = F[t, 1, 0, k]
            yy = F[t, 1, 1, k]
            a, b, c, d = (
                listed_F[t, 0, 0, k], listed_F[t, 0, 1, k], listed_F[t, 1, 0, k],
                listed_F[t, 1, 1, k],
            )  # fmt: skip
            largest = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))
            # G times det F₀, of which the smallest singular value is taken as of any 2 × 2 matrix
            gxx = xx * d - xy * c
            gxy = xy * a - xx * b
            gyx = yx * d - yy * c
            gyy = yy * a - yx * b
            smallest = 0.5 * (np.hypot(gxx + gyy, gxy - gyx) - np.hypot(gxx - gyy, gxy + gyx))
            room = reach - 2.0 * largest * np.sqrt(moved[0, k])
            covered[t, k] = smallest * room >= cutoff * (a * d - b * c)


def make_neighbours(
    cell: CellParameters,
    position: Array,
    lattice: Array,
    arrangement: Arrangement | None = None,
) -> Neighbours:
    """Everyone who can interact in an arrangement.

    Args:
        position: (n, 2) reference positions, µm.
        lattice: (2, 2), its columns the lattice vectors, µm.
        arrangement: instead of the cell's own, such as a slab.
    """
    arrangement = arrangement or make_arrangement(cell)
    particles = len(position)
    walls = arrangement.walls
    cutoff = cell.repulsion_cutoff
    weight = 0.5 * cell.outer_wall
    contacts, has_block = _contacts(arrangement, position, lattice, cutoff)
    mass = np.full(particles, cell.fluid_mass)
    mass[:walls] = cell.wall_particle_mass * np.where(arrangement.outer > 0, weight, 1.0)
    rims = arrangement.rims if cell.has_uniform_fluid else ()
    fluid_mass = cell.fluid_density * arrangement.tessellation.areas[: len(rims)]
    for rim, of_fluid in zip(rims, fluid_mass, strict=True):
        np.add.at(mass, rim[:, 0], of_fluid / len(rim))
    counts = np.array(arrangement.fluid_counts, dtype=np.int64)
    fluid = [
        first + np.stack(np.triu_indices(count, 1), axis=1)
        for first, count in zip(walls + arrangement.fluid_start, counts, strict=False)
    ]
    pattern = make_pattern(*_interacting_groups(arrangement, contacts[has_block]), len(rims))
    dense = dense_pattern(particles, len(rims))
    if factorisation_work(pattern) >= SPARSE_PAYS_BELOW * factorisation_work(dense):
        pattern = dense
    lists = [pairs[np.lexsort(pairs.T[::-1])] for pairs in (arrangement.bonds, contacts)]
    weights = [np.where(_is_outer(arrangement, pairs), weight, 1.0) for pairs in lists]
    around = [np.empty((0, 4), dtype=np.int32), *(rim[:, [0, 0, 1, 2]] for rim in rims)]
    lists.append(np.concatenate(around))
    owner, shift, (bonds, contacts, in_rims) = _localised(lists, particles)
    topology = Topology(
        bonds=bonds,
        contacts=contacts,
        fluid_pairs=np.concatenate([np.empty((0, 2)), *fluid]).astype(np.int32),
        bond_weight=weights[0],
        contact_weight=weights[1],
        owner=owner,
        image_offset=np.ascontiguousarray(shift @ lattice.T),
        particles=particles,
        walls=walls,
        fluid_start=arrangement.fluid_start,
        fluid_pair_start=np.append(0, np.cumsum(counts * (counts - 1) // 2)).astype(np.int32),
        rim=np.ascontiguousarray(in_rims[:, 1]),
        rim_start=np.cumsum([0, *map(len, rims)], dtype=np.int32),
        fluid_mass=fluid_mass,
        rest_area=rim_areas(arrangement.rims, position, lattice)[: len(rims)],
        area=abs(float(np.linalg.det(lattice))),
        **pattern._asdict(),
    )
    return Neighbours(topology, mass, lattice, shift, cutoff)


def _interacting_groups(
    arrangement: Arrangement, contacts: Ints
) -> tuple[Ints, set[tuple[int, int]]]:
    """Group of each particle, walls along an edge or the fluid of a plant cell; coupled groups.

    SPH fluid meets all walls around it, and they each other by way of it: a group is a whole edge.
    With a uniform fluid only walls near each other are coupled, so that groups are small; the fluid
    is a pressure, which comes behind all walls.

    contacts: (k, 2) or more columns, the first two the particles that may touch, by their owners.
    """
    has_particles = bool(arrangement.fluid_counts)
    cells = len(arrangement.rims)
    walls = arrangement.wall_edge if has_particles else _pieces_of_walls(arrangement)
    first = int(walls.max()) + 1
    counts = arrangement.fluid_counts or (1,) * cells
    labels = np.concatenate([walls, first + np.repeat(np.arange(cells), counts)])
    pairs = set()
    for k, rim in enumerate(arrangement.rims):
        around = np.unique(labels[rim[:, 0]]).tolist()
        pairs |= {(first + k, g) for g in around}
        if has_particles:
            pairs |= {(g, h) for g in around for h in around}
    for listed in (arrangement.bonds, contacts):
        pairs |= {(g, h) for g, h in np.unique(labels[listed[:, :2]], axis=0).tolist()}
    return labels, pairs


def _pieces_of_walls(arrangement: Arrangement) -> Index:
    """(walls,) group of each wall particle: a vertex alone, or a piece of an edge between two."""
    vertices = len(arrangement.tessellation.vertices)
    groups = [np.arange(vertices)]
    count = vertices
    for particles in np.bincount(arrangement.wall_edge[vertices:]):
        pieces = -(-particles // PIECE)
        groups.append(count + np.arange(particles) * pieces // max(particles, 1))
        count += pieces
    return np.concatenate(groups)


def _contacts(
    arrangement: Arrangement, position: Array, lattice: Array, cutoff: float
) -> tuple[Ints, Flags]:
    """Contacts (k, 4) that can come about, and whether they have a block in matrices.

    SPH fluid with the walls around it at any distance, for it may flow. Walls that are far from
    each other, and bound no plant cell of SPH fluid together, meet only where tissue is crushed:
    their forces act then, but matrices do without them, and solvers take more steps.
    """
    walls = arrangement.walls
    has_particles = bool(arrangement.fluid_counts)
    pairs = _wall_pairs(position[:walls], lattice, FARTHEST * cutoff)
    bonded = np.isin(_keys(pairs), _keys(arrangement.bonds))
    pairs = pairs[~bonded]
    i = pairs[:, 0]
    j = pairs[:, 1]
    shift = pairs[:, 2:]
    distance = np.linalg.norm(position[j] + shift @ lattice.T - position[i], axis=1)
    has_block = distance <= (BESIDE if has_particles else BESIDE_UNIFORM) * cutoff
    if has_particles:
        same = np.unique(np.concatenate([_keys(_all_pairs(rim)) for rim in arrangement.rims]))
        has_block |= np.isin(_keys(pairs), same)
    fluid = walls + arrangement.fluid_start
    touching = []
    for first, last, rim in zip(fluid[:-1], fluid[1:], arrangement.rims, strict=False):
        inside = np.repeat(np.arange(first, last), len(rim))[:, None]
        touching.append(np.hstack([inside, np.tile(rim, (last - first, 1))]))
    every = np.concatenate([pairs, *touching]).astype(np.int32)
    return every, np.append(has_block, np.ones(len(every) - len(pairs), dtype=np.bool_))


def _wall_pairs(position: Array, lattice: Array, reach: float) -> Index:
    """(k, 4) pairs of wall particles within reach, each once."""
    height = abs(np.linalg.det(lattice)) / np.linalg.norm(lattice, axis=0)[::-1]
    extent = np.ptp(np.linalg.solve(lattice, position.T), axis=1)
    most = np.ceil(reach / height + extent).astype(int)
    pairs = []
    for a in range(-most[0], most[0] + 1):
        for b in range(-most[1], most[1] + 1):
            r = position[None] + lattice @ np.array([a, b]) - position[:, None]
            i, j = np.nonzero((r**2).sum(axis=2) <= reach**2)
            once = (i < j) | ((i == j) & ((a, b) > (0, 0)))
            i = i[once]
            j = j[once]
            pairs.append(np.stack([i, j, np.full_like(i, a), np.full_like(i, b)], axis=1))
    return np.concatenate(pairs)


def _all_pairs(rim: Ints) -> Ints:
    """(k, 4) pairs of different wall particles, by their images, around one plant cell."""
    p, q = np.nonzero(~np.eye(len(rim), dtype=np.bool_))
    return np.column_stack([rim[p, 0], rim[q, 0], rim[q, 1:] - rim[p, 1:]])


def _keys(pairs: NDArray[np.integer]) -> Index:
    """One number for each pair (k, 4), the same whichever of the two comes first."""
    i, j, a, b = pairs.T.astype(np.int64)
    turned = (i > j) | ((i == j) & ((a < 0) | ((a == 0) & (b < 0))))
    i, j = np.where(turned, j, i), np.where(turned, i, j)
    a = np.where(turned, -a, a)
    b = np.where(turned, -b, b)
    # i, j, a, b side by side in 64 bits; shifts are raised by half of `_SHIFTS` to be positive
    return ((i << 32) | j) * _SHIFTS**2 + (a + _SHIFTS // 2) * _SHIFTS + b + _SHIFTS // 2


def _is_outer(arrangement: Arrangement, pairs: Ints) -> Flags:
    """(k,) whether both particles of pairs (k, 4) lie along one outer wall."""
    of = np.pad(arrangement.outer, (0, arrangement.particles - arrangement.walls))
    i, j = of[pairs[:, :2]].T
    return np.asarray((i > 0) & (i == j))


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
