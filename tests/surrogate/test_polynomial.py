"""Polynomials by common factors against numpy."""

import numpy as np
import pytest

from surrofe2.simd import TILE
from surrofe2.square_symmetry import parity
from surrofe2.surrogate.compiled_frame import TILES
from surrofe2.surrogate.features import monomials
from surrofe2.surrogate.polynomial import ROWS, add_polynomial, make_polynomial
from surrofe2.tensors import INPUTS


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
    y = rng.normal(size=(4, TILES, TILE))
    expected = y.copy()
    for (product, component), value in zip(listed, values, strict=True):
        expected[component] += value * x[list(product)].prod(axis=0)
    polynomials = make_polynomial(listed, values)
    add_polynomial(x, polynomials, np.empty((ROWS + len(polynomials.made), 2, TILE)), y)
    assert np.abs(y - expected).max() < 1e-12 * np.abs(expected).max()


def test_common_factors_save_multiplications():
    listed = all_products(4, True)
    polynomials = make_polynomial(listed, np.ones(len(listed)))
    assert np.count_nonzero(polynomials.tail_coefficients) == len(listed)
    work = polynomials.tail_coefficients.size + len(polynomials.heads) + len(polynomials.made)
    assert work < 1.6 * len(listed)


def test_no_polynomials_add_nothing():
    polynomials = make_polynomial([], np.empty(0))
    x, y = np.ones((INPUTS + 1, TILES, TILE)), np.ones((4, TILES, TILE))
    add_polynomial(x, polynomials, np.empty((ROWS, 2, TILE)), y)
    assert (y == 1.0).all()
