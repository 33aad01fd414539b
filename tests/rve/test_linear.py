import numpy as np
import pytest

from surrofe2.rve.linear import (
    factorise,
    factorise_symmetric,
    is_negative_definite,
    solve_factorised,
)
from surrofe2.rve.linear_columns import solve_four, solve_four_transposed
from surrofe2.simd import TILE


def systems(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, n, TILE)) - 3.0 * n * np.eye(n)[:, :, None]


@pytest.mark.parametrize("n", [1, 3, 4, 5, 8, 9, 67, 68])
@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_each_lane_solves_its_own_system(n, precision):
    a = systems(n)
    b = np.random.default_rng(1).normal(size=(n, TILE))
    lu, x = a.copy(), b.copy()
    factorise(lu)
    solve_factorised(lu.astype(precision), x)
    expected = [np.linalg.solve(a[:, :, lane], b[:, lane]) for lane in range(TILE)]
    tolerance = 1e-12 if precision is np.float64 else 1e-5
    np.testing.assert_allclose(x, np.transpose(expected), rtol=0, atol=tolerance)


@pytest.mark.parametrize("n", [1, 4, 9, 68])
@pytest.mark.parametrize("kind", ["any", "transposed", "symmetric"])
def test_four_columns_at_once(n, kind):
    a = systems(n)
    b = np.random.default_rng(1).normal(size=(4, n, TILE))
    if kind == "symmetric":
        a = a + a.swapaxes(0, 1)
    lu, x = a.copy(), b.copy()
    (factorise_symmetric if kind == "symmetric" else factorise)(lu)
    (solve_four_transposed if kind == "transposed" else solve_four)(lu, x)
    for lane in range(TILE):
        matrix = a[:, :, lane].T if kind == "transposed" else a[:, :, lane]
        expected = np.linalg.solve(matrix, b[:, :, lane].T).T
        np.testing.assert_allclose(x[:, :, lane], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [1, 4, 6, 68])
def test_pivots_of_the_symmetric_elimination(n):
    """Their product is the determinant, their signs tell definiteness."""
    a = systems(n)
    a = a + a.swapaxes(0, 1)
    a[:, :, 2] += 20.0 * n * np.outer(np.arange(n) == n - 1, np.arange(n) == n - 1)
    a[:, :, 5] *= -1.0
    answer, reduced = np.empty(TILE, dtype=bool), a.copy()
    is_negative_definite(reduced, answer)
    for lane in range(TILE):
        sign, logarithm = np.linalg.slogdet(a[:, :, lane])
        pivots = 1.0 / reduced[:, :, lane].diagonal()
        assert np.prod(np.sign(pivots)) == sign
        assert np.log(np.abs(pivots)).sum() == pytest.approx(logarithm, rel=1e-12)
        assert answer[lane] == (np.linalg.eigvalsh(a[:, :, lane]).max() < 0)
    assert answer[0]
    assert not answer[2]
    assert not answer[5]
