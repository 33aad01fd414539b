"""Polynomials by the last inputs of their monomials, against numpy."""

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.base.square_symmetry import parity
from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.compiled_frame import TILES
from surrofe2.surrogate.features import monomials
from surrofe2.surrogate.polynomial import ROWS, make_polynomial, set_polynomial


def all_products(degree, symmetric):
    found = [(), *monomials(degree)]
    if symmetric:
        return [(product, parity(product)) for product in found]
    return [(product, component) for product in found for component in range(3)]


@pytest.mark.parametrize(("degree", "symmetric"), [(1, True), (4, True), (3, False), (5, True)])
def test_polynomials_are_sums_of_their_monomials(degree, symmetric):
    rng = np.random.default_rng(degree)
    listed = all_products(degree, symmetric)
    values = rng.normal(size=len(listed))
    x = rng.uniform(-1.0, 1.0, (INPUTS + 1, TILES, TILE))
    x[INPUTS] = 1.0
    expected = np.zeros((4, TILES, TILE))
    for (product, component), value in zip(listed, values, strict=True):
        expected[component] += value * x[list(product)].prod(axis=0)
    polynomials = make_polynomial(zip(listed, values.tolist(), strict=True), 4)
    y = rng.normal(size=expected.shape)
    set_polynomial(x, polynomials, np.empty((ROWS + len(polynomials.products), 2, TILE)), y)
    assert np.abs(y - expected).max() < 1e-12 * np.abs(expected).max()
    # every tail of two inputs and more is one multiplication
    assert len(polynomials.products) == len({p[:-1] for p, _ in listed if len(p) > 2})


def test_no_monomials_give_nothing():
    x, y = np.ones((INPUTS + 1, TILES, TILE)), np.ones((4, TILES, TILE))
    set_polynomial(x, make_polynomial([], 4), np.empty((ROWS, 2, TILE)), y)
    assert (y == 0.0).all()
