"""A trained network as plain arrays: what is stored, and what its compiled pass reads."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.sampling import SLACK, SamplingRange
from surrofe2.base.tensors import INPUTS, check_arrays
from surrofe2.surrogate.compiled_frame import ONE
from surrofe2.surrogate.compiled_network import COMPONENTS, evaluate_factors, make_room
from surrofe2.surrogate.features import Features, Product, differentiated, make_features
from surrofe2.surrogate.polynomial import Polynomial, make_polynomial

Array = NDArray[np.float64]
HIGHEST_DEGREE = 5
Layers = tuple[tuple[Array, Array], ...]
"""Matrix (outputs, inputs) and bias (outputs,) of each layer of a tanh network."""


@dataclass(frozen=True, eq=False, slots=True)
class NetworkParameters:
    """All that a network is, see `network`.

    Attributes:
        symmetry, degree: of the plant cell and of the baseline.
        tensors: by name: `input_scale` (7,), which the inputs are divided by; `output_scale` (4,)
            of the terms, µN/µm; `coefficients` (m,) of the baseline's monomials;
            `factors.0.weight`, `factors.0.bias`, … of the layers that give the factors of the
            terms.
    """

    symmetry: str
    degree: int
    tensors: Mapping[str, Array]

    def __post_init__(self) -> None:
        if not (isinstance(self.degree, int) and 0 <= self.degree <= HIGHEST_DEGREE):
            raise InputError(
                f"network.degree: {quoted(self.degree)}; it must be from 0 to {HIGHEST_DEGREE}"
            )
        features = self.features
        wanted: dict[str, tuple[int, ...]] = {
            "input_scale": (INPUTS,),
            "output_scale": (4,),
            "coefficients": (len(features.monomials),),
        }
        count = sum(name.startswith("factors.") for name in self.tensors) // 2
        if not count:
            raise InputError("network.factors: 0 layers; there must be at least one")
        size = features.read
        for k in np.arange(count).tolist():
            bias = self.tensors.get(f"factors.{k}.bias", np.empty(0))
            rows = len(features.terms) if k == count - 1 else len(bias)
            wanted |= {f"factors.{k}.weight": (rows, size), f"factors.{k}.bias": (rows,)}
            size = rows
        check_arrays("network", self.tensors, wanted)

    @property
    def features(self) -> Features:
        """The products that the network is made of."""
        return make_features(self.symmetry, self.degree)

    @property
    def layers(self) -> Layers:
        """Those that give the factors."""
        count = sum(name.endswith(".weight") for name in self.tensors)
        return tuple(
            (self.tensors[f"factors.{k}.weight"], self.tensors[f"factors.{k}.bias"])
            for k in np.arange(count)
        )

    def fingerprint(self, range: SamplingRange) -> str:
        """16 hexadecimal digits of all weights and the range in which they are used."""
        digest = hashlib.sha256(repr((range, self.symmetry, self.degree)).encode())
        for name, values in sorted(self.tensors.items()):
            digest.update(f"{name} {values.shape}".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:16]


class NetworkArrays(NamedTuple):
    """A network as the arrays its kernels read.

    Attributes:
        bounds: (4,) below and above which U₁₁ and U₂₂, and above which |U₁₂| and |A| are out of
            range, by the rounding of the range test wider than the range.
        input_factor: (7,) 1/input scale; output_factor: (4,).
        at_rest: (terms,) what the factors are at rest, 0 unless they are subtracted.
        products, begins, heads, group_begins, tails, coefficients: `polynomial.Polynomial` of the
            baseline.
        invariants: (i, 3) int64 factors; terms: (t, 4) int64 factors and component.
        powers: (3,) int64 of s, d, g in the invariants of U alone, see `features`.
        sizes: (layers + 1,) int64 inputs, and outputs of each layer of the network of factors,
            padded to multiples of four; weights, biases: its layers, flat, one after the other.
    """

    bounds: Array
    input_factor: Array
    output_factor: Array
    at_rest: Array
    products: NDArray[np.int64]
    begins: NDArray[np.int64]
    heads: NDArray[np.int64]
    group_begins: NDArray[np.int64]
    tails: NDArray[np.int64]
    coefficients: Array
    invariants: NDArray[np.int64]
    terms: NDArray[np.int64]
    powers: NDArray[np.int64]
    sizes: NDArray[np.int64]
    weights: Array
    biases: Array

    @classmethod
    def of(cls, network: NetworkParameters, range: SamplingRange) -> NetworkArrays:
        """The arrays of a network that is asked within a range."""
        features, given = network.features, network.tensors
        low, high = range.stretch
        above = np.array([high + SLACK, range.shear + SLACK, range.rate + SLACK * range.rate])
        sizes, weights, biases = _pack_layers(network.layers)
        arrays = cls(
            bounds=np.array([np.nextafter(low - SLACK, -np.inf), *np.nextafter(above, np.inf)]),
            input_factor=1.0 / given["input_scale"],
            output_factor=given["output_scale"],
            at_rest=np.zeros(len(features.terms)),
            **make_polynomial(_monomials(network), COMPONENTS)._asdict(),
            invariants=np.array([_three(product) for product in features.invariants]),
            terms=np.array([(*_three(product), k) for product, k in features.terms]),
            powers=np.array(features.powers),
            sizes=sizes,
            weights=weights,
            biases=biases,
        )
        return arrays._less_rest(features)

    def _less_rest(self, features: Features) -> NetworkArrays:
        """Arrays that subtract what the network gives at rest, by the very same instructions."""
        room = make_room(self, self, 0)
        room.x[:] = 0.0
        room.x[ONE] = 1.0
        first = evaluate_factors(self, room)
        subtracted = np.array([not product for product, _ in features.terms])
        at_rest = np.where(subtracted, room.units[first : first + len(subtracted), 0, 0], 0.0)
        return self._replace(at_rest=at_rest)


def slope_polynomial(network: NetworkParameters) -> Polynomial:
    """The slopes of a network's baseline, component `COMPONENTS` × input + component."""
    slopes = (
        ((left, COMPONENTS * variable + component), value * number)
        for (product, component), value in _monomials(network)
        for variable, number, left in differentiated(product)
    )
    return make_polynomial(slopes, COMPONENTS * INPUTS)


def sizes_at_rest(network: NetworkParameters) -> Array:
    """(7,) Frobenius norm of what each input adds to the linear stress, by a unit of it, µN/µm.

    That of the baseline, which has all slopes at rest where they were known to the training.
    """
    slopes = np.zeros((COMPONENTS, INPUTS))
    for (product, component), value in _monomials(network):
        if len(product) == 1:
            slopes[component, product[0]] += value
    sizes: Array = np.sqrt(0.5 * (slopes**2).sum(axis=0)) / network.tensors["input_scale"]
    return sizes


def _monomials(network: NetworkParameters) -> list[tuple[tuple[Product, int], float]]:
    """Product, component and coefficient of the baseline."""
    coefficients = network.tensors["coefficients"].tolist()
    return list(zip(network.features.monomials, coefficients, strict=True))


def _pack_layers(layers: Layers) -> tuple[NDArray[np.int64], Array, Array]:
    """(sizes, matrices, biases), flat and padded; see `NetworkArrays`."""
    matrices = [_padded(matrix) for matrix, _ in layers]
    return (
        np.array([matrices[0].shape[1], *(len(matrix) for matrix in matrices)]),
        np.concatenate([matrix.ravel() for matrix in matrices]),
        np.concatenate([_padded(bias[:, None])[:, 0] for _, bias in layers]),
    )


def _padded(matrix: Array) -> Array:
    rows, columns = (4 * -(-size // 4) for size in matrix.shape)
    result = np.zeros((rows, columns))
    result[: matrix.shape[0], : matrix.shape[1]] = matrix
    return result


def _three(product: Product) -> Product:
    return product + (ONE,) * (3 - len(product))
