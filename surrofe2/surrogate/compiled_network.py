"""The network of a surrogate in compiled code: value, and slopes along some of the inputs.

Layout and names as in `compiled_frame`. What is differentiated by the first K inputs has the input
as first axis: (K, rows, TILES, TILE); a value alone is the same with K = 0. Rows of a layer are
computed four at a time, so sizes are padded with zeros to multiples of four.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, fill_tanh, inverse_root, load, spread, store
from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.compiled_frame import BLOCK, ONE, TILES
from surrofe2.surrogate.features import BEND, STRETCH
from surrofe2.surrogate.polynomial import ROWS, set_polynomial

COMPONENTS = 4
"""Of P̂."""


class Room(NamedTuple):
    """What a block is worked out in, used again for the next.

    x: (8, …) scaled inputs and ones; y: (4, …) components; products: (rows, 2, TILE) of
    polynomials; units: (all units, …) of the network; the others, with K before, are their slopes.
    """

    x: Any
    y: Any
    y_slopes: Any
    products: Any
    units: Any
    unit_slopes: Any


@kernel
def make_room(arrays, slope_polynomial, inputs):  # type: ignore[no-untyped-def]
    """Room for values and for slopes along so many inputs, 0 or 7; see `NetworkArrays`.

    slope_polynomial: where there are no slopes, the arrays once more.
    """
    products = max(arrays.products.shape[0], slope_polynomial.products.shape[0])
    units = arrays.sizes.sum()
    return Room(
        np.empty((INPUTS + 1, TILES, TILE)),
        np.empty((COMPONENTS, TILES, TILE)),
        np.empty((inputs, COMPONENTS, TILES, TILE)),
        np.empty((ROWS + products, 2, TILE)),
        np.empty((units, TILES, TILE)),
        np.empty((inputs, units, TILES, TILE)),
    )


@kernel
def evaluate_network(arrays, slope_polynomial, room):  # type: ignore[no-untyped-def]
    """The components of P̂, y, and their slopes by scaled inputs, from x; see `make_room`."""
    set_polynomial(room.x, arrays, room.products, room.y)
    if room.y_slopes.shape[0]:
        flat = room.y_slopes.reshape(INPUTS * COMPONENTS, TILES, TILE)
        set_polynomial(room.x, slope_polynomial, room.products, flat)
    _add_terms(arrays, room, evaluate_factors(arrays, room))


@kernel
def evaluate_factors(arrays, room):  # type: ignore[no-untyped-def]
    """Fill the units of the factors, and their slopes; returns the row of the first factor."""
    x, units, slopes = room.x, room.units, room.unit_slopes
    products = arrays.invariants.shape[0]
    units[products + STRETCH : arrays.sizes[0]] = 0.0
    for row in range(products):
        a, b, c = three(arrays.invariants, row)
        for t in range(TILES):
            store(load(x, a, t) * load(x, b, t) * load(x, c, t), units, row, t)
    if slopes.shape[0]:
        slopes[:, : arrays.sizes[0]] = 0.0
        for row in range(products):
            for t in range(TILES):
                _add_product_slopes(arrays.invariants, row, x, spread(1.0), slopes, row, t)
    _fill_near_invariants(arrays.powers, x, units, slopes, products)
    return _forward(arrays.sizes, arrays.weights, arrays.biases, units, slopes)


@kernel
def _fill_near_invariants(powers, x, units, slopes, first):  # type: ignore[no-untyped-def]
    """The units from `first` on that tell states near rest apart, x^p/√(δ² + x²), and slopes."""
    for k in range(STRETCH):
        for t in range(TILES):
            value = load(x, k, t)
            raised = value if powers[k] == 2 else load(x, ONE, t)
            inverse = inverse_root(value * value + BEND * BEND)
            near = raised * value * inverse
            store(near, units, first + k, t)
            if slopes.shape[0]:
                by_power = raised * (float(powers[k]) * inverse)
                store(by_power - near * value * inverse * inverse, slopes, k, first + k, t)


@kernel
def _forward(sizes, weights, biases, units, slopes):  # type: ignore[no-untyped-def]
    """Fill the units of all layers, and their slopes, from the inputs'; the last has no tanh.

    Returns the first row of the last layer.
    """
    none = np.zeros(sizes.max())
    begin, first_weight, first_bias = 0, 0, 0
    for layer in range(1, sizes.shape[0]):
        rows, columns = sizes[layer], sizes[layer - 1]
        end = first_weight + rows * columns
        matrix = weights[first_weight:end].reshape(rows, columns)
        middle = begin + columns
        is_last = layer == sizes.shape[0] - 1
        apply_layer(matrix, biases[first_bias : first_bias + rows], units[begin:], units[middle:])
        if not is_last:
            fill_tanh(units[middle : middle + rows].reshape(rows * BLOCK))
        for k in range(slopes.shape[0]):
            apply_layer(matrix, none, slopes[k, begin:], slopes[k, middle:])
            if not is_last:
                _times_tanh_slope(units[middle:], slopes[k, middle:], rows)
        begin, first_weight = middle, end
        first_bias += rows
    return begin


@kernel
def _times_tanh_slope(tanh, slopes, rows):  # type: ignore[no-untyped-def]
    """Multiply slopes (rows, …) by 1 − tanh²."""
    for row in range(rows):
        for t in range(TILES):
            h = load(tanh, row, t)
            store((1.0 - h * h) * load(slopes, row, t), slopes, row, t)


@kernel
def _add_terms(arrays, room, first_factor):  # type: ignore[no-untyped-def]
    """Add (factor − factor at rest) × product of each term to its component."""
    x, y, y_slopes = room.x, room.y, room.y_slopes
    inputs = y_slopes.shape[0]
    for term in range(arrays.terms.shape[0]):
        a, b, c = three(arrays.terms, term)
        component = arrays.terms[term, 3]
        scale, at_rest = arrays.output_factor[component], arrays.at_rest[term]
        for t in range(TILES):
            factor = (load(room.units, first_factor + term, t) - at_rest) * scale
            product = load(x, a, t) * load(x, b, t) * load(x, c, t)
            store(load(y, component, t) + factor * product, y, component, t)
            for k in range(inputs):
                slope = load(room.unit_slopes, k, first_factor + term, t) * (product * scale)
                store(load(y_slopes, k, component, t) + slope, y_slopes, k, component, t)
            if inputs:
                _add_product_slopes(arrays.terms, term, x, factor, y_slopes, component, t)


@kernel
def _add_product_slopes(table, row, x, factor, slopes, component, t):  # type: ignore[no-untyped-def]
    """Add those of factor × the product of the three inputs that a row of the table names."""
    a, b, c = three(table, row)
    first, second, third = load(x, a, t), load(x, b, t), load(x, c, t)
    _add_to(slopes, a, component, t, factor * second * third)
    _add_to(slopes, b, component, t, factor * first * third)
    _add_to(slopes, c, component, t, factor * first * second)


@kernel
def _add_to(slopes, k, component, t, value):  # type: ignore[no-untyped-def]
    if k < slopes.shape[0]:
        store(load(slopes, k, component, t) + value, slopes, k, component, t)


@kernel
def three(table, row):  # type: ignore[no-untyped-def]
    """The first three entries of a row; to unpack the row itself takes longer than its use."""
    return table[row, 0], table[row, 1], table[row, 2]


@kernel
def apply_layer(matrix, bias, source, target):  # type: ignore[no-untyped-def]
    """target = matrix source + bias, (rows, …); four rows of two tiles stay in registers."""
    for t in range(0, TILES, 2):
        for j in range(0, matrix.shape[0], 4):
            a, b = spread(bias[j]), spread(bias[j + 1])
            c, d = spread(bias[j + 2]), spread(bias[j + 3])
            e, f, g, h = a, b, c, d
            for k in range(matrix.shape[1]):
                one, two = load(source, k, t), load(source, k, t + 1)
                first, second = spread(matrix[j, k]), spread(matrix[j + 1, k])
                third, fourth = spread(matrix[j + 2, k]), spread(matrix[j + 3, k])
                a += first * one
                b += second * one
                c += third * one
                d += fourth * one
                e += first * two
                f += second * two
                g += third * two
                h += fourth * two
            store(a, target, j, t)
            store(b, target, j + 1, t)
            store(c, target, j + 2, t)
            store(d, target, j + 3, t)
            store(e, target, j, t + 1)
            store(f, target, j + 1, t + 1)
            store(g, target, j + 2, t + 1)
            store(h, target, j + 3, t + 1)
