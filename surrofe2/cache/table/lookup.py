"""Stress from a table's linear models, point by point, in one compiled pass.

All models answer whose ellipsoids hold the point or an image of it, each with a weight that is 0
at the surface of its ellipsoid and infinite at its centre, so that the answer is continuous
wherever there is one: a macro scale that chooses its steps by their error sees no jumps. With b
the bound of a model and L the largest that is allowed, the weight is (L/b − 1)².
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.cache.table.records import OUTPUTS
from surrofe2.cache.table.search_tree import DEPTH, find_all
from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS
from surrofe2.stress_law import Status
from surrofe2.tensors import INPUTS

MANY = 1000  # points from which on more than one core pays

_OK, _OUT_OF_RANGE, _NOT_FINITE = int(Status.OK), int(Status.OUT_OF_RANGE), int(Status.NOT_FINITE)
_NOT_TRUSTED = int(Status.NOT_TRUSTED)
_AT_ONCE = 100  # points a core answers at once
_MOST = 256  # models that answer for a point
_NEAREST = 1e-9  # of the tolerance: a bound that is as good as none


def look_up(
    F: Any, F_dot: Any, tolerance: float, own_tolerance: float, images: int, records: Any, tree: Any
) -> tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.float64]]:
    """(stress (n, 2, 2), status (n,), bound (n,)) as `StressTable.lookup` gives them."""
    count = len(F)
    answer = np.empty((count, 2, 2)), np.empty(count, dtype=np.int8), np.empty(count)
    compute = _all_parallel if count >= MANY else _some
    compute(0, count, (F, F_dot), (tolerance, own_tolerance), images, records, tree, answer)
    return answer


@parallel_kernel
def _all_parallel(first, last, asked, tolerances, images, records, tree, answer):  # type: ignore[no-untyped-def]
    for part in prange((last - first + _AT_ONCE - 1) // _AT_ONCE):
        begin = first + part * _AT_ONCE
        end = min(begin + _AT_ONCE, last)
        _some(begin, end, asked, tolerances, images, records, tree, answer)


@kernel
def _some(first, last, asked, tolerances, images, records, tree, answer):  # type: ignore[no-untyped-def]
    (F, F_dot), (tolerance, own), (stress, status, bound) = asked, tolerances, answer
    x, image, s = np.empty(INPUTS), np.empty(INPUTS), np.empty(OUTPUTS)
    found, bounds = np.empty(_MOST, dtype=np.int32), np.empty(_MOST)
    stack = np.empty(DEPTH, dtype=np.int32)
    limit = min(own, tolerance * abs(tolerance) / own)
    for p in range(first, last):
        stress[p] = np.nan
        bound[p] = np.inf
        status[p] = _OUT_OF_RANGE
        cosine, sine = read_inputs(F[p], F_dot[p], x)
        if not np.isfinite(cosine):
            continue
        least, total, radius = np.inf, 0.0, 0.0
        s[:] = 0.0
        for flips in range(images):
            for i in range(INPUTS):
                image[i] = x[i] * INPUT_SIGNS[flips, i]
            count = find_all(
                image, own, records.centre, records.curvature, tree, stack, found, bounds
            )
            for n in range(count):
                k, b = found[n], bounds[n]
                least = min(least, b)
                if b <= limit:
                    weight = ((limit - b) / max(b, _NEAREST * own) + _NEAREST) ** 2
                    total += weight
                    radius += weight * np.sqrt(b * own)
                    _add(weight, image, k, records, COMPONENT_SIGNS[flips], s)
        if least == np.inf:
            continue
        if total == 0.0:
            status[p] = _NOT_TRUSTED
            bound[p] = np.sqrt(least * own)
            continue
        bound[p] = radius / total
        for k in range(OUTPUTS):
            s[k] /= total
        write_stress(s, cosine, sine, stress[p])
        finite = np.isfinite(stress[p, 0, 0] + stress[p, 0, 1] + stress[p, 1, 0] + stress[p, 1, 1])
        status[p] = _OK if finite else _NOT_FINITE


@kernel
def _add(weight, image, record, records, signs, s):  # type: ignore[no-untyped-def]
    """Add a linear model's components, turned back by the signs of the image, to s."""
    for k in range(OUTPUTS):
        value = records.stress[record, k]
        for i in range(INPUTS):
            value += records.slope[record, k, i] * (image[i] - records.centre[record, i])
        s[k] += weight * signs[k] * value


@kernel
def read_inputs(F, F_dot, x):  # type: ignore[no-untyped-def]
    """Fill x (7,) and return cos and sin of R; NaN where F is no deformation or not finite."""
    xx, xy, yx, yy = F[0, 0], F[0, 1], F[1, 0], F[1, 1]
    vxx, vxy, vyx, vyy = F_dot[0, 0], F_dot[0, 1], F_dot[1, 0], F_dot[1, 1]
    total = xx + xy + yx + yy + vxx + vxy + vyx + vyy
    if not (np.isfinite(total) and xx * yy - xy * yx > 0.0):
        return np.nan, np.nan
    along, across = xx + yy, yx - xy
    length = 1.0 / np.sqrt(along * along + across * across)
    c, s = along * length, across * length
    uxx, uyy = c * xx + s * yx, c * yy - s * xy
    x[0] = (uxx - 1.0) + (uyy - 1.0)
    x[1] = uxx - uyy
    x[2] = 2.0 * (c * xy + s * yy)
    axx, axy = c * vxx + s * vyx, c * vxy + s * vyy
    ayx, ayy = c * vyx - s * vxx, c * vyy - s * vxy
    x[3], x[4], x[5], x[6] = axx + ayy, axx - ayy, axy + ayx, ayx - axy
    return c, s


@kernel
def write_stress(s, c, sine, stress):  # type: ignore[no-untyped-def]
    """σ = R S Rᵀ from the components of S."""
    xx, yy = 0.5 * (s[0] + s[1]), 0.5 * (s[0] - s[1])
    xy, yx = 0.5 * (s[2] - s[3]), 0.5 * (s[2] + s[3])
    left_xx, left_xy = c * xx - sine * yx, c * xy - sine * yy
    left_yx, left_yy = sine * xx + c * yx, sine * xy + c * yy
    stress[0, 0] = left_xx * c - left_xy * sine
    stress[0, 1] = left_xx * sine + left_xy * c
    stress[1, 0] = left_yx * c - left_yy * sine
    stress[1, 1] = left_yx * sine + left_yy * c
