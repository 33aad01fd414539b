"""A network as the plain arrays that its compiled pass reads."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.sampling import SLACK, SamplingRange
from surrofe2.surrogate.features import STRETCH, Product
from surrofe2.surrogate.network import StressNetwork, TanhNetwork, slope_table
from surrofe2.surrogate.polynomials import make_polynomials
from surrofe2.tensors import INPUTS

BIOT = 4
"""Components of P̂; behind them stand the symmetric ones of its elastic part."""
_ONE = INPUTS  # behind the inputs stands a row of ones, so that every product has three factors


class Weights(NamedTuple):
    """A network as the arrays its kernel reads; p: its precision.

    Attributes:
        bounds: (4,) low, high, shear, rate, widened by the rounding of the range test.
        input_factor: (7,) p; 1/input scale.
        output_factor: (4,) p; over the number of members.
        energy_factor: (3,) p; from slopes of the energy networks to components of P̂.
        at_rest: (factors,) p; what the factors are at rest, 0 unless they are subtracted.
        energy_at_rest: (3,) p; likewise of the energy networks' slope.
        made, heads, begins, tails, tail_coefficients: `polynomials.Polynomials` of the baseline;
            the components of P̂, and from `BIOT` on those that come from its energy.
        monomials: (m, 4) int64, the same of P̂ for its slopes by the inputs; row of the product of
            all factors but the first, that factor or the row of ones, component, row to keep the
            product in or −1.
        coefficients: (m,) p.
        energy_monomials, energy_coefficients: of the slopes of the baseline's energy, likewise.
        invariants: (i, 3) int64 factors.
        terms: (t, 5) int64 factors, component, number of the network's factor.
        powers: (3,) int64 of s, d, g in the invariants of the energy; 0: no energy.
        sizes: (layers + 1,) int64, padded, of the networks of factors.
        weights, biases: (members, …) p; all layers one after the other, padded.
        energy_sizes, energy_weights, energy_biases: of the energy networks; empty: no energy.
        energy_turned: (members, …) p; the transposed matrices of all layers, likewise.
    """

    bounds: NDArray[np.float64]
    input_factor: NDArray[Any]
    output_factor: NDArray[Any]
    energy_factor: NDArray[Any]
    at_rest: NDArray[Any]
    energy_at_rest: NDArray[Any]
    made: NDArray[np.int64]
    heads: NDArray[np.int64]
    begins: NDArray[np.int64]
    tails: NDArray[np.int64]
    tail_coefficients: NDArray[Any]
    monomials: NDArray[np.int64]
    coefficients: NDArray[Any]
    energy_monomials: NDArray[np.int64]
    energy_coefficients: NDArray[Any]
    invariants: NDArray[np.int64]
    terms: NDArray[np.int64]
    powers: NDArray[np.int64]
    sizes: NDArray[np.int64]
    weights: NDArray[Any]
    biases: NDArray[Any]
    energy_sizes: NDArray[np.int64]
    energy_weights: NDArray[Any]
    energy_biases: NDArray[Any]
    energy_turned: NDArray[Any]


def pack(network: StressNetwork, range: SamplingRange) -> Weights:
    """The arrays of a network for `evaluate`, with nothing subtracted at rest."""
    features = network.features
    scale = network.input_scale.numpy()
    precision = scale.dtype
    low, high = range.stretch
    members = network.ensemble
    owner, numbers, shapes = slope_table(features.energy_monomials)
    to_biot = (2.0 / scale[:STRETCH]).astype(precision)
    monomials, coefficients = _chain(features.monomials, network.coefficients.numpy())
    energy = network.energy_coefficients.numpy()
    biot_coefficients = [
        energy[k] * number * to_biot[variable]
        for (k, number), variable in zip(numbers, owner, strict=True)
    ]
    slopes = list(zip(shapes, owner, strict=True))
    slope_coefficients = np.array(biot_coefficients, dtype=precision)
    energy_monomials, energy_coefficients = _chain(slopes, slope_coefficients)
    polynomials = make_polynomials(
        [*features.monomials, *((shape, BIOT + variable) for shape, variable in slopes)],
        np.concatenate([network.coefficients.numpy(), slope_coefficients]),
    )
    factors = _layers([member.factors for member in members], precision)
    own_energies = [member.energy for member in members if member.energy is not None]
    energies = _layers(own_energies, precision)
    return Weights(
        bounds=np.array(
            [low - SLACK, high + SLACK, range.shear + SLACK, range.rate + SLACK * range.rate]
        ),
        input_factor=(1.0 / scale).astype(precision),
        output_factor=(network.output_scale.numpy() / len(members)).astype(precision),
        energy_factor=(network.energy_scale.numpy() * to_biot / len(members)).astype(precision),
        at_rest=np.zeros(features.factors, dtype=precision),
        energy_at_rest=np.zeros(STRETCH, dtype=precision),
        **polynomials._asdict(),
        monomials=monomials,
        coefficients=coefficients,
        energy_monomials=energy_monomials,
        energy_coefficients=energy_coefficients,
        invariants=np.array([_three(product) for product in features.invariants]),
        terms=np.array([(*_three(t.product), t.component, t.factor) for t in features.terms]),
        powers=np.array(features.powers or (0,) * STRETCH),
        sizes=factors.sizes,
        weights=factors.weights,
        biases=factors.biases,
        energy_sizes=energies.sizes,
        energy_weights=energies.weights,
        energy_biases=energies.biases,
        energy_turned=energies.turned,
    )


class _Layers(NamedTuple):
    sizes: NDArray[np.int64]
    weights: NDArray[Any]
    biases: NDArray[Any]
    turned: NDArray[Any]


def _layers(networks: list[TanhNetwork], precision: np.dtype[Any]) -> _Layers:
    if not networks:
        none = np.empty((0, 0), dtype=precision)
        return _Layers(np.empty(0, dtype=np.int64), none, none, none)
    weights, biases, turned = [], [], []
    for network in networks:
        values = [parameter.detach().numpy() for parameter in network.layers.parameters()]
        matrices = [_padded(matrix) for matrix in values[::2]]
        weights.append(np.concatenate([matrix.ravel() for matrix in matrices]))
        turned.append(np.concatenate([matrix.T.ravel() for matrix in matrices]))
        biases.append(np.concatenate([_padded(bias[:, None])[:, 0] for bias in values[1::2]]))
    sizes = np.array([matrices[0].shape[1], *(len(matrix) for matrix in matrices)])
    return _Layers(sizes, np.stack(weights), np.stack(biases), np.stack(turned))


def _padded(matrix: NDArray[Any]) -> NDArray[Any]:
    rows, columns = (4 * -(-size // 4) for size in matrix.shape)
    result = np.zeros((rows, columns), dtype=matrix.dtype)
    result[: matrix.shape[0], : matrix.shape[1]] = matrix
    return result


def _three(product: Product) -> Product:
    return product + (_ONE,) * (3 - len(product))


def _chain(
    products: Iterable[tuple[Product, int]], coefficients: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Each product as a shorter one times its first factor; row 0 of the kept ones is 1.

    Shorter ones that are not among the products come in with coefficient 0.
    """
    row: dict[Product, int] = {(): 0}
    table: list[tuple[int, int, int, int]] = []
    values: list[Any] = []

    def add(product: Product, component: int, value: Any, keep: bool) -> None:
        shorter = product[1:]
        if shorter not in row:
            add(shorter, component, 0.0, True)
        place = row.setdefault(product, len(row)) if keep and product not in row else -1
        table.append((row[shorter], product[0] if product else _ONE, component, place))
        values.append(value)

    listed = list(products)
    needed = {product[1:] for product, _ in listed}
    for (product, component), value in zip(listed, coefficients, strict=True):
        add(product, component, value, product in needed)
    chained = np.array(table, dtype=np.int64).reshape(-1, 4)
    return chained, np.array(values, dtype=coefficients.dtype)
