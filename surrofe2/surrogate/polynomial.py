"""Polynomials of the seven inputs: a sum over the last input of each monomial.

    y_c = Σ_heads x_head (Σ_tails coefficient · tail)

A monomial's head is the last of its inputs, its tail the product of the others, which is an earlier
tail times an input: so a tail costs one multiplication, and a monomial one with addition.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import load, spread, store
from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.compiled_frame import ONE, TILES
from surrofe2.surrogate.features import Product

Array = NDArray[np.float64]

ROWS = INPUTS + 1


class Polynomial(NamedTuple):
    """Polynomials of several components as the arrays their kernel reads.

    Rows are numbered: inputs, ones, and then the products.

    Attributes:
        products: (m, 2) int64 rows, whose product is the next row.
        begins: (components + 1,) int64 first group of each component.
        heads: (g,) int64 row of the head of each group.
        group_begins: (g + 1,) int64 first monomial of each group.
        tails: (t,) int64 row of the tail of each monomial; coefficients: (t,).
    """

    products: NDArray[np.int64]
    begins: NDArray[np.int64]
    heads: NDArray[np.int64]
    group_begins: NDArray[np.int64]
    tails: NDArray[np.int64]
    coefficients: Array


def make_polynomial(
    monomials: Iterable[tuple[tuple[Product, int], float]], components: int
) -> Polynomial:
    """Polynomials from ((sorted product, component), coefficient) of monomials, each there once."""
    rows: dict[Product, int] = {(k,): k for k in np.arange(INPUTS).tolist()}
    rows[()] = ONE
    products: list[tuple[int, int]] = []

    def row(product: Product) -> int:
        if product not in rows:
            pair = row(product[:-1]), product[-1]
            rows[product] = ROWS + len(products)
            products.append(pair)
        return rows[product]

    groups: list[dict[int, dict[int, float]]] = [{} for _ in np.arange(components)]
    for (product, component), value in monomials:
        group = groups[component].setdefault(product[-1] if product else ONE, {})
        group[row(product[:-1])] = value
    every = [(head, of[head]) for of in groups for head in sorted(of)]
    listed = [term for _, group in every for term in sorted(group.items())]
    return Polynomial(
        np.array(products, dtype=np.int64).reshape(-1, 2),
        np.cumsum([0, *(len(of) for of in groups)], dtype=np.int64),
        np.array([head for head, _ in every], dtype=np.int64),
        np.cumsum([0, *(len(group) for _, group in every)], dtype=np.int64),
        np.array([tail for tail, _ in listed], dtype=np.int64),
        np.array([value for _, value in listed], dtype=np.float64),
    )


@kernel
def set_polynomial(x, polynomial, rows, y):  # type: ignore[no-untyped-def]
    """Set the rows of y (components, TILES, TILE) at inputs x (8, TILES, TILE).

    The last row of x are ones. rows: (`ROWS` + m, 2, TILE) room for the products of two tiles.
    """
    products, begins, heads = polynomial.products, polynomial.begins, polynomial.heads
    group_begins, tails = polynomial.group_begins, polynomial.tails
    coefficients = polynomial.coefficients
    for t in range(0, TILES, 2):
        for k in range(ROWS):
            store(load(x, k, t), rows, k, 0)
            store(load(x, k, t + 1), rows, k, 1)
        for k in range(products.shape[0]):
            i, j = products[k, 0], products[k, 1]
            store(load(rows, i, 0) * load(rows, j, 0), rows, ROWS + k, 0)
            store(load(rows, i, 1) * load(rows, j, 1), rows, ROWS + k, 1)
        for component in range(begins.shape[0] - 1):
            one, two = spread(0.0), spread(0.0)
            for group in range(begins[component], begins[component + 1]):
                a, b = spread(0.0), spread(0.0)
                for k in range(group_begins[group], group_begins[group + 1]):
                    coefficient = spread(coefficients[k])
                    a += coefficient * load(rows, tails[k], 0)
                    b += coefficient * load(rows, tails[k], 1)
                one += a * load(rows, heads[group], 0)
                two += b * load(rows, heads[group], 1)
            store(one, y, component, t)
            store(two, y, component, t + 1)
