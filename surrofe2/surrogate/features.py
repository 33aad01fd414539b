"""Which products of inputs a network reads and what it multiplies, so that symmetry is exact.

A network gives factors from invariants; a term is factor × product of inputs and belongs to one
component. Under D4 an invariant has no sign and a term has the sign of its component, see
`square_symmetry`, so whatever the weights, the symmetry holds. Without symmetry every input is an
invariant and every component has every term.

Besides, a network reads u = x^p/√(δ² + x²) of the scaled sum, difference and shear x of U − I, with
δ = `BEND` and p such that u has no sign. Near rest u changes ten times as fast as x. Squares, which
D4 asks for, hardly tell small states apart, and a plant cell's stress bends within half a per cent
of strain, where pairs of particles come to act.

With D4, P̂(I, 0) = 0 by what is subtracted from the factors, see `network`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, half_widths
from surrofe2.base.square_symmetry import DIFFERENCE, SHEAR, SPIN, SUM, parity
from surrofe2.base.tensors import INPUTS

SYMMETRIES = ("D4", "none")

Product = tuple[int, ...]
STRETCH = 3  # the first inputs are those of U − I
BEND = 0.1
"""Of the half width of a range: size of U − I up to which states near rest are told apart best."""
_COMPONENTS = (SUM, DIFFERENCE, SHEAR, SPIN)

# input numbers: sum s, difference d, shear g of U − I; sum S, difference D, shear G, spin W of A
_s, _d, _g, _S, _D, _G, _W = range(INPUTS)
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


@dataclass(frozen=True, slots=True)
class Features:
    """What a network of one symmetry is made of.

    Attributes:
        invariants: products of inputs that the network reads.
        terms: product and component of what each of its outputs multiplies; those with an empty
            product are factor − factor at rest.
        powers: of s, d, g in the numerators of what tells states near rest apart.
        monomials: of the baseline, each with its component.
    """

    invariants: tuple[Product, ...]
    terms: tuple[tuple[Product, int], ...]
    powers: tuple[int, ...]
    monomials: tuple[tuple[Product, int], ...]

    @property
    def read(self) -> int:
        """How many numbers the network reads."""
        return len(self.invariants) + len(self.powers)


def input_scale(range: SamplingRange) -> NDArray[np.float64]:
    """(7,) what the inputs of a network are divided by; a bound of 0 gives ½."""
    return 0.5 * half_widths(range)


def monomials(degree: int) -> tuple[Product, ...]:
    """All products of 1 to `degree` inputs, as sorted input numbers, by rising degree."""
    return tuple(
        product
        for factors in range(1, degree + 1)
        for product in combinations_with_replacement(range(INPUTS), factors)
    )


def make_features(symmetry: str, degree: int) -> Features:
    """The features of a symmetry, with a baseline of that degree."""
    if symmetry not in SYMMETRIES:
        raise InputError(f"symmetry: {symmetry!r}; it must be one of {', '.join(SYMMETRIES)}")
    kept = monomials(degree)
    if symmetry == "D4":
        return Features(
            invariants=INVARIANTS,
            terms=tuple((product, parity(product)) for product in COVARIANTS),
            powers=(1, 2, 2),
            monomials=tuple((product, parity(product)) for product in kept),
        )
    return Features(
        invariants=tuple((k,) for k in range(INPUTS)),
        terms=tuple(((), component) for component in _COMPONENTS),
        powers=(1, 1, 1),
        monomials=tuple((product, k) for product in kept for k in _COMPONENTS),
    )


def differentiated(product: Product) -> list[tuple[int, float, Product]]:
    """(input, number, product left) of each derivative of a product that is not 0."""
    return [
        (k, float(product.count(k)), product[: product.index(k)] + product[product.index(k) + 1 :])
        for k in sorted(set(product))
    ]
