"""Particles of RVEs: what a law keeps of them from call to call, and what they feel at (F, Ḟ).

Unknowns are material positions z, so that x = F z moves along with F, and velocities v = Ḟ z are
affine: v = L x. z of particle 0, a wall corner, stays at the origin.

A state is a warm start: where particles were last, and kept factorisations, see `newton`. These and
their slopes are by far the largest part of it (22 kB a point) and few change from one state to the
next. Each tile has a block of memory of its own, in single precision, lanes last::

    block   lu (size, TILE), then slopes (free, 8, TILE)      free = 2 particles − 2

A block is written once, by the kernel it was made for; a state that renews some tiles gets new
blocks for these and shares the others. Kernels find a block by its address, and Python keeps it
for as long as any state refers to it.

What is stored of a state are the positions at which its factors were made, not the factors: made
again there they have the same bits, whichever lane, tile or list of contacts a point has then.

While RVEs are solved, `Answer.iterations` (tiles, TILE) says how each lane stands. Solvers work on
a whole tile, and a lane that is done must stay as it is while the others go on::

    state         number   what it means                        what changes it
    UNDER_WAY     0        a solver works on it, or will        `settle`: solved, or OPEN;
                                                                `give_up`: given up
    solved        n > 0    n evaluations of forces solved it    nothing within this solve
    OPEN          −1       a solver missed it, or it is too     `newton_loop`: UNDER_WAY
                           far off for kept factors
    given up      −n       a search left it after n             `newton_loop`: UNDER_WAY
    PASSED_OVER   1        the next solver must not touch it    `solve`: OPEN, after that solver

A call begins with all lanes UNDER_WAY. `chord` takes those, `newton` also those below 0; a path
(`continuation`) brings what is then still OPEN closer, for `newton` to end. A lane below 0 after
that is not converged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import kernel, pair_law, parallel_kernel
from surrofe2.base.simd import (
    TILE,
    load,
    pack,
    put_points,
    root,
    spread,
    store,
    take_points,
    tiles_for,
    unpack,
)
from surrofe2.plant_cell.forces import elastic_energy, fold_images, local_forces
from surrofe2.plant_cell.neighbours import Near, Neighbours, Topology
from surrofe2.plant_cell.pair_laws import Constants
from surrofe2.plant_cell.pair_sums import make_workspace

UNDER_WAY = 0
OPEN = -1
PASSED_OVER = 1
"""How a lane stands that is not solved, see above."""
SLOPES = 8
_BYTES = 4
_TILES = ("z", "F", "F_dot", "iterations", "left")
"""Arrays of tiles that every state has."""
_Pointer: Any = types.CPointer  # type: ignore[attr-defined]


class Drive(NamedTuple):
    """F and Ḟ (the rate that particles feel) of all tiles, (tiles, 2, 2, TILE)."""

    F: Array
    rate: Array


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """One block for each tile, and where its factors were made.

    Attributes:
        blocks: (rows, TILE) float32 each; several tiles may share one.
        address: (tiles,) of the blocks.
        drive, z: F, the rate that particles felt and their material positions (tiles, 2, n, TILE)
            at which the factors were made; those of the elastic equilibrium of "slow-manifold".
    """

    blocks: tuple[NDArray[np.float32], ...]
    address: Index
    drive: Drive
    z: Array

    @classmethod
    def of(cls, blocks: Sequence[NDArray[np.float32]], drive: Drive, z: Array) -> Factors:
        """The factors kept in these blocks, made at z and `drive`."""
        address = [block.__array_interface__["data"][0] for block in blocks]
        return cls(tuple(blocks), np.array(address, dtype=np.intp), drive, z)

    @classmethod
    def empty(cls, drive: Drive, z: Array, topology: Topology) -> Factors:
        """Uninitialised factors, which are to be made at z and `drive`."""
        rows = topology.size + (2 * topology.particles - 2) * SLOPES
        return cls.of([np.empty((rows, TILE), dtype=np.float32) for _ in range(len(z))], drive, z)

    @property
    def nbytes(self) -> int:
        """Of all blocks, each counted once."""
        return len(np.unique(self.address)) * self.blocks[0].nbytes

    def slopes(self, topology: Topology) -> Array:
        """(tiles, free, 8, TILE) ∂z/∂(F, Ḟ) where the factors were made."""
        shape = (2 * topology.particles - 2, SLOPES, TILE)
        return np.stack([block[topology.size :].reshape(shape) for block in self.blocks])

    def repeated(self, tiles: int) -> Factors:
        """The first tile's factors for `tiles` tiles."""
        F, rate, z = (np.repeat(each[:1], tiles, axis=0) for each in (*self.drive, self.z))
        address = np.repeat(self.address[:1], tiles)
        return Factors(self.blocks[:1] * tiles, address, Drive(F, rate), z)

    def renewed(self, wanted: Any) -> Factors:
        """These with new, uninitialised blocks for the tiles that `wanted` (tiles,) marks.

        Whoever fills them says where: see `made_at`.
        """
        blocks = list(self.blocks)
        address = self.address.copy()
        for tile in wanted.nonzero()[0].tolist():
            blocks[tile] = np.empty_like(blocks[tile])
            address[tile] = blocks[tile].__array_interface__["data"][0]
        return replace(self, blocks=tuple(blocks), address=address)

    def made_at(self, wanted: Any, drive: Drive, z: Array) -> Factors:
        """These, of which those of the tiles that `wanted` (tiles,) marks were made at z."""
        if not wanted.any():
            return self
        former = *self.drive, self.z
        F, rate, at = (
            np.where(wanted.reshape(-1, *[1] * (here.ndim - 1)), there, here)
            for here, there in zip(former, (*drive, z), strict=True)
        )
        return replace(self, drive=Drive(F, rate), z=at)

    def take(self, index: Index) -> Factors:
        """The factors of the points `index` alone; the last tile filled up as by `pack`."""
        blocks = []
        for points in pack(index):
            tile, lane = np.divmod(points, TILE)
            block = self.blocks[tile[0]]
            if (points != TILE * tile[0] + np.arange(TILE)).any():  # else the block is shared
                columns = zip(tile, lane, strict=True)
                block = np.stack([self.blocks[t][:, k] for t, k in columns], axis=-1)
            blocks.append(block)
        F, rate, z = (take_points(each, index) for each in (*self.drive, self.z))
        return Factors.of(blocks, Drive(F, rate), z)

    def put(self, index: Index, part: Factors, row: Index) -> Factors:
        """These with the points `index` replaced by the points `row` of `part`."""
        blocks = list(self.blocks)
        for tile in np.unique(index // TILE):
            blocks[tile] = blocks[tile].copy()
        for at, source in zip(index, row, strict=True):
            lanes = part.blocks[source // TILE]
            blocks[at // TILE][:, at % TILE] = lanes[:, source % TILE]
        F, rate, z = (each.copy() for each in (*self.drive, self.z))
        for here, there in zip((F, rate, z), (*part.drive, part.z), strict=True):
            put_points(here, index, there, row)
        return Factors.of(blocks, Drive(F, rate), z)


@intrinsic
def _singles_at(typing: Any, address: Any) -> Any:
    """Pointer to the single-precision numbers at an address."""
    pointer = _Pointer(types.float32)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.FloatType().as_pointer())

    return pointer(types.intp), generate


@kernel
def kept_factors(address, topology):
    """(lu (size, TILE), slopes (free, 8, TILE)) of the block at an address; not copied."""
    size = topology.size
    lu = carray(_singles_at(address), (size, TILE))
    behind = address + _BYTES * size * TILE
    return lu, carray(_singles_at(behind), (2 * topology.particles - 2, SLOPES, TILE))


@kernel
def keep_factors(lu, target):
    """Copy factors to where they are kept, in its precision."""
    for i in range(lu.shape[0]):
        store(load(lu, i), target, i)


@dataclass(frozen=True, slots=True)
class RveState:
    """Particles of n RVEs in tiles, at the deformation they were solved at.

    Attributes:
        of: fingerprint of the law that it is a state of.
        points: n; the last tile is filled up with copies.
        z: (tiles, 2, particles, TILE) material positions, x = F z, µm.
        F, F_dot: (tiles, 2, 2, TILE) where z was solved.
        factors: kept factorisation and prediction, see `newton`.
        near: the contacts to solve with first; None: they have to be listed.
        iterations: (tiles, TILE) force evaluations of the last solve.
        left: (tiles, TILE) whether the RVE left its branch at a bifurcation on its way here.
        fluctuation: as z, v − L x, µm/µs; None: zero, velocities are affine.
        elastic: as z, of the elastic equilibrium that "slow-manifold" starts from; None: z itself.
        is_checked: whether every point was found stable at this very z, its factors made there.
    """

    of: str
    points: int
    z: Array
    F: Array
    F_dot: Array
    factors: Factors
    near: Near | None
    iterations: NDArray[np.int32]
    left: Flags
    fluctuation: Array | None = None
    elastic: Array | None = None
    is_checked: bool = False

    @property
    def relaxed(self) -> Array:
        """z of the elastic equilibrium."""
        return self.z if self.elastic is None else self.elastic

    @property
    def beyond_affine(self) -> Array:
        """v − L x."""
        return np.zeros_like(self.z) if self.fluctuation is None else self.fluctuation

    @property
    def left_points(self) -> Flags:
        """(points,) `left`."""
        return unpack(self.left, self.points)

    def to_arrays(self, neighbours: Neighbours) -> dict[str, NDArray[Any]]:
        """(n, …) of all points by name, for `from_arrays`.

        Of the factors, which are large, there is what they are made of again, to the bit; of the
        list of contacts a bit for each, and where there is no list, NaN as z.
        """
        near = self.near
        every = neighbours.topology.contacts
        listed = np.zeros(len(every), dtype=np.bool_) if near is None else near.listed
        tiles = {
            **self._tiles(self),
            "factors.F": self.factors.drive.F,
            "factors.rate": self.factors.drive.rate,
            "factors.z": self.factors.z,
            "near.F": self.F if near is None else near.F,
            "near.z": np.full_like(self.z, np.nan) if near is None else near.z,
        }
        arrays = {name: unpack(values, self.points) for name, values in tiles.items()}
        arrays["near.listed"] = np.tile(np.packbits(listed), (self.points, 1))
        return arrays

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], of: str, neighbours: Neighbours
    ) -> RveState:
        """The state whose `to_arrays` gave these, with factors that are still to be made.

        Points of several states become one state, which lists the contacts of all.
        """
        names = (*_TILES, "fluctuation", "elastic")
        tiles: dict[str, Any] = {name: pack(arrays[name]) for name in names if name in arrays}
        drive = Drive(pack(arrays["factors.F"]), pack(arrays["factors.rate"]))
        factors = Factors.empty(drive, pack(arrays["factors.z"]), neighbours.topology)
        near = None
        near_z = pack(arrays["near.z"])
        if not np.isnan(near_z).any():
            bits = np.bitwise_or.reduce(arrays["near.listed"], axis=0)
            listed = np.unpackbits(bits, count=len(neighbours.topology.contacts)).astype(np.bool_)
            near = neighbours.listing(pack(arrays["near.F"]), near_z, listed)
        return cls(of=of, points=len(arrays["z"]), factors=factors, near=near, **tiles)

    def take(self, index: Index) -> RveState:
        """The state of the points `index` alone."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self
        tiles = self._tiles(self).items()
        taken: dict[str, Any] = {name: take_points(values, index) for name, values in tiles}
        near = self.near and self.near.take(index)
        factors = self.factors.take(index)
        return replace(self, points=len(index), factors=factors, near=near, **taken)

    def put(self, index: Index, part: RveState) -> RveState:
        """This state with the points `index` replaced by those of `part`."""
        index, row = with_copies(index, self.points)
        tiles = {name: values.copy() for name, values in self._tiles(part).items()}
        for name, values in part._tiles(self).items():
            put_points(tiles[name], index, values, row)
        factors = self.factors.put(index, part.factors, row)
        near = self.near and part.near and self.near.put(index, part.near, row)
        is_checked = self.is_checked and part.is_checked
        return replace(self, factors=factors, near=near, is_checked=is_checked, **tiles)

    def _tiles(self, other: RveState) -> dict[str, Any]:
        """Arrays of tiles by name, but those that neither this state nor the other has."""
        tiles: dict[str, Any] = {name: getattr(self, name) for name in _TILES}
        if self.fluctuation is not None or other.fluctuation is not None:
            tiles["fluctuation"] = self.beyond_affine
        if self.elastic is not None or other.elastic is not None:
            tiles["elastic"] = self.relaxed
        return tiles


def with_copies(index: Index, points: int) -> tuple[Index, Index]:
    """`index` and, if the last point is in it, the lanes that fill its tile up with copies of it.

    The second array says which place of the given `index` each comes from.
    """
    place = np.arange(len(index))
    last = place[index == points - 1]
    copies = np.arange(points, tiles_for(points) * TILE if len(last) else points)
    return np.append(index, copies), np.append(place, np.repeat(last, len(copies)))


# What particles feel


class Answer(NamedTuple):
    """What a solver says of all tiles.

    stress: (tiles, 2, 2, TILE) µN/µm. residual: (tiles, 1, TILE) mean force, µN.
    iterations: (tiles, TILE) how lanes stand, or evaluations of forces used; see above.
    stable: (tiles, TILE) whether the elastic Hessian is positive definite.
    """

    stress: Array
    residual: Array
    iterations: NDArray[np.int32]
    stable: Flags


def empty_answer(tiles: int) -> Answer:
    """Nothing solved, no stress, and all stable."""
    return Answer(
        stress=np.full((tiles, 2, 2, TILE), np.nan),
        residual=np.empty((tiles, 1, TILE)),
        iterations=np.full((tiles, TILE), UNDER_WAY, dtype=np.int32),
        stable=np.ones((tiles, TILE), dtype=np.bool_),
    )


@kernel
def drive_of(drive, t):
    """The `Drive` of tile t."""
    return Drive(drive.F[t], drive.rate[t])


@kernel
def answer_of(answer, t):
    """The `Answer` of tile t."""
    return Answer(answer.stress[t], answer.residual[t], answer.iterations[t], answer.stable[t])


@kernel
def copy_particles(source, target):
    """Copy as many particles as both (2, …, TILE) have."""
    for axis in range(2):
        for i in range(min(source.shape[1], target.shape[1])):
            store(load(source, axis, i), target, axis, i)


@kernel
def keep_lane(source, k, target):
    """Copy lane k of an array with three axes to one that may be shorter along the second."""
    for a in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[a, i, k] = source[a, i, k]


@kernel
def set_images(z, topology):
    """Fill the image part of local material positions from its own part."""
    particles = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        for axis in range(2):
            store(load(z, axis, i) + topology.image_offset[k, axis], z, axis, particles + k)


@pair_law
def entries(tensor):
    """(xx, xy, yx, yy) of a tensor (2, 2, TILE)."""
    return load(tensor, 0, 0), load(tensor, 0, 1), load(tensor, 1, 0), load(tensor, 1, 1)


@pair_law
def inverse(of):
    """The entries of the inverse of a tensor with the entries `of`."""
    xx, xy, yx, yy = of
    per_det = 1.0 / (xx * yy - xy * yx)
    return yy * per_det, -xy * per_det, -yx * per_det, xx * per_det


@kernel
def map_affine(F, z, x):
    """x = F z; F (2, 2, TILE), z and x (2, local, TILE)."""
    xx, xy, yx, yy = entries(F)
    for i in range(z.shape[1]):
        zx = load(z, 0, i)
        zy = load(z, 1, i)
        store(xx * zx + xy * zy, x, 0, i)
        store(yx * zx + yy * zy, x, 1, i)


@kernel
def place_images(work, F, topology):
    """Images of the own particles in work.z, and x = F z of all."""
    set_images(work.z, topology)
    map_affine(F, work.z, work.x)


@kernel
def place(work, z, F, topology):
    """Material positions z of own particles, their images, and x = F z of all."""
    copy_particles(z, work.z)
    place_images(work, F, topology)


@kernel
def cauchy_stress(x, f, F, area, stress):
    """Virial stress (eq. 57b) from unfolded local forces: σ = −1/V Σ_k f_k ⊗ x_k, µN/µm.

    Every pair adds f and −f to its two local particles, so the sum over pairs of f ⊗ r is minus
    the sum over local particles of force ⊗ position. V = det F times the reference area.
    """
    xx = spread(0.0)
    xy = spread(0.0)
    yx = spread(0.0)
    yy = spread(0.0)
    for k in range(x.shape[1]):
        px = load(x, 0, k)
        py = load(x, 1, k)
        fx = load(f, 0, k)
        fy = load(f, 1, k)
        xx -= fx * px
        xy -= fx * py
        yx -= fy * px
        yy -= fy * py
    fxx, fxy, fyx, fyy = entries(F)
    per_volume = 1.0 / (area * (fxx * fyy - fxy * fyx))
    store(xx * per_volume, stress, 0, 0)
    store(xy * per_volume, stress, 0, 1)
    store(yx * per_volume, stress, 1, 0)
    store(yy * per_volume, stress, 1, 1)


@kernel
def mean_force(f, particles, residual):
    """residual (1, TILE): mean over own particles of the folded force's magnitude, µN."""
    total = spread(0.0)
    for i in range(particles):
        fx = load(f, 0, i)
        fy = load(f, 1, i)
        total += root(fx * fx + fy * fy)
    store(total * (1.0 / particles), residual, 0)


@kernel
def measure(work, F, topology, c, stress, residual):
    """Forces (folded), stress and mean force at work.x and work.v."""
    local_forces(work, topology, c)
    cauchy_stress(work.x, work.f, F, topology.area, stress)
    fold_images(work.f, topology)
    mean_force(work.f, topology.particles, residual)


@kernel
def evaluate(work, drive, is_affine, topology, c, stress, residual):
    """`measure` at work.z with velocities v = rate z if `is_affine`, else those in work.v."""
    place_images(work, drive.F, topology)
    if is_affine:
        map_affine(drive.rate, work.z, work.v)
    measure(work, drive.F, topology, c, stress, residual)


@parallel_kernel
def stress_at(drive, z, topology, c, answer):
    """Stress and mean force at given z with affine velocities, all tiles."""
    for t in numba.prange(z.shape[0]):
        _stress_tile(drive_of(drive, t), z[t], topology, c, answer_of(answer, t))


@kernel
def _stress_tile(drive, z, topology, c, answer):
    work = make_workspace(topology)
    copy_particles(z, work.z)
    evaluate(work, drive, True, topology, c, answer.stress, answer.residual)


def stored_energy(F: Array, z: Array, topology: Topology, c: Constants) -> Array:
    """(m,) elastic energy at F (m, 2, 2) and material positions z (m, 2, n), pJ."""
    energy = np.empty((tiles_for(len(z)), 1, TILE))
    energies(pack(F), pack(z), topology, c, energy)
    return unpack(energy, len(z))[:, 0]


@parallel_kernel
def energies(F, z, topology, c, energy):
    """Elastic energy (tiles, 1, TILE) of every cell at z (tiles, 2, n, TILE), pJ."""
    for t in numba.prange(z.shape[0]):
        _energy_tile(F[t], z[t], topology, c, energy[t])


@kernel
def _energy_tile(F, z, topology, c, energy):
    work = make_workspace(topology)
    place(work, z, F, topology)
    elastic_energy(work, topology, c, energy)
