"""Polynomials of the seven inputs: all products of inputs, then a sum of them for each component.

Each product is an earlier one times an input, so it costs one multiplication. By symmetry most
products belong to one component, so the sums are over lists and not by a dense layer.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.simd import load, spread, store
from surrofe2.surrogate.compiled_frame import ONE, TILES
from surrofe2.surrogate.features import Product
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]

ROWS = INPUTS + 1


class Polynomial(NamedTuple):
    """Polynomials of several components as the arrays their kernel reads.

    Rows are numbered: inputs, ones, and then the products.

    Attributes:
        products: (m, 2) int64 rows, whose product is the next row.
        begins: (components + 1,) int64 where each component begins among the monomials.
        monomials: (t,) int64 row of each, padded to a multiple of four for each component.
        coefficients: (t,) of the monomials.
    """

    products: NDArray[np.int64]
    begins: NDArray[np.int64]
    monomials: NDArray[np.int64]
    coefficients: Array


def make_polynomial(
    monomials: Iterable[tuple[tuple[Product, int], float]], components: int
) -> Polynomial:
    """Polynomials from ((sorted product, component), coefficient) of each monomial."""
    rows: dict[Product, int] = {(k,): k for k in np.arange(INPUTS).tolist()}
    rows[()] = ONE
    products: list[tuple[int, int]] = []

    def row(product: Product) -> int:
        if product not in rows:
            pair = row(product[:-1]), product[-1]
            rows[product] = ROWS + len(products)
            products.append(pair)
        return rows[product]

    sums: list[dict[int, float]] = [{} for _ in np.arange(components)]
    for (product, component), value in monomials:
        of, k = sums[component], row(product)
        of[k] = of.get(k, 0.0) + value
    padded = [[*sorted(of.items()), *[(ONE, 0.0)] * (-len(of) % 4)] for of in sums]
    listed = np.array([each for of in padded for each in of]).reshape(-1, 2)
    return Polynomial(
        np.array(products, dtype=np.int64).reshape(-1, 2),
        np.cumsum([0, *(len(of) for of in padded)], dtype=np.int64),
        np.ascontiguousarray(listed[:, 0], dtype=np.int64),
        np.ascontiguousarray(listed[:, 1], dtype=np.float64),
    )


@kernel
def set_polynomial(x, polynomial, rows, y):  # type: ignore[no-untyped-def]
    """Set the rows of y (components, TILES, TILE) at inputs x (8, TILES, TILE).

    The last row of x are ones. rows: (`ROWS` + m, 2, TILE) room for the products of two tiles.
    """
    products, begins = polynomial.products, polynomial.begins
    numbers, coefficients = polynomial.monomials, polynomial.coefficients
    for t in range(0, TILES, 2):
        for k in range(ROWS):
            store(load(x, k, t), rows, k, 0)
            store(load(x, k, t + 1), rows, k, 1)
        for k in range(products.shape[0]):
            i, j = products[k, 0], products[k, 1]
            store(load(rows, i, 0) * load(rows, j, 0), rows, ROWS + k, 0)
            store(load(rows, i, 1) * load(rows, j, 1), rows, ROWS + k, 1)
        for component in range(begins.shape[0] - 1):
            # four sums of each tile, none of which waits for another
            a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            e, f, g, h = a, b, c, d
            for k in range(begins[component], begins[component + 1], 4):
                first, second = spread(coefficients[k]), spread(coefficients[k + 1])
                third, fourth = spread(coefficients[k + 2]), spread(coefficients[k + 3])
                a += first * load(rows, numbers[k], 0)
                b += second * load(rows, numbers[k + 1], 0)
                c += third * load(rows, numbers[k + 2], 0)
                d += fourth * load(rows, numbers[k + 3], 0)
                e += first * load(rows, numbers[k], 1)
                f += second * load(rows, numbers[k + 1], 1)
                g += third * load(rows, numbers[k + 2], 1)
                h += fourth * load(rows, numbers[k + 3], 1)
            store((a + b) + (c + d), y, component, t)
            store((e + f) + (g + h), y, component, t + 1)
