"""Products of inputs, each an earlier one times one input, and polynomials as sums of them.

Invariants and terms, the polynomial that is corrected, the failure boundary and the scale of the
bound are all made of them: by `columns` in numpy and torch, by `evaluate` in compiled code, there
with slopes.
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
"""Numbers of the inputs that are multiplied; the empty product is 1."""

bare_kernel = compiled(_nrt=False)
"""A kernel that makes no arrays, and counts no references to those that it is given: counting takes
an atomic operation at each call and each slice."""

ONE = INPUTS
"""The number of the input that is 1."""
STRETCH = 3
"""The number of inputs of U − I, which are the first."""
TILES = 6
"""Tiles of a block of points, as many as `evaluate` sums at once.

Each quantity of a block is (TILES, TILE)."""
BLOCK = TILES * TILE
"""Points of a block."""
# A polynomial of at most so many terms is summed in one group: several groups would take longer.
_FEW = 24


def monomials(degree: int) -> tuple[Product, ...]:
    """Return all products of 1 to `degree` of the seven inputs, by rising degree."""
    return tuple(
        product
        for factors in range(1, degree + 1)
        for product in combinations_with_replacement(range(INPUTS), factors)
    )


def columns(x: Any, products: Iterable[Product]) -> list[Any]:
    """Compute products of the columns of x (n, inputs), each as (n,), by numpy or torch.

    Column `ONE` of x holds ones.
    """
    values: dict[Product, Any] = {(): x[:, ONE]}

    def column(product: Product) -> Any:
        """Return a product, and remember it and its beginnings, which other products share."""
        if product not in values:
            last = x[:, product[-1]]
            if len(product) == 1:
                values[product] = last
            else:
                values[product] = column(product[:-1]) * last
        return values[product]

    return [column(product) for product in products]


class Polynomials(NamedTuple):
    """Several polynomials of the same inputs as the arrays their kernel reads.

        y = Σ_heads x_head (Σ coefficient · row)

    A term's head is the last of its inputs, and its row is the product of the others, so that a
    term costs one multiplication and one addition. Where a polynomial has few terms, the head of
    each is 1. Rows are numbered: first the inputs, 1 among them, then the products.

    Attributes:
        products: (m, 2) int64 row and input, whose product is the next row.
        begins: (outputs + 1,) int64 first group of each polynomial.
        heads: (g,) int64 input that is the head of each group of terms.
        group_begins: (g + 1,) int64 first term of each group.
        rows: (t,) int64 row of each term.
        coefficients: (t,) coefficient of each term.
        kept: (k,) int64 rows that callers read besides.
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
        """Make the arrays of polynomials, and of products that are needed besides.

        Args:
            inputs: number of inputs, that which is 1 among them.
            polynomials: the terms of each, (product, coefficient).
            kept: products of which the caller reads the rows.
        """
        row_of: dict[Product, int] = {(k,): k for k in range(inputs)}
        row_of[()] = ONE
        products: list[tuple[int, int]] = []

        def row(product: Product) -> int:
            """Return the row of a product; it and its beginnings get one where they have none."""
            if product not in row_of:
                factor = row(product[:-1])  # first: it may add rows, which must come before this
                row_of[product] = inputs + len(products)
                products.append((factor, product[-1]))
            return row_of[product]

        # coefficients by row, by head, of each polynomial
        groups_of: list[dict[int, dict[int, float]]] = []
        for polynomial in polynomials:
            terms = list(polynomial)
            groups: dict[int, dict[int, float]] = {}
            for product, coefficient in terms:
                if product and len(terms) > _FEW:
                    groups.setdefault(product[-1], {})[row(product[:-1])] = coefficient
                else:
                    groups.setdefault(ONE, {})[row(product)] = coefficient
            groups_of.append(groups)
        kept_rows = [row(product) for product in kept]

        # flat lists, sorted so that the order of a sum, and its bits, depend on the terms alone
        begins = [0]
        heads: list[int] = []
        group_begins = [0]
        rows: list[int] = []
        coefficients: list[float] = []
        for groups in groups_of:
            for head in sorted(groups):
                heads.append(head)
                for number, coefficient in sorted(groups[head].items()):
                    rows.append(number)
                    coefficients.append(coefficient)
                group_begins.append(len(rows))
            begins.append(len(heads))
        return cls(
            products=np.array(products, dtype=np.int64).reshape(-1, 2),
            begins=np.array(begins, dtype=np.int64),
            heads=np.array(heads, dtype=np.int64),
            group_begins=np.array(group_begins, dtype=np.int64),
            rows=np.array(rows, dtype=np.int64),
            coefficients=np.array(coefficients, dtype=np.float64),
            kept=np.array(kept_rows, dtype=np.int64),
        )


class Room(NamedTuple):
    """The arrays in which polynomials are evaluated; the next block uses them again.

    Attributes:
        rows: (inputs + m, TILES, TILE) values of inputs and products.
        y: (outputs, TILES, TILE) values of the polynomials.
        slopes: (K, inputs + m, TILES, TILE) slopes of `rows` by each of the first K inputs; K may
            be 0.
        y_slopes: (K, outputs, TILES, TILE) slopes of `y`.
    """

    rows: Any
    y: Any
    slopes: Any
    y_slopes: Any


@kernel
def make_room(polynomials, inputs, along):  # type: ignore[no-untyped-def]
    """Make room for values, and for slopes along the first `along` inputs.

    The slopes of inputs are set here once: 1 by the input itself, else 0.
    """
    rows = inputs + polynomials.products.shape[0]
    outputs = polynomials.begins.shape[0] - 1
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
    """Compute the products and polynomials of a `Room` from its inputs, and their slopes.

    - products: row k + inputs is the product of a row and an input, `products[k]`.
    - polynomials: y = Σ_heads x_head (Σ coefficient · row).
    - slopes by input `along`, if there is room for them, by the product rule; a head or second
      factor j depends on `along` only if it is that input itself. So an input that depends on
      others must be the first of its products.

    polynomials: `Polynomials`, or arrays with the same fields. The kernel is written out where it
    is used: a call with all these arrays takes as long as a small polynomial.
    """
    products = polynomials.products
    begins = polynomials.begins
    heads = polynomials.heads
    group_begins = polynomials.group_begins
    numbers = polynomials.rows
    rows, y, slopes, y_slopes = room
    coefficients = polynomials.coefficients
    inputs = rows.shape[0] - products.shape[0]
    # unsigned, since numba tests signed indices for counting from the end
    for k in range(np.uint64(products.shape[0])):
        i = products[k, 0]
        j = products[k, 1]
        row = np.uint64(inputs) + k
        for t in range(TILES):
            store(load(rows, i, t) * load(rows, j, t), rows, row, t)
    for output in range(begins.shape[0] - 1):
        # Written out for the six tiles, as additions to one sum wait for each other. one to six are
        # the sums over groups, a to f those within a group.
        one = spread(0.0)
        two = spread(0.0)
        three = spread(0.0)
        four = spread(0.0)
        five = spread(0.0)
        six = spread(0.0)
        for group in range(begins[output], begins[output + 1]):
            head = heads[group]
            first = group_begins[group]
            last = group_begins[group + 1]
            a = spread(0.0)
            b = spread(0.0)
            c = spread(0.0)
            d = spread(0.0)
            e = spread(0.0)
            f = spread(0.0)
            for k in range(np.uint64(first), np.uint64(last)):
                coefficient = spread(coefficients[k])
                row = numbers[k]
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
        inner = slopes[along]
        result = y_slopes[along]
        # two tiles at a time: t in a and one, t + 1 in b and two
        for t in range(0, TILES, 2):
            for k in range(products.shape[0]):
                i = products[k, 0]
                j = products[k, 1]
                row = inputs + k
                a = load(inner, i, t) * load(rows, j, t)
                b = load(inner, i, t + 1) * load(rows, j, t + 1)
                if j == along:
                    a += load(rows, i, t)
                    b += load(rows, i, t + 1)
                store(a, inner, row, t)
                store(b, inner, row, t + 1)
            for output in range(begins.shape[0] - 1):
                one = spread(0.0)
                two = spread(0.0)
                for group in range(begins[output], begins[output + 1]):
                    head = heads[group]
                    a = spread(0.0)
                    b = spread(0.0)
                    first = group_begins[group]
                    last = group_begins[group + 1]
                    for k in range(first, last):
                        coefficient = spread(coefficients[k])
                        row = numbers[k]
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
