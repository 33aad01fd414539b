"""A network as the plain arrays that its compiled pass reads."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.sampling import SLACK, SamplingRange
from surrofe2.surrogate.components import INPUTS, parity
from surrofe2.surrogate.network import COVARIANTS, INVARIANTS, StressNetwork

_ONE = INPUTS  # behind the inputs stands a row of ones, so that every product has three factors


class Weights(NamedTuple):
    """A network as the arrays its kernel reads; p: its precision.

    Attributes:
        bounds: (4,) low, high, shear, rate, widened by the rounding of the range test.
        input_factor: (7,) p; 1/input scale.
        output_factor: (4,) p.
        at_rest: (1,) p; g₀(0).
        monomials: (m, 4) int64; row of the product of all factors but the last, last factor,
            component, row to keep the product in or −1.
        coefficients: (m,) p.
        invariants, covariants: (13, 3) int64 factors; covariants have their component behind.
        sizes: (layers + 1,) int64, padded.
        weights, biases: p; all layers one after the other, padded.
    """

    bounds: NDArray[np.float64]
    input_factor: NDArray[Any]
    output_factor: NDArray[Any]
    at_rest: NDArray[Any]
    monomials: NDArray[np.int64]
    coefficients: NDArray[Any]
    invariants: NDArray[np.int64]
    covariants: NDArray[np.int64]
    sizes: NDArray[np.int64]
    weights: NDArray[Any]
    biases: NDArray[Any]


def pack(network: StressNetwork, range: SamplingRange) -> Weights:
    """The arrays of a network for `evaluate`."""
    parameters = [values.detach().numpy() for values in network.layers.parameters()]
    precision = parameters[0].dtype
    matrices = [_padded(values) for values in parameters[::2]]
    biases = [_padded(values[:, None])[:, 0] for values in parameters[1::2]]
    low, high = range.stretch
    return Weights(
        bounds=np.array(
            [low - SLACK, high + SLACK, range.shear + SLACK, range.rate + SLACK * range.rate]
        ),
        input_factor=1.0 / network.input_scale.numpy(),
        output_factor=network.output_scale.numpy().copy(),
        at_rest=np.zeros(1, dtype=precision),
        monomials=_chain(network.monomials),
        coefficients=network.coefficients.numpy().copy(),
        invariants=np.array([_three(product) for product in INVARIANTS]),
        covariants=np.array([(*_three(product), parity(product)) for product in COVARIANTS]),
        sizes=np.array([matrices[0].shape[1], *(len(matrix) for matrix in matrices)]),
        weights=np.concatenate([matrix.ravel() for matrix in matrices]),
        biases=np.concatenate(biases),
    )


def _padded(matrix: NDArray[Any]) -> NDArray[Any]:
    rows, columns = (4 * -(-size // 4) for size in matrix.shape)
    result = np.zeros((rows, columns), dtype=matrix.dtype)
    result[: matrix.shape[0], : matrix.shape[1]] = matrix
    return result


def _three(product: tuple[int, ...]) -> tuple[int, ...]:
    return product + (_ONE,) * (3 - len(product))


def _chain(products: tuple[tuple[int, ...], ...]) -> NDArray[np.int64]:
    row: dict[tuple[int, ...], int] = {(): 0}
    degree = max((len(product) for product in products), default=0)
    table = []
    for product in products:
        keep = -1
        if len(product) < degree:
            keep = row[product] = len(row)
        table.append((row[product[:-1]], product[-1], parity(product), keep))
    return np.array(table, dtype=np.int64).reshape(-1, 4)
