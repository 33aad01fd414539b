"""Kept factorisations and slopes of a batch of RVEs, shared by the states that agree on them.

They are by far the largest part of a state (22 kB a point) and few change from one state to the
next. Each tile has a block of memory of its own, all single precision, lanes last::

    block   lu (free, free, TILE), then slopes (free, 8, TILE)      free = 2 particles − 2
            sparse: lu (size, TILE)

A block is written once, by the kernel it was made for; a state that renews some tiles gets new
blocks for these and shares the others. Kernels find a block by its address, and Python keeps it
for as long as any state refers to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.simd import TILE

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
    def empty(cls, tiles: int, free: int, size: int | None = None) -> Factors:
        """Uninitialised factors of `tiles` tiles with `free` unknowns a point.

        size: numbers in the lu of a point; None: dense, free².
        """
        rows = (free * free if size is None else size) + free * SLOPES
        return cls.of([np.empty((rows, TILE), dtype=np.float32) for _ in range(tiles)])

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Each block once, and which is whose, for `from_arrays`."""
        _, first, block_of = np.unique(self.address, return_index=True, return_inverse=True)
        return {"blocks": np.stack([self.blocks[k] for k in first]), "block_of": block_of}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Factors:
        """The factors whose `to_arrays` gave these."""
        blocks = [np.array(block) for block in arrays["blocks"]]
        return cls.of([blocks[k] for k in arrays["block_of"]])

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
def kept(address, free):
    """(lu (free, free, TILE), slopes (free, 8, TILE)) of the block at an address; not copied."""
    lu = carray(_singles_at(address), (free, free, TILE))
    behind = address + _BYTES * free * free * TILE
    return lu, carray(_singles_at(behind), (free, SLOPES, TILE))


@kernel
def kept_sparse(address, size, free):
    """As `kept` with lu (size, TILE)."""
    lu = carray(_singles_at(address), (size, TILE))
    behind = address + _BYTES * size * TILE
    return lu, carray(_singles_at(behind), (free, SLOPES, TILE))
