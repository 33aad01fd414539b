"""Domain and error bound in the compiled pass; layout and names as in `compiled_frame`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.simd import TILE, load, root, spread, store, where_less
from surrofe2.stress_law import Status
from surrofe2.surrogate.compiled_frame import TILES, scale_inputs
from surrofe2.surrogate.domain import Domain, boundary_table
from surrofe2.surrogate.error_bound import (
    COMPRESSION,
    NEAR,
    NORM,
    REACH,
    Calibration,
    scale_table,
)
from surrofe2.tensors import INPUTS

_ROWS = NEAR + 1
_HEIGHT, _BOUND = _ROWS, _ROWS + 1
BOUND_ROWS = _BOUND + 1
"""Rows that `apply_bound` works in."""
_NOT_TRUSTED, _OUT_OF_RANGE = int(Status.NOT_TRUSTED), int(Status.OUT_OF_RANGE)
_FACTORS = 4  # of each product


class BoundArrays(NamedTuple):
    """Domain and bound as the arrays their kernel reads.

    Attributes:
        factor: (7,) 1/scale of the inputs.
        boundary_table: (k, 4) int64; boundary: (k,) float64; no rows: no sample failed.
        bound_table: (l, 4) int64; bound: (l,) float64, µN/µm; no rows: no bound is known.
        near: (7,) share of each squared input in the size of a state.
        allowance: (8,) of `allowance`; empty: bounds count once everywhere.
    """

    factor: NDArray[np.float64]
    boundary_table: NDArray[np.int64]
    boundary: NDArray[np.float64]
    bound_table: NDArray[np.int64]
    bound: NDArray[np.float64]
    near: NDArray[np.float64]
    allowance: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        domain: Domain | None,
        calibration: Calibration | None,
        allowance: NDArray[np.float64] | None = None,
    ) -> BoundArrays:
        """The arrays of a domain (None: everywhere) and a bound (None: infinite)."""
        table, boundary = np.empty((0, _FACTORS), dtype=np.int64), np.empty(0)
        bound_table, bound = np.empty((0, _FACTORS), dtype=np.int64), np.empty(0)
        factor, near = np.ones(INPUTS), np.ones(INPUTS)
        if domain is not None:
            factor = 1.0 / domain.scale
            if len(domain.boundary):
                table, boundary = boundary_table(domain.square), domain.boundary
            if calibration is not None and np.isfinite(calibration.quantile):
                used = calibration.scale > 0.0
                bound_table = scale_table()[used]
                bound = calibration.quantile * calibration.scale[used]
                near = calibration.near
        counted = np.empty(0) if allowance is None else allowance
        return cls(factor, table, boundary, bound_table, bound, near, counted)


@kernel
def apply_bound(start, frame, arrays, tolerance, room, status, bound):  # type: ignore[no-untyped-def]
    """Write the bound, and the status outside the domain or where the bound is too large.

    room: (`BOUND_ROWS`, TILES, TILE). status: what the range test gave.
    """
    x = room[:_ROWS]
    scale_inputs(frame, arrays.factor, x)
    room[_HEIGHT] = 0.0
    _add_products(arrays.boundary_table, arrays.boundary, x, room, _HEIGHT)
    _square_rows(arrays.near, x)
    room[_BOUND] = 0.0
    _add_products(arrays.bound_table, arrays.bound, x, room, _BOUND)
    if arrays.allowance.shape[0]:
        _weigh(arrays.allowance, x, room)
    known = arrays.bound.shape[0] > 0
    for p in range(min(TILES * TILE, status.shape[0] - start)):
        point, t, lane = start + p, p // TILE, p % TILE
        value = room[_BOUND, t, lane] if known else np.inf
        code = status[point]
        if code == 0 and not room[_HEIGHT, t, lane] <= 0.0:
            code = _OUT_OF_RANGE
        if code == 0 and not value <= tolerance:
            code = _NOT_TRUSTED
        bound[point] = value if code == 0 or code == _NOT_TRUSTED else np.inf
        status[point] = code


@kernel
def _square_rows(near, x):  # type: ignore[no-untyped-def]
    """Rows 0 to 6 squared, row 8: the square of s where negative, row 9: the mean square, row 10:
    m/(m + `REACH`), m their mean by the shares `near`."""
    for t in range(TILES):
        low = where_less(load(x, 0, t), 0.0, load(x, 0, t), 0.0)
        store(low * low, x, COMPRESSION, t)
        total, size = spread(0.0), spread(0.0)
        for k in range(INPUTS):
            square = load(x, k, t) * load(x, k, t)
            store(square, x, k, t)
            total += square
            size += near[k] * square
        store(total * (1.0 / INPUTS), x, NORM, t)
        store(size / (size + REACH), x, NEAR, t)


@kernel
def _weigh(allowance, x, room):  # type: ignore[no-untyped-def]
    """The bound as often as `allowance.weight` says, by squared inputs."""
    for t in range(TILES):
        square = spread(0.0)
        for k in range(INPUTS):
            square += allowance[k] * load(x, k, t)
        share = root(square) + allowance[INPUTS]
        share = where_less(share, 1.0, share, 1.0)
        store(load(room, _BOUND, t) / share, room, _BOUND, t)


@kernel
def _add_products(table, coefficients, x, room, row):  # type: ignore[no-untyped-def]
    for t in range(TILES):
        total = load(room, row, t)
        for k in range(table.shape[0]):
            product = load(x, table[k, 0], t) * load(x, table[k, 1], t)
            product = product * (load(x, table[k, 2], t) * load(x, table[k, 3], t))
            total += coefficients[k] * product
        store(total, room, row, t)
