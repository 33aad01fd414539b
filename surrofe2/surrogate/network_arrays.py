"""A trained network as plain arrays: what is stored, and what its compiled pass reads."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, quoted
from surrofe2.sampling import SLACK, SamplingRange
from surrofe2.surrogate.compiled_frame import ONE
from surrofe2.surrogate.compiled_network import (
    BIOT,
    COMPONENTS,
    evaluate_energy_slope,
    evaluate_factors,
    make_room,
)
from surrofe2.surrogate.features import STRETCH, Features, Product, differentiated, make_features
from surrofe2.surrogate.polynomial import Polynomial, make_polynomial
from surrofe2.tensors import INPUTS, check_arrays

Array = NDArray[np.float64]
HIGHEST_DEGREE = 5
Layers = tuple[tuple[Array, Array], ...]
"""Matrix (outputs, inputs) and bias (outputs,) of each layer of a tanh network."""


@dataclass(frozen=True, eq=False, slots=True)
class NetworkParameters:
    """All that a network is, see `network`.

    Attributes:
        form, symmetry, degree: of the stress, of the plant cell and of the baseline.
        tensors: by name: `input_scale` (7,), which the inputs are divided by; `output_scale` (4,)
            of the terms, µN/µm; `energy_scale` (1,) of the energy network; `coefficients` (m,) of
            the baseline's monomials, `energy_coefficients` of its energy's; `factors.0.weight`,
            `factors.0.bias`, … of the layers that give the factors of the terms, and `energy.…`
            of those that give an energy, where there is one.
    """

    form: str
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
            "energy_scale": (1,),
            "coefficients": (len(features.monomials),),
            "energy_coefficients": (len(features.energy_monomials),),
        }
        for part, size, outputs in (
            ("factors", features.read, len(features.terms)),
            ("energy", STRETCH, 1),
        ):
            count = sum(name.startswith(f"{part}.") for name in self.tensors) // 2
            for k in np.arange(count).tolist():
                given = self.tensors.get(f"{part}.{k}.bias", np.empty(0))
                rows = outputs if k == count - 1 else len(given)
                wanted |= {f"{part}.{k}.weight": (rows, size), f"{part}.{k}.bias": (rows,)}
                size = rows
            if bool(count) != (part == "factors" or features.elastic):
                raise InputError(f"network.{part}: {count} layers; those of another form")
        check_arrays("network", self.tensors, wanted)

    @property
    def features(self) -> Features:
        """The products that the network is made of."""
        return make_features(self.form, self.symmetry, self.degree)

    def layers(self, part: str) -> Layers:
        """Those of "factors" or "energy"; empty where the network has none."""
        names = [name for name in self.tensors if name.startswith(f"{part}.")]
        count = sum(name.endswith(".weight") for name in names)
        return tuple(
            (self.tensors[f"{part}.{k}.weight"], self.tensors[f"{part}.{k}.bias"])
            for k in np.arange(count)
        )

    def fingerprint(self, range: SamplingRange) -> str:
        """16 hexadecimal digits of all weights and the range in which they are used."""
        digest = hashlib.sha256(repr((range, self.form, self.symmetry, self.degree)).encode())
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
        energy_factor: (3,) from slopes of the energy network to components of P̂.
        at_rest: (terms,) what the factors are at rest, 0 unless they are subtracted;
            energy_at_rest: (3,) likewise of the energy network's slope.
        made, heads, begins, tails, tail_coefficients: `polynomial.Polynomial` of the baseline; the
            components of P̂, and from `BIOT` on those that come from its energy.
        invariants: (i, 3) int64 factors; terms: (t, 4) int64 factors and component.
        powers: (3,) int64 of s, d, g in the invariants of U alone, see `features`.
        sizes: (layers + 1,) int64 inputs, and outputs of each layer of the network of factors,
            padded to multiples of four; weights, biases: its layers, flat, one after the other.
        energy_sizes, energy_weights, energy_biases: likewise of the energy network, (1,) 0 and
            empty where there is none; energy_turned: its transposed matrices.
    """

    bounds: Array
    input_factor: Array
    output_factor: Array
    energy_factor: Array
    at_rest: Array
    energy_at_rest: Array
    made: NDArray[np.int64]
    heads: NDArray[np.int64]
    begins: NDArray[np.int64]
    tails: NDArray[np.int64]
    tail_coefficients: Array
    invariants: NDArray[np.int64]
    terms: NDArray[np.int64]
    powers: NDArray[np.int64]
    sizes: NDArray[np.int64]
    weights: Array
    biases: Array
    energy_sizes: NDArray[np.int64]
    energy_weights: Array
    energy_biases: Array
    energy_turned: Array

    @classmethod
    def of(cls, network: NetworkParameters, range: SamplingRange) -> NetworkArrays:
        """The arrays of a network that is asked within a range."""
        features, given = network.features, network.tensors
        low, high = range.stretch
        above = np.array([high + SLACK, range.shear + SLACK, range.rate + SLACK * range.rate])
        sizes, weights, biases, _ = _pack_layers(network.layers("factors"))
        energy_sizes, energy_weights, energy_biases, energy_turned = _pack_layers(
            network.layers("energy")
        )
        arrays = cls(
            bounds=np.array([np.nextafter(low - SLACK, -np.inf), *np.nextafter(above, np.inf)]),
            input_factor=1.0 / given["input_scale"],
            output_factor=given["output_scale"],
            energy_factor=given["energy_scale"] * _to_biot(network),
            at_rest=np.zeros(len(features.terms)),
            energy_at_rest=np.zeros(STRETCH),
            **_polynomial(_monomials(network))._asdict(),
            invariants=np.array([_three(product) for product in features.invariants]),
            terms=np.array([(*_three(product), k) for product, k in features.terms]),
            powers=np.array(features.powers),
            sizes=sizes,
            weights=weights,
            biases=biases,
            energy_sizes=energy_sizes,
            energy_weights=energy_weights,
            energy_biases=energy_biases,
            energy_turned=energy_turned,
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
        slope = np.zeros(STRETCH)
        if features.elastic:
            last = evaluate_energy_slope(self, room)
            linear = np.array(features.powers) == 1
            slope = np.where(linear, room.back[last, :STRETCH, 0, 0], 0.0)
        return self._replace(at_rest=at_rest, energy_at_rest=slope)


def slope_polynomial(network: NetworkParameters) -> Polynomial:
    """The slopes of a network's baseline, component `COMPONENTS` × input + component."""
    return _polynomial(
        ((left, COMPONENTS * variable + component), value * number)
        for (product, component), value in _monomials(network)
        for variable, number, left in differentiated(product)
    )


def sizes_at_rest(network: NetworkParameters) -> Array:
    """(7,) Frobenius norm of what each input adds to the linear stress, by a unit of it, µN/µm.

    That of the baseline, which has all slopes at rest where they were known to the training.
    """
    slopes = np.zeros((BIOT, INPUTS))
    for (product, component), value in _monomials(network):
        if len(product) == 1:
            slopes[component % BIOT, product[0]] += value
    sizes: Array = np.sqrt(0.5 * (slopes**2).sum(axis=0)) / network.tensors["input_scale"]
    return sizes


def _monomials(network: NetworkParameters) -> list[tuple[tuple[Product, int], float]]:
    """Product, component and coefficient of the baseline and, from `BIOT` on, of its energy."""
    features, given, to_biot = network.features, network.tensors, _to_biot(network).tolist()
    found = list(zip(features.monomials, given["coefficients"].tolist(), strict=True))
    energy = zip(features.energy_monomials, given["energy_coefficients"].tolist(), strict=True)
    return found + [
        ((left, BIOT + variable), value * number * to_biot[variable])
        for product, value in energy
        for variable, number, left in differentiated(product)
    ]


def _polynomial(monomials: Iterable[tuple[tuple[Product, int], float]]) -> Polynomial:
    listed = list(monomials)
    return make_polynomial([key for key, _ in listed], np.array([value for _, value in listed]))


def _to_biot(network: NetworkParameters) -> Array:
    """(3,) from slopes of an energy by scaled inputs to components of P̂."""
    factor: Array = 2.0 / network.tensors["input_scale"][:STRETCH]
    return factor


def _pack_layers(layers: Layers) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """(sizes, matrices, biases, transposed matrices), flat and padded; see `NetworkArrays`."""
    if not layers:
        return np.zeros(1, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0)
    matrices = [_padded(matrix) for matrix, _ in layers]
    return (
        np.array([matrices[0].shape[1], *(len(matrix) for matrix in matrices)]),
        np.concatenate([matrix.ravel() for matrix in matrices]),
        np.concatenate([_padded(bias[:, None])[:, 0] for _, bias in layers]),
        np.concatenate([matrix.T.ravel() for matrix in matrices]),
    )


def _padded(matrix: Array) -> Array:
    rows, columns = (4 * -(-size // 4) for size in matrix.shape)
    result = np.zeros((rows, columns))
    result[: matrix.shape[0], : matrix.shape[1]] = matrix
    return result


def _three(product: Product) -> Product:
    return product + (ONE,) * (3 - len(product))
