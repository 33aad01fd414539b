"""Records of two tables of one RVE as one table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.table_evidence import Rule, weigh
from surrofe2.cache.table_records import Records, joined
from surrofe2.cache.table_tree import find, make_tree

SAME = 0.01
"""A record within so small a share of the tolerance of another, by its bound, adds nothing."""
_NO_GROWTH = Rule(reach=1.0)


def merged(first: Records, second: Records, tolerance: float, images: int) -> Records:
    """All records of both but those of the second that the first has too.

    The stress at each centre is a true answer, and shrinks every ellipsoid that is wrong there.

    Args:
        tolerance: µN/µm, for which ellipsoids are tested.
        images: 4 with the symmetry D4, 1 without.
    """
    records = joined(first, second.take(_new(first, second, SAME * tolerance)))
    weigh(records.centre, records.stress, tolerance, images, records, _NO_GROWTH)
    return records


def _new(first: Records, second: Records, near: float) -> NDArray[np.intp]:
    tree = make_tree(first.centre, first.half_width(near))
    found = [find(x, near, first.centre, first.curvature, tree)[0] for x in second.centre]
    return np.flatnonzero(np.array(found, dtype=np.intp) < 0)
