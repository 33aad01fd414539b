"""Slopes of a network by its inputs in compiled code, forward along all inputs at once.

Layout as in `compiled`; what is differentiated has the input first: (7, rows, BLOCK). The twin is
`network_slopes.differentiate`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.surrogate.compiled_frame import (
    FRAME_ROWS,
    read_points,
    scale_inputs,
    take_rotation_out,
)
from surrofe2.surrogate.compiled_network import apply_layer
from surrofe2.surrogate.features import STRETCH
from surrofe2.surrogate.lanes import BLOCK
from surrofe2.surrogate.packing import Weights
from surrofe2.surrogate.vector_tanh import fill_tanh
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]
_ONE = INPUTS


def evaluate_slopes(F: Any, F_dot: Any, weights: Weights) -> tuple[Array, Array]:
    """(components of P̂ (n, 4), their slopes by the inputs (n, 4, 7)); no range is tested.

    F, F_dot: (n, 2, 2) contiguous float64, det F > 0.
    """
    P, slopes = np.empty((len(F), 4)), np.empty((len(F), 4, INPUTS))
    _evaluate(F, F_dot, weights, P, slopes)
    return P, slopes


@kernel
def _evaluate(F, F_dot, weights, P, slopes):  # type: ignore[no-untyped-def]
    for block in range((F.shape[0] + BLOCK - 1) // BLOCK):
        _evaluate_block(block * BLOCK, F, F_dot, weights, P, slopes)


@kernel
def _evaluate_block(start, F, F_dot, weights, P, slopes):  # type: ignore[no-untyped-def]
    frame = np.empty((FRAME_ROWS, BLOCK))
    precision = weights.input_factor.dtype
    x = np.empty((INPUTS + 1, BLOCK), dtype=precision)
    y, dy = np.zeros((4, BLOCK), dtype=precision), np.zeros((INPUTS, 4, BLOCK), dtype=precision)
    read_points(start, F, F_dot, frame)
    take_rotation_out(frame)
    scale_inputs(frame, weights.input_factor, x)
    _add_terms(x, weights, y, dy)
    _add_polynomials(x, weights.monomials, weights.coefficients, y, dy)
    if weights.powers[0]:
        _add_elastic(x, frame, weights, y, dy)
    for p in range(min(BLOCK, P.shape[0] - start)):
        for c in range(4):
            P[start + p, c] = y[c, p]
            for k in range(INPUTS):
                slopes[start + p, c, k] = dy[k, c, p] * weights.input_factor[k]


@kernel
def _set_product(x, factors, row, slopes):  # type: ignore[no-untyped-def]
    """A product of three rows of x, and its slopes (7, BLOCK)."""
    a, b, c = factors[0], factors[1], factors[2]
    slopes[:] = 0.0
    for p in range(BLOCK):
        row[p] = x[a, p] * x[b, p] * x[c, p]
    for first, second, third in ((a, b, c), (b, c, a), (c, a, b)):
        if first != _ONE:
            for p in range(BLOCK):
                slopes[first, p] += x[second, p] * x[third, p]


@kernel
def _factors(x, weights, factors, dfactors):  # type: ignore[no-untyped-def]
    sizes = weights.sizes
    none = np.zeros(sizes.max(), dtype=x.dtype)
    for member in range(weights.weights.shape[0]):
        source = np.zeros((sizes[0], BLOCK), dtype=x.dtype)
        dsource = np.zeros((INPUTS, sizes[0], BLOCK), dtype=x.dtype)
        for row in range(weights.invariants.shape[0]):
            _set_product(x, weights.invariants[row], source[row], dsource[:, row])
        first, first_bias = 0, 0
        for layer in range(1, sizes.shape[0]):
            rows, columns = sizes[layer], sizes[layer - 1]
            size = rows * columns
            matrix = weights.weights[member, first : first + size].reshape(rows, columns)
            target = np.empty((rows, BLOCK), dtype=x.dtype)
            dtarget = np.empty((INPUTS, rows, BLOCK), dtype=x.dtype)
            apply_layer(matrix, weights.biases[member, first_bias:], source, target)
            for k in range(INPUTS):
                apply_layer(matrix, none, dsource[k], dtarget[k])
            if layer + 1 < sizes.shape[0]:
                fill_tanh(target)
                for k in range(INPUTS):
                    for row in range(rows):
                        for p in range(BLOCK):
                            h = target[row, p]
                            dtarget[k, row, p] *= 1.0 - h * h
            source, dsource = target, dtarget
            first += size
            first_bias += rows
        factors += source
        dfactors += dsource


@kernel
def _add_terms(x, weights, y, dy):  # type: ignore[no-untyped-def]
    count = weights.sizes[-1]
    factors = np.zeros((count, BLOCK), dtype=x.dtype)
    dfactors = np.zeros((INPUTS, count, BLOCK), dtype=x.dtype)
    _factors(x, weights, factors, dfactors)
    product, dproduct = np.empty(BLOCK, dtype=x.dtype), np.empty((INPUTS, BLOCK), dtype=x.dtype)
    for term in range(weights.terms.shape[0]):
        component, factor = weights.terms[term, 3], weights.terms[term, 4]
        scale, at_rest = weights.output_factor[component], weights.at_rest[factor]
        _set_product(x, weights.terms[term], product, dproduct)
        for p in range(BLOCK):
            y[component, p] += scale * (factors[factor, p] - at_rest) * product[p]
        for k in range(INPUTS):
            for p in range(BLOCK):
                dy[k, component, p] += scale * (
                    dfactors[k, factor, p] * product[p]
                    + (factors[factor, p] - at_rest) * dproduct[k, p]
                )


@kernel
def _add_polynomials(x, table, coefficients, y, dy):  # type: ignore[no-untyped-def]
    rows = max(1, table[:, 3].max() + 1) if table.shape[0] else 1
    kept = np.empty((rows, BLOCK), dtype=x.dtype)
    dkept = np.zeros((rows, INPUTS, BLOCK), dtype=x.dtype)
    kept[0] = 1.0
    product, dproduct = np.empty(BLOCK, dtype=x.dtype), np.empty((INPUTS, BLOCK), dtype=x.dtype)
    for term in range(table.shape[0]):
        prefix, factor, component, keep = table[term]
        for p in range(BLOCK):
            product[p] = kept[prefix, p] * x[factor, p]
        for k in range(INPUTS):
            for p in range(BLOCK):
                dproduct[k, p] = dkept[prefix, k, p] * x[factor, p]
        if factor != _ONE:
            for p in range(BLOCK):
                dproduct[factor, p] += kept[prefix, p]
        c = coefficients[term]
        for p in range(BLOCK):
            y[component, p] += c * product[p]
        for k in range(INPUTS):
            for p in range(BLOCK):
                dy[k, component, p] += c * dproduct[k, p]
        if keep >= 0:
            kept[keep] = product
            dkept[keep] = dproduct


@kernel
def _energy_slope(x, weights, slope, dslope):  # type: ignore[no-untyped-def]
    """∂W by the invariants of U (rows, BLOCK) and its slopes by s, d, g: forward over reverse."""
    sizes = weights.energy_sizes
    none = np.zeros(sizes.max(), dtype=x.dtype)
    for member in range(weights.energy_weights.shape[0]):
        hidden = np.zeros((sizes[:-1].sum(), BLOCK), dtype=x.dtype)
        dhidden = np.zeros((STRETCH, hidden.shape[0], BLOCK), dtype=x.dtype)
        for k in range(STRETCH):
            squared = weights.powers[k] == 2
            for p in range(BLOCK):
                hidden[k, p] = x[k, p] * x[k, p] if squared else x[k, p]
                dhidden[k, k, p] = x[k, p] + x[k, p] if squared else x[_ONE, p]
        begin, first, first_bias = 0, 0, 0
        for layer in range(1, sizes.shape[0] - 1):
            rows, columns = sizes[layer], sizes[layer - 1]
            matrix = weights.energy_weights[member, first : first + rows * columns].reshape(
                rows, columns
            )
            middle = begin + columns
            end = middle + rows
            bias = weights.energy_biases[member, first_bias : first_bias + rows]
            apply_layer(matrix, bias, hidden[begin:middle], hidden[middle:end])
            fill_tanh(hidden[middle:end])
            for k in range(STRETCH):
                apply_layer(matrix, none, dhidden[k, begin:middle], dhidden[k, middle:end])
                for row in range(middle, end):
                    for p in range(BLOCK):
                        dhidden[k, row, p] *= 1.0 - hidden[row, p] * hidden[row, p]
            begin = middle
            first += rows * columns
            first_bias += rows
        back = np.empty((sizes[-2], BLOCK), dtype=x.dtype)
        dback = np.zeros((STRETCH, sizes[-2], BLOCK), dtype=x.dtype)
        for row in range(sizes[-2]):
            back[row] = weights.energy_weights[member, first + row]
        for layer in range(sizes.shape[0] - 2, 0, -1):
            rows, columns = sizes[layer], sizes[layer - 1]
            for k in range(STRETCH):
                for row in range(rows):
                    for p in range(BLOCK):
                        h = hidden[begin + row, p]
                        dback[k, row, p] = (1.0 - h * h) * dback[k, row, p] - (h + h) * dhidden[
                            k, begin + row, p
                        ] * back[row, p]
            for row in range(rows):
                for p in range(BLOCK):
                    h = hidden[begin + row, p]
                    back[row, p] *= 1.0 - h * h
            first -= rows * columns
            matrix = weights.energy_turned[member, first : first + rows * columns].reshape(
                columns, rows
            )
            before = np.empty((columns, BLOCK), dtype=x.dtype)
            dbefore = np.empty((STRETCH, columns, BLOCK), dtype=x.dtype)
            apply_layer(matrix, none, back, before)
            for k in range(STRETCH):
                apply_layer(matrix, none, dback[k], dbefore[k])
            back, dback = before, dbefore
            begin -= columns
        slope += back
        dslope += dback


@kernel
def _add_elastic(x, frame, weights, y, dy):  # type: ignore[no-untyped-def]
    rows = weights.energy_sizes[0]
    slope = np.zeros((rows, BLOCK), dtype=x.dtype)
    dslope = np.zeros((STRETCH, rows, BLOCK), dtype=x.dtype)
    _energy_slope(x, weights, slope, dslope)
    biot = np.zeros((STRETCH, BLOCK), dtype=x.dtype)
    dbiot = np.zeros((INPUTS, STRETCH, BLOCK), dtype=x.dtype)
    for k in range(STRETCH):
        at_rest, factor = weights.energy_at_rest[k], weights.energy_factor[k]
        squared = weights.powers[k] == 2
        for p in range(BLOCK):
            inner = x[k, p] + x[k, p] if squared else x[_ONE, p]
            biot[k, p] = (slope[k, p] - at_rest) * inner * factor
            for j in range(STRETCH):
                dbiot[j, k, p] = dslope[j, k, p] * inner * factor
            if squared:
                dbiot[k, k, p] += 2.0 * (slope[k, p] - at_rest) * factor
    _add_polynomials(x, weights.energy_monomials, weights.energy_coefficients, biot, dbiot)
    for p in range(BLOCK):
        t = frame[10, p] + frame[12, p]
        d, g = frame[10, p] - frame[12, p], 2.0 * frame[11, p]
        spin = (biot[1, p] * g - biot[2, p] * d) / t
        for c in range(STRETCH):
            y[c, p] += biot[c, p]
        y[3, p] += spin
        for j in range(STRETCH):
            for c in range(STRETCH):
                dy[j, c, p] += dbiot[j, c, p]
            dy[j, 3, p] += (dbiot[j, 1, p] * g - dbiot[j, 2, p] * d) / t
        dy[0, 3, p] -= spin / t / weights.input_factor[0]
        dy[1, 3, p] -= biot[2, p] / t / weights.input_factor[1]
        dy[2, 3, p] += biot[1, p] / t / weights.input_factor[2]
