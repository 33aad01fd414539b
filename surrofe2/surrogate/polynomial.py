"""Polynomials of the seven inputs, many at once, in few multiplications.

Monomials of a component are gathered by a common factor, their head; what is left of each, its
tail, is at most a product of two inputs:

    y_c = Σ_heads head (Σ_tails coefficient · tail)

Every product of inputs that is a head or a tail is computed once; after that a monomial costs one
multiplication with addition, and so does a group. Heads are chosen greedily, the one first that
most of the monomials left over share; groups are summed four at a time, from tails they share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations_with_replacement
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
_TAIL = 2  # inputs of a tail, at most
_WIDTH = 4  # groups that are summed at a time


class Polynomial(NamedTuple):
    """Polynomials of several components as the arrays their kernel reads.

    Rows are numbered: inputs, ones, and then the products made.

    Attributes:
        made: (m, 2) int64 rows, whose product is the next row.
        heads: (4 q, 2) int64 row of the head of each group and its component; padded with groups
            of coefficient 0.
        begins: (q + 1,) int64 first tail of each four groups.
        tails: (t,) int64 row of each tail.
        tail_coefficients: (t, 4) of each tail in each of its four groups.
    """

    made: NDArray[np.int64]
    heads: NDArray[np.int64]
    begins: NDArray[np.int64]
    tails: NDArray[np.int64]
    tail_coefficients: Array


class _Group(NamedTuple):
    """Monomials of one component with a common head: their coefficients by tail."""

    head: Product
    component: int
    tails: dict[Product, float]


def make_polynomial(products: Iterable[tuple[Product, int]], coefficients: Array) -> Polynomial:
    """Polynomials from (sorted product, component) of each coefficient."""
    rows: dict[Product, int] = {(k,): k for k in np.arange(INPUTS).tolist()}
    rows[()] = ONE
    made: list[tuple[int, int]] = []

    def row(product: Product) -> int:
        if product not in rows:
            pair = row(product[:-1]), product[-1]
            rows[product] = ROWS + len(made)
            made.append(pair)
        return rows[product]

    wanted: dict[int, dict[Product, float]] = {}
    for (product, component), value in zip(products, coefficients, strict=True):
        monomials = wanted.setdefault(component, {})
        monomials[product] = monomials.get(product, 0.0) + value
    groups = [group for component in wanted for group in _groups(component, wanted[component])]
    heads, begins, tails, values = [], [0], [], []
    for four in _in_fours(groups):
        heads += [(row(group.head), group.component) for group in four]
        heads += [(ONE, 0)] * (_WIDTH - len(four))
        shared = sorted(set().union(*(group.tails for group in four)))
        tails += [row(tail) for tail in shared]
        for tail in shared:
            of_four = [group.tails.get(tail, 0.0) for group in four]
            values.append(of_four + [0.0] * (_WIDTH - len(four)))
        begins.append(len(tails))
    return Polynomial(
        np.array(made, dtype=np.int64).reshape(-1, 2),
        np.array(heads, dtype=np.int64).reshape(-1, 2),
        np.array(begins, dtype=np.int64),
        np.array(tails, dtype=np.int64),
        np.array(values, dtype=np.float64).reshape(-1, _WIDTH),
    )


def _in_fours(groups: list[_Group]) -> Iterator[list[_Group]]:
    """Groups in fours that have many tails in common, so that few coefficients are 0."""
    left = sorted(groups, key=lambda group: len(group.tails), reverse=True)
    while left:
        four = [left.pop(0)]
        shared = set(four[0].tails)
        while left and len(four) < _WIDTH:
            nearest = min(left, key=lambda group: len(shared ^ group.tails.keys()))
            left.remove(nearest)
            four.append(nearest)
            shared |= nearest.tails.keys()
        yield four


def _groups(component: int, monomials: dict[Product, float]) -> Iterator[_Group]:
    """Every monomial of a component in one group."""
    left = set(monomials)
    degree = max(len(product) for product in left)
    numbers = np.arange(INPUTS).tolist()
    sizes = np.arange(max(_TAIL, degree - 1) + 1).tolist()
    shapes = [list(combinations_with_replacement(numbers, size)) for size in sizes]
    every_tail = [tail for size in sizes[: _TAIL + 1] for tail in shapes[size]]
    covers = {
        head: {tuple(sorted(head + tail)): tail for tail in every_tail}
        for heads in shapes
        for head in heads
    }
    while left:
        head = max(covers, key=lambda head: (len(left & covers[head].keys()), -len(head)))
        covered = left & covers[head].keys()
        tails = {covers[head][product]: monomials[product] for product in covered}
        yield _Group(head, component, tails)
        left -= covered


@kernel
def add_polynomial(x, polynomial, rows, y):  # type: ignore[no-untyped-def]
    """Add to the rows of y (components, TILES, TILE) at inputs x (8, TILES, TILE).

    The last row of x are ones. rows: (`ROWS` + m, 2, TILE) room for the products made, of two
    tiles, as one alone has to wait for its own sums.
    """
    made, begins = polynomial.made, polynomial.begins
    tails, coefficients = polynomial.tails, polynomial.tail_coefficients
    for t in range(0, TILES, 2):
        for k in range(ROWS):
            store(load(x, k, t), rows, k, 0)
            store(load(x, k, t + 1), rows, k, 1)
        for k in range(made.shape[0]):
            i, j = made[k, 0], made[k, 1]
            store(load(rows, i, 0) * load(rows, j, 0), rows, ROWS + k, 0)
            store(load(rows, i, 1) * load(rows, j, 1), rows, ROWS + k, 1)
        for four in range(begins.shape[0] - 1):
            a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            e, f, g, h = a, b, c, d
            for k in range(begins[four], begins[four + 1]):
                one, two = load(rows, tails[k], 0), load(rows, tails[k], 1)
                first, second = spread(coefficients[k, 0]), spread(coefficients[k, 1])
                third, fourth = spread(coefficients[k, 2]), spread(coefficients[k, 3])
                a += first * one
                b += second * one
                c += third * one
                d += fourth * one
                e += first * two
                f += second * two
                g += third * two
                h += fourth * two
            _add_group(polynomial.heads, 4 * four, rows, a, e, y, t)
            _add_group(polynomial.heads, 4 * four + 1, rows, b, f, y, t)
            _add_group(polynomial.heads, 4 * four + 2, rows, c, g, y, t)
            _add_group(polynomial.heads, 4 * four + 3, rows, d, h, y, t)


@kernel
def _add_group(heads, group, rows, one, two, y, t):  # type: ignore[no-untyped-def]
    head, component = heads[group, 0], heads[group, 1]
    store(load(y, component, t) + one * load(rows, head, 0), y, component, t)
    store(load(y, component, t + 1) + two * load(rows, head, 1), y, component, t + 1)
