"""Stress, status and error bound of a surrogate in one compiled pass, block by block.

Layout and names as in `compiled_frame`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.simd import TILE
from surrofe2.stress_law import Status
from surrofe2.surrogate.compiled_bound import BOUND_ROWS, BoundArrays, apply_bound
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
from surrofe2.surrogate.compiled_network import evaluate_network, make_room, set_polynomial_slopes
from surrofe2.surrogate.network_arrays import NetworkArrays
from surrofe2.surrogate.polynomial import Polynomial
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]

MANY = 2000
"""Points from which on more than one core pays."""
_PART = 16 * BLOCK  # points that a core takes at a time
_OK, _OUT_OF_RANGE, _NOT_FINITE = int(Status.OK), int(Status.OUT_OF_RANGE), int(Status.NOT_FINITE)


class Answer(NamedTuple):
    """Stress (n, 2, 2) in µN/µm, NaN where the status (n,) is not 0, and bound (n,), µN/µm."""

    stress: Array
    status: NDArray[np.int8]
    bound: Array

    @classmethod
    def empty(cls, count: int) -> Answer:
        """Room for so many points."""
        return cls(np.empty((count, 2, 2)), np.empty(count, dtype=np.int8), np.empty(count))


def lookup(
    F: Array, F_dot: Array, network: NetworkArrays, bounds: BoundArrays, tolerance: float
) -> tuple[Array, NDArray[np.int8], Array]:
    """Stress (n, 2, 2), status (n,) and bound (n,); points with NaN or det F ≤ 0 are out of range.

    F, F_dot: (n, 2, 2) contiguous float64. tolerance: of the bound, µN/µm.
    """
    answer = Answer.empty(len(F))
    compute = _lookup_parallel if len(F) >= MANY else _lookup_serial
    compute(F, F_dot, network, bounds, float(tolerance), answer)
    return answer.stress, answer.status, answer.bound


def status_and_bound(
    F: Array, F_dot: Array, network: NetworkArrays, bounds: BoundArrays, tolerance: float
) -> tuple[NDArray[np.int8], Array]:
    """Status and bound of `lookup` without the stress, whose finiteness is not tested."""
    status, bound = np.empty(len(F), dtype=np.int8), np.empty(len(F))
    test = _test_parallel if len(F) >= MANY else _test_some
    test(F, F_dot, network.bounds, bounds, float(tolerance), status, bound)
    return status, bound


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
def _lookup_serial(F, F_dot, network, bounds, tolerance, answer):  # type: ignore[no-untyped-def]
    lookup_part(0, F.shape[0], F, F_dot, network, bounds, tolerance, answer)


@parallel_kernel
def _lookup_parallel(F, F_dot, network, bounds, tolerance, answer):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        end = min((part + 1) * _PART, F.shape[0])
        lookup_part(part * _PART, end, F, F_dot, network, bounds, tolerance, answer)


@kernel
def lookup_part(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, network, bounds, tolerance, answer
):
    """Set the answer at points `begin` to `end`."""
    frame, rows = np.empty((FRAME_ROWS, TILES, TILE)), np.empty((BOUND_ROWS, TILES, TILE))
    room = make_room(network, network, np.int64(0))  # one signature for all numbers of inputs
    for start in range(begin, end, BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        set_inside(frame, network.bounds)
        scale_inputs(frame, network.input_factor, room.x)
        evaluate_network(network, room)
        set_stress(room.y, frame)
        _write_stress(start, frame, answer)
        apply_bound(start, frame, bounds, tolerance, rows, answer.status, answer.bound)
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


@parallel_kernel
def _test_parallel(F, F_dot, limits, bounds, tolerance, status, bound):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        some = slice(part * _PART, min((part + 1) * _PART, F.shape[0]))
        _test_some(F[some], F_dot[some], limits, bounds, tolerance, status[some], bound[some])


@kernel
def _test_some(F, F_dot, limits, bounds, tolerance, status, bound):  # type: ignore[no-untyped-def]
    frame, rows = np.empty((FRAME_ROWS, TILES, TILE)), np.empty((BOUND_ROWS, TILES, TILE))
    for start in range(0, F.shape[0], BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        set_inside(frame, limits)
        for p in range(min(BLOCK, F.shape[0] - start)):
            inside = frame[INSIDE, p // TILE, p % TILE] > 0.0
            status[start + p] = _OK if inside else _OUT_OF_RANGE
        apply_bound(start, frame, bounds, tolerance, rows, status, bound)


@kernel
def _slopes(F, F_dot, network, slope_polynomial, P, slopes):  # type: ignore[no-untyped-def]
    frame = np.empty((FRAME_ROWS, TILES, TILE))
    room = make_room(network, slope_polynomial, np.int64(INPUTS))
    for start in range(0, F.shape[0], BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        scale_inputs(frame, network.input_factor, room.x)
        set_polynomial_slopes(slope_polynomial, room)
        evaluate_network(network, room)
        for p in range(min(BLOCK, F.shape[0] - start)):
            t, lane = p // TILE, p % TILE
            for c in range(4):
                P[start + p, c] = room.y[c, t, lane]
                for k in range(INPUTS):
                    slope = room.y_slopes[k, c, t, lane] * network.input_factor[k]
                    slopes[start + p, c, k] = slope
