"""Points dealt to ranks in blocks of whole tiles, by what the blocks cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import tiles_for
from surrofe2.simd import TILE

Index = NDArray[np.int64]
Array = NDArray[np.float64]

UNEVEN = 1.1
"""Seconds of the slowest rank by the mean from which points are dealt anew."""


def deal(points: int, ranks: int, least: int = 1) -> Index:
    """(ranks + 1,) first points of equal blocks of all ranks, and `points`.

    Blocks begin with tiles, so that the same RVEs share a tile by any number of ranks.

    Args:
        least: tiles of a block; where there are fewer, the first ranks have them.
    """
    tiles = tiles_for(points)
    sharing = min(ranks, max(1, tiles // least))
    ends = np.minimum(np.arange(ranks + 1) / sharing, 1.0)
    cuts: Index = np.minimum(np.rint(ends * tiles).astype(np.int64) * TILE, points)
    return cuts


def redeal(cuts: Index, seconds: Array) -> Index:
    """Blocks that would have taken all ranks equally long, had each point of a block of `cuts`
    taken as long as the others of it: (ranks,) seconds in all.
    """
    passed = np.concatenate([[0.0], np.cumsum(seconds)])
    wanted = np.linspace(0.0, passed[-1], len(cuts))
    tiles = np.interp(wanted, passed, -(-cuts // TILE))
    new: Index = np.minimum(np.rint(tiles).astype(np.int64) * TILE, cuts[-1])
    return new


def is_uneven(seconds: Array) -> bool:
    """Whether the slowest rank takes so much longer than the mean that dealing anew pays."""
    mean = float(seconds.mean())
    return mean > 0.0 and float(seconds.max()) > UNEVEN * mean


_CALLS = 64
"""Calls after which blocks may be dealt anew."""


class Blocks:
    """Who has what of a number of points or elements, by how long the ranks took lately.

    Attributes:
        cuts: (ranks + 1,), as of `deal`.
    """

    def __init__(self, count: int, ranks: int) -> None:
        self.cuts = deal(count, ranks)
        self._seconds, self._calls = np.zeros(ranks), 0

    def took(self, seconds: Array) -> None:
        """That ranks took so long (ranks,) for one call."""
        self._seconds += seconds
        self._calls += 1
        if self._calls == _CALLS:
            ranks = len(self._seconds)
            if is_uneven(self._seconds) and tiles_for(int(self.cuts[-1])) > 4 * ranks:
                self.cuts = redeal(self.cuts, self._seconds)
            self._seconds, self._calls = np.zeros(ranks), 0
