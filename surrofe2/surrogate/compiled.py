"""The network as one compiled pass from (F, Ḟ) to stress and status.

Layout: points are taken in blocks of `BLOCK`; every quantity is a row of `BLOCK` values, one a
point, so each innermost loop runs over the points of a block with all else constant, which the
compiler turns into SIMD instructions:

    frame (rows, BLOCK)  float64: A, Ḟ, cos and sin of R, U, σ
    x     (8, BLOCK)     scaled inputs and, in the last row, ones
    h     (units, BLOCK) layer of the network; weights are broadcast over the row
    y     (7, BLOCK)     components of P̂ = RᵀP, and those of the baseline's energy

From x on everything is in the precision of the weights. What sums over many rows, network,
polynomials and half-spaces, takes `LANES` points of a block at a time, see `lanes`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.stress_law import Status
from surrofe2.surrogate.compiled_frame import (
    FRAME_ROWS,
    put_rotation_back,
    read_points,
    scale_inputs,
    take_rotation_out,
    turn_to_cauchy,
)
from surrofe2.surrogate.compiled_network import energy_slope, network_factors
from surrofe2.surrogate.error_bound import EVERYWHERE_UNKNOWN, ROOM, Trust, apply_trust
from surrofe2.surrogate.features import STRETCH, Features
from surrofe2.surrogate.lanes import BLOCK, LANES
from surrofe2.surrogate.packing import BIOT, Weights
from surrofe2.surrogate.polynomials import ROWS, add_polynomials
from surrofe2.tensors import INPUTS

MANY = 2000  # points from which on more than one core pays
_PART = 16 * BLOCK  # points that a core takes at a time

_ONE = INPUTS  # row of x that holds ones
_OK, _OUT_OF_RANGE, _NOT_FINITE = int(Status.OK), int(Status.OUT_OF_RANGE), int(Status.NOT_FINITE)


def evaluate(F: Any, F_dot: Any, weights: Weights) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Stress (n, 2, 2) in µN/µm, NaN where the status (n,) int8 is not 0.

    F, F_dot: (n, 2, 2) contiguous float64. Points with NaN or det F ≤ 0 are out of range.
    """
    return evaluate_trusted(F, F_dot, weights, EVERYWHERE_UNKNOWN, np.inf)[:2]


def evaluate_trusted(
    F: Any, F_dot: Any, weights: Weights, trust: Trust, tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.float64]]:
    """The same within the domain and where the bound (n,) is at most the tolerance, µN/µm."""
    stress = np.empty((len(F), 2, 2))
    status = np.empty(len(F), dtype=np.int8)
    bound = np.empty(len(F))
    compute = _evaluate_parallel if len(F) >= MANY else _evaluate_serial
    compute(F, F_dot, weights, trust, float(tolerance), stress, status, bound)
    return stress, status, bound


def status_and_bound(
    F: Any, F_dot: Any, weights: Weights, trust: Trust, tolerance: float
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Status and bound of `evaluate_trusted` without the stress, which is not found."""
    status = np.empty(len(F), dtype=np.int8)
    bound = np.empty(len(F))
    test = _test_parallel if len(F) >= MANY else _test_some
    test(F, F_dot, weights.bounds, trust, float(tolerance), status, bound)
    return status, bound


def without_rest(weights: Weights, features: Features) -> Weights:
    """The weights that subtract what the network gives at rest, by the very same instructions."""
    x = np.zeros((INPUTS + 1, BLOCK), dtype=weights.input_factor.dtype)
    x[_ONE] = 1.0
    room = _make_room(weights)
    network_factors(x, weights, room.layers, room.factors)
    factors = room.factors[: features.factors, 0]
    subtracted = np.zeros(features.factors, dtype=bool)
    subtracted[[term.factor for term in features.terms if not term.product]] = True
    slope = np.zeros(STRETCH, dtype=factors.dtype)
    if features.powers:
        linear = np.array(features.powers) == 1
        slope = np.where(linear, energy_slope(x, weights)[:STRETCH, 0], slope)
    return weights._replace(
        at_rest=np.where(subtracted, factors, np.zeros_like(factors)), energy_at_rest=slope
    )


class _Room(NamedTuple):
    """What a block is worked out in, used again for the next; float64 where trusted, else p."""

    frame: Any
    inside: Any
    x: Any
    y: Any
    layers: Any
    factors: Any
    products: Any
    trusted: Any


@kernel
def _make_room(weights):  # type: ignore[no-untyped-def]
    sizes, precision = weights.sizes, weights.input_factor.dtype
    return _Room(
        np.empty((FRAME_ROWS, BLOCK)),
        np.empty(BLOCK, dtype=np.bool_),
        np.empty((INPUTS + 1, BLOCK), dtype=precision),
        np.empty((BIOT + STRETCH, BLOCK), dtype=precision),
        np.empty((2, sizes.max(), BLOCK), dtype=precision),
        np.empty((sizes[-1], BLOCK), dtype=precision),
        np.empty((ROWS + weights.made.shape[0], LANES), dtype=precision),
        np.empty((ROOM, BLOCK)),
    )


@kernel
def _evaluate_serial(  # type: ignore[no-untyped-def]
    F, F_dot, weights, trust, tolerance, stress, status, bound
):
    _evaluate_some(0, F.shape[0], F, F_dot, weights, trust, tolerance, stress, status, bound)


@parallel_kernel
def _evaluate_parallel(F, F_dot, weights, trust, tolerance, stress, status, bound):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        _evaluate_some(
            part * _PART,
            min((part + 1) * _PART, F.shape[0]),
            F, F_dot, weights, trust, tolerance, stress, status, bound,
        )  # fmt: skip


@kernel
def _evaluate_some(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, weights, trust, tolerance, stress, status, bound
):
    room = _make_room(weights)
    for start in range(begin, end, BLOCK):
        _evaluate_block(start, F, F_dot, weights, trust, tolerance, room, stress, status, bound)


@kernel
def _evaluate_block(start, F, F_dot, weights, trust, tolerance, room, stress, status, bound):  # type: ignore[no-untyped-def]
    frame, x, y = room.frame, room.x, room.y
    read_points(start, F, F_dot, frame)
    take_rotation_out(frame)
    _test_range(frame, weights.bounds, room.inside)
    scale_inputs(frame, weights.input_factor, x)
    network_factors(x, weights, room.layers, room.factors)
    y[:] = 0.0
    _combine(x, room.factors, weights, y)
    add_polynomials(x, weights, room.products, y)
    if weights.powers[0]:
        _add_elastic(x, frame, weights, y)
    turn_to_cauchy(y, frame)
    put_rotation_back(frame)
    _write(start, frame, room.inside, stress, status)
    apply_trust(start, frame, trust, tolerance, room.trusted, status, bound)
    _take_away(start, status, stress)


@parallel_kernel
def _test_parallel(F, F_dot, bounds, trust, tolerance, status, bound):  # type: ignore[no-untyped-def]
    for part in prange((F.shape[0] + _PART - 1) // _PART):
        some = slice(part * _PART, min((part + 1) * _PART, F.shape[0]))
        _test_some(F[some], F_dot[some], bounds, trust, tolerance, status[some], bound[some])


@kernel
def _test_some(F, F_dot, bounds, trust, tolerance, status, bound):  # type: ignore[no-untyped-def]
    frame, rows = np.empty((FRAME_ROWS, BLOCK)), np.empty((ROOM, BLOCK))
    inside = np.empty(BLOCK, dtype=np.bool_)
    for start in range(0, F.shape[0], BLOCK):
        read_points(start, F, F_dot, frame)
        take_rotation_out(frame)
        _test_range(frame, bounds, inside)
        for p in range(min(BLOCK, F.shape[0] - start)):
            status[start + p] = _OK if inside[p] else _OUT_OF_RANGE
        apply_trust(start, frame, trust, tolerance, rows, status, bound)


@kernel
def _test_range(frame, bounds, inside):  # type: ignore[no-untyped-def]
    low, high, shear, rate = bounds[0], bounds[1], bounds[2], bounds[3]
    for p in range(BLOCK):
        ok = (frame[10, p] >= low) & (frame[10, p] <= high)
        ok &= (frame[12, p] >= low) & (frame[12, p] <= high) & (abs(frame[11, p]) <= shear)
        ok &= (abs(frame[0, p]) <= rate) & (abs(frame[1, p]) <= rate)
        ok &= (abs(frame[2, p]) <= rate) & (abs(frame[3, p]) <= rate)
        inside[p] = ok


@kernel
def _combine(x, factors, weights, y):  # type: ignore[no-untyped-def]
    for k in range(weights.terms.shape[0]):
        a, b, c, component, factor = weights.terms[k]
        at_rest = weights.at_rest[factor]
        for p in range(BLOCK):
            y[component, p] += (factors[factor, p] - at_rest) * (x[a, p] * x[b, p] * x[c, p])
    for component in range(4):
        scale = weights.output_factor[component]
        for p in range(BLOCK):
            y[component, p] *= scale


@kernel
def _add_elastic(x, frame, weights, y):  # type: ignore[no-untyped-def]
    """2 ∂W/∂(s, d, g), and the spin that makes the Cauchy stress of these symmetric."""
    biot = np.empty((STRETCH, BLOCK), dtype=x.dtype)
    slope = energy_slope(x, weights)
    for k in range(3):
        at_rest, factor = weights.energy_at_rest[k], weights.energy_factor[k]
        squared = weights.powers[k] == 2
        for p in range(BLOCK):
            inner = x[k, p] + x[k, p] if squared else x[_ONE, p]
            biot[k, p] = y[BIOT + k, p] + (slope[k, p] - at_rest) * inner * factor
    for p in range(BLOCK):
        difference, shear = frame[10, p] - frame[12, p], 2.0 * frame[11, p]
        spin = (biot[1, p] * shear - biot[2, p] * difference) / (frame[10, p] + frame[12, p])
        y[0, p] += biot[0, p]
        y[1, p] += biot[1, p]
        y[2, p] += biot[2, p]
        y[3, p] += spin


@kernel
def _write(start, frame, inside, stress, status):  # type: ignore[no-untyped-def]
    for p in range(min(BLOCK, stress.shape[0] - start)):
        code = _OK if inside[p] else _OUT_OF_RANGE
        for i in range(4):
            if code == _OK and not np.isfinite(frame[13 + i, p]):
                code = _NOT_FINITE
            stress[start + p, i // 2, i % 2] = frame[13 + i, p]
        status[start + p] = code


@kernel
def _take_away(start, status, stress):  # type: ignore[no-untyped-def]
    """No stress where the status is not 0."""
    for point in range(start, min(start + BLOCK, stress.shape[0])):
        if status[point] != _OK:
            for i in range(4):
                stress[point, i // 2, i % 2] = np.nan
