"""Domain and bound inside the compiled pass: block layout and names as in `compiled`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.stress_law import Status
from surrofe2.surrogate.compiled_frame import scale_inputs
from surrofe2.surrogate.domain import FEATURES, Domain
from surrofe2.surrogate.lanes import LANES, filled, larger, load, store
from surrofe2.surrogate.trust_features import COMPRESSION, FACTORS, NORM, cliff_table, scale_table
from surrofe2.tensors import INPUTS

if TYPE_CHECKING:
    from surrofe2.surrogate.calibration import Calibration

_ROWS = NORM + 1
_SIDES = 2 * FEATURES + 1
ROOM = _ROWS + _SIDES + 3
"""Rows that `apply_trust` works in."""
_NOT_TRUSTED, _OUT_OF_RANGE = int(Status.NOT_TRUSTED), int(Status.OUT_OF_RANGE)


class Trust(NamedTuple):
    """Domain and bound as the arrays their kernel reads.

    Attributes:
        factor: (7,) 1/scale of the inputs.
        square: (1,) int64, 1 where moduli are taken.
        sides: (m, 2) int64, the two features of each half-space: 0 to 8, 9 more for the negative,
            18 for none; limits: (m,) of their sum; m is even.
        cliff_table: (k, 4) int64; cliff: (k,) float64.
        bound_table: (l, 4) int64; bound: (l,) float64, µN/µm; no rows: no bound is known.
    """

    factor: NDArray[np.float64]
    square: NDArray[np.int64]
    sides: NDArray[np.int64]
    limits: NDArray[np.float64]
    cliff_table: NDArray[np.int64]
    cliff: NDArray[np.float64]
    bound_table: NDArray[np.int64]
    bound: NDArray[np.float64]


def pack_trust(domain: Domain | None, calibration: Calibration | None) -> Trust:
    """The arrays of a domain (None: everywhere) and a bound (None: infinite) for `compiled`."""
    sides, limits = np.empty((0, 2), dtype=np.int64), np.empty(0)
    table, cliff = np.empty((0, FACTORS), dtype=np.int64), np.empty(0)
    factor, square = np.ones(INPUTS), False
    if domain is not None:
        sides, limits = _pack_faces(domain)
        factor, square = 1.0 / domain.scale, domain.square
        if len(domain.cliff):
            table, cliff = cliff_table(square), domain.cliff
    bound_table, bound = np.empty((0, FACTORS), dtype=np.int64), np.empty(0)
    if domain is not None and calibration is not None and np.isfinite(calibration.quantile):
        used = calibration.scale > 0.0
        bound_table = scale_table()[used]
        bound = calibration.quantile * calibration.scale[used]
    return Trust(factor, np.array([int(square)]), sides, limits, table, cliff, bound_table, bound)


def _pack_faces(domain: Domain) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Sides and limits; where their number is odd, with a half-space that holds everything."""
    sides = np.where(domain.signs < 0.0, domain.pairs + FEATURES, domain.pairs)
    sides[domain.signs == 0.0] = 2 * FEATURES
    odd = len(sides) % 2
    return (
        np.concatenate([sides, np.full((odd, 2), 2 * FEATURES)]),
        np.concatenate([domain.limits, np.full(odd, np.inf)]),
    )


EVERYWHERE_UNKNOWN = pack_trust(None, None)
"""No domain beyond the range, and no bound."""


@kernel
def apply_trust(start, frame, trust, tolerance, room, status, bound):  # type: ignore[no-untyped-def]
    """Write the bound, and the status outside the domain or where the bound is too large.

    Rows 10 to 12 of `frame` hold U₁₁, U₁₂, U₂₂, rows 0 to 3 A = RᵀḞ. room: (`ROOM`, size).
    """
    x, f = room[:_ROWS], room[_ROWS : _ROWS + _SIDES]
    height, beyond, local = room[ROOM - 3 : ROOM - 2], room[ROOM - 2 : ROOM - 1], room[ROOM - 1 :]
    scale_inputs(frame, trust.factor, x)
    height[:] = 0.0 if trust.cliff.shape[0] else -1.0
    _add_products(trust.cliff_table, trust.cliff, x, height)
    _set_features(x, trust.square[0] == 1, f)
    _test_faces(f, trust, beyond)
    _square_rows(x)
    local[:] = 0.0
    _add_products(trust.bound_table, trust.bound, x, local)
    known = trust.bound.shape[0] > 0
    for p in range(min(frame.shape[1], status.shape[0] - start)):
        point = start + p
        value = local[0, p] if known else np.inf
        code = status[point]
        if code == 0 and not (beyond[0, p] <= 0.0 and height[0, p] <= 0.0):
            code = _OUT_OF_RANGE
        if code == 0 and not value <= tolerance:
            code = _NOT_TRUSTED
        bound[point] = value if code == 0 or code == _NOT_TRUSTED else np.inf
        status[point] = code


@kernel
def _set_features(x, square, f):  # type: ignore[no-untyped-def]
    """Rows 0 to 8: the features of `domain`; 9 to 17: negatives of what has a sign; 18: zeros."""
    for p in range(0, f.shape[1], LANES):
        for k in range(FEATURES):
            one = load(x, k if k < INPUTS else k - 6, p)
            if k >= INPUTS:
                one = one * load(x, k - 3, p)  # dD and gG
            other = filled(0.0) - one
            if square and k < INPUTS and k != 0 and k != 3:
                one = larger(one, other)
            store(f, k, p, one)
            store(f, FEATURES + k, p, other)
        store(f, 2 * FEATURES, p, filled(0.0))


@kernel
def _test_faces(f, trust, beyond):  # type: ignore[no-untyped-def]
    """How far each point is beyond the half-space that it violates most, 0 where within all."""
    sides, limits = trust.sides, trust.limits
    for p in range(0, f.shape[1], LANES):
        most = filled(0.0)
        other = most
        for k in range(0, limits.shape[0], 2):  # two at a time, as one has to wait for the last
            over = load(f, sides[k, 0], p) + load(f, sides[k, 1], p) - filled(limits[k])
            most = larger(over, most)
            over = load(f, sides[k + 1, 0], p) + load(f, sides[k + 1, 1], p) - filled(limits[k + 1])
            other = larger(over, other)
        store(beyond, 0, p, larger(other, most))


@kernel
def _square_rows(x):  # type: ignore[no-untyped-def]
    """Rows 0 to 6 squared, row 8: the square of s where negative, row 9: the mean square."""
    for p in range(x.shape[1]):
        low = min(x[0, p], 0.0)
        x[COMPRESSION, p] = low * low
        total = 0.0
        for k in range(7):
            x[k, p] = x[k, p] * x[k, p]
            total += x[k, p]
        x[NORM, p] = total / 7.0


@kernel
def _add_products(table, coefficients, x, values):  # type: ignore[no-untyped-def]
    for p in range(0, x.shape[1], LANES):
        total = load(values, 0, p)
        for k in range(table.shape[0]):
            a, b, c, d = table[k, 0], table[k, 1], table[k, 2], table[k, 3]
            product = (load(x, a, p) * load(x, b, p)) * (load(x, c, p) * load(x, d, p))
            total = total + filled(coefficients[k]) * product
        store(values, 0, p, total)
