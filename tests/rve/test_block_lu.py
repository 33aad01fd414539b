"""The block factorisation against numpy, lane by lane: in several groups, and dense in one."""

import numpy as np
import pytest

from surrofe2.base.simd import TILE
from surrofe2.plant_cell.block_matrices import (
    factorisation_work,
    factorise,
    has_negative_pivots,
    make_pattern,
    solve,
    solve_columns,
)

PAIRS = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 0), (0, 3)]
GROUPS = ("several", 1, 3, 4, 5, 9, 34)
"""Groups of 2 to 14 particles, or one group of so many."""


def system(groups, seed=1, symmetric=False):
    """A pattern, its values, and the same matrices dense."""
    rng = np.random.default_rng(seed)
    if groups == "several":
        labels = np.concatenate([[0], rng.choice(7, 70, p=np.array([1, 2, 3, 1, 2, 3, 2]) / 14)])
        pairs = PAIRS
    else:
        labels, pairs = np.zeros(groups + 1, dtype=int), []
    pattern = make_pattern(labels, pairs)
    n = len(labels)
    coupled = {(g, g) for g in range(7)} | set(pairs) | {(h, g) for g, h in pairs}
    dense = np.zeros((2 * n - 2, 2 * n - 2, TILE))
    for i in range(1, n):
        for j in range(1, n):
            if (labels[i], labels[j]) in coupled:
                dense[2 * i - 2 : 2 * i, 2 * j - 2 : 2 * j] = rng.normal(size=(2, 2, TILE))
    if symmetric:
        dense += np.swapaxes(dense, 0, 1)
    dense -= max(40.0, 1.5 * n) * np.eye(2 * n - 2)[..., None]
    return pattern, packed(dense, pattern), dense


def packed(dense, pattern):
    values = np.zeros((pattern.size, TILE))
    for i in range(1, len(pattern.group)):
        for j in range(1, len(pattern.group)):
            g, h = pattern.group[i], pattern.group[j]
            if pattern.offset[g, h] >= 0:
                for a in range(2):
                    row = pattern.start[g] + (pattern.column[i] + a) * pattern.width[g]
                    at = row + pattern.offset[g, h] + pattern.column[j]
                    values[at : at + 2] = dense[2 * i - 2 + a, 2 * j - 2 : 2 * j]
    return values


@pytest.mark.parametrize("groups", GROUPS)
@pytest.mark.parametrize(("precision", "error"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_each_lane_solves_its_own_system(groups, precision, error):
    pattern, values, dense = system(groups)
    b = np.random.default_rng(2).normal(size=dense.shape[1:])
    x = b.copy()
    factorise(values, pattern, False)
    solve(values.astype(precision), x, pattern)
    expected = np.linalg.solve(np.moveaxis(dense, -1, 0), b.T[..., None])[..., 0].T
    np.testing.assert_allclose(x, expected, rtol=0, atol=error)


@pytest.mark.parametrize("groups", GROUPS)
@pytest.mark.parametrize("kind", ["any", "transposed", "symmetric"])
def test_four_columns_at_once(groups, kind):
    pattern, values, dense = system(groups, symmetric=kind == "symmetric")
    b = np.random.default_rng(1).normal(size=(4, *dense.shape[1:]))
    x = b.copy()
    factorise(values, pattern, kind == "symmetric")
    solve_columns(values, x, pattern, kind == "transposed")
    matrices = np.moveaxis(dense.swapaxes(0, 1) if kind == "transposed" else dense, -1, 0)
    expected = np.linalg.solve(matrices, b.transpose(2, 1, 0)).transpose(2, 1, 0)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("groups", GROUPS)
def test_pivots_of_the_symmetric_elimination(groups):
    """Their product is the determinant, their signs tell definiteness."""
    pattern, _, dense = system(groups, seed=3, symmetric=True)
    size = len(dense)
    dense[size - 1, size - 1, 2] += 20.0 * max(40.0, size)
    dense[..., 5] *= -1.0
    values, answer = packed(dense, pattern), np.empty(TILE, dtype=np.bool_)
    factorise(values, pattern, True)
    has_negative_pivots(values, pattern, answer)
    order = [
        pattern.start[g] + pattern.offset[g, g] + k * (pattern.width[g] + 1)
        for g in range(len(pattern.width))
        for k in range(pattern.first[g + 1] - pattern.first[g])
    ]
    for lane in range(TILE):
        pivots = 1.0 / values[order, lane]
        sign, logarithm = np.linalg.slogdet(dense[..., lane])
        assert np.prod(np.sign(pivots)) == sign
        assert np.log(np.abs(pivots)).sum() == pytest.approx(logarithm, rel=1e-12)
        assert answer[lane] == (np.linalg.eigvalsh(dense[..., lane]).max() < 0)
    assert answer[0]
    assert not answer[2]
    assert not answer[5]


def test_work_in_groups_is_less_than_dense_and_fill_is_kept():
    pattern, values, dense = system("several")
    assert factorisation_work(pattern) < 0.5 * len(dense) ** 3 / 3.0
    assert np.count_nonzero(values[:, 0]) < pattern.size < dense[..., 0].size
