"""The network as one compiled pass from (F, Ḟ) to stress and status.

Layout: points are taken in blocks of `BLOCK`; every quantity is a row of `BLOCK` values, one a
point, so each innermost loop runs over the points of a block with all else constant, which the
compiler turns into SIMD instructions:

    frame (rows, BLOCK)  float64: A, Ḟ, cos and sin of R, U, σ
    x     (8, BLOCK)     scaled inputs and, in the last row, ones
    h     (units, BLOCK) layer of the network; weights are broadcast over the row
    y     (4, BLOCK)     components of P̂ = RᵀP

From x on everything is in the precision of the weights. Rows of a layer are computed two at a
time from four of the layer before, so sizes are padded with zeros to multiples of four.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.polar_inputs import INPUTS
from surrofe2.stress_law import Status
from surrofe2.surrogate.error_bound import EVERYWHERE_UNKNOWN, Trust, apply_trust
from surrofe2.surrogate.features import STRETCH, Features
from surrofe2.surrogate.packing import Weights
from surrofe2.surrogate.vector_tanh import fill_tanh

BLOCK = 40
MANY = 2000  # points from which on more than one core pays

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


def without_rest(weights: Weights, features: Features) -> Weights:
    """The weights that subtract what the network gives at rest, by the very same instructions."""
    x = np.zeros((INPUTS + 1, BLOCK), dtype=weights.input_factor.dtype)
    x[_ONE] = 1.0
    factors = network_factors(x, weights)[: features.factors, 0]
    subtracted = np.zeros(features.factors, dtype=bool)
    subtracted[[term.factor for term in features.terms if not term.product]] = True
    slope = np.zeros(STRETCH, dtype=factors.dtype)
    if features.powers:
        linear = np.array(features.powers) == 1
        slope = np.where(linear, energy_slope(x, weights)[:STRETCH, 0], slope)
    return weights._replace(
        at_rest=np.where(subtracted, factors, np.zeros_like(factors)), energy_at_rest=slope
    )


@kernel
def _evaluate_serial(  # type: ignore[no-untyped-def]
    F, F_dot, weights, trust, tolerance, stress, status, bound
):
    for block in range((F.shape[0] + BLOCK - 1) // BLOCK):
        _evaluate_block(block * BLOCK, F, F_dot, weights, trust, tolerance, stress, status, bound)


@parallel_kernel
def _evaluate_parallel(F, F_dot, weights, trust, tolerance, stress, status, bound):  # type: ignore[no-untyped-def]
    for block in prange((F.shape[0] + BLOCK - 1) // BLOCK):
        _evaluate_block(block * BLOCK, F, F_dot, weights, trust, tolerance, stress, status, bound)


@kernel
def _evaluate_block(start, F, F_dot, weights, trust, tolerance, stress, status, bound):  # type: ignore[no-untyped-def]
    frame = np.empty((19, BLOCK))
    inside = np.empty(BLOCK, dtype=np.bool_)
    y = np.zeros((4, BLOCK), dtype=weights.input_factor.dtype)
    x = np.empty((INPUTS + 1, BLOCK), dtype=weights.input_factor.dtype)
    read_points(start, F, F_dot, frame)
    take_rotation_out(frame)
    _test_range(frame, weights.bounds, inside)
    scale_inputs(frame, weights.input_factor, x)
    _combine(x, network_factors(x, weights), weights, y)
    _add_polynomials(x, weights.monomials, weights.coefficients, y)
    if weights.powers[0]:
        _add_elastic(x, frame, weights, y)
    _turn_to_cauchy(y, frame)
    _put_rotation_back(frame)
    _write(start, frame, inside, stress, status)
    apply_trust(start, frame, trust, tolerance, stress, status, bound)


@kernel
def read_points(start, F, F_dot, frame):  # type: ignore[no-untyped-def]
    """Rows 0 to 3: F, rows 4 to 7: Ḟ; behind the last point it is repeated."""
    for p in range(BLOCK):
        point = min(start + p, F.shape[0] - 1)
        for i in range(2):
            for j in range(2):
                frame[2 * i + j, p] = F[point, i, j]
                frame[4 + 2 * i + j, p] = F_dot[point, i, j]


@kernel
def take_rotation_out(frame):  # type: ignore[no-untyped-def]
    """Rows 8, 9: cos and sin of R; rows 10 to 12: U₁₁, U₁₂, U₂₂; rows 0 to 3: A = RᵀḞ."""
    for p in range(BLOCK):
        xx, xy, yx, yy = frame[0, p], frame[1, p], frame[2, p], frame[3, p]
        along, across = xx + yy, yx - xy
        length = 1.0 / np.sqrt(along * along + across * across)
        c, s = along * length, across * length
        frame[8, p] = c
        frame[9, p] = s
        frame[10, p] = c * xx + s * yx
        frame[11, p] = c * xy + s * yy
        frame[12, p] = c * yy - s * xy
        vxx, vxy, vyx, vyy = frame[4, p], frame[5, p], frame[6, p], frame[7, p]
        frame[0, p] = c * vxx + s * vyx
        frame[1, p] = c * vxy + s * vyy
        frame[2, p] = c * vyx - s * vxx
        frame[3, p] = c * vyy - s * vxy


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
def scale_inputs(frame, factor, x):  # type: ignore[no-untyped-def]
    """The inputs of `components`, scaled, and a row of ones."""
    for p in range(BLOCK):
        x[0, p] = ((frame[10, p] - 1.0) + (frame[12, p] - 1.0)) * factor[0]
        x[1, p] = (frame[10, p] - frame[12, p]) * factor[1]
        x[2, p] = 2.0 * frame[11, p] * factor[2]
        x[3, p] = (frame[0, p] + frame[3, p]) * factor[3]
        x[4, p] = (frame[0, p] - frame[3, p]) * factor[4]
        x[5, p] = (frame[1, p] + frame[2, p]) * factor[5]
        x[6, p] = (frame[2, p] - frame[1, p]) * factor[6]
        x[_ONE, p] = 1.0


@kernel
def network_factors(x, weights):  # type: ignore[no-untyped-def]
    """Rows of the factors of the terms at scaled inputs x (8, BLOCK), summed over the members."""
    sizes = weights.sizes
    total = np.zeros((sizes[-1], BLOCK), dtype=x.dtype)
    for member in range(weights.weights.shape[0]):
        source = np.zeros((sizes[0], BLOCK), dtype=x.dtype)
        for k in range(weights.invariants.shape[0]):
            a, b, c = weights.invariants[k]
            for p in range(BLOCK):
                source[k, p] = x[a, p] * x[b, p] * x[c, p]
        first, first_bias = 0, 0
        for layer in range(1, sizes.shape[0]):
            rows, columns = sizes[layer], sizes[layer - 1]
            size = rows * columns
            matrix = weights.weights[member, first : first + size].reshape(rows, columns)
            bias = weights.biases[member, first_bias : first_bias + rows]
            target = np.empty((rows, BLOCK), dtype=x.dtype)
            apply_layer(matrix, bias, source, target)
            if layer + 1 < sizes.shape[0]:
                fill_tanh(target)
            source = target
            first += size
            first_bias += rows
        for row in range(sizes[-1]):
            for p in range(BLOCK):
                total[row, p] += source[row, p]
    return total


@kernel
def energy_slope(x, weights):  # type: ignore[no-untyped-def]
    """Rows of ∂W by the invariants of U (4, BLOCK), summed over the members: forward and back."""
    sizes = weights.energy_sizes
    total = np.zeros((sizes[0], BLOCK), dtype=x.dtype)
    none = np.zeros(sizes.max(), dtype=x.dtype)
    for member in range(weights.energy_weights.shape[0]):
        hidden = np.zeros((sizes[:-1].sum(), BLOCK), dtype=x.dtype)
        for k in range(3):
            for p in range(BLOCK):
                hidden[k, p] = x[k, p] * x[k, p] if weights.powers[k] == 2 else x[k, p]
        begin, first, first_bias = 0, 0, 0
        for layer in range(1, sizes.shape[0] - 1):
            rows, columns = sizes[layer], sizes[layer - 1]
            matrix = weights.energy_weights[member, first : first + rows * columns].reshape(
                rows, columns
            )
            end = begin + columns
            bias = weights.energy_biases[member, first_bias : first_bias + rows]
            apply_layer(matrix, bias, hidden[begin:end], hidden[end : end + rows])
            fill_tanh(hidden[end : end + rows])
            begin = end
            first += rows * columns
            first_bias += rows
        last = weights.energy_weights[member, first : first + sizes[-2]]
        back = np.empty((sizes[-2], BLOCK), dtype=x.dtype)
        for row in range(sizes[-2]):
            for p in range(BLOCK):
                back[row, p] = last[row]
        for layer in range(sizes.shape[0] - 2, 0, -1):
            rows, columns = sizes[layer], sizes[layer - 1]
            for row in range(rows):
                for p in range(BLOCK):
                    h = hidden[begin + row, p]
                    back[row, p] *= 1.0 - h * h
            first -= rows * columns
            matrix = weights.energy_turned[member, first : first + rows * columns].reshape(
                columns, rows
            )
            before = np.empty((columns, BLOCK), dtype=x.dtype)
            apply_layer(matrix, none, back, before)
            back = before
            begin -= columns
        for row in range(sizes[0]):
            for p in range(BLOCK):
                total[row, p] += back[row, p]
    return total


@kernel
def apply_layer(matrix, bias, source, target):  # type: ignore[no-untyped-def]
    """target = matrix source + bias, (rows, BLOCK)."""
    for j in range(0, matrix.shape[0], 2):
        for p in range(BLOCK):
            target[j, p] = bias[j]
            target[j + 1, p] = bias[j + 1]
        for k in range(0, matrix.shape[1], 4):
            a0, a1, a2, a3 = matrix[j, k], matrix[j, k + 1], matrix[j, k + 2], matrix[j, k + 3]
            b0, b1 = matrix[j + 1, k], matrix[j + 1, k + 1]
            b2, b3 = matrix[j + 1, k + 2], matrix[j + 1, k + 3]
            for p in range(BLOCK):
                s0, s1, s2, s3 = source[k, p], source[k + 1, p], source[k + 2, p], source[k + 3, p]
                target[j, p] += a0 * s0 + a1 * s1 + a2 * s2 + a3 * s3
                target[j + 1, p] += b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3


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
def _add_polynomials(x, table, coefficients, y):  # type: ignore[no-untyped-def]
    """Each monomial is an earlier one times one more input; row 0 of the earlier ones is 1."""
    kept = np.empty((max(1, table[:, 3].max() + 1) if table.shape[0] else 1, BLOCK), dtype=x.dtype)
    kept[0] = 1.0
    for k in range(table.shape[0]):
        prefix, factor, component, keep = table[k]
        c = coefficients[k]
        if keep >= 0:
            for p in range(BLOCK):
                kept[keep, p] = kept[prefix, p] * x[factor, p]
                y[component, p] += c * kept[keep, p]
        else:
            for p in range(BLOCK):
                y[component, p] += c * kept[prefix, p] * x[factor, p]


@kernel
def _add_elastic(x, frame, weights, y):  # type: ignore[no-untyped-def]
    """2 ∂W/∂(s, d, g), and the spin that makes the Cauchy stress of these symmetric."""
    biot = np.zeros((3, BLOCK), dtype=x.dtype)
    slope = energy_slope(x, weights)
    for k in range(3):
        at_rest, factor = weights.energy_at_rest[k], weights.energy_factor[k]
        squared = weights.powers[k] == 2
        for p in range(BLOCK):
            inner = x[k, p] + x[k, p] if squared else x[_ONE, p]
            biot[k, p] = (slope[k, p] - at_rest) * inner * factor
    _add_polynomials(x, weights.energy_monomials, weights.energy_coefficients, biot)
    for p in range(BLOCK):
        difference, shear = frame[10, p] - frame[12, p], 2.0 * frame[11, p]
        spin = (biot[1, p] * shear - biot[2, p] * difference) / (frame[10, p] + frame[12, p])
        y[0, p] += biot[0, p]
        y[1, p] += biot[1, p]
        y[2, p] += biot[2, p]
        y[3, p] += spin


@kernel
def _turn_to_cauchy(y, frame):  # type: ignore[no-untyped-def]
    """Rows 13 to 16: components of S = P̂ U/det U."""
    for p in range(BLOCK):
        t, d, g = frame[10, p] + frame[12, p], frame[10, p] - frame[12, p], 2.0 * frame[11, p]
        factor = 2.0 / (t * t - d * d - g * g)
        frame[13, p] = factor * (t * y[0, p] + d * y[1, p] + g * y[2, p])
        frame[14, p] = factor * (d * y[0, p] + t * y[1, p] - g * y[3, p])
        frame[15, p] = factor * (g * y[0, p] + t * y[2, p] + d * y[3, p])
        frame[16, p] = factor * (t * y[3, p] - g * y[1, p] + d * y[2, p])


@kernel
def _put_rotation_back(frame):  # type: ignore[no-untyped-def]
    """Rows 13 to 16: σ₁₁, σ₁₂, σ₂₁, σ₂₂; R turns (difference, shear) by twice its angle."""
    for p in range(BLOCK):
        c, s = frame[8, p], frame[9, p]
        c2, s2 = c * c - s * s, 2.0 * c * s
        total, spin = frame[13, p], frame[16, p]
        difference = c2 * frame[14, p] - s2 * frame[15, p]
        shear = s2 * frame[14, p] + c2 * frame[15, p]
        frame[13, p] = 0.5 * (total + difference)
        frame[14, p] = 0.5 * (shear - spin)
        frame[15, p] = 0.5 * (shear + spin)
        frame[16, p] = 0.5 * (total - difference)


@kernel
def _write(start, frame, inside, stress, status):  # type: ignore[no-untyped-def]
    for p in range(min(BLOCK, stress.shape[0] - start)):
        code = _OK if inside[p] else _OUT_OF_RANGE
        for i in range(4):
            if code == _OK and not np.isfinite(frame[13 + i, p]):
                code = _NOT_FINITE
        status[start + p] = code
        for i in range(4):
            stress[start + p, i // 2, i % 2] = frame[13 + i, p] if code == _OK else np.nan
