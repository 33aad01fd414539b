"""What true answers say of a table's ellipsoids: covered, to be grown, to be shrunk; compiled.

Growing is ISAT's (Pope 1997, section 3.3): where the linear model of a near record is right at a
point outside its ellipsoid, this becomes the least ellipsoid that holds the old one and the point.
Along the point p, in the metric of the ellipsoid, that is a change of rank one:

    C ← C + (target − b)/b² (C p)(C p)ᵀ,    b = pᵀ C p,    so that pᵀ C p becomes `target`.

Shrinking is the same with a larger target: the error that was seen, and a margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.table_inputs import INPUT_SIGNS, OUTPUT_SIGNS, OUTPUTS
from surrofe2.cache.table_records import Records
from surrofe2.cache.table_tree import quadratic
from surrofe2.compilation import kernel
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]


class Rule(NamedTuple):
    """When ellipsoids grow and shrink.

    Attributes:
        reach: an ellipsoid grows to a point only where its bound there is at most so many
            tolerances
        growing: … and the error seen there at most this share of the tolerance, for the same is
            then claimed of the opposite point, and of those between.
        shrinking: errors above the bound are let pass up to this share of the tolerance.
        margin: a shrunk ellipsoid bounds so many times the error that was seen.
    """

    reach: float = 2.0
    growing: float = 0.4
    shrinking: float = 0.7
    margin: float = 1.5


_RULE = Rule()


def weigh(
    x: Array, s: Array, tolerance: float, images: int, records: Records, rule: Rule = _RULE
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """(covered (m,), counts) of m true answers, by which curvature and extent change in place.

    Args:
        x, s: (m, 7), (m, 4) inputs and stress.
        images: 4 with the symmetry D4, 1 without.
        records: whose arrays are changed: pass copies.
    """
    covered = np.zeros(len(x), dtype=np.bool_)
    counts = np.zeros(2, dtype=np.int64)
    _weigh(
        x, s, tolerance, images, rule, records.centre, records.stress, records.slope,
        records.curvature, records.extent, covered, counts,
    )  # fmt: skip
    return covered, {"grown": int(counts[0]), "shrunk": int(counts[1])}


@kernel
def _weigh(  # type: ignore[no-untyped-def]
    x, s, tolerance, images, rule, centre, stress, slope, curvature, extent, covered, counts
):
    reach = rule.reach * tolerance
    p, candidate = np.empty(INPUTS), np.empty(INPUTS)
    for point in range(x.shape[0]):
        nearest, least = -1, reach
        for k in range(centre.shape[0]):
            for flips in range(images):
                near = True
                for i in range(INPUTS):
                    p[i] = x[point, i] * INPUT_SIGNS[flips, i] - centre[k, i]
                    near &= p[i] * p[i] <= reach * extent[k, i]
                if not near:
                    continue
                bound = quadratic(p, curvature[k])
                if bound > reach:
                    continue
                error = _error(p, s[point], flips, stress[k], slope[k])
                if bound > tolerance:
                    if error <= rule.growing * tolerance and bound < least:
                        nearest, least = k, bound
                        candidate[:] = p
                elif error > max(bound, rule.shrinking * tolerance):
                    counts[1] += 1
                    set_bound(p, rule.margin * error, curvature[k], extent[k])
                    bound = rule.margin * error
                    covered[point] |= bound <= tolerance
                else:
                    covered[point] = True
        if not covered[point] and nearest >= 0:
            counts[0] += 1
            set_bound(candidate, (1.0 - 1e-9) * tolerance, curvature[nearest], extent[nearest])
            covered[point] = True


@kernel
def _error(p, s, flips, stress, slope):  # type: ignore[no-untyped-def]
    """Frobenius norm of the linear model's error at the image `flips` of a true answer s."""
    total = 0.0
    for k in range(OUTPUTS):
        answer = stress[k]
        for i in range(INPUTS):
            answer += slope[k, i] * p[i]
        total += (answer - s[k] * OUTPUT_SIGNS[flips, k]) ** 2
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
