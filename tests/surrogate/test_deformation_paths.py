"""Paths that calibration is done on: within the range, consistent in time, asked in order."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.sampling import SamplingRange, contains
from surrofe2.base.tensors import unrotated
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.deformation_paths import (
    CHUNK,
    random_walks,
    run_paths,
    true_stress,
)
from tests.laws import SoftLaw

RANGE = SamplingRange(stretch=(0.9, 1.05), shear=0.08, rate=0.01)


def components(F, F_dot):
    """(n, 7) U₁₁, U₂₂, U₁₂ and the entries of RᵀḞ."""
    U, A, _ = unrotated(F, F_dot)
    return np.hstack([U.reshape(-1, 4)[:, [0, 3, 1]], A.reshape(-1, 4)])


def scaled(range, x):
    """Within ±1 over the range."""
    low, high = range.stretch
    middle = np.array([0.5 * (low + high)] * 2 + [0.0] * 5)
    return (x - middle) / [*[0.5 * (high - low)] * 2, range.shear, *[range.rate] * 4]


def test_walks_begin_at_rest_and_are_smooth():
    walks = random_walks(RANGE, 50, 2001, seed=2)
    assert np.array_equal(walks.F[0], np.broadcast_to(np.eye(2), (50, 2, 2)))
    assert not walks.F_dot[0].any()
    for path, largest in ((walks.F, 0.3), (walks.F_dot, 0.05)):
        assert np.abs(np.diff(path, axis=0)).max() < 0.02 * largest


def test_walks_end_anywhere_in_the_range_many_in_corners():
    walks = random_walks(RANGE, 8000, 2, seed=3)
    x = scaled(RANGE, components(walks.F[-1], walks.F_dot[-1]))
    corner = (abs(x[:, :3]) >= 0.9 - 1e-9).all(axis=1)
    assert 0.22 < corner.mean() < 0.28
    sides, counts = np.unique(np.sign(x[corner, :3]), axis=0, return_counts=True)
    assert len(sides) == 8
    assert counts.min() > 150
    fast = (abs(x[corner, 3:]) >= 0.9 - 1e-9).all(axis=1)
    assert 0.45 < fast.mean() < 0.55
    usual = x[~corner]
    for k in np.arange(7):  # a third of these are small
        assert np.histogram(usual[:, k], 10, (-1.0, 1.0))[0].min() > 0.05 * len(usual)


def test_small_walks_are_of_all_sizes_and_have_few_components_too():
    walks = random_walks(RANGE, 36_000, 2, seed=3)
    rest = scaled(RANGE, np.array([[1.0, 1.0, *[0.0] * 5]]))
    x = abs(scaled(RANGE, components(walks.F[-1], walks.F_dot[-1])) - rest)
    decades = np.histogram(np.log10(x.max(axis=1)), [-3, -2, -1, 0.5])[0]
    assert decades.min() > 2000
    # one component large, all others below a fifth of it: each of the seven
    order = np.sort(x, axis=1)
    alone = (order[:, -1] > 0.01) & (order[:, -2] < 0.2 * order[:, -1])
    assert np.bincount(x[alone].argmax(axis=1), minlength=7).min() > 0


@pytest.mark.parametrize("narrow", [{}, {"shear": 0.0}, {"rate": 0.0}])
def test_walks_stay_in_the_range_and_fill_it(narrow):
    range = SamplingRange(**{"stretch": (0.9, 1.05), "shear": 0.08, "rate": 0.01, **narrow})
    F, F_dot = random_walks(range, 300, 30, seed=1).states
    assert F.flags.c_contiguous
    assert contains(range, F, F_dot).all()
    x = components(F, F_dot)
    assert x[:, 0].min() < 0.91
    assert x[:, 1].max() > 1.04
    assert np.abs(x[:, 2]).max() >= 0.9 * range.shear
    assert np.abs(x[:, 3:]).max(axis=0).min() >= 0.9 * range.rate
    assert (x[:, :2].std(axis=0) > 0.02).all()
    turned = np.abs(F[:, 0, 1] - F[:, 1, 0])
    assert turned.max() > 0.3


def test_a_run_with_all_its_points_is_one_path():
    def states(points, steps):
        rng = np.random.default_rng(points)
        return [(rng.random((points, 2, 2)), rng.random((points, 2, 2))) for _ in range(steps)]

    runs = [states(3, 9), [], states(2, 2)]
    paths = run_paths(runs, 5)
    assert paths.count == 3
    assert paths.owner.tolist() == [0, 0, 0, 1, 2, 2]
    assert np.array_equal(paths.F[:, :3], [runs[0][k][0] for k in (0, 2, 4, 6, 8)])
    assert np.array_equal(paths.F_dot[-1, 4:], runs[2][1][1])
    assert np.array_equal(paths.F[:, 3], np.broadcast_to(np.eye(2), (5, 2, 2)))


class ForgetfulLaw(SoftLaw):
    """Has no stress after a warm start at odd points; counts its states."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot)
        if state is not None:
            assert len(state) == len(F)
            answer.status[1::2] = Status.NOT_CONVERGED
            answer.stress[1::2] = np.nan
        return replace(answer, state=np.arange(len(F)))


@pytest.mark.parametrize("count", [3, CHUNK + 5])
def test_true_stress_along_paths(count):
    walks = random_walks(RANGE, count, 4, seed=6)
    done = []
    stress, status = true_stress(walks, ForgetfulLaw(), done.append)
    F, F_dot = walks.states
    assert not status.any()
    assert np.array_equal(stress, SoftLaw().respond(F, F_dot).stress)
    assert done == sorted(done)
    assert done[-1] == len(F)


def test_where_no_stress_is_found_the_status_says_so():
    walks = random_walks(RANGE, 60, 4, seed=6)
    stress, status = true_stress(walks, SoftLaw(fails_above=1.0))
    failed = walks.states[0][:, 0, 0] > 1.0
    assert 10 < failed.sum() < 150
    assert np.array_equal(status != 0, failed)
    assert np.array_equal(np.isnan(stress).all(axis=(1, 2)), failed)


class LawOfTwoBranches(SoftLaw):
    """Leaves its branch where F₁₂ > 0.03 and stays on the other, which differs where F₁₁ > 1."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot)
        left = F[:, 0, 1] > 0.03
        if state is not None:
            left |= state
        answer.stress[left & (F[:, 0, 0] > 1.0)] += 0.5
        return replace(answer, state=left, left_bifurcation=left)


def test_beyond_a_bifurcation_there_is_no_one_stress_but_back_on_the_branch_there_is():
    walks = random_walks(RANGE, 200, 12, seed=6)
    stress, status = true_stress(walks, LawOfTwoBranches())
    left = np.maximum.accumulate(walks.F[:, :, 0, 1] > 0.03)
    beyond, other = walks.F[:, :, 0, 1] > 0.03, walks.F[:, :, 0, 0] > 1.0
    lost = (beyond | (left & other)).reshape(-1)
    assert 100 < lost.sum() < left.sum() - 100
    assert np.array_equal(status == Status.UNSTABLE, lost)
    F, F_dot = walks.states
    assert np.array_equal(stress[~lost], SoftLaw().respond(F, F_dot).stress[~lost])
