"""Whether a list of contacts holds all there are at a deformation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.plant_cell.arranged_patch import Unlisted
from surrofe2.rve.particle_state import list_covers
from surrofe2.simd import TILE

Array = NDArray[np.float64]


def covers(
    F: Array, z: Array, reference: Array, reach: float, unlisted: Unlisted | None, cutoff: float
) -> NDArray[np.bool_]:
    """(tiles, TILE): whether no pair beyond a list's `reach` can be within the cut-off.

    First by the bound of `list_covers`; where that is too coarse, the pairs up to a longer reach
    that the list leaves out are looked at one by one.
    """
    covered = np.empty((len(F), TILE), dtype=np.bool_)
    list_covers(F, z, reference, reach, cutoff, covered)
    if unlisted is None or covered.all():
        return covered
    farther, apart = np.empty_like(covered), np.empty_like(covered)
    list_covers(F, z, reference, unlisted.reach, cutoff, farther)
    _all_apart(F, z, unlisted.pairs, unlisted.offset, cutoff, apart)
    return covered | (farther & apart)


@kernel
def _all_apart(F, z, pairs, offset, cutoff, apart):
    apart[:] = True
    for t in range(z.shape[0]):
        for k in range(pairs.shape[0]):
            i, j = pairs[k, 0], pairs[k, 1]
            for lane in range(TILE):
                rx = z[t, 0, j, lane] + offset[k, 0] - z[t, 0, i, lane]
                ry = z[t, 1, j, lane] + offset[k, 1] - z[t, 1, i, lane]
                px = F[t, 0, 0, lane] * rx + F[t, 0, 1, lane] * ry
                py = F[t, 1, 0, lane] * rx + F[t, 1, 1, lane] * ry
                if px * px + py * py < cutoff * cutoff:
                    apart[t, lane] = False
