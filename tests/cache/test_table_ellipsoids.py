"""Growth, shrinkage and first size of ellipsoids, against plain numpy."""

import numpy as np
import pytest

from surrofe2.cache.branches import RETURN
from surrofe2.cache.table.records import (
    Records,
    Rule,
    curvature_from_constant,
    curvature_from_slopes,
    limited,
    set_bound,
    update_ellipsoids,
)


def random_records(count, seed=0):
    random = np.random.default_rng(seed)
    half = random.normal(size=(count, 7, 7))
    curvature = half @ np.swapaxes(half, 1, 2) + 0.5 * np.eye(7)
    return Records(
        random.normal(size=(count, 7)),
        random.normal(size=(count, 4)),
        random.normal(size=(count, 4, 7)),
        curvature,
    )


def bounds(records, x):
    d = x - records.centre
    return np.einsum("ni,nij,nj->n", d, records.curvature, d)


@pytest.mark.parametrize("radius", [0.5, 1.4])
def test_a_changed_ellipsoid_passes_the_point_and_changes_nowhere_else(radius):
    """In the metric of the ellipsoid only the semi-axis through the point changes."""
    records = random_records(1)
    C = records.curvature[0].copy()
    p = np.random.default_rng(2).normal(size=7)
    p *= radius / np.sqrt(p @ C @ p)
    across = np.random.default_rng(3).normal(size=(20, 7))
    across -= np.outer(across @ C @ p, p) / (p @ C @ p)
    before = np.einsum("ni,ij,nj->n", across, C, across)
    set_bound(p, 1.0, C)
    assert p @ C @ p == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", across, C, across), before, rtol=1e-10)
    assert np.linalg.eigvalsh(C).min() > 0.0


def linear(records, x, k=0):
    return records.stress[k] + records.slope[k] @ (x - records.centre[k])


def along(records, radius):
    p = np.array([1.0, 0.3, -0.2, 0.1, 0.4, 0.0, 0.2])
    return records.centre[0] + p * radius / np.sqrt(p @ records.curvature[0] @ p)


def weighed(radius, error, rule=None):
    """One RVE answer at a radius in the ellipsoid of tolerance 1, off by a Frobenius error."""
    records = random_records(1)
    x = along(records, radius)
    s = linear(records, x) + np.array([error * np.sqrt(2.0), 0.0, 0.0, 0.0])
    covered, counts = update_ellipsoids(x[None], s[None], 1, records, 1.0, rule or Rule())
    return covered[0], counts, bounds(records, x)[0]


@pytest.mark.parametrize("radius", [0.8, 1.3])
def test_a_right_answer_near_by_makes_an_ellipsoid_grow_beyond_it(radius):
    """So near to its centre that a cache takes the point back."""
    covered, counts, bound = weighed(radius, 0.3)
    assert covered
    assert counts == {"grown": 1, "shrunk": 0}
    assert bound == pytest.approx(Rule().grown)
    assert np.sqrt(bound) < RETURN


def test_a_right_answer_well_within_changes_nothing():
    assert weighed(0.7, 0.3) == (True, {"grown": 0, "shrunk": 0}, pytest.approx(0.49))


@pytest.mark.parametrize(("radius", "error"), [(1.3, 0.5), (1.5, 0.0)])
def test_a_wrong_or_a_far_answer_does_not(radius, error):
    covered, counts, bound = weighed(radius, error)
    assert not covered
    assert counts == {"grown": 0, "shrunk": 0}
    assert bound == pytest.approx(radius**2)


def test_a_violation_shrinks_so_that_the_point_is_out():
    covered, counts, bound = weighed(0.9, 2.0)
    assert not covered
    assert counts == {"grown": 0, "shrunk": 1}
    assert bound == pytest.approx(3.0)


def test_first_size_is_exact_for_one_quadratic_component():
    """s₀ alone curves, by ½ xᵀHx: the bound is ½ xᵀ|H|x/√2, the Frobenius norm of its error."""
    random = np.random.default_rng(4)
    H = random.normal(size=(7, 7))
    H = H + H.T
    slope = np.zeros((1, 4, 7))
    step, reach = np.full(7, 0.1), np.linspace(1.0, 2.0, 7)
    probed = np.zeros((1, 7, 4, 7))
    probed[0, :, 0] = step[:, None] * H
    C = curvature_from_slopes(slope, probed, step, reach)[0]
    size, axes = np.linalg.eigh(reach[:, None] * H * reach)
    expected = 0.5 / np.sqrt(2.0) * (axes * np.abs(size)) @ axes.T / (reach[:, None] * reach)
    np.testing.assert_allclose(C, expected, atol=1e-10)


def test_conservative_first_size_holds_the_stress_constant():
    random = np.random.default_rng(5)
    slope, reach, tolerance = random.normal(size=(1, 4, 7)), np.full(7, 3.0), 0.2
    C = curvature_from_constant(slope, tolerance, reach)[0]
    for d in random.normal(size=(50, 7)):
        edge = d * np.sqrt(tolerance / (d @ C @ d))
        assert np.sqrt(0.5 * ((slope[0] @ edge) ** 2).sum()) <= tolerance
        assert (np.abs(edge) <= reach).all()


def test_no_first_ellipsoid_reaches_farther_than_the_range():
    C = limited(np.zeros((1, 7, 7)), 0.5, np.arange(1.0, 8.0))[0]
    np.testing.assert_allclose(np.sqrt(0.5 / np.diag(C)), np.arange(1.0, 8.0))
