"""The tanh networks of a surrogate in compiled code; layout and names as in `compiled`.

Rows of a layer are computed four at a time, so sizes are padded with zeros to multiples of four.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.surrogate.lanes import BLOCK, LANES, filled, load, store
from surrofe2.surrogate.vector_tanh import fill_tanh


@kernel
def network_factors(x, weights, layers, total):  # type: ignore[no-untyped-def]
    """Fill the rows of the factors of the terms (factors, BLOCK), summed over the members.

    x: (8, BLOCK) scaled inputs. layers: (2, units, BLOCK) room for the largest layers.
    """
    sizes = weights.sizes
    total[:] = 0.0
    for member in range(weights.weights.shape[0]):
        _set_invariants(x, weights.invariants, layers[0, : sizes[0]])
        first, first_bias = 0, 0
        for layer in range(1, sizes.shape[0]):
            rows, columns = sizes[layer], sizes[layer - 1]
            size = rows * columns
            matrix = weights.weights[member, first : first + size].reshape(rows, columns)
            bias = weights.biases[member, first_bias : first_bias + rows]
            target = layers[layer % 2, :rows]
            apply_layer(matrix, bias, layers[(layer - 1) % 2], target)
            if layer + 1 < sizes.shape[0]:
                fill_tanh(target)
            first += size
            first_bias += rows
        answer = layers[(sizes.shape[0] - 1) % 2]
        for row in range(sizes[-1]):
            for p in range(BLOCK):
                total[row, p] += answer[row, p]


@kernel
def _set_invariants(x, invariants, rows):  # type: ignore[no-untyped-def]
    """Rows of what the network reads, and zeros behind them."""
    for k in range(invariants.shape[0]):
        a, b, c = invariants[k]
        for p in range(BLOCK):
            rows[k, p] = x[a, p] * x[b, p] * x[c, p]
    rows[invariants.shape[0] :] = 0.0


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
    """target = matrix source + bias, (rows, BLOCK); four rows at a time stay in registers."""
    for p in range(0, BLOCK, LANES):
        for j in range(0, matrix.shape[0], 4):
            a, b, c, d = (
                filled(bias[j]),
                filled(bias[j + 1]),
                filled(bias[j + 2]),
                filled(bias[j + 3]),
            )
            for k in range(matrix.shape[1]):
                row = load(source, k, p)
                a = a + filled(matrix[j, k]) * row
                b = b + filled(matrix[j + 1, k]) * row
                c = c + filled(matrix[j + 2, k]) * row
                d = d + filled(matrix[j + 3, k]) * row
            store(target, j, p, a)
            store(target, j + 1, p, b)
            store(target, j + 2, p, c)
            store(target, j + 3, p, d)
