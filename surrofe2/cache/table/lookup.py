"""Stress from a table's linear models, eight points at a time, in one compiled pass.

All models answer whose ellipsoids hold the point or an image of it, each with a weight that is 0
at the surface of its ellipsoid and infinite at its centre, so that the answer is continuous. With b
the bound of a model and L the largest that is allowed, the weight is (L/b − 1)². Eight points at a
time are asked of each record that may hold one of them; where it does not, its weight is 0.

A screen says which records come into question. Multiplied out, the bound (x − x₀)ᵀ C (x − x₀) is a
polynomial of degree 2 in x. An image flips the sign of each of its 36 monomials as it flips one
component of a tensor, the parity of the monomial; so sums over the monomials of each parity give
the bounds at all four images. Their rounding is that of numbers as large as x₀ᵀ C x₀, so they are
no bounds to answer by.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, any_less, load, root, spread, store, where_less
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS, parity
from surrofe2.base.tensors import INPUTS
from surrofe2.cache.table.records import OUTPUTS, Records
from surrofe2.law.stress_law import Status


def _parity(pair: tuple[int, int]) -> int:
    """Return the parity of the monomial x_i x_j: the component whose sign an image flips with it.

    The index 7 stands for the factor 1, which no image flips.
    """
    return parity(tuple(k for k in pair if k < INPUTS))


# The factors of each monomial, sorted by parity.
_PAIRS = np.array(sorted(combinations_with_replacement(range(INPUTS + 1), 2), key=_parity))
PRODUCTS = len(_PAIRS)
# For each component the number of monomials up to the last one of its parity.
_ENDS = tuple(
    int(sum(_parity(pair) <= component for pair in _PAIRS.tolist()))
    for component in range(len(COMPONENT_SIGNS))
)
_SUM, _DIFFERENCE, _SHEAR, _SPIN = _ENDS

# Number of points from which on more than one core pays.
MANY = 1000

_OK = int(Status.OK)
_OUT_OF_RANGE = int(Status.OUT_OF_RANGE)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_TRUSTED = int(Status.NOT_TRUSTED)
_AT_ONCE = 16 * TILE  # points that a core answers at once
# A bound below this fraction of the tolerance is as good as none: the weight stays finite.
NEAREST = 1e-9
# Screened bounds may be larger than the tolerance by so much, because of their rounding.
_SLACK = 1.0 + 1e-6

# The rows of `room`, in which eight points are worked out, one in each lane.
_X = 0  # the seven inputs
_ONE = _X + INPUTS  # 1
_AWAY = _ONE + 1  # the seven distances from a record's centre
_S = _AWAY + INPUTS  # sums of the weighted components of the models
_TOTAL = _S + OUTPUTS  # sum of the weights
_RADIUS = _TOTAL + 1  # sum of the weighted bounds of the error
_LEAST = _RADIUS + 1  # smallest bound of all records
_COS = _LEAST + 1  # cos θ and sin θ of the rotation R
_SIN = _COS + 1
_ROWS = _SIN + 1


def look_up(
    F: Any,
    F_dot: Any,
    tolerances: tuple[float, float],
    images: int,
    records: Any,
    screen: Any,
) -> tuple[Array, NDArray[np.int8], Array]:
    """Look up the stress of n points in all records.

    Args:
        F, F_dot: contiguous float64 (n, 2, 2).
        tolerances: the tolerance that is asked for, and the table's own, µN/µm.
        images: 4 with the symmetry D4, 1 without.
        records: `Records`.
        screen: `make_screen` of them.

    Returns:
        stress (n, 2, 2), status (n,) and bound of the error (n,), as of `StressTable.lookup`.
    """
    count = len(F)
    answer = np.empty((count, 2, 2)), np.empty(count, dtype=np.int8), np.empty(count)
    compute = _look_up_parallel if count >= MANY else _look_up_range
    compute(0, count, (F, F_dot), tolerances, images, records, screen, answer)
    return answer


@parallel_kernel
def _look_up_parallel(first, last, asked, tolerances, images, records, screen, answer):  # type: ignore[no-untyped-def]
    """Do what `_look_up_range` does on all cores, a part of the points at a time."""
    for part in prange((last - first + _AT_ONCE - 1) // _AT_ONCE):
        begin = first + part * _AT_ONCE
        end = min(begin + _AT_ONCE, last)
        _look_up_range(begin, end, asked, tolerances, images, records, screen, answer)


@kernel
def _look_up_range(first, last, asked, tolerances, images, records, screen, answer):  # type: ignore[no-untyped-def]
    """Fill `answer`, the arrays of stress, status and bound, at points from `first` to `last`."""
    F, F_dot = asked
    tolerance, size = tolerances
    room = np.zeros((_ROWS, TILE))
    x = np.empty(INPUTS)
    inputs = room[_X : _ONE + 1]
    bounds = np.empty((len(INPUT_SIGNS), TILE))
    products = np.empty((PRODUCTS, TILE))
    candidates = np.empty(images * screen.shape[0], dtype=np.int64)
    # Largest bound b of a model that answers: the bound of its error, √(b size), is then at most
    # the tolerance that was asked for. A negative tolerance stays negative and allows nothing.
    limit = min(size, tolerance * abs(tolerance) / size)
    store(1.0, room, _ONE)
    for start in range(first, last, TILE):
        for lane in range(TILE):
            # behind the last point it is repeated
            p = min(start + lane, last - 1)
            room[_COS, lane], room[_SIN, lane] = _read_inputs(F, F_dot, p, x)
            for i in range(INPUTS):
                room[_X + i, lane] = x[i]
        for row in range(_S, _LEAST):  # all sums
            store(0.0, room, row)
        store(np.inf, room, _LEAST)
        fill_products(inputs, products)
        count = 0
        # Candidates first, then their models: one loop of both takes three times as long.
        for k in range(screen.shape[0]):
            fill_bounds(screen, k, products, bounds)
            for flips in range(images):
                if any_less(load(bounds, flips), _SLACK * size):
                    candidates[count] = images * k + flips
                    count += 1
        for n in range(count):
            _add_model(candidates[n] // images, candidates[n] % images, limit, size, records, room)
        for lane in range(min(TILE, last - start)):
            _write(room, lane, size, start + lane, answer)


@kernel
def _add_model(k, flips, limit, size, records, room):  # type: ignore[no-untyped-def]
    """Add to the sums in `room` the model of record k at the image `flips` of eight points.

    Args:
        limit: largest bound by which a model answers, µN/µm.
        size: the table's own tolerance, µN/µm.
    """
    for i in range(INPUTS):
        away = load(room, _X + i) * INPUT_SIGNS[flips, i] - records.centre[k, i]
        store(away, room, _AWAY + i)
    bound = spread(0.0)  # dᵀ C d, by the lower half of C
    for i in range(INPUTS):
        row = spread(0.0)
        away = load(room, _AWAY + i)
        for j in range(i):
            row += records.curvature[k, i, j] * load(room, _AWAY + j)
        bound += (row + row + records.curvature[k, i, i] * away) * away
    bound = where_less(bound, 0.0, 0.0, bound)  # rounding may make it negative
    least = load(room, _LEAST)
    store(where_less(bound, least, bound, least), room, _LEAST)
    nearest = NEAREST * size
    root_of_weight = (limit - bound) / where_less(bound, nearest, nearest, bound) + NEAREST
    weight = where_less(limit, bound, 0.0, root_of_weight * root_of_weight)
    store(load(room, _TOTAL) + weight, room, _TOTAL)
    store(load(room, _RADIUS) + weight * root(bound * size), room, _RADIUS)
    for c in range(OUTPUTS):
        value = spread(records.stress[k, c])
        for i in range(INPUTS):
            value += records.slope[k, c, i] * load(room, _AWAY + i)
        turned = weight * COMPONENT_SIGNS[flips, c]
        store(load(room, _S + c) + turned * value, room, _S + c)


@kernel
def _write(room, lane, size, p, answer):  # type: ignore[no-untyped-def]
    """Write stress, status and bound of point p, which is in this lane, into `answer`."""
    stress, status, bound = answer
    least = room[_LEAST, lane]
    total = room[_TOTAL, lane]
    cosine = room[_COS, lane]
    for i in range(4):
        stress[p, i // 2, i % 2] = np.nan
    if not (np.isfinite(cosine) and least <= size):
        status[p] = _OUT_OF_RANGE
        bound[p] = np.inf
    elif total == 0.0:
        status[p] = _NOT_TRUSTED
        bound[p] = np.sqrt(least * size)
    else:
        bound[p] = room[_RADIUS, lane] / total
        is_finite = _write_stress(room, lane, total, stress, p)
        status[p] = _OK if is_finite else _NOT_FINITE


@kernel
def _read_inputs(F, F_dot, p, x):  # type: ignore[no-untyped-def]
    """Fill x (7,) with the inputs of point p, and return cos θ and sin θ of R.

    All are NaN where F is no deformation or a number is not finite. See `base.tensors.to_inputs`.
    """
    xx = F[p, 0, 0]
    xy = F[p, 0, 1]
    yx = F[p, 1, 0]
    yy = F[p, 1, 1]
    vxx = F_dot[p, 0, 0]
    vxy = F_dot[p, 0, 1]
    vyx = F_dot[p, 1, 0]
    vyy = F_dot[p, 1, 1]
    total = xx + xy + yx + yy + vxx + vxy + vyx + vyy
    if not (np.isfinite(total) and xx * yy - xy * yx > 0.0):
        x[:] = np.nan  # in no ellipsoid
        return np.nan, np.nan
    along = xx + yy
    across = yx - xy
    length = 1.0 / np.sqrt(along * along + across * across)
    c = along * length
    s = across * length
    uxx = c * xx + s * yx
    uyy = c * yy - s * xy
    x[0] = (uxx - 1.0) + (uyy - 1.0)
    x[1] = uxx - uyy
    x[2] = 2.0 * (c * xy + s * yy)
    axx = c * vxx + s * vyx
    axy = c * vxy + s * vyy
    ayx = c * vyx - s * vxx
    ayy = c * vyy - s * vxy
    x[3] = axx + ayy
    x[4] = axx - ayy
    x[5] = axy + ayx
    x[6] = ayx - axy
    return c, s


@kernel
def _write_stress(room, lane, total, stress, p):  # type: ignore[no-untyped-def]
    """Write σ = R S Rᵀ of point p from the sums of its lane, and return whether it is finite.

    The sums are `total` times the components of S.
    """
    c = room[_COS, lane]
    sine = room[_SIN, lane]
    half = 0.5 / total
    mean = half * room[_S, lane]
    difference = half * room[_S + 1, lane]
    shear = half * room[_S + 2, lane]
    spin = half * room[_S + 3, lane]
    xx = mean + difference
    yy = mean - difference
    xy = shear - spin
    yx = shear + spin
    left_xx = c * xx - sine * yx
    left_xy = c * xy - sine * yy
    left_yx = sine * xx + c * yx
    left_yy = sine * xy + c * yy
    stress[p, 0, 0] = left_xx * c - left_xy * sine
    stress[p, 0, 1] = left_xx * sine + left_xy * c
    stress[p, 1, 0] = left_yx * c - left_yy * sine
    stress[p, 1, 1] = left_yx * sine + left_yy * c
    return np.isfinite(stress[p, 0, 0] + stress[p, 0, 1] + stress[p, 1, 0] + stress[p, 1, 1])


def make_screen(records: Records) -> Array:
    """Return (n, `PRODUCTS`) coefficients of the bounds of n records as polynomials in x."""
    centre = records.centre
    curvature = records.curvature
    pull = np.einsum("nij,nj->ni", curvature, centre)
    # (x, 1)ᵀ W (x, 1) = (x − x₀)ᵀ C (x − x₀), of which the upper half is taken
    whole = np.empty((len(centre), INPUTS + 1, INPUTS + 1))
    whole[:, :INPUTS, :INPUTS] = curvature
    whole[:, :INPUTS, INPUTS] = -pull
    whole[:, INPUTS, INPUTS] = (centre * pull).sum(axis=1)
    i, j = _PAIRS.T
    return np.ascontiguousarray(whole[:, i, j] * np.where(i == j, 1.0, 2.0))


@kernel
def fill_products(x, products):  # type: ignore[no-untyped-def]
    """Fill in the monomials (`PRODUCTS`, TILE) of eight inputs x (8, TILE), the last of which
    are 1.
    """
    for m in range(PRODUCTS):
        store(load(x, _PAIRS[m, 0]) * load(x, _PAIRS[m, 1]), products, m)


@kernel
def fill_bounds(screen, k, products, bounds):  # type: ignore[no-untyped-def]
    """Fill in the bounds (4, TILE) of record k at the four images of eight points."""
    # sums of the terms by parity: an image changes the sign of two of them
    of_sum = spread(0.0)
    of_difference = spread(0.0)
    of_shear = spread(0.0)
    of_spin = spread(0.0)
    for m in range(_SUM):
        of_sum += screen[k, m] * load(products, m)
    for m in range(_SUM, _DIFFERENCE):
        of_difference += screen[k, m] * load(products, m)
    for m in range(_DIFFERENCE, _SHEAR):
        of_shear += screen[k, m] * load(products, m)
    for m in range(_SHEAR, _SPIN):
        of_spin += screen[k, m] * load(products, m)
    # the signs are those of COMPONENT_SIGNS
    store((of_sum + of_spin) + (of_difference + of_shear), bounds, 0)
    store((of_sum + of_spin) - (of_difference + of_shear), bounds, 1)
    store((of_sum - of_spin) + (of_difference - of_shear), bounds, 2)
    store((of_sum - of_spin) - (of_difference - of_shear), bounds, 3)
