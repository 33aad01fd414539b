"""Grows and shrinks the ellipsoids of a table by true answers; compiled.

Growing is like ISAT's (Pope 1997, section 3.3): where the linear model of a near record is right at
a point outside its ellipsoid or near its surface, the ellipsoid grows along the point p until that
is well inside. In the metric of the ellipsoid that is a change of rank one:

    C ← C + (target − b)/b² (C p)(C p)ᵀ,    b = pᵀ C p,    so that pᵀ C p becomes `target`.

Shrinking is the same with a larger target: the error that was seen, and a margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS
from surrofe2.base.tensors import INPUTS
from surrofe2.cache.table.records import OUTPUTS, Records, joined

Array = NDArray[np.float64]


class Rule(NamedTuple):
    """When ellipsoids grow and shrink.

    Attributes:
        reach: an ellipsoid grows to a point only where its bound there is at most so many
            tolerances
        growing: … and the error seen there at most this share of the tolerance, for the same is
            then claimed of the opposite point, and of those between.
        grown: … so far that its bound there is this share of the tolerance, for the error grows
            with the bound, and a cache takes a point back only well within an ellipsoid.
        shrinking: errors above the bound are let pass up to this share of the tolerance.
        margin: a shrunk ellipsoid bounds so many times the error that was seen.
    """

    reach: float = 2.0
    growing: float = 0.4
    grown: float = 0.56
    shrinking: float = 0.7
    margin: float = 1.5


_RULE = Rule()
_NO_GROWTH = Rule(reach=1.0, growing=-1.0)
SAME = 0.01
"""A record within so small a share of the tolerance of another, by its bound, adds nothing."""


def update_ellipsoids(
    x: Array,
    s: Array,
    images: int,
    records: Records,
    tolerance: float,
    rule: Rule = _RULE,
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """(covered (m,), counts) of m true answers, by which curvature and extent change in place.

    Args:
        x, s: (m, 7), (m, 4) inputs and stress.
        images: 4 with the symmetry D4, 1 without.
        records: whose arrays are changed.
        tolerance: µN/µm, that decides.
    """
    covered = np.zeros(len(x), dtype=np.bool_)
    counts = np.zeros(2, dtype=np.int64)
    _update(x, s, images, rule, records, float(tolerance), covered, counts)
    return covered, {"grown": int(counts[0]), "shrunk": int(counts[1])}


@kernel
def _update(x, s, images, rule, records, tolerance, covered, counts):  # type: ignore[no-untyped-def]
    reach = rule.reach * tolerance
    p, candidate = np.empty(INPUTS), np.empty(INPUTS)
    for point in range(x.shape[0]):
        nearest, least, within = -1, reach, False
        for k in range(records.centre.shape[0]):
            for flips in range(images):
                for i in range(INPUTS):
                    p[i] = x[point, i] * INPUT_SIGNS[flips, i] - records.centre[k, i]
                bound = _quadratic(p, records.curvature[k])
                if bound > reach:
                    continue
                error = _error(p, s[point], flips, records.stress[k], records.slope[k])
                if bound <= tolerance and error > max(bound, rule.shrinking * tolerance):
                    counts[1] += 1
                    set_bound(p, rule.margin * error, records.curvature[k], records.extent[k])
                    bound = rule.margin * error
                elif bound <= rule.grown * tolerance:
                    within = True
                elif error <= rule.growing * tolerance and bound < least:
                    nearest, least = k, bound
                    candidate[:] = p
                covered[point] |= bound <= tolerance
        if nearest >= 0 and not within:
            counts[0] += 1
            target = rule.grown * tolerance
            set_bound(candidate, target, records.curvature[nearest], records.extent[nearest])
            covered[point] = True


@kernel
def _quadratic(d, matrix):  # type: ignore[no-untyped-def]
    """dᵀ M d."""
    total = 0.0
    for i in range(INPUTS):
        row = 0.0
        for j in range(INPUTS):
            row += matrix[i, j] * d[j]
        total += row * d[i]
    return total


@kernel
def _error(p, s, flips, stress, slope):  # type: ignore[no-untyped-def]
    """Frobenius norm of the linear model's error at the image `flips` of a true answer s."""
    total = 0.0
    for k in range(OUTPUTS):
        answer = stress[k]
        for i in range(INPUTS):
            answer += slope[k, i] * p[i]
        total += (answer - s[k] * COMPONENT_SIGNS[flips, k]) ** 2
    return np.sqrt(0.5 * total)


@kernel
def set_bound(p, target, curvature, extent):  # type: ignore[no-untyped-def]
    """Change C (7, 7), and diag C⁻¹ (7,), by rank one in place so that pᵀ C p is `target`."""
    pull = np.zeros(INPUTS)
    bound = 0.0
    for i in range(INPUTS):
        for j in range(INPUTS):
            pull[i] += curvature[i, j] * p[j]
        bound += pull[i] * p[i]
    if bound <= 0.0:
        return
    factor = (target - bound) / (bound * bound)
    for i in range(INPUTS):
        for j in range(INPUTS):
            curvature[i, j] += factor * pull[i] * pull[j]
        extent[i] += (1.0 / target - 1.0 / bound) * p[i] * p[i]


def merged(first: Records, second: Records, tolerance: float, images: int) -> Records:
    """All records of both but those of the second that the first has too.

    The stress at each centre is a true answer, and shrinks every ellipsoid that is wrong there.

    Args:
        tolerance: µN/µm, for which ellipsoids are tested.
        images: 4 with the symmetry D4, 1 without.
    """
    is_known = np.empty(len(second.centre), dtype=np.bool_)
    _hold_any(second.centre, SAME * tolerance, first, is_known)
    records = joined(first, second.take(np.flatnonzero(~is_known)))
    update_ellipsoids(records.centre, records.stress, images, records, tolerance, _NO_GROWTH)
    return records


@kernel
def _hold_any(x, limit, records, held):  # type: ignore[no-untyped-def]
    """Fill held (m,): whether the bound of any record at x (m, 7) is at most `limit`."""
    for p in range(x.shape[0]):
        held[p] = False
        for k in range(records.centre.shape[0]):
            d = x[p] - records.centre[k]
            held[p] |= _quadratic(d, records.curvature[k]) <= limit
