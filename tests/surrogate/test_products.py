"""Polynomials in products of inputs: compiled values and slopes against numpy."""

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.base.square_symmetry import parity
from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.products import ONE, TILES, Polynomials, columns, evaluate, monomials


def all_products(degree, symmetric):
    products = [(), *monomials(degree)]
    if symmetric:
        return [(product, parity(product)) for product in products]
    return [(product, component) for product in products for component in range(3)]


def differentiated(product, k):
    left = list(product)
    if k not in left:
        return 0.0, ()
    left.remove(k)
    return float(product.count(k)), tuple(left)


@pytest.mark.parametrize("inputs", [0, INPUTS])
@pytest.mark.parametrize(("degree", "symmetric"), [(1, True), (4, True), (3, False), (5, True)])
def test_values_and_slopes_are_sums_of_monomials(degree, symmetric, inputs):
    rng = np.random.default_rng(degree)
    listed = all_products(degree, symmetric)
    coefficients = rng.normal(size=len(listed)).tolist()
    x = rng.uniform(-1.0, 1.0, (TILES * TILE, INPUTS + 1))
    x[:, ONE] = 1.0
    expected, slopes = np.zeros((4, len(x))), np.zeros((INPUTS, 4, len(x)))
    for (product, component), c in zip(listed, coefficients, strict=True):
        expected[component] += c * columns(x, [product])[0]
        for k in range(INPUTS):
            count, left = differentiated(product, k)
            slopes[k, component] += c * count * columns(x, [left])[0]
    each = [
        [(product, c) for (product, at), c in zip(listed, coefficients, strict=True) if at == k]
        for k in range(4)
    ]
    kept = [(0, 3, 6), (2,), ()]
    polynomials = Polynomials.of(ONE + 1, each, kept)
    rows = np.full((ONE + 1 + len(polynomials.products), TILES, TILE), np.nan)
    rows[: ONE + 1] = x.T.reshape(-1, TILES, TILE)
    y, row_slopes = np.empty((4, TILES, TILE)), np.empty((inputs, *rows.shape))
    y_slopes = np.empty((inputs, *y.shape))
    evaluate(polynomials, rows, y, row_slopes, y_slopes)
    assert np.abs(y.reshape(4, -1) - expected).max() < 1e-12 * np.abs(expected).max()
    found = y_slopes.reshape(inputs, 4, len(x)) - slopes[:inputs]
    assert np.abs(found).max(initial=0.0) < 1e-12 * np.abs(slopes).max()
    read = rows[polynomials.kept].reshape(len(kept), -1)
    assert np.allclose(read, columns(x, kept), rtol=1e-15, atol=0.0)
    for k in range(inputs):
        wanted = x[:, 3] * x[:, 6] if k == 0 else x[:, 0] * x[:, 9 - k] if k in (3, 6) else 0.0 * k
        assert np.allclose(row_slopes[k, polynomials.kept[0]].ravel(), wanted, rtol=1e-15)
