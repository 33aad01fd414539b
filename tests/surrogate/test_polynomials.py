"""Polynomials by common factors, and the SIMD values they are computed with, against numpy."""

import numpy as np
import pytest

from surrofe2.compilation import kernel
from surrofe2.square_symmetry import parity
from surrofe2.surrogate.features import monomials
from surrofe2.surrogate.lanes import BLOCK, LANES, filled, larger, load, store
from surrofe2.surrogate.polynomials import ROWS, add_polynomials, make_polynomials
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
    x = rng.uniform(-1.0, 1.0, (INPUTS + 1, BLOCK))
    x[INPUTS] = 1.0
    y = rng.normal(size=(4, BLOCK))
    expected = y.copy()
    for (product, component), value in zip(listed, values, strict=True):
        expected[component] += value * x[list(product)].prod(axis=0)
    polynomials = make_polynomials(listed, values)
    add_polynomials(x, polynomials, np.empty((ROWS + len(polynomials.made), LANES)), y)
    assert np.abs(y - expected).max() < 1e-12 * np.abs(expected).max()


def test_common_factors_save_multiplications():
    listed = all_products(4, True)
    polynomials = make_polynomials(listed, np.ones(len(listed)))
    assert np.count_nonzero(polynomials.tail_coefficients) == len(listed)
    work = polynomials.tail_coefficients.size + len(polynomials.heads) + len(polynomials.made)
    assert work < 1.6 * len(listed)


def test_no_polynomials_add_nothing():
    polynomials = make_polynomials([], np.empty(0))
    x, y = np.ones((INPUTS + 1, BLOCK)), np.ones((4, BLOCK))
    add_polynomials(x, polynomials, np.empty((ROWS, LANES)), y)
    assert (y == 1.0).all()


@kernel
def _combine(a, b, number, result):
    one, other = load(a, 1, LANES), load(b, 0, 2)
    store(result, 0, 0, one + other * filled(number))
    store(result, 1, 0, one - other)
    store(result, 2, 0, larger(one, other))


@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_lanes_are_numbers_side_by_side(precision):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 3, 3 * LANES)).astype(precision)
    a[1, LANES + 3], b[0, 2 + 5] = np.nan, np.nan
    result = np.empty((3, LANES), dtype=precision)
    _combine(a, b, precision(0.5), result)
    one, other = a[1, LANES : 2 * LANES], b[0, 2 : 2 + LANES]
    half = precision(0.5)
    assert np.allclose(result[0], one + half * other, rtol=1e-6, equal_nan=True)
    assert np.array_equal(result[1], one - other, equal_nan=True)
    assert np.array_equal(result[2], np.where(one > other, one, other), equal_nan=True)
