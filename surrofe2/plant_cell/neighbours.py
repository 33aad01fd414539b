"""Lists of who interacts with whom in an arrangement: bonds, fluid pairs and contacts.

Contacts are pairs of a fluid particle and a wall particle around its plant cell, and pairs of wall
particles that are not bonded to each other. `Neighbours` has all that can come about; `near` lists
those within the cut-off and a skin, which can be used until particles have moved too far
(`Near.covers`). A contact that is left out exerts no force, so a list never changes a result.

Kernels see local particles only: first the unit's own, then images of those that they interact
with, so that a pair (i, j) needs no shift. All RVEs of one call share a list, so that they can be
SIMD lanes. While lists are made, a pair is a row (i, j, a, b): own particles i and j, and the
lattice shift (a, b) of j.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
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
"""Distance beyond the cut-off up to which contacts are listed, in cut-offs."""
BESIDE = 1.4
"""Distance in the reference, in cut-offs, up to which two walls have a block in matrices if they
bound no plant cell of SPH fluid together. Farther ones meet where tissue is crushed by 29 %."""
BESIDE_UNIFORM = 1.2
"""The same with a uniform fluid. Walls beyond it meet only where tissue is crushed by a sixth."""
FARTHEST = 3.0
"""Distance in the reference, in cut-offs, beyond which two walls are never listed: they would meet
only where tissue is crushed to a third."""
PIECE = 4
"""Most wall particles in a group where the fluid is uniform. With nine Voronoi cells, groups of 6
take a third more multiplications, and smaller groups no fewer."""
SPARSE_PAYS_BELOW = 0.8
"""Fraction of the multiplications of a dense matrix below which groups are used."""
_SHIFTS = 128
"""Each component of a lattice shift is smaller than half of this."""


class Topology(NamedTuple):
    """Lists of interacting particles, by local indices, and the layout of matrices.

    The fields from `group` on are those of a `Pattern`. They are repeated here, for parallel
    kernels do not accept a tuple within a tuple.

    bonds, contacts, fluid_pairs: (·, 2) local i, j, the first an own particle.
    bond_weight, contact_weight: (·,) fraction of a pair's force and damping that acts: ½ where one
        of the two walls is missing, along a slab's outer walls.
    particles, walls: number of own particles, and of walls, which come first among them.
    owner, image_offset: (g,) own particle of each image, (g, 2) vector from there to the image, µm;
        image k has the local index particles + k.
    fluid_start: (cells + 1,) where the SPH particles of each plant cell begin, counted from the
        first of all.
    fluid_pair_start: (cells + 1,) where the fluid pairs of each plant cell begin.
    rim: (·,) local wall particles around each plant cell with a uniform fluid, one plant cell after
        the other; empty with SPH fluid.
    rim_start: (cells + 1,) where each plant cell begins in `rim`.
    fluid_mass, rest_area: (cells,) mass of the uniform fluid, ng, and its area at rest, µm².
    area: area of the reference, µm².
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
    """A topology with the contacts that were within `reach` of each other when it was listed.

    Attributes:
        topology: the topology with the listed contacts alone.
        every: the topology with all contacts.
        listed: (k,) True for those of all contacts that are listed.
        F: (tiles, 2, 2, TILE) deformation at which they were listed.
        z: (tiles, 2, own, TILE) material positions at which they were listed, x = F z, µm.
        reach: µm.
        cutoff: distance beyond which a contact exerts no force, µm.
    """

    topology: Topology
    every: Topology
    listed: Flags
    F: Array
    z: Array
    reach: float
    cutoff: float

    def covers(self, F: Array, z: Array, *, exactly: bool = False) -> Flags:
        """Return (tiles, TILE) whether all contacts that act at z (tiles, 2, n, TILE) are listed.

        A contact that is not listed had |r₀| > reach. With particles at most d from where they were
        listed, in material coordinates, and G = F F₀⁻¹, |r| ≥ s_min(G) (reach − 2 s_max(F₀) d), s
        being singular values. Where this bound does not suffice and the answer is wanted `exactly`,
        the distance of each contact that is not listed is computed.
        """
        covered = np.empty((len(F), TILE), dtype=np.bool_)
        mark_covered(F, z, self.F, self.z, self.reach, self.cutoff, covered)
        if exactly and not covered.all():
            every = self.every
            unlisted = self.every.contacts[~self.listed]
            mark_apart(F, z, unlisted, every.owner, every.image_offset, self.cutoff, covered)
        return covered

    def take(self, index: Index) -> Near:
        """Return the same list for some of the points that it was made for."""
        return replace(self, F=take_points(self.F, index), z=take_points(self.z, index))

    def put(self, index: Index, part: Near, row: Index) -> Near | None:
        """Return the list with the points `index` replaced by the points `row` of `part`.

        None where the two list different contacts, as one list cannot be both.
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
        topology: the topology with every contact.
        mass: (n,) mass of each particle, ng, walls first.
        lattice: (2, 2) µm, its columns the periods.
        shift: (g, 2) integer lattice shift of each image.
        cutoff: distance beyond which a contact exerts no force, µm.
    """

    topology: Topology
    mass: Array
    lattice: Array
    shift: Ints
    cutoff: float

    def near(self, F: Array, z: Array, skin: float | None = None) -> Near:
        """List the contacts that any RVE at F (tiles, 2, 2, TILE), z (tiles, 2, n, TILE) may have.

        Args:
            skin: distance beyond the cut-off up to which contacts are listed, µm; None: `SKIN`;
                infinite: every contact is listed.
        """
        every = self.topology
        reach = self.cutoff + (SKIN * self.cutoff if skin is None else skin)
        listed = np.empty(len(every.contacts), dtype=np.bool_)
        mark_near(F, z, every.contacts, every.owner, every.image_offset, reach, listed)
        return self._listing(F, z, listed, reach)

    def listing(self, F: Array, z: Array, listed: Flags) -> Near:
        """Make the list of the contacts `listed` (k,) again that `near` made at F and z."""
        return self._listing(F, z, listed, self.cutoff + SKIN * self.cutoff)

    def _listing(self, F: Array, z: Array, listed: Flags, reach: float) -> Near:
        """Make a list of contacts, with those images alone that something interacts with."""
        every = self.topology
        particles = self.topology.particles
        contacts = every.contacts[listed]
        used = np.arange(particles + len(every.owner)) < particles
        used[contacts[:, 1]] = used[every.bonds[:, 1]] = used[every.rim] = True
        # New numbers of local particles. Images keep their order, so that sums over them are the
        # same to the bit with every list.
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
    """Fill near (k,) with whether a pair of local particles is within reach in any RVE.

    F: (tiles, 2, 2, TILE). z: (tiles, 2, n, TILE). pairs: (k, 2). owner, offset: as of `Topology`.
    """
    for k in range(pairs.shape[0]):
        near[k] = False
        for t in range(z.shape[0]):
            if any_less(_square(F, z, t, pairs[k], owner, offset), reach * reach):
                near[k] = True
                break


@kernel
def mark_apart(F, z, pairs, owner, offset, cutoff, apart):
    """Set apart (tiles, TILE) to True in RVEs where no pair is within the cut-off."""
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
    """Return the squared distance of a pair of local particles in the RVEs of tile t, lanes."""
    particles = z.shape[2]
    i = pair[0]
    j = pair[1]
    offset_x = 0.0
    offset_y = 0.0
    if j >= particles:
        image = j - particles
        j = owner[image]
        offset_x = offset[image, 0]
        offset_y = offset[image, 1]
    dx = load(z, t, 0, j) - load(z, t, 0, i)
    dy = load(z, t, 1, j) - load(z, t, 1, i)
    dx = dx + offset_x
    dy = dy + offset_y
    rx = load(F, t, 0, 0) * dx + load(F, t, 0, 1) * dy
    ry = load(F, t, 1, 0) * dx + load(F, t, 1, 1) * dy
    return rx * rx + ry * ry


@kernel
def mark_covered(F, z, listed_F, listed_z, reach, cutoff, covered):
    """Fill covered (tiles, TILE) by the bound of `Near.covers`.

    s_min(G) (reach − 2 s_max(F₀) d) ≥ cutoff, with F₀ = listed_F. The singular values of a matrix
    [[a, b], [c, d]] are ½ (|(a + d, b − c)| ± |(a − d, b + c)|).
    """
    moved = np.empty((1, TILE))
    for t in range(z.shape[0]):
        # d², the largest square of a displacement
        store(0.0, moved, 0)
        for i in range(z.shape[2]):
            dx = load(z, t, 0, i) - load(listed_z, t, 0, i)
            dy = load(z, t, 1, i) - load(listed_z, t, 1, i)
            farthest = load(moved, 0)
            square = dx * dx + dy * dy
            store(where_less(farthest, square, square, farthest), moved, 0)
        for lane in range(TILE):
            xx = F[t, 0, 0, lane]
            xy = F[t, 0, 1, lane]
            yx = F[t, 1, 0, lane]
            yy = F[t, 1, 1, lane]
            a = listed_F[t, 0, 0, lane]
            b = listed_F[t, 0, 1, lane]
            c = listed_F[t, 1, 0, lane]
            d = listed_F[t, 1, 1, lane]
            largest = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))
            # G = F F₀⁻¹ times det F₀, which multiplies the right-hand side, too
            gxx = xx * d - xy * c
            gxy = xy * a - xx * b
            gyx = yx * d - yy * c
            gyy = yy * a - yx * b
            smallest = 0.5 * (np.hypot(gxx + gyy, gxy - gyx) - np.hypot(gxx - gyy, gxy + gyx))
            room = reach - 2.0 * largest * np.sqrt(moved[0, lane])
            covered[t, lane] = smallest * room >= cutoff * (a * d - b * c)


def make_neighbours(
    cell: CellParameters,
    position: Array,
    lattice: Array,
    arrangement: Arrangement | None = None,
) -> Neighbours:
    """List everyone who can interact in an arrangement.

    Args:
        position: (n, 2) reference positions, µm.
        lattice: (2, 2), its columns the lattice vectors, µm.
        arrangement: an arrangement instead of the cell's own, such as a slab.
    """
    arrangement = arrangement or make_arrangement(cell)
    particles = len(position)
    walls = arrangement.walls
    cutoff = cell.repulsion_cutoff
    outer_weight = 0.5 * cell.outer_wall
    contacts, has_block = _contacts(arrangement, position, lattice, cutoff)
    # with SPH fluid there are none here, and all that follows from them is empty
    rims = arrangement.rims if cell.has_uniform_fluid else ()
    fluid_mass = cell.fluid_density * arrangement.tessellation.areas[: len(rims)]
    mass = np.full(particles, cell.fluid_mass)
    mass[:walls] = cell.wall_particle_mass * np.where(arrangement.outer > 0, outer_weight, 1.0)
    # a uniform fluid has no particles; the walls around it carry its mass
    for rim, mass_of_fluid in zip(rims, fluid_mass, strict=True):
        # `add.at`, since a particle may be on a rim twice: itself and its image
        np.add.at(mass, rim[:, 0], mass_of_fluid / len(rim))
    counts = np.array(arrangement.fluid_counts, dtype=np.int64)
    # before contacts are sorted, for `has_block` is in their first order
    labels, coupled = _interacting_groups(arrangement, contacts[has_block])
    pattern = make_pattern(labels, coupled, len(rims))
    dense = dense_pattern(particles, len(rims))
    if factorisation_work(pattern) >= SPARSE_PAYS_BELOW * factorisation_work(dense):
        pattern = dense
    # in ascending order, so that sums over pairs do not depend on how they were listed
    bonds = arrangement.bonds[np.lexsort(arrangement.bonds.T[::-1])]
    contacts = contacts[np.lexsort(contacts.T[::-1])]
    bond_weight = np.where(_is_outer(arrangement, bonds), outer_weight, 1.0)
    contact_weight = np.where(_is_outer(arrangement, contacts), outer_weight, 1.0)
    # particles of a rim as pairs of a particle with its own image, to get their local numbers
    pairs_of_rims = [np.empty((0, 4), dtype=np.int32)]
    pairs_of_rims += [rim[:, [0, 0, 1, 2]] for rim in rims]
    owner, shift, local_pairs = _localised(
        [bonds, contacts, np.concatenate(pairs_of_rims)], particles
    )
    local_bonds, local_contacts, local_rims = local_pairs
    topology = Topology(
        bonds=local_bonds,
        contacts=local_contacts,
        fluid_pairs=_fluid_pairs(walls + arrangement.fluid_start, counts),
        bond_weight=bond_weight,
        contact_weight=contact_weight,
        owner=owner,
        image_offset=np.ascontiguousarray(shift @ lattice.T),
        particles=particles,
        walls=walls,
        fluid_start=arrangement.fluid_start,
        fluid_pair_start=np.append(0, np.cumsum(counts * (counts - 1) // 2)).astype(np.int32),
        rim=np.ascontiguousarray(local_rims[:, 1]),
        rim_start=np.cumsum([0, *map(len, rims)], dtype=np.int32),
        fluid_mass=fluid_mass,
        rest_area=rim_areas(arrangement.rims, position, lattice)[: len(rims)],
        area=abs(float(np.linalg.det(lattice))),
        **pattern._asdict(),
    )
    return Neighbours(topology, mass, lattice, shift, cutoff)


def _fluid_pairs(starts: Ints, counts: Index) -> Ints:
    """Return all pairs (k, 2) of SPH particles within each plant cell.

    starts: first particle of each plant cell; a last one, behind all, is not used.
    """
    pairs = [np.empty((0, 2))]
    for first, count in zip(starts, counts, strict=False):
        pairs.append(first + np.stack(np.triu_indices(count, 1), axis=1))
    return np.concatenate(pairs).astype(np.int32)


def _interacting_groups(
    arrangement: Arrangement, contacts: Ints
) -> tuple[Ints, set[tuple[int, int]]]:
    """Return the group of each particle (n,), and the pairs of groups that are coupled.

    A group is walls along an edge or the fluid of a plant cell. SPH fluid meets all walls around
    it, and couples these: a group is a whole edge. With a uniform fluid only walls near each other
    are coupled, so that groups are small; the fluid is a pressure, which comes behind all walls.

    contacts: (k, 2) or more columns, the first two the particles that may touch, by their owners.
    """
    has_particles = bool(arrangement.fluid_counts)
    cells = len(arrangement.rims)
    walls = arrangement.wall_edge if has_particles else _pieces_of_walls(arrangement)
    first = int(walls.max()) + 1
    # a uniform fluid is one pressure, which lies like a particle
    counts = arrangement.fluid_counts or (1,) * cells
    labels = np.concatenate([walls, first + np.repeat(np.arange(cells), counts)])
    coupled = set()
    for k, rim in enumerate(arrangement.rims):
        around = np.unique(labels[rim[:, 0]]).tolist()
        for g in around:
            coupled.add((first + k, g))
        if has_particles:
            coupled.update(product(around, around))
    for pairs in (arrangement.bonds, contacts):
        for g, h in np.unique(labels[pairs[:, :2]], axis=0).tolist():
            coupled.add((g, h))
    return labels, coupled


def _pieces_of_walls(arrangement: Arrangement) -> Index:
    """Return (walls,) the group of each wall particle: a vertex alone, or a piece of an edge.

    Pieces have at most `PIECE` particles, and those of one edge differ by at most one.
    """
    vertices = len(arrangement.tessellation.vertices)
    groups = [np.arange(vertices)]
    count = vertices
    for particles in np.bincount(arrangement.wall_edge[vertices:]):
        pieces = -(-particles // PIECE)  # rounded up
        groups.append(count + np.arange(particles) * pieces // max(particles, 1))
        count += pieces
    return np.concatenate(groups)


def _contacts(
    arrangement: Arrangement, position: Array, lattice: Array, cutoff: float
) -> tuple[Ints, Flags]:
    """Return the contacts (k, 4) that can come about, and (k,) whether matrices have a block.

    SPH fluid may touch each of the walls around it, for it flows. Walls that are far from each
    other, and bound no plant cell of SPH fluid together, meet only where tissue is crushed: their
    forces act then, but matrices do without them, and solvers take more steps.
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
        around_one_cell = np.concatenate([_keys(_all_pairs(rim)) for rim in arrangement.rims])
        has_block |= np.isin(_keys(pairs), np.unique(around_one_cell))
    fluid = walls + arrangement.fluid_start
    with_fluid = []
    for first, last, rim in zip(fluid[:-1], fluid[1:], arrangement.rims, strict=False):
        inside = np.repeat(np.arange(first, last), len(rim))[:, None]
        with_fluid.append(np.hstack([inside, np.tile(rim, (last - first, 1))]))
    every = np.concatenate([pairs, *with_fluid]).astype(np.int32)
    # fluid may come to any wall around it, so that every pair with it has a block
    return every, np.append(has_block, np.ones(len(every) - len(pairs), dtype=np.bool_))


def _wall_pairs(position: Array, lattice: Array, reach: float) -> Index:
    """Return the pairs (k, 4) of wall particles within reach, each once."""
    # as many periods to each side as reach and the particles' own extent make necessary; heights
    # are distances of opposite sides of the lattice's parallelogram
    height = abs(np.linalg.det(lattice)) / np.linalg.norm(lattice, axis=0)[::-1]
    extent = np.ptp(np.linalg.solve(lattice, position.T), axis=1)
    most = np.ceil(reach / height + extent).astype(int)
    pairs = []
    for a in range(-most[0], most[0] + 1):
        for b in range(-most[1], most[1] + 1):
            r = position[None] + lattice @ np.array([a, b]) - position[:, None]
            i, j = np.nonzero((r**2).sum(axis=2) <= reach**2)
            # (j, i) with the opposite shift is the same pair
            once = (i < j) | ((i == j) & ((a, b) > (0, 0)))
            i = i[once]
            j = j[once]
            pairs.append(np.stack([i, j, np.full_like(i, a), np.full_like(i, b)], axis=1))
    return np.concatenate(pairs)


def _all_pairs(rim: Ints) -> Ints:
    """Return the pairs (k, 4) of different wall particles around one plant cell, both ways.

    rim: (p, 3) wall particles and the lattice shifts of their images.
    """
    p, q = np.nonzero(~np.eye(len(rim), dtype=np.bool_))
    return np.column_stack([rim[p, 0], rim[q, 0], rim[q, 1:] - rim[p, 1:]])


def _keys(pairs: NDArray[np.integer]) -> Index:
    """Return one number for each pair (k, 4), the same whichever of the two comes first."""
    i, j, a, b = pairs.T.astype(np.int64)
    turned = (i > j) | ((i == j) & ((a < 0) | ((a == 0) & (b < 0))))
    first = np.where(turned, j, i)
    second = np.where(turned, i, j)
    a = np.where(turned, -a, a)
    b = np.where(turned, -b, b)
    # the four side by side in 64 bits; shifts are raised by half of `_SHIFTS` to be positive
    particles = (first << 32) | second
    return particles * _SHIFTS**2 + (a + _SHIFTS // 2) * _SHIFTS + b + _SHIFTS // 2


def _is_outer(arrangement: Arrangement, pairs: Ints) -> Flags:
    """Return (k,) whether both particles of pairs (k, 4) lie along one outer wall."""
    fluid = arrangement.particles - arrangement.walls
    side = np.pad(arrangement.outer, (0, fluid))  # 0 for fluid
    i, j = side[pairs[:, :2]].T
    return np.asarray((i > 0) & (i == j))


def _localised(lists: list[Ints], particles: int) -> tuple[Ints, Ints, list[Ints]]:
    """Replace shifted particles in lists of pairs (·, 4) by images, which have local numbers.

    Returns:
        Owner (g,) and lattice shift (g, 2) of each image, numbered as they first appear, and the
        lists of local pairs (·, 2).
    """
    every = np.concatenate(lists)
    is_shifted = every[:, 2:].any(axis=1)
    images, first, number = np.unique(
        every[is_shifted, 1:], axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    local = every[:, :2].copy()
    local[is_shifted, 1] = particles + rank[number.reshape(-1)]
    images = images[order].astype(np.int32)
    owner = np.ascontiguousarray(images[:, 0])
    shift = np.ascontiguousarray(images[:, 1:])
    ends = np.cumsum([len(pairs) for pairs in lists])
    local_pairs = [np.ascontiguousarray(part) for part in np.split(local, ends[:-1])]
    return owner, shift, local_pairs
