"""Which products of inputs a network reads and what it multiplies, so that symmetry is exact.

A network gives factors from invariants; a term is factor × product of inputs and belongs to one
component. Under D4 an invariant has no sign and a term has the sign of its component, see
`square_symmetry`, so whatever the weights, the symmetry holds. Without symmetry every input is an
invariant and every component has every term.

Besides, a network reads u = x^p/√(δ² + x²) of the scaled sum, difference and shear x of U − I, with
δ = `BEND` and p such that u has no sign. Near rest u changes ten times as fast as x. Squares, which
D4 asks for, hardly tell small states apart, and a plant cell's stress bends within half a per cent
of strain, where pairs of particles come to act.

Forms of the stress, P̂ = RᵀP (see `network`):

    stress      all of P̂ from terms; with D4, P̂(I, 0) = 0 by what is subtracted
    energy      ∂W/∂U from an energy of U, and terms each of which has a factor of A
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.sampling import SamplingRange, half_widths
from surrofe2.square_symmetry import DIFFERENCE, SHEAR, SPIN, SUM, parity
from surrofe2.tensors import INPUTS

FORMS = ("energy", "stress")
SYMMETRIES = ("D4", "none")

Product = tuple[int, ...]
STRETCH = 3  # the first inputs are those of U − I
BEND = 0.1
"""Of the half width of a range: size of U − I up to which states near rest are told apart best."""
_COMPONENTS = (SUM, DIFFERENCE, SHEAR, SPIN)

# input numbers: sum s, difference d, shear g of U − I; sum S, difference D, shear G, spin W of A
_s, _d, _g, _S, _D, _G, _W = range(INPUTS)
_RATES = (_S, _D, _G, _W)
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
# those with a factor of A, of which every product with a factor of A is an invariant multiple
VISCOUS_COVARIANTS: tuple[Product, ...] = (
    (_S,), (_d, _D), (_g, _G), (_D, _D), (_G, _G), (_W, _W),
    (_d, _g, _W), (_d, _G, _W), (_g, _D, _W), (_D, _G, _W),
    (_D,), (_g, _W), (_G, _W), (_d, _S), (_d, _g, _G), (_d, _G, _G), (_d, _W, _W),
    (_G,), (_d, _W), (_D, _W), (_g, _S), (_d, _g, _D), (_g, _D, _D), (_g, _W, _W),
    (_W,), (_d, _G), (_g, _D), (_D, _G), (_d, _g, _S),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Features:
    """What a network of one form and symmetry is made of.

    Attributes:
        invariants: products of inputs that the network reads.
        terms: product and component of what each of its outputs multiplies; those with an empty
            product are factor − factor at rest.
        powers: of s, d, g in the least invariants of U alone: those that an energy reads, and the
            numerators of those that tell states near rest apart.
        elastic: whether there is an energy.
        monomials: of the baseline in P̂, each with its component.
        energy_monomials: of the baseline's energy.
    """

    invariants: tuple[Product, ...]
    terms: tuple[tuple[Product, int], ...]
    powers: tuple[int, ...]
    elastic: bool
    monomials: tuple[tuple[Product, int], ...]
    energy_monomials: tuple[Product, ...]

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


def make_features(form: str, symmetry: str, degree: int) -> Features:
    """The features of a form and symmetry, with a baseline of that degree in P̂."""
    if form not in FORMS:
        raise InputError(f"training.form: {form!r}; it must be one of {', '.join(FORMS)}")
    if symmetry not in SYMMETRIES:
        raise InputError(f"symmetry: {symmetry!r}; it must be one of {', '.join(SYMMETRIES)}")
    square, elastic = symmetry == "D4", form == "energy"
    if square:
        products = VISCOUS_COVARIANTS if elastic else COVARIANTS
        terms = tuple((product, parity(product)) for product in products)
    else:
        factors: tuple[Product, ...] = tuple((rate,) for rate in _RATES) if elastic else ((),)
        terms = tuple((product, component) for component in _COMPONENTS for product in factors)
    return Features(
        invariants=INVARIANTS if square else tuple((k,) for k in range(INPUTS)),
        terms=terms,
        powers=(1, 2, 2) if square else (1, 1, 1),
        elastic=elastic,
        monomials=_monomials(elastic, square, degree),
        energy_monomials=_energy_monomials(square, degree + 1) if elastic and degree else (),
    )


def _monomials(elastic: bool, square: bool, degree: int) -> tuple[tuple[Product, int], ...]:
    kept = monomials(degree)
    if elastic:
        kept = tuple(product for product in kept if product[-1] >= STRETCH)
    if square:
        return tuple((product, parity(product)) for product in kept)
    return tuple((product, k) for product in kept for k in _COMPONENTS)


def _energy_monomials(square: bool, degree: int) -> tuple[Product, ...]:
    """Of degree 2 and more: there is no stress at rest."""
    products = [p for p in monomials(degree) if max(p) < STRETCH and len(p) > 1]
    if not square:
        return tuple(products)
    return tuple(p for p in products if p.count(_d) % 2 == p.count(_g) % 2 == 0)


def differentiated(product: Product) -> list[tuple[int, float, Product]]:
    """(input, number, product left) of each derivative of a product that is not 0."""
    return [
        (k, float(product.count(k)), product[: product.index(k)] + product[product.index(k) + 1 :])
        for k in sorted(set(product))
    ]
