"""The sparse factorisation against numpy, lane by lane."""

import numpy as np
import pytest

from surrofe2.plant_cell.block_pattern import factorisation_work, make_pattern
from surrofe2.rve.sparse_linear import factorise_sparse, has_negative_pivots, solve_sparse
from surrofe2.rve.sparse_transposed import solve_sparse_transposed
from surrofe2.simd import TILE

PAIRS = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 0), (0, 3)]


def system(seed, symmetric=False):
    """A pattern of groups of 2 to 14 particles, its values, and the same matrices dense."""
    rng = np.random.default_rng(seed)
    labels = np.concatenate([[0], rng.choice(7, 70, p=np.array([1, 2, 3, 1, 2, 3, 2]) / 14)])
    pattern = make_pattern(labels, PAIRS)
    n = len(labels)
    coupled = {(g, g) for g in range(7)} | set(PAIRS) | {(h, g) for g, h in PAIRS}
    dense = np.zeros((2 * n - 2, 2 * n - 2, TILE))
    for i in range(1, n):
        for j in range(1, n):
            if (labels[i], labels[j]) in coupled:
                dense[2 * i - 2 : 2 * i, 2 * j - 2 : 2 * j] = rng.normal(size=(2, 2, TILE))
    if symmetric:
        dense += np.swapaxes(dense, 0, 1)
    dense -= 40.0 * np.eye(2 * n - 2)[..., None]
    return pattern, packed(dense, pattern, n), dense


def packed(dense, pattern, n):
    values = np.zeros((pattern.size, TILE))
    for i in range(1, n):
        for j in range(1, n):
            g, h = pattern.group[i], pattern.group[j]
            if pattern.offset[g, h] >= 0:
                at = pattern.row_start[i] + pattern.offset[g, h] + 2 * pattern.place[j]
                for a in range(2):
                    row = at + a * pattern.width[g]
                    values[row : row + 2] = dense[2 * i - 2 + a, 2 * j - 2 : 2 * j]
    return values


@pytest.mark.parametrize(("precision", "error"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_solution(precision, error):
    pattern, values, dense = system(1)
    b = np.random.default_rng(2).normal(size=dense.shape[1:])
    x = b.copy()
    factorise_sparse(values, pattern)
    solve_sparse(values.astype(precision), x, pattern)
    for k in range(TILE):
        expected = np.linalg.solve(dense[..., k], b[:, k])
        np.testing.assert_allclose(x[:, k], expected, rtol=0, atol=error)


def test_solution_of_the_transposed_system():
    pattern, values, dense = system(1)
    b = np.random.default_rng(2).normal(size=dense.shape[1:])
    x = b.copy()
    factorise_sparse(values, pattern)
    solve_sparse_transposed(values, x, pattern)
    for k in range(TILE):
        expected = np.linalg.solve(dense[..., k].T, b[:, k])
        np.testing.assert_allclose(x[:, k], expected, rtol=0, atol=1e-12)


def test_work_is_less_than_dense_and_fill_is_kept():
    pattern, values, dense = system(1)
    assert factorisation_work(pattern) < 0.5 * len(dense) ** 3 / 3.0
    assert np.count_nonzero(values[:, 0]) < pattern.size < dense[..., 0].size


def test_definiteness_is_told_lane_by_lane():
    pattern, _, dense = system(3, symmetric=True)
    n = len(dense) // 2 + 1
    dense[10, 10, [2, 5]] += 60.0
    values = packed(dense, pattern, n)
    answer = np.empty(TILE, dtype=np.bool_)
    factorise_sparse(values, pattern)
    has_negative_pivots(values, pattern, answer)
    expected = [np.linalg.eigvalsh(dense[..., k]).max() < 0.0 for k in range(TILE)]
    assert expected.count(False) >= 2
    np.testing.assert_array_equal(answer, expected)
