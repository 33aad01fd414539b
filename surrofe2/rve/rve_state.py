"""The warm start of an RVE law: what its particles did last, and the factorisations kept.

Factorisations and slopes are by far the largest part of a state (22 kB a point) and few change
from one state to the next. Each tile has a block of memory of its own, in single precision, lanes
last::

    block   lu (size, TILE), then slopes (free, 8, TILE)      free = 2 particles − 2

A block is written once, by the kernel it was made for; a state that renews some tiles gets new
blocks for these and shares the others. Kernels find a block by its address, and Python keeps it
for as long as any state refers to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.neighbours import Near
from surrofe2.plant_cell.tiles import Topology, pack, put_points, tiles_for, unpack

Reals = NDArray[np.float64]

SLOPES = 8
_BYTES = 4
_Pointer: Any = types.CPointer  # type: ignore[attr-defined]


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """One block for each tile.

    Attributes:
        blocks: (rows, TILE) float32 each; several tiles may share one.
        address: (tiles,) of the blocks.
    """

    blocks: tuple[NDArray[np.float32], ...]
    address: NDArray[np.intp]

    @classmethod
    def of(cls, blocks: list[NDArray[np.float32]]) -> Factors:
        """The factors kept in these blocks."""
        address = [block.__array_interface__["data"][0] for block in blocks]
        return cls(tuple(blocks), np.array(address, dtype=np.intp))

    @classmethod
    def empty(cls, tiles: int, topology: Topology) -> Factors:
        """Uninitialised factors of `tiles` tiles."""
        rows = topology.size + (2 * topology.particles - 2) * SLOPES
        return cls.of([np.empty((rows, TILE), dtype=np.float32) for _ in range(tiles)])

    @property
    def nbytes(self) -> int:
        """Of all blocks, each counted once."""
        return len(np.unique(self.address)) * self.blocks[0].nbytes

    def repeated(self, tiles: int) -> Factors:
        """The first tile's factors for `tiles` tiles."""
        return Factors(self.blocks[:1] * tiles, np.repeat(self.address[:1], tiles))

    def renewed(self, wanted: Any) -> Factors:
        """These with new, uninitialised blocks for the tiles that `wanted` (tiles,) marks."""
        blocks, address = list(self.blocks), self.address.copy()
        for tile in wanted.nonzero()[0].tolist():
            blocks[tile] = np.empty_like(blocks[tile])
            address[tile] = blocks[tile].__array_interface__["data"][0]
        return Factors(tuple(blocks), address)

    def take(self, index: NDArray[np.intp]) -> Factors:
        """The factors of the points `index` alone; the last tile filled up as by `pack`."""
        tiles = -(-len(index) // TILE)
        padded = index[np.minimum(np.arange(tiles * TILE), len(index) - 1)].reshape(tiles, TILE)
        return Factors.of([self._gathered(*np.divmod(points, TILE)) for points in padded])

    def put(self, index: NDArray[np.intp], part: Factors) -> Factors:
        """These with the points `index` replaced by the first ones of `part`."""
        tile, lane = np.divmod(index, TILE)
        from_tile, from_lane = np.divmod(np.arange(len(index)), TILE)
        blocks = list(self.blocks)
        for changed in np.unique(tile).tolist():
            block = blocks[changed].copy()
            for k in (tile == changed).nonzero()[0].tolist():
                block[:, lane[k]] = part.blocks[from_tile[k]][:, from_lane[k]]
            blocks[changed] = block
        return Factors.of(blocks)

    def _gathered(self, tile: NDArray[np.intp], lane: NDArray[np.intp]) -> NDArray[np.float32]:
        """One block of TILE points."""
        first = self.blocks[tile[0]]
        if (tile == tile[0]).all() and (lane == np.arange(TILE)).all():
            return first
        block = np.empty_like(first)
        for source in np.unique(tile).tolist():
            here = (tile == source).nonzero()[0]
            block[:, here] = self.blocks[source][:, lane[here]]
        return block


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
    z: Reals
    F: Reals
    F_dot: Reals
    factors: Factors
    near: Near | None
    iterations: NDArray[np.int32]
    left: NDArray[np.bool_]
    fluctuation: Reals | None = None
    elastic: Reals | None = None
    is_checked: bool = False

    @property
    def relaxed(self) -> Reals:
        """z of the elastic equilibrium."""
        return self.z if self.elastic is None else self.elastic

    @property
    def beyond_affine(self) -> Reals:
        """v − L x."""
        return np.zeros_like(self.z) if self.fluctuation is None else self.fluctuation

    @property
    def left_points(self) -> NDArray[np.bool_]:
        """(points,) `left`."""
        return unpack(self.left, self.points)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """(n, …) of all points by name, for `from_arrays`; not the factors, which are large and
        can be made again.
        """
        return {name: unpack(tiles, self.points) for name, tiles in self._tiles(self).items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], of: str, factors: Factors) -> RveState:
        """The state of the same law whose `to_arrays` gave these, with the first of `factors`."""
        points = len(arrays["z"])
        tiles: dict[str, Any] = {name: pack(values) for name, values in arrays.items()}
        factors = factors.repeated(tiles_for(points))
        return cls(of=of, points=points, factors=factors, near=None, **tiles)

    def take(self, index: NDArray[np.intp]) -> RveState:
        """The state of the points `index` alone."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self
        tiles = self._tiles(self).items()
        taken: dict[str, Any] = {k: pack(unpack(v, self.points)[index]) for k, v in tiles}
        near, factors = self.near and self.near.take(index, self.points), self.factors.take(index)
        return replace(self, points=len(index), factors=factors, near=near, **taken)

    def put(self, index: NDArray[np.intp], part: RveState) -> RveState:
        """This state with the points `index` replaced by those of `part`."""
        index, row = with_copies(index, self.points)
        part = part.take(row)
        tiles = {name: values.copy() for name, values in self._tiles(part).items()}
        for name, values in part._tiles(self).items():
            put_points(tiles[name], index, values)
        factors = self.factors.put(index, part.factors)
        near = self.near and part.near and self.near.put(index, part.near)
        is_checked = self.is_checked and part.is_checked
        return replace(self, factors=factors, near=near, is_checked=is_checked, **tiles)

    def _tiles(self, other: RveState) -> dict[str, Any]:
        """Arrays of tiles by name, but those that neither this state nor the other has."""
        tiles: dict[str, Any] = {
            "z": self.z,
            "F": self.F,
            "F_dot": self.F_dot,
            "iterations": self.iterations,
            "left": self.left,
        }
        if self.fluctuation is not None or other.fluctuation is not None:
            tiles["fluctuation"] = self.beyond_affine
        if self.elastic is not None or other.elastic is not None:
            tiles["elastic"] = self.relaxed
        return tiles


def with_copies(index: NDArray[np.intp], points: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """`index` and, if the last point is in it, the lanes that fill its tile up with copies of it.

    The second array says which place of the given `index` each comes from.
    """
    place = np.arange(len(index))
    last = place[index == points - 1]
    copies = np.arange(points, tiles_for(points) * TILE if len(last) else points)
    return np.append(index, copies), np.append(place, np.repeat(last, len(copies)))
