"""The products that a network reads and multiplies, and its weights.

A network gives factors from invariants; a term is factor × product of inputs and belongs to one
component. Under D4 an invariant has no sign and a term has the sign of its component, see
`square_symmetry`, so the symmetry holds whatever the weights. Without symmetry every input is an
invariant and every component has every term.

Inputs are the seven, 1, and of the first three x, those of U − I, u = x/√(δ² + x²) with δ = `BEND`.
Near rest u changes ten times as fast as x: a plant cell's stress bends within half a per cent of
strain, where pairs of particles come to act. Under D4 a network reads the product u x where the
sign of u alone would change.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.sampling import SamplingRange, half_widths
from surrofe2.base.square_symmetry import parity
from surrofe2.base.tensors import INPUTS, check_arrays
from surrofe2.surrogate.products import ONE, STRETCH, Product, monomials

SYMMETRIES = ("D4", "none")
HIGHEST_DEGREE = 5
BEND = 0.1
"""Size of U − I, as a fraction of the half width of a range, up to which states differ most."""
BENT = ONE + 1
"""The first of the inputs u, which are the last."""
NETWORK_INPUTS = BENT + STRETCH
COMPONENTS = 4
"""The number of components of P̂: sum, difference, shear and spin."""

# input numbers: sum s, difference d, shear g of U − I; sum S, difference D, shear G, spin W of A
_s, _d, _g, _S, _D, _G, _W = range(INPUTS)
_us, _ud, _ug = range(BENT, NETWORK_INPUTS)
INVARIANTS: tuple[Product, ...] = (
    (_s,), (_S,),
    (_d, _d), (_d, _D), (_D, _D), (_g, _g), (_g, _G), (_G, _G), (_W, _W),
    (_d, _g, _W), (_d, _G, _W), (_g, _D, _W), (_D, _G, _W),
)  # fmt: skip
COVARIANTS: tuple[Product, ...] = (
    (),
    (_d,), (_D,), (_g, _W), (_G, _W),
    (_g,), (_G,), (_d, _W), (_D, _W),
    (_W,), (_d, _g), (_d, _G), (_g, _D), (_D, _G),
)  # fmt: skip


class Features(NamedTuple):
    """The products of inputs that make a network of one symmetry.

    Attributes:
        invariants: products of inputs that the network reads.
        terms: (product, component) that each output of the network multiplies and adds to. A term
            with an empty product is factor − factor at rest, so that it vanishes at rest.
        monomials: (product, component) of the baseline.
    """

    invariants: tuple[Product, ...]
    terms: tuple[tuple[Product, int], ...]
    monomials: tuple[tuple[Product, int], ...]


def input_scale(range: SamplingRange) -> Array:
    """Return what the inputs of a network are divided by, (7,); ½ where the range has no width."""
    return 0.5 * half_widths(range)


def make_features(symmetry: str, degree: int) -> Features:
    """Make the features of a symmetry, with a baseline of a degree.

    Raises:
        InputError: an unknown symmetry.
    """
    if symmetry not in SYMMETRIES:
        raise InputError(f"symmetry: {symmetry!r}; it must be one of {', '.join(SYMMETRIES)}")
    products = monomials(degree)
    if symmetry == "D4":
        # the sign of a product under the symmetry says to which component it may belong
        return Features(
            invariants=(*INVARIANTS, (_us,), (_ud, _d), (_ug, _g)),
            terms=tuple((product, parity(product)) for product in COVARIANTS),
            monomials=tuple((product, parity(product)) for product in products),
        )
    return Features(
        invariants=tuple((k,) for k in (*range(INPUTS), _us, _ud, _ug)),
        terms=tuple(((), k) for k in range(COMPONENTS)),
        monomials=tuple((product, k) for product in products for k in range(COMPONENTS)),
    )


@dataclass(frozen=True, eq=False, slots=True)
class NetworkParameters:
    """All that a trained network is, as arrays; see `network` for the formula.

    Attributes:
        symmetry: symmetry of the plant cell, one of `SYMMETRIES`.
        degree: degree of the baseline.
        tensors: `input_scale` (7,), which the inputs are divided by; `output_scale` (4,) of the
            terms, µN/µm; `coefficients` (m,) of the baseline's monomials; `factors.0.weight`,
            `factors.0.bias`, … of the layers that give the factors of the terms.
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
        shapes: dict[str, tuple[int, ...]] = {
            "input_scale": (INPUTS,),
            "output_scale": (COMPONENTS,),
            "coefficients": (len(features.monomials),),
        }
        layers = sum(name.startswith("factors.") for name in self.tensors) // 2
        if not layers:
            raise InputError("network.factors: 0 layers; there must be at least one")
        inputs_of_layer = len(features.invariants)
        for k in np.arange(layers).tolist():
            is_last = k == layers - 1
            if is_last:
                units = len(features.terms)
            else:  # the size of a hidden layer is free; its bias states it
                units = len(self.tensors.get(f"factors.{k}.bias", np.empty(0)))
            shapes[f"factors.{k}.weight"] = (units, inputs_of_layer)
            shapes[f"factors.{k}.bias"] = (units,)
            inputs_of_layer = units
        check_arrays("network", self.tensors, shapes)

    @property
    def features(self) -> Features:
        """The products of this symmetry and degree."""
        return make_features(self.symmetry, self.degree)

    @property
    def layers(self) -> tuple[tuple[Array, Array], ...]:
        """Matrix (outputs, inputs) and bias (outputs,) of each layer that gives the factors."""
        count = sum(name.endswith(".weight") for name in self.tensors)
        return tuple(
            (self.tensors[f"factors.{k}.weight"], self.tensors[f"factors.{k}.bias"])
            for k in np.arange(count)
        )

    @property
    def baseline(self) -> list[list[tuple[Product, float]]]:
        """The monomials of each component of P̂, each as (product, coefficient in µN/µm)."""
        terms: list[list[tuple[Product, float]]] = [[] for _ in range(COMPONENTS)]
        values = self.tensors["coefficients"].tolist()
        for (product, component), value in zip(self.features.monomials, values, strict=True):
            terms[component].append((product, value))
        return terms

    def sizes_at_rest(self) -> Array:
        """Return the size of the linear stress at rest by a unit of each input, (7,), µN/µm.

        The size is the Frobenius norm. The slopes are those of the baseline, which has all slopes
        at rest where the training knew them.
        """
        slopes = np.zeros((COMPONENTS, INPUTS))
        coefficients = self.tensors["coefficients"].tolist()
        for (product, component), value in zip(self.features.monomials, coefficients, strict=True):
            is_linear = len(product) == 1
            if is_linear:
                slopes[component, product[0]] = value
        # ½: a component of 1 stands for two entries of the tensor of ½ each
        sizes: Array = np.sqrt(0.5 * (slopes**2).sum(axis=0)) / self.tensors["input_scale"]
        return sizes

    def fingerprint(self, range: SamplingRange) -> str:
        """Return 16 hexadecimal digits of all weights and the range in which they are used."""
        digest = hashlib.sha256(repr((range, self.symmetry, self.degree)).encode())
        for name, values in sorted(self.tensors.items()):
            digest.update(f"{name} {values.shape}".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:16]
