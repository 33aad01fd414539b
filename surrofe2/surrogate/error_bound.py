"""Domain and bound inside the compiled pass: block layout and names as in `compiled`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.polar_inputs import INPUTS
from surrofe2.stress_law import Status
from surrofe2.surrogate.trust_features import COMPRESSION, FACTORS, NORM, cliff_table, scale_table

if TYPE_CHECKING:
    from surrofe2.surrogate.calibration import Calibration
    from surrofe2.surrogate.domain import Domain

_ROWS = NORM + 1
_NOT_TRUSTED, _OUT_OF_RANGE = int(Status.NOT_TRUSTED), int(Status.OUT_OF_RANGE)


class Trust(NamedTuple):
    """Domain and bound as the arrays their kernel reads.

    Attributes:
        factor: (7,) 1/scale of the inputs.
        square: (1,) int64, 1 where moduli are taken.
        pairs: (m, 2) int64; faces: (m, 3) both signs and the limit of each half-space.
        cliff_table: (k, 4) int64; cliff: (k,) float64.
        bound_table: (l, 4) int64; bound: (l,) float64, µN/µm; no rows: no bound is known.
    """

    factor: NDArray[np.float64]
    square: NDArray[np.int64]
    pairs: NDArray[np.int64]
    faces: NDArray[np.float64]
    cliff_table: NDArray[np.int64]
    cliff: NDArray[np.float64]
    bound_table: NDArray[np.int64]
    bound: NDArray[np.float64]


def pack_trust(domain: Domain | None, calibration: Calibration | None) -> Trust:
    """The arrays of a domain (None: everywhere) and a bound (None: infinite) for `compiled`."""
    pairs, faces = np.empty((0, 2), dtype=np.int64), np.empty((0, 3))
    table, cliff = np.empty((0, FACTORS), dtype=np.int64), np.empty(0)
    factor, square = np.ones(INPUTS), False
    if domain is not None:
        pairs = domain.pairs
        faces = np.column_stack([domain.signs, domain.limits])
        factor, square = 1.0 / domain.scale, domain.square
        if len(domain.cliff):
            table, cliff = cliff_table(square), domain.cliff
    bound_table, bound = np.empty((0, FACTORS), dtype=np.int64), np.empty(0)
    if domain is not None and calibration is not None and np.isfinite(calibration.quantile):
        used = calibration.scale > 0.0
        bound_table = scale_table()[used]
        bound = calibration.quantile * calibration.scale[used]
    return Trust(factor, np.array([int(square)]), pairs, faces, table, cliff, bound_table, bound)


EVERYWHERE_UNKNOWN = pack_trust(None, None)
"""No domain beyond the range, and no bound."""


@kernel
def apply_trust(start, frame, trust, tolerance, stress, status, bound):  # type: ignore[no-untyped-def]
    """Write the bound; take the stress away outside the domain or where the bound is too large.

    Rows 10 to 12 of `frame` hold U₁₁, U₁₂, U₂₂, rows 0 to 3 A = RᵀḞ.
    """
    size = frame.shape[1]
    x = np.empty((_ROWS, size))
    _scale_inputs(frame, trust.factor, x)
    height = np.full(size, -1.0)
    if trust.cliff.shape[0]:
        height[:] = 0.0
        _add_products(trust.cliff_table, trust.cliff, x, height)
    beyond = np.zeros(size)
    _test_faces(x, trust, beyond)
    local = np.zeros(size)
    _square_rows(x)
    _add_products(trust.bound_table, trust.bound, x, local)
    known = trust.bound.shape[0] > 0
    for p in range(min(size, stress.shape[0] - start)):
        point = start + p
        value = local[p] if known else np.inf
        code = status[point]
        if code == 0 and not (beyond[p] <= 0.0 and height[p] <= 0.0):
            code = _OUT_OF_RANGE
        if code == 0 and not value <= tolerance:
            code = _NOT_TRUSTED
        bound[point] = value if code == 0 or code == _NOT_TRUSTED else np.inf
        if code != status[point]:
            status[point] = code
            stress[point, 0, 0] = np.nan
            stress[point, 0, 1] = np.nan
            stress[point, 1, 0] = np.nan
            stress[point, 1, 1] = np.nan


@kernel
def _scale_inputs(frame, factor, x):  # type: ignore[no-untyped-def]
    """Rows 0 to 6: s, d, g, S, D, G, W; row 7: ones."""
    for p in range(frame.shape[1]):
        x[0, p] = ((frame[10, p] - 1.0) + (frame[12, p] - 1.0)) * factor[0]
        x[1, p] = (frame[10, p] - frame[12, p]) * factor[1]
        x[2, p] = 2.0 * frame[11, p] * factor[2]
        x[3, p] = (frame[0, p] + frame[3, p]) * factor[3]
        x[4, p] = (frame[0, p] - frame[3, p]) * factor[4]
        x[5, p] = (frame[1, p] + frame[2, p]) * factor[5]
        x[6, p] = (frame[2, p] - frame[1, p]) * factor[6]
        x[7, p] = 1.0


@kernel
def _test_faces(x, trust, beyond):  # type: ignore[no-untyped-def]
    """How far each point is beyond the half-space that it violates most; NaN or above 0: out."""
    size = x.shape[1]
    f = np.empty((9, size))
    square = trust.square[0] == 1
    for k in range(7):
        if square and k != 0 and k != 3:
            for p in range(size):
                f[k, p] = abs(x[k, p])
        else:
            for p in range(size):
                f[k, p] = x[k, p]
    for p in range(size):
        f[7, p] = x[1, p] * x[4, p]
        f[8, p] = x[2, p] * x[5, p]
    for k in range(trust.pairs.shape[0]):
        i, j = trust.pairs[k, 0], trust.pairs[k, 1]
        a, b, limit = trust.faces[k, 0], trust.faces[k, 1], trust.faces[k, 2]
        for p in range(size):
            over = a * f[i, p] + b * f[j, p] - limit
            beyond[p] = over if over > beyond[p] else beyond[p]


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
    for k in range(table.shape[0]):
        a, b, c, d = table[k, 0], table[k, 1], table[k, 2], table[k, 3]
        factor = coefficients[k]
        for p in range(x.shape[1]):
            values[p] += factor * (x[a, p] * x[b, p]) * (x[c, p] * x[d, p])
