"""Stress, status and risk of a surrogate in one compiled pass, block by block; its domain.

Layout and names as in `compiled_frame`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, root, spread, store, where_less
from surrofe2.base.tensors import INPUTS
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.compiled_frame import (
    BLOCK,
    FRAME_ROWS,
    INSIDE,
    S11,
    TILES,
    read_points,
    scale_inputs,
    set_inside,
    set_stress,
    take_rotation_out,
)
from surrofe2.surrogate.compiled_network import evaluate_network, make_room
from surrofe2.surrogate.domain import Domain, boundary_table
from surrofe2.surrogate.error_bound import (
    COMPRESSION,
    NEAR,
    NORM,
    REACH,
    Calibration,
    scale_table,
)
from surrofe2.surrogate.network_arrays import NetworkArrays
from surrofe2.surrogate.polynomial import Polynomial

Array = NDArray[np.float64]

MANY = 2000
"""Points from which on more than one core pays."""
_PART = 16 * BLOCK  # points that a core takes at a time
_OK, _OUT_OF_RANGE = int(Status.OK), int(Status.OUT_OF_RANGE)
_NOT_FINITE, _NOT_TRUSTED = int(Status.NOT_FINITE), int(Status.NOT_TRUSTED)
_ROWS = NEAR + 1
_HEIGHT, _RISK = _ROWS, _ROWS + 1
_RISK_ROWS = _RISK + 1  # that `_apply_risk` works in
_FACTORS = 4  # of each product


class Answer(NamedTuple):
    """Stress (n, 2, 2) in µN/µm, NaN where the status (n,) is not 0, and risk (n,)."""

    stress: Array
    status: NDArray[np.int8]
    risk: Array

    @classmethod
    def empty(cls, count: int) -> Answer:
        """Room for so many points."""
        return cls(np.empty((count, 2, 2)), np.empty(count, dtype=np.int8), np.empty(count))


class BoundArrays(NamedTuple):
    """Domain and bound as the arrays their kernel reads.

    Attributes:
        factor: (7,) 1/scale of the inputs.
        boundary_table: (k, 4) int64; boundary: (k,) float64; no rows: no sample failed.
        bound_table: (l, 4) int64; bound: (l,) float64, of the bound over the tolerance; no
            rows: no bound is known.
        near: (7,) share of each squared input in the size of a state.
        local: (8,) `error_bound.tolerance_coefficients`; empty: the tolerance counts everywhere.
    """

    factor: NDArray[np.float64]
    boundary_table: NDArray[np.int64]
    boundary: NDArray[np.float64]
    bound_table: NDArray[np.int64]
    bound: NDArray[np.float64]
    near: NDArray[np.float64]
    local: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        domain: Domain | None,
        calibration: Calibration | None,
        tolerance: NDArray[np.float64] | None = None,
    ) -> BoundArrays:
        """The arrays of a domain (None: everywhere) and a bound (None: infinite).

        tolerance: (9,) `error_bound.tolerance_coefficients`, then the tolerance in µN/µm, where
        this is infinite, the risk is 0, whatever the bound.
        """
        local, most = (np.empty(0), 1.0) if tolerance is None else (tolerance[:-1], tolerance[-1])
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
                bound = calibration.quantile * calibration.scale[used] / most
                near = calibration.near
        if np.isinf(most):
            bound_table, bound = scale_table()[:1], np.zeros(1)
        return cls(factor, table, boundary, bound_table, bound, near, local)


def lookup(
    F: Array, F_dot: Array, network: NetworkArrays, bounds: BoundArrays, limit: float
) -> tuple[Array, NDArray[np.int8], Array]:
    """Stress (n, 2, 2), status (n,) and risk (n,); points with NaN or det F ≤ 0 are out of range.

    F, F_dot: (n, 2, 2) contiguous float64. limit: of the risk.
    """
    answer = Answer.empty(len(F))
    compute = _lookup_parallel if len(F) >= MANY else _lookup_serial
    compute(F, F_dot, network, bounds, float(limit), answer)
    return answer.stress, answer.status, answer.risk


def status_and_risk(
    F: Array, F_dot: Array, network: NetworkArrays, bounds: BoundArrays, limit: float
) -> tuple[NDArray[np.int8], Array]:
    """Status and risk of `lookup` without the stress, whose finiteness is not tested."""
    status, risk = np.empty(len(F), dtype=np.int8), np.empty(len(F))
    test = _test_parallel if len(F) >= MANY else _test_some
    test(F, F_dot, network.bounds, bounds, float(limit), status, risk)
    return status, risk


def evaluate_slopes(
    F: Array, F_dot: Array, network: NetworkArrays, slopes: Polynomial
) -> tuple[Array, Array]:
    """(components of P̂ (n, 4), their slopes by the inputs (n, 4, 7)); no range is tested.

    F, F_dot: (n, 2, 2) contiguous float64, det F > 0. slopes: of the network's polynomial.
    """
    P, P_slopes = np.empty((len(F), 4)), np.empty((len(F), 4, INPUTS))
    _slopes(F, F_dot, network, slopes, P, P_slopes)
    return P, P_slopes


@kernel
def _lookup_serial(F, F_dot, network, bounds, limit, answer):  # type: ignore[no-untyped-def]
    lookup_part(0, F.shape[0], F, F_dot, network, bounds, limit, answer)


@parallel_kernel
def _lookup_parallel(F, F_dot, network, bounds, limit, answer):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        end = min((part + 1) * _PART, F.shape[0])
        lookup_part(part * _PART, end, F, F_dot, network, bounds, limit, answer)


@kernel
def lookup_part(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, network, bounds, limit, answer
):
    """Set the answer at points `begin` to `end`."""
    frame, rows = np.empty((FRAME_ROWS, TILES, TILE)), np.empty((_RISK_ROWS, TILES, TILE))
    room = make_room(network, network, np.int64(0))  # one signature for all numbers of inputs
    for start in range(begin, end, BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        set_inside(frame, network.bounds)
        scale_inputs(frame, network.input_factor, room.x)
        evaluate_network(network, network, room)
        set_stress(room.y, frame)
        _write_stress(start, frame, answer)
        _apply_risk(start, frame, bounds, limit, rows, answer.status, answer.risk)
        for point in range(start, min(start + BLOCK, F.shape[0])):
            if answer.status[point] != _OK:
                answer.stress[point] = np.nan


@kernel
def _write_stress(start, frame, answer):  # type: ignore[no-untyped-def]
    for p in range(min(BLOCK, answer.status.shape[0] - start)):
        t, lane = p // TILE, p % TILE
        code = _OK if frame[INSIDE, t, lane] > 0.0 else _OUT_OF_RANGE
        for i in range(4):
            value = frame[S11 + i, t, lane]
            if code == _OK and not np.isfinite(value):
                code = _NOT_FINITE
            answer.stress[start + p, i // 2, i % 2] = value
        answer.status[start + p] = code


@kernel
def _apply_risk(start, frame, arrays, limit, room, status, risk):  # type: ignore[no-untyped-def]
    """Write the risk, and the status outside the domain or where the risk is too large.

    room: (`_RISK_ROWS`, TILES, TILE). status: what the range test gave.
    """
    x = room[:_ROWS]
    scale_inputs(frame, arrays.factor, x)
    room[_HEIGHT] = 0.0
    _add_products(arrays.boundary_table, arrays.boundary, x, room, _HEIGHT)
    _square_rows(arrays.near, x)
    room[_RISK] = 0.0
    _add_products(arrays.bound_table, arrays.bound, x, room, _RISK)
    if arrays.local.shape[0]:
        _divide_by_local_tolerance(arrays.local, x, room)
    known = arrays.bound.shape[0] > 0
    for p in range(min(TILES * TILE, status.shape[0] - start)):
        point, t, lane = start + p, p // TILE, p % TILE
        value = room[_RISK, t, lane] if known else np.inf
        code = status[point]
        if code == 0 and not room[_HEIGHT, t, lane] <= 0.0:
            code = _OUT_OF_RANGE
        if code == 0 and not value <= limit:
            code = _NOT_TRUSTED
        risk[point] = value if code == 0 or code == _NOT_TRUSTED else np.inf
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
def _divide_by_local_tolerance(coefficients, x, room):  # type: ignore[no-untyped-def]
    """Divide the risk by `error_bound.local_tolerance`, by squared inputs."""
    for t in range(TILES):
        square = spread(0.0)
        for k in range(INPUTS):
            square += coefficients[k] * load(x, k, t)
        share = root(square) + coefficients[INPUTS]
        share = where_less(share, 1.0, share, 1.0)
        store(load(room, _RISK, t) / share, room, _RISK, t)


@kernel
def _add_products(table, coefficients, x, room, row):  # type: ignore[no-untyped-def]
    for t in range(TILES):
        total = load(room, row, t)
        for k in range(table.shape[0]):
            product = load(x, table[k, 0], t) * load(x, table[k, 1], t)
            product = product * (load(x, table[k, 2], t) * load(x, table[k, 3], t))
            total += coefficients[k] * product
        store(total, room, row, t)


@parallel_kernel
def _test_parallel(F, F_dot, limits, bounds, limit, status, risk):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        some = slice(part * _PART, min((part + 1) * _PART, F.shape[0]))
        _test_some(F[some], F_dot[some], limits, bounds, limit, status[some], risk[some])


@kernel
def _test_some(F, F_dot, limits, bounds, limit, status, risk):  # type: ignore[no-untyped-def]
    frame, rows = np.empty((FRAME_ROWS, TILES, TILE)), np.empty((_RISK_ROWS, TILES, TILE))
    for start in range(0, F.shape[0], BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        set_inside(frame, limits)
        for p in range(min(BLOCK, F.shape[0] - start)):
            inside = frame[INSIDE, p // TILE, p % TILE] > 0.0
            status[start + p] = _OK if inside else _OUT_OF_RANGE
        _apply_risk(start, frame, bounds, limit, rows, status, risk)


@kernel
def _slopes(F, F_dot, network, slope_polynomial, P, slopes):  # type: ignore[no-untyped-def]
    frame = np.empty((FRAME_ROWS, TILES, TILE))
    room = make_room(network, slope_polynomial, np.int64(INPUTS))
    for start in range(0, F.shape[0], BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        scale_inputs(frame, network.input_factor, room.x)
        evaluate_network(network, slope_polynomial, room)
        for p in range(min(BLOCK, F.shape[0] - start)):
            t, lane = p // TILE, p % TILE
            for c in range(4):
                P[start + p, c] = room.y[c, t, lane]
                for k in range(INPUTS):
                    slope = room.y_slopes[k, c, t, lane] * network.input_factor[k]
                    slopes[start + p, c, k] = slope
