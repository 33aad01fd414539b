"""Products of inputs, each an earlier one times one input, and polynomials as sums of them.

One table serves invariants and terms, the polynomial that is corrected, the failure boundary and
the scale of the bound: `columns` in numpy and torch, `evaluate` in compiled code, with slopes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import compiled, kernel, pair_law
from surrofe2.base.simd import TILE, load, spread, store
from surrofe2.base.tensors import INPUTS

Product = tuple[int, ...]
"""Numbers of the inputs that are multiplied; an empty one is 1."""

bare_kernel = compiled(_nrt=False)
"""A kernel that makes no arrays, and counts no references to those that it is given: counting takes
an atomic operation at each call and each slice."""

ONE = INPUTS
"""The number of the input that is 1."""
STRETCH = 3
"""The first inputs are those of U − I."""
TILES = 6
"""Tiles of a block of points, as many as `evaluate` sums at once; each quantity of a block is
(TILES, TILE)."""
BLOCK = TILES * TILE
"""Points of a block."""
_FEW = 24  # terms, which are summed faster in one group than in several


def monomials(degree: int) -> tuple[Product, ...]:
    """All products of 1 to `degree` of the seven inputs, by rising degree."""
    return tuple(
        product
        for factors in range(1, degree + 1)
        for product in combinations_with_replacement(range(INPUTS), factors)
    )


def columns(x: Any, products: Iterable[Product]) -> list[Any]:
    """The products of the columns of x (n, inputs), numpy or torch; column `ONE` holds ones."""
    values: dict[Product, Any] = {(): x[:, ONE]}

    def column(product: Product) -> Any:
        if product not in values:
            last = x[:, product[-1]]
            values[product] = last if len(product) == 1 else column(product[:-1]) * last
        return values[product]

    return [column(product) for product in products]


class Polynomials(NamedTuple):
    """Several polynomials of the same inputs as the arrays their kernel reads.

        y = Σ_heads x_head (Σ coefficient · row)

    A term's head is the last of its inputs, its row the product of the others: so a term costs one
    multiplication and addition. Of few terms the head is 1. Rows are numbered: the inputs, 1 among
    them, then the products.

    Attributes:
        products: (m, 2) int64 row and input, whose product is the next row.
        begins: (outputs + 1,) int64 first group of each polynomial.
        heads: (g,) int64 input of each group; group_begins: (g + 1,) int64 its first term.
        rows: (t,) int64 row of each term; coefficients: (t,).
        kept: (k,) int64 rows that are read besides.
    """

    products: Index
    begins: Index
    heads: Index
    group_begins: Index
    rows: Index
    coefficients: Array
    kept: Index

    @classmethod
    def of(
        cls,
        inputs: int,
        polynomials: Sequence[Iterable[tuple[Product, float]]],
        kept: Iterable[Product] = (),
    ) -> Polynomials:
        """Polynomials of so many inputs, each by its (product, coefficient), and rows besides."""
        numbers: dict[Product, int] = {(k,): k for k in range(inputs)} | {(): ONE}
        products: list[tuple[int, int]] = []

        def row(product: Product) -> int:
            if product not in numbers:
                pair = row(product[:-1]), product[-1]
                numbers[product] = inputs + len(products)
                products.append(pair)
            return numbers[product]

        groups: list[dict[int, dict[int, float]]] = [{} for _ in polynomials]
        for polynomial, of in zip(polynomials, groups, strict=True):
            terms = list(polynomial)
            for product, value in terms:
                if product and len(terms) > _FEW:
                    of.setdefault(product[-1], {})[row(product[:-1])] = value
                else:
                    of.setdefault(ONE, {})[row(product)] = value
        also = [row(product) for product in kept]
        every = [(head, of[head]) for of in groups for head in sorted(of)]
        flat = [term for _, group in every for term in sorted(group.items())]
        return cls(
            np.array(products, dtype=np.int64).reshape(-1, 2),
            np.cumsum([0, *(len(of) for of in groups)], dtype=np.int64),
            np.array([head for head, _ in every], dtype=np.int64),
            np.cumsum([0, *(len(group) for _, group in every)], dtype=np.int64),
            np.array([number for number, _ in flat], dtype=np.int64),
            np.array([value for _, value in flat], dtype=np.float64),
            np.array(also, dtype=np.int64),
        )


class Room(NamedTuple):
    """What polynomials are evaluated in, used again for the next block.

    Attributes:
        rows: (inputs + m, TILES, TILE) inputs and products.
        y: (outputs, TILES, TILE) polynomials.
        slopes, y_slopes: (K, …) of both by each of the first K inputs; K = 0: of none.
    """

    rows: Any
    y: Any
    slopes: Any
    y_slopes: Any


@kernel
def make_room(polynomials, inputs, along):  # type: ignore[no-untyped-def]
    """Room for slopes along the first `along` inputs, which are 0 and 1 but of the products."""
    rows, outputs = inputs + polynomials.products.shape[0], polynomials.begins.shape[0] - 1
    slopes = np.zeros((along, rows, TILES, TILE))
    for k in range(along):
        slopes[k, k] = 1.0
    return Room(
        np.empty((rows, TILES, TILE)),
        np.empty((outputs, TILES, TILE)),
        slopes,
        np.empty((along, outputs, TILES, TILE)),
    )


@pair_law
def evaluate(polynomials, room):  # type: ignore[no-untyped-def]
    """Set the products and the polynomials by the inputs, and their slopes by the inputs'.

    Where there are slopes, an input that depends on others is the first of its products. Written
    out where it is used: a call with all these arrays takes as long as a small polynomial.
    """
    products, begins, heads = polynomials.products, polynomials.begins, polynomials.heads
    group_begins, numbers = polynomials.group_begins, polynomials.rows
    rows, y, slopes, y_slopes = room
    coefficients, inputs = polynomials.coefficients, rows.shape[0] - products.shape[0]
    # numba tests signed indices for counting from the end
    for k in range(np.uint64(products.shape[0])):
        i, j, row = products[k, 0], products[k, 1], np.uint64(inputs) + k
        for t in range(TILES):
            store(load(rows, i, t) * load(rows, j, t), rows, row, t)
    for output in range(begins.shape[0] - 1):
        # a sum for each of the six tiles: additions to one sum wait for each other
        one, two, three = spread(0.0), spread(0.0), spread(0.0)
        four, five, six = spread(0.0), spread(0.0), spread(0.0)
        for group in range(begins[output], begins[output + 1]):
            head, first, last = heads[group], group_begins[group], group_begins[group + 1]
            a, b, c = spread(0.0), spread(0.0), spread(0.0)
            d, e, f = spread(0.0), spread(0.0), spread(0.0)
            for k in range(np.uint64(first), np.uint64(last)):
                coefficient, row = spread(coefficients[k]), numbers[k]
                a += coefficient * load(rows, row, 0)
                b += coefficient * load(rows, row, 1)
                c += coefficient * load(rows, row, 2)
                d += coefficient * load(rows, row, 3)
                e += coefficient * load(rows, row, 4)
                f += coefficient * load(rows, row, 5)
            one += a * load(rows, head, 0)
            two += b * load(rows, head, 1)
            three += c * load(rows, head, 2)
            four += d * load(rows, head, 3)
            five += e * load(rows, head, 4)
            six += f * load(rows, head, 5)
        store(one, y, output, 0)
        store(two, y, output, 1)
        store(three, y, output, 2)
        store(four, y, output, 3)
        store(five, y, output, 4)
        store(six, y, output, 5)
    for along in range(slopes.shape[0]):
        inner, result = slopes[along], y_slopes[along]
        for t in range(0, TILES, 2):
            for k in range(products.shape[0]):
                i, j, row = products[k, 0], products[k, 1], inputs + k
                a = load(inner, i, t) * load(rows, j, t)
                b = load(inner, i, t + 1) * load(rows, j, t + 1)
                if j == along:
                    a += load(rows, i, t)
                    b += load(rows, i, t + 1)
                store(a, inner, row, t)
                store(b, inner, row, t + 1)
            for output in range(begins.shape[0] - 1):
                one, two = spread(0.0), spread(0.0)
                for group in range(begins[output], begins[output + 1]):
                    head, a, b = heads[group], spread(0.0), spread(0.0)
                    first, last = group_begins[group], group_begins[group + 1]
                    for k in range(first, last):
                        coefficient, row = spread(coefficients[k]), numbers[k]
                        a += coefficient * load(inner, row, t)
                        b += coefficient * load(inner, row, t + 1)
                    one += a * load(rows, head, t)
                    two += b * load(rows, head, t + 1)
                    if head == along:
                        for k in range(first, last):
                            one += coefficients[k] * load(rows, numbers[k], t)
                            two += coefficients[k] * load(rows, numbers[k], t + 1)
                store(one, result, output, t)
                store(two, result, output, t + 1)
