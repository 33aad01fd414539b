"""Particles of RVEs: what a law keeps of them from call to call, and what they feel at (F, Ḟ).

Unknowns are material positions z, so that x = F z moves along with F, and velocities v = Ḟ z are
affine: v = L x. z of particle 0, a wall corner, stays at the origin.

A state is a warm start: where particles were last, and kept factorisations, see `newton`. These and
their slopes are by far the largest part of it (22 kB per point), and few change from one state to
the next. Each tile has a block of memory of its own, in single precision, lanes last::

    block   lu (size, TILE), then slopes (free, 8, TILE)      free = 2 particles − 2

A block is written once, by the kernel it was made for; a state that renews some tiles gets new
blocks for these and shares the others. Kernels get a block by its address, and Python keeps it
for as long as any state refers to it.

Files contain the positions at which factors were made, not the factors: made again there they have
the same bits, whichever lane, tile or list of contacts a point has then.

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
from surrofe2.base.compilation import kernel, loop_body, pair_law, parallel_kernel
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
"""States of a lane that is not solved, see the table above."""
SLOPES = 8
"""Columns of kept slopes: four by F_xx, xy, yx, yy, then four by Ḟ."""
_BYTES = 4
"""Size of a number in single precision."""
_TILES = ("z", "F", "F_dot", "iterations", "has_left")
"""Arrays of tiles that every state has."""
_Pointer: Any = types.CPointer  # type: ignore[attr-defined]


class Drive(NamedTuple):
    """F and Ḟ, the rate that particles feel, of all tiles (tiles, 2, 2, TILE), or of one tile."""

    F: Array
    rate: Array


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """Kept factors: one block for each tile, and the states at which they were made.

    Attributes:
        blocks: one array (rows, TILE) of float32 for each tile; several tiles may share one.
        address: (tiles,) addresses of the blocks in memory, by which kernels get them.
        drive: F and the rate that particles felt where the factors were made.
        z: (tiles, 2, n, TILE) material positions where the factors were made; with "slow-manifold"
            those of the elastic equilibrium.
    """

    blocks: tuple[NDArray[np.float32], ...]
    address: Index
    drive: Drive
    z: Array

    @classmethod
    def of(cls, blocks: Sequence[NDArray[np.float32]], drive: Drive, z: Array) -> Factors:
        """Return the factors kept in these blocks, made at z and `drive`."""
        # kernels get addresses, for blocks are arrays of their own, some of which several tiles
        # share
        address = [_address_of(block) for block in blocks]
        return cls(tuple(blocks), np.array(address, dtype=np.intp), drive, z)

    @classmethod
    def empty(cls, drive: Drive, z: Array, topology: Topology) -> Factors:
        """Return factors that are not initialised, and are to be made at z and `drive`."""
        rows = topology.size + (2 * topology.particles - 2) * SLOPES
        blocks = [np.empty((rows, TILE), dtype=np.float32) for _ in range(len(z))]
        return cls.of(blocks, drive, z)

    @property
    def nbytes(self) -> int:
        """Memory of all blocks, each counted once."""
        return len(np.unique(self.address)) * self.blocks[0].nbytes

    def slopes(self, topology: Topology) -> Array:
        """Return ∂z/∂(F, Ḟ) where the factors were made, (tiles, free, 8, TILE)."""
        shape = (2 * topology.particles - 2, SLOPES, TILE)
        return np.stack([block[topology.size :].reshape(shape) for block in self.blocks])

    def repeated(self, tiles: int) -> Factors:
        """Return the first tile's factors for `tiles` tiles."""
        drive = Drive(
            np.repeat(self.drive.F[:1], tiles, axis=0),
            np.repeat(self.drive.rate[:1], tiles, axis=0),
        )
        z = np.repeat(self.z[:1], tiles, axis=0)
        address = np.repeat(self.address[:1], tiles)
        return Factors(self.blocks[:1] * tiles, address, drive, z)

    def renewed(self, wanted: Any) -> Factors:
        """Return these with new, uninitialised blocks for the `wanted` (tiles,) tiles.

        A caller that fills the blocks records the states at which it does by `made_at`.
        """
        blocks = list(self.blocks)
        address = self.address.copy()
        for tile in wanted.nonzero()[0].tolist():
            blocks[tile] = np.empty_like(blocks[tile])
            address[tile] = _address_of(blocks[tile])
        return replace(self, blocks=tuple(blocks), address=address)

    def made_at(self, wanted: Any, drive: Drive, z: Array) -> Factors:
        """Return these with `drive` and z as the states at which the `wanted` tiles were made."""
        if not wanted.any():
            return self

        def replaced(former: Array, new: Array) -> Array:
            """Return an array of tiles with those that are wanted taken from `new`."""
            is_wanted = wanted.reshape(-1, *[1] * (former.ndim - 1))
            return np.where(is_wanted, new, former)

        F = replaced(self.drive.F, drive.F)
        rate = replaced(self.drive.rate, drive.rate)
        return replace(self, drive=Drive(F, rate), z=replaced(self.z, z))

    def take(self, index: Index) -> Factors:
        """Return the factors of the points `index` alone; the last tile is filled up by `pack`."""
        blocks = []
        # each row holds the points that come to share a tile
        for points in pack(index):
            tile, lane = np.divmod(points, TILE)
            block = self.blocks[tile[0]]
            is_whole_tile = (points == TILE * tile[0] + np.arange(TILE)).all()
            if not is_whole_tile:  # else the block is shared
                columns = [self.blocks[t][:, k] for t, k in zip(tile, lane, strict=True)]
                block = np.stack(columns, axis=-1)
            blocks.append(block)
        drive = Drive(take_points(self.drive.F, index), take_points(self.drive.rate, index))
        return Factors.of(blocks, drive, take_points(self.z, index))

    def put(self, index: Index, part: Factors, row: Index) -> Factors:
        """Return these with the points `index` replaced by the points `row` of `part`."""
        blocks = list(self.blocks)
        for tile in np.unique(index // TILE):
            # other states may share the block, so a copy is written to
            blocks[tile] = blocks[tile].copy()
        for point, point_of_part in zip(index, row, strict=True):
            source = part.blocks[point_of_part // TILE]
            blocks[point // TILE][:, point % TILE] = source[:, point_of_part % TILE]
        F = self.drive.F.copy()
        rate = self.drive.rate.copy()
        z = self.z.copy()
        put_points(F, index, part.drive.F, row)
        put_points(rate, index, part.drive.rate, row)
        put_points(z, index, part.z, row)
        return Factors.of(blocks, Drive(F, rate), z)


def _address_of(block: NDArray[np.float32]) -> int:
    """Return the address of an array's first number in memory."""
    return int(block.__array_interface__["data"][0])


@intrinsic
def _singles_at(typing: Any, address: Any) -> Any:
    """Return a pointer to the single-precision numbers at an address."""
    pointer = _Pointer(types.float32)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        """Emit the machine code: an integer becomes a pointer."""
        return builder.inttoptr(args[0], ir.FloatType().as_pointer())

    return pointer(types.intp), generate


@kernel
def kept_factors(address, topology):
    """Return lu (size, TILE) and slopes (free, 8, TILE) of the block at an address, not copied."""
    size = topology.size
    lu = carray(_singles_at(address), (size, TILE))
    behind = address + _BYTES * size * TILE
    return lu, carray(_singles_at(behind), (2 * topology.particles - 2, SLOPES, TILE))


@kernel
def keep_factors(lu, target):
    """Copy factors lu (size, TILE) to where they are kept, in the precision of that array."""
    for i in range(lu.shape[0]):
        store(load(lu, i), target, i)


@dataclass(frozen=True, slots=True)
class RveState:
    """Particles of n RVEs in tiles, at the deformation they were solved at.

    Attributes:
        of: fingerprint of the law that it is a state of.
        points: number n of points; the last tile is filled up with copies.
        z: (tiles, 2, particles, TILE) material positions, x = F z, µm.
        F, F_dot: (tiles, 2, 2, TILE) deformation and rate at which z was solved.
        factors: kept factors and slopes, see `newton`.
        near: the contacts to solve with first; None: they have to be listed.
        iterations: (tiles, TILE) force evaluations of the last solve.
        has_left: (tiles, TILE) whether the RVE left its branch at a bifurcation on its way here.
        fluctuation: v − L x, shaped as z, µm/µs; None: zero, velocities are affine.
        elastic: material positions of the elastic equilibrium that "slow-manifold" starts from,
            shaped as z; None: z itself.
        is_checked: whether every point is known to be stable at this z, with factors made there.
    """

    of: str
    points: int
    z: Array
    F: Array
    F_dot: Array
    factors: Factors
    near: Near | None
    iterations: NDArray[np.int32]
    has_left: Flags
    fluctuation: Array | None = None
    elastic: Array | None = None
    is_checked: bool = False

    @property
    def relaxed(self) -> Array:
        """Material positions of the elastic equilibrium, shaped as z."""
        return self.z if self.elastic is None else self.elastic

    @property
    def beyond_affine(self) -> Array:
        """Velocities v − L x, shaped as z, µm/µs."""
        return np.zeros_like(self.z) if self.fluctuation is None else self.fluctuation

    @property
    def left_points(self) -> Flags:
        """True where a point left its branch at a bifurcation, (points,)."""
        return unpack(self.has_left, self.points)

    def to_arrays(self, neighbours: Neighbours) -> dict[str, NDArray[Any]]:
        """Return arrays (n, …) of all points by name, for `from_arrays`.

        Factors are large; instead of them there are the states at which they were made, from which
        they can be made again, to the bit. The list of contacts is a bit for each contact; without
        a list, its positions are NaN.
        """
        tiles = self._tiles(with_fluctuation=False, with_elastic=False)
        tiles["factors.F"] = self.factors.drive.F
        tiles["factors.rate"] = self.factors.drive.rate
        tiles["factors.z"] = self.factors.z
        if self.near is None:
            listed = np.zeros(len(neighbours.topology.contacts), dtype=np.bool_)
            tiles["near.F"] = self.F
            tiles["near.z"] = np.full_like(self.z, np.nan)
        else:
            listed = self.near.listed
            tiles["near.F"] = self.near.F
            tiles["near.z"] = self.near.z
        arrays = {name: unpack(values, self.points) for name, values in tiles.items()}
        arrays["near.listed"] = np.tile(np.packbits(listed), (self.points, 1))
        return arrays

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], of: str, neighbours: Neighbours
    ) -> RveState:
        """Return the state whose `to_arrays` returned these, with factors that are to be made yet.

        Points of several states become one state, which lists the contacts of all.
        """
        names = (*_TILES, "fluctuation", "elastic")
        tiles: dict[str, Any] = {name: pack(arrays[name]) for name in names if name in arrays}
        drive = Drive(pack(arrays["factors.F"]), pack(arrays["factors.rate"]))
        factors = Factors.empty(drive, pack(arrays["factors.z"]), neighbours.topology)
        near = None
        near_z = pack(arrays["near.z"])
        # `to_arrays` writes NaN where there was no list
        if not np.isnan(near_z).any():
            bits = np.bitwise_or.reduce(arrays["near.listed"], axis=0)
            listed = np.unpackbits(bits, count=len(neighbours.topology.contacts)).astype(np.bool_)
            near = neighbours.listing(pack(arrays["near.F"]), near_z, listed)
        return cls(of=of, points=len(arrays["z"]), factors=factors, near=near, **tiles)

    def take(self, index: Index) -> RveState:
        """Return the state of the points `index` alone."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self
        tiles = self._tiles(with_fluctuation=False, with_elastic=False)
        taken: dict[str, Any] = {name: take_points(tiles[name], index) for name in tiles}
        near = None if self.near is None else self.near.take(index)
        factors = self.factors.take(index)
        return replace(self, points=len(index), factors=factors, near=near, **taken)

    def put(self, index: Index, part: RveState) -> RveState:
        """Return this state with the points `index` replaced by those of `part`."""
        index, row = with_copies(index, self.points)
        # an array that only one of the two has is needed of both
        optional = {
            "with_fluctuation": self.fluctuation is not None or part.fluctuation is not None,
            "with_elastic": self.elastic is not None or part.elastic is not None,
        }
        tiles = {name: values.copy() for name, values in self._tiles(**optional).items()}
        for name, values in part._tiles(**optional).items():
            put_points(tiles[name], index, values, row)
        near = None
        if self.near is not None and part.near is not None:
            near = self.near.put(index, part.near, row)
        return replace(
            self,
            factors=self.factors.put(index, part.factors, row),
            near=near,
            is_checked=self.is_checked and part.is_checked,
            **tiles,
        )

    def _tiles(self, *, with_fluctuation: bool, with_elastic: bool) -> dict[str, Any]:
        """Return the arrays of tiles by name; the optional ones if this state has them or must."""
        tiles: dict[str, Any] = {name: getattr(self, name) for name in _TILES}
        if with_fluctuation or self.fluctuation is not None:
            tiles["fluctuation"] = self.beyond_affine
        if with_elastic or self.elastic is not None:
            tiles["elastic"] = self.relaxed
        return tiles


def with_copies(index: Index, points: int) -> tuple[Index, Index]:
    """Add the lanes that hold copies of the last of `points` points, if it is in `index`.

    Returns:
        The index with these lanes, and for each entry its place in the index that was passed.
    """
    place = np.arange(len(index))
    last = place[index == points - 1]
    lanes = tiles_for(points) * TILE if len(last) else points
    copies = np.arange(points, lanes)
    return np.append(index, copies), np.append(place, np.repeat(last, len(copies)))


# What particles feel


class Answer(NamedTuple):
    """Results of a solver for all tiles, which it fills in; or for one tile, without that axis.

    stress: (tiles, 2, 2, TILE) Cauchy stress, µN/µm.
    residual: (tiles, 1, TILE) mean force, µN; `iterate` and `stress_at` alone fill it.
    iterations: (tiles, TILE) states of the lanes, or evaluations of forces; see the table above.
    stable: (tiles, TILE) whether the elastic Hessian is positive definite.
    """

    stress: Array
    residual: Array
    iterations: NDArray[np.int32]
    stable: Flags


def empty_answer(tiles: int) -> Answer:
    """Return an `Answer` with nothing solved, no stress, and all stable."""
    return Answer(
        stress=np.full((tiles, 2, 2, TILE), np.nan),
        residual=np.empty((tiles, 1, TILE)),
        iterations=np.full((tiles, TILE), UNDER_WAY, dtype=np.int32),
        stable=np.ones((tiles, TILE), dtype=np.bool_),
    )


@kernel
def drive_of(drive, t):
    """Return the `Drive` of tile t."""
    return Drive(drive.F[t], drive.rate[t])


@kernel
def answer_of(answer, t):
    """Return the `Answer` of tile t; its arrays are views."""
    return Answer(answer.stress[t], answer.residual[t], answer.iterations[t], answer.stable[t])


@kernel
def copy_particles(source, target):
    """Copy particles from source to target (2, ·, TILE), as many as both have."""
    for axis in range(2):
        for i in range(min(source.shape[1], target.shape[1])):
            store(load(source, axis, i), target, axis, i)


@kernel
def keep_lane(source, lane, target):
    """Copy one lane of an array (·, ·, TILE) to one that may be shorter along the second axis."""
    for a in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[a, i, lane] = source[a, i, lane]


@kernel
def set_images(z, topology):
    """Fill the images in z (2, local, TILE): each is its owner moved by a lattice vector."""
    particles = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        for axis in range(2):
            store(load(z, axis, i) + topology.image_offset[k, axis], z, axis, particles + k)


@pair_law
def entries(tensor):
    """Return the entries (xx, xy, yx, yy) of a tensor (2, 2, TILE)."""
    return load(tensor, 0, 0), load(tensor, 0, 1), load(tensor, 1, 0), load(tensor, 1, 1)


@pair_law
def inverse(tensor):
    """Return the inverse of a tensor; both as entries (xx, xy, yx, yy)."""
    xx, xy, yx, yy = tensor
    per_det = 1.0 / (xx * yy - xy * yx)
    return yy * per_det, -xy * per_det, -yx * per_det, xx * per_det


@kernel
def map_affine(F, z, x):
    """Fill x (2, local, TILE) with F z; F (2, 2, TILE), z (2, local, TILE)."""
    xx, xy, yx, yy = entries(F)
    for i in range(z.shape[1]):
        zx = load(z, 0, i)
        zy = load(z, 1, i)
        store(xx * zx + xy * zy, x, 0, i)
        store(yx * zx + yy * zy, x, 1, i)


@kernel
def place_images(workspace, F, topology):
    """Fill the images in workspace.z by its own particles, and workspace.x with F z of all."""
    set_images(workspace.z, topology)
    map_affine(F, workspace.z, workspace.x)


@kernel
def place(workspace, z, F, topology):
    """Fill workspace.z with z (2, n, TILE) and the images, and workspace.x with F z of all."""
    copy_particles(z, workspace.z)
    place_images(workspace, F, topology)


@kernel
def cauchy_stress(x, f, F, area, stress):
    """Fill stress (2, 2, TILE) with the virial stress (eq. 57b), σ = −1/V Σ_k f_k ⊗ x_k, µN/µm.

    x, f: (2, local, TILE) positions, µm, and forces, not folded yet, µN. V is det F times the
    reference area. Every pair adds f and −f to its two local particles, so the sum over pairs of
    f ⊗ r is minus the sum over local particles of force ⊗ position.
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
    """Fill residual (1, TILE) with the mean magnitude of the folded forces on own particles, µN."""
    total = spread(0.0)
    for i in range(particles):
        fx = load(f, 0, i)
        fy = load(f, 1, i)
        total += root(fx * fx + fy * fy)
    store(total * (1.0 / particles), residual, 0)


@kernel
def measure(workspace, F, topology, constants, stress, residual):
    """Compute folded forces, stress (2, 2, TILE) and residual (1, TILE) at the workspace's x, v."""
    local_forces(workspace, topology, constants)
    # before forces are folded: in the virial each belongs to the position of its image
    cauchy_stress(workspace.x, workspace.f, F, topology.area, stress)
    fold_images(workspace.f, topology)
    mean_force(workspace.f, topology.particles, residual)


@kernel
def evaluate(workspace, drive, is_affine, topology, constants, stress, residual):
    """Do as `measure` at workspace.z; v becomes drive.rate z if `is_affine`, else it stays."""
    place_images(workspace, drive.F, topology)
    if is_affine:
        map_affine(drive.rate, workspace.z, workspace.v)
    measure(workspace, drive.F, topology, constants, stress, residual)


@parallel_kernel
def stress_at(drive, z, topology, constants, answer):
    """Fill stress and residual of the answer at z (tiles, 2, n, TILE) with affine velocities."""
    for t in numba.prange(z.shape[0]):
        _stress_tile(drive_of(drive, t), z[t], topology, constants, answer_of(answer, t))


@loop_body
def _stress_tile(drive, z, topology, constants, answer):
    """Do as `stress_at` for one tile."""
    workspace = make_workspace(topology)
    copy_particles(z, workspace.z)
    evaluate(workspace, drive, True, topology, constants, answer.stress, answer.residual)


def stored_energy(F: Array, z: Array, topology: Topology, constants: Constants) -> Array:
    """Return the elastic energy (m,) at F (m, 2, 2) and material positions z (m, 2, n), pJ."""
    energy = np.empty((tiles_for(len(z)), 1, TILE))
    energies(pack(F), pack(z), topology, constants, energy)
    return unpack(energy, len(z))[:, 0]


@parallel_kernel
def energies(F, z, topology, constants, energy):
    """Fill energy (tiles, 1, TILE) with that of the RVEs at F and z (tiles, 2, n, TILE), pJ."""
    for t in numba.prange(z.shape[0]):
        _energy_tile(F[t], z[t], topology, constants, energy[t])


@loop_body
def _energy_tile(F, z, topology, constants, energy):
    """Do as `energies` for one tile."""
    workspace = make_workspace(topology)
    place(workspace, z, F, topology)
    elastic_energy(workspace, topology, constants, energy)
