"""Paths that calibration is done on: within the range, consistent in time, asked in order."""

import numpy as np
import pytest

from surrofe2.load_case import LoadCase
from surrofe2.sampling import SamplingRange, contains
from surrofe2.stress_law import Acceptance, Status, StressResponse
from surrofe2.surrogate.deformation_paths import (
    CHUNK,
    DeformationPaths,
    WatchedLaw,
    random_corners,
    random_loads,
    random_small_states,
    random_states,
    random_walks,
    run_paths,
    true_stress,
)
from surrofe2.tensors import rotation, transpose
from tests.laws import SoftLaw

RANGE = SamplingRange(stretch=(0.9, 1.05), shear=0.08, rate=0.01)


def test_corners_are_where_all_stretches_are_near_a_bound():
    F, F_dot = random_corners(RANGE, 4000, seed=3).states
    assert contains(RANGE, F, F_dot).all()
    low, high = RANGE.stretch
    x = np.stack([F[:, 0, 0], F[:, 1, 1], F[:, 0, 1]], axis=1) - [*[0.5 * (low + high)] * 2, 0.0]
    x /= [0.5 * (high - low), 0.5 * (high - low), RANGE.shear]
    assert abs(x).min() >= 0.9 - 1e-12
    corners = np.unique(np.sign(x), axis=0, return_counts=True)[1]
    assert len(corners) == 8
    assert corners.min() > 400
    fast = (abs(F_dot) >= 0.9 * RANGE.rate - 1e-15).all(axis=(1, 2))
    assert 0.45 < fast.mean() < 0.55


def test_small_states_are_of_all_sizes_and_have_few_components_too():
    F, F_dot = random_small_states(RANGE, 9000, seed=3).states
    assert contains(RANGE, F, F_dot).all()
    U, half = F - np.eye(2), 0.5 * np.diff(RANGE.stretch)
    x = np.stack([U[:, 0, 0] / half, U[:, 1, 1] / half, U[:, 0, 1] / RANGE.shear], axis=1)
    x = abs(np.hstack([x.reshape(-1, 3), F_dot.reshape(-1, 4) / RANGE.rate]))
    decades = np.histogram(np.log10(x.max(axis=1)), [-4, -3, -2, -1, 0.5])[0]
    assert decades.min() > 200
    # one component large, all others below a fifth of it: each of the seven
    order = np.sort(x, axis=1)
    alone = (order[:, -1] > 0.1) & (order[:, -2] < 0.2 * order[:, -1])
    assert np.bincount(x[alone].argmax(axis=1), minlength=7).min() > 0


@pytest.mark.parametrize("narrow", [{}, {"shear": 0.0}, {"rate": 0.0}])
def test_walks_and_states_stay_in_the_range_and_fill_it(narrow):
    range = SamplingRange(**{"stretch": (0.9, 1.05), "shear": 0.08, "rate": 0.01, **narrow})
    for paths in (random_walks(range, 300, 30, seed=1), random_states(range, 9000, seed=1)):
        F, F_dot = paths.states
        assert F.flags.c_contiguous
        assert contains(range, F, F_dot).all()
        R = transpose(rotation(F))
        U, A = R @ F, R @ F_dot
        assert U[:, 0, 0].min() < 0.91
        assert U[:, 1, 1].max() > 1.04
        assert np.abs(U[:, 0, 1]).max() >= 0.9 * range.shear
        assert np.abs(A).max(axis=0).min() >= 0.7 * range.rate
        spread = U.reshape(-1, 4)[:, [0, 3]].std(axis=0)
        assert (spread > 0.02).all()


def test_rates_are_those_of_the_walk():
    """∫Ḟ dt along a walk is the change of F: times follow from F₂₂ where it moves."""
    walks = random_walks(RANGE, 20, 4001, seed=2)
    F, F_dot = walks.F, walks.F_dot
    mean = 0.5 * (F_dot[1:] + F_dot[:-1])
    step = np.diff(F, axis=0)
    # a walk's states are evenly spaced in time, by a spacing of its own
    spacing = (step * mean).sum(axis=(0, 2, 3)) / (mean**2).sum(axis=(0, 2, 3))
    assert (spacing > 0.0).all()
    missed = np.abs(step - spacing[:, None, None] * mean).max(axis=(0, 2, 3))
    assert (missed < 3e-3 * np.abs(step).max(axis=(0, 2, 3))).all()


def test_the_seed_alone_decides():
    first, second, other = (random_walks(RANGE, 5, 7, seed) for seed in (3, 3, 4))
    assert np.array_equal(first.F, second.F)
    assert np.array_equal(first.F_dot, second.F_dot)
    assert not np.array_equal(first.F, other.F)


def test_loads_push_everywhere_and_reverse():
    load = LoadCase()
    loads = random_loads(load, 200, seed=5)
    forces = np.array([one.body_force for one in loads])
    modulus = np.hypot(*forces.T)
    assert 0.05 <= modulus.min() < 0.07
    assert 0.55 < modulus.max() <= 0.6
    assert (np.sign(forces).std(axis=0) > 0.9).all()
    factors = np.array([[factor for _, factor in one.amplitude] for one in loads])
    assert (factors.min(axis=1) < 0.0).mean() > 0.8
    assert {one.duration for one in loads} == {50.0}
    assert all(one.amplitude_at(50.0) == one.amplitude[-1][1] for one in loads)


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
    assert run_paths([], 5).count == 0


def test_the_largest_on_each_path():
    rest = np.zeros((2, 3, 2, 2))
    paths = DeformationPaths("walks", rest, rest, np.array([0, 1, 1]))
    assert paths.largest(np.array([1.0, 2.0, 3.0, 7.0, 5.0, 6.0])).tolist() == [7.0, 6.0]


class ForgetfulLaw(SoftLaw):
    """Has no stress after a warm start at odd points; counts its states."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot)
        status = answer.status.copy()
        if state is not None:
            assert len(state) == len(F)
            status[1::2] = Status.NOT_CONVERGED
            answer.stress[1::2] = np.nan
        return StressResponse(answer.stress, status, np.arange(len(F)))

    def accept(self, F, F_dot, response):
        return Acceptance(response.status, response.state)


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
    walks = random_walks(RANGE, 40, 4, seed=6)
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
        return StressResponse(answer.stress, answer.status, left, left_bifurcation=left)

    def accept(self, F, F_dot, response):
        return Acceptance(response.status, response.state, None, response.left_bifurcation)


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


def test_a_watched_law_answers_as_before_and_tells_accepted_steps():
    met = []
    law, watched = SoftLaw(), WatchedLaw(SoftLaw(), lambda *state: met.append(state))
    F, F_dot = random_states(RANGE, 4, seed=1).states
    answer = watched.respond(F, F_dot)
    assert met == []
    assert np.array_equal(answer.stress, law.respond(F, F_dot).stress)
    watched.accept(F, F_dot, answer)
    ((noted, noted_dot),) = met
    assert np.array_equal(noted, F)
    assert np.array_equal(noted_dot, F_dot)
    assert watched.density == law.density
