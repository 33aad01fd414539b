"""Which part answers which point, what is counted, and what becomes of the fallback's state."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.sampling import SamplingRange
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.stress_law import SURROGATE, Status, StressResponse
from surrofe2.macro import MacroSettings, simulate
from surrofe2.plant_cell.parameters import CellParameters
from tests.cache.tables import observed
from tests.laws import (
    CELL,
    Learnt,
    Memoryless,
    PointStates,
    Surrogate,
    TrueLaw,
    Truth,
    exact,
    stretched,
)


@pytest.fixture
def fallback():
    return TrueLaw()


@pytest.fixture
def cached(fallback):
    return CachedLaw(Surrogate(), fallback)


def test_each_point_is_answered_by_the_part_that_can(cached, fallback):
    F, F_dot = stretched(1.0, 1.6, 1.1, 0.4, 1.7)
    answer = cached.respond(F, F_dot)
    by_surrogate = np.array([1.0, 0.0, 1.0, 0.0, 0.0])[:, None, None]
    np.testing.assert_allclose(answer.stress, exact(F, F_dot) + by_surrogate, rtol=1e-14)
    assert not answer.status.any()
    assert (answer.effort["hits"], answer.effort["rve_solves"]) == (2, 3)
    assert len(fallback.asked) == 1
    assert np.array_equal(fallback.asked[0][0], F[[1, 3, 4]])


def test_what_left_the_range_is_counted_at_accepted_steps(fallback):
    """Three points leave by U₁₁, one by U₂₂; what another reason sent to the fallback is not."""
    cached = CachedLaw(Surrogate(), fallback)
    cached.surrogate.range = SamplingRange(stretch=(0.9, 1.5), shear=0.1, rate=0.1)
    F, F_dot = stretched(1.0, 1.6, 1.1, 0.4, 1.7, 1.6)
    F[5, 1, 1] = 3.0
    for _ in range(2):
        answer = cached.respond(F, F_dot)
        assert cached.history()["left_range"] == {}
    state = cached.accept(F, F_dot, answer).state
    F[1, 0, 0] = 1.55
    cached.accept(F, F_dot, cached.respond(F, F_dot, state))
    expected = {
        "U₁₁": {"points": 4, "farthest": pytest.approx(1.7), "bound": 1.5},
        "U₂₂": {"points": 2, "farthest": pytest.approx(3.0), "bound": 1.5},
    }
    assert cached.history()["left_range"] == expected
    again = CachedLaw(Surrogate(), fallback)
    again.state_from_arrays(cached.state_to_arrays(state))
    assert again.history()["left_range"] == expected


def test_counts_are_of_accepted_steps(cached):
    F, F_dot = stretched(1.0, 1.6, 1.1, 0.4, 1.7)
    for _ in range(3):
        answer = cached.respond(F, F_dot)
        assert set(cached.counts.values()) == {0}
    state = cached.accept(F, F_dot, answer).state
    assert cached.counts == {
        "hits": 2,
        "fallbacks": 3,
        "fallbacks_out_of_range": 2,
        "fallbacks_not_finite": 1,
        "fallbacks_not_trusted": 0,
        "in_domain": 3,
        "steps": 1,
        "switched": 0,
    }
    cached.accept(F, F_dot, cached.respond(F, F_dot, state))
    assert cached.counts["hits"] == 4
    cached.counts["hits"] = 99
    assert cached.counts["hits"] == 4
    cached.reset_counts()
    assert set(cached.counts.values()) == {0}


def test_a_refused_step_changes_nothing():
    cached, kept, learnt = observed(TrueLaw(), audit=1.0)
    F, F_dot = stretched(1.9, 1.0, 1.6)
    refused = cached.accept(F, F_dot, cached.respond(F, F_dot))
    assert refused.status.tolist() == [Status.UNSTABLE, Status.OK, Status.OK]
    assert set(cached.counts.values()) == {0}
    assert cached.report()["audit"]["audited"] == 0
    assert not kept
    assert not learnt


def test_asked_twice_it_says_the_same(cached, fallback):
    F, F_dot = stretched(1.6, 1.0, 0.4)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    warm_before = state.on_fallback.state.F.copy()
    first, second = (cached.respond(1.01 * F, F_dot, state) for _ in range(2))
    assert np.array_equal(first.stress, second.stress)
    assert np.array_equal(first.state.on_fallback.state.F, second.state.on_fallback.state.F)
    assert np.array_equal(state.on_fallback.state.F, warm_before)
    starts = [start.F for _, start in fallback.asked[1:]]
    assert np.array_equal(starts[0], starts[1])


def test_a_point_that_leaves_the_range_later_is_solved_cold_and_called_moved(cached, fallback):
    F, F_dot = stretched(1.0, 1.6, 1.1, 1.7)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    assert np.array_equal(fallback.accepted[0][0], F[[1, 3]])
    later, _ = stretched(1.51, 1.52, 1.1, 1.54)
    answer = cached.respond(later, F_dot, state)
    (warm_F, warm), (cold_F, cold) = fallback.asked[1:]
    assert np.array_equal(warm_F, later[[1, 3]])
    assert np.array_equal(warm.F, F[[1, 3]] + 100.0)
    assert np.array_equal(cold_F, later[[0]])
    assert cold is None
    assert answer.switched.tolist() == [Status.OUT_OF_RANGE, 0, 0, 0]
    assert answer.state.on_fallback.points.tolist() == [1, 3, 0]
    assert np.array_equal(answer.state.on_fallback.state.F, later[[1, 3, 0]])
    assert answer.effort["rve_solves"] == 3
    off = np.array([0.0, 0.0, 1.0, 0.0])[:, None, None]
    np.testing.assert_allclose(answer.stress, exact(later, F_dot) + off, rtol=1e-14)


def test_a_point_on_the_fallback_comes_back_when_its_step_is_kept_not_within(cached, fallback):
    F, F_dot = stretched(1.6, 1.0)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    back, _ = stretched(1.4, 1.1)
    answer = cached.respond(back, F_dot, state)
    assert np.array_equal(fallback.asked[-1][0], back[[0]])
    off = np.array([0.0, 1.0])[:, None, None]
    np.testing.assert_allclose(answer.stress, exact(back, F_dot) + off, rtol=1e-14)
    assert answer.switched is None
    assert answer.effort["fallbacks_out_of_range"] == 1  # why it left
    accepted = cached.accept(back, F_dot, answer)
    assert not len(accepted.state.on_fallback)
    # The next step begins with the surrogate's stress there.
    np.testing.assert_allclose(accepted.stress, exact(back, F_dot) + 1.0, rtol=1e-14)
    assert cached.respond(back, F_dot, accepted.state).effort["hits"] == 2


def test_a_point_on_its_way_out_begins_the_next_step_on_the_fallback(cached, fallback):
    F, _ = stretched(1.2, 1.0)
    further, _ = stretched(1.4, 1.0)  # one more such step would end at 1.6
    F_dot = 0.1 * (further - F)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    accepted = cached.accept(further, F_dot, cached.respond(further, F_dot, state))
    assert accepted.state.on_fallback.points.tolist() == [0]
    assert np.array_equal(accepted.state.on_fallback.state.F, further[[0]] + 100.0)
    np.testing.assert_allclose(accepted.stress[0], exact(further, F_dot)[0], rtol=1e-14)
    np.testing.assert_allclose(accepted.stress[1], exact(further, F_dot)[1] + 1.0, rtol=1e-14)
    out, _ = stretched(1.55, 1.0)
    assert cached.respond(out, F_dot, accepted.state).switched is None
    assert cached.counts["switched"] == 1


def test_the_start_of_a_step_once_more_with_points_moved(cached):
    F, F_dot = stretched(1.6, 1.3, 1.0)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    out, _ = stretched(1.6, 1.55, 1.0)
    switched = cached.respond(out, F_dot, state).switched
    start = StressResponse(exact(F, F_dot), np.zeros(3, dtype=np.int8), state)
    begun = cached.restart_step(F, F_dot, start, switched)
    assert not begun.status.any()
    np.testing.assert_allclose(begun.stress[1], exact(F, F_dot)[1], rtol=1e-14)
    assert begun.state.on_fallback.points.tolist() == [0, 1]
    again = cached.respond(out, F_dot, begun.state)
    assert again.switched is None
    np.testing.assert_allclose(again.stress[1], exact(out, F_dot)[1], rtol=1e-14)


def test_a_state_for_other_points_is_refused(cached):
    F, F_dot = stretched(1.6, 1.3, 1.0)
    state = cached.respond(F, F_dot).state
    with pytest.raises(InputError, match="not a state of a CachedLaw for 2 points"):
        cached.respond(F[:2], F_dot[:2], state)


def test_a_failure_of_the_fallback_is_passed_on(cached):
    F, F_dot = stretched(1.0, 2.5, 1.6)
    answer = cached.respond(F, F_dot)
    assert answer.status.tolist() == [Status.OK, Status.UNSTABLE, Status.OK]
    assert np.isnan(answer.stress[1]).all()
    assert answer.effort["fallbacks"] == 2


def test_a_fallback_without_state_is_enough():
    class Stateless(Memoryless):
        cell, initialisation, stress = CELL, "elastic", staticmethod(exact)

    cached = CachedLaw(Surrogate(), Stateless())
    F, F_dot = stretched(1.6, 1.0)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    answer = cached.respond(F, F_dot, state)
    np.testing.assert_allclose(answer.stress[0], exact(F, F_dot)[0], rtol=1e-14)


def test_other_parameters_or_initialisation_are_refused():
    water = CellParameters.preset("water")
    with pytest.raises(MismatchError) as error:
        CachedLaw(Surrogate(), TrueLaw(water))
    assert CELL.fingerprint in str(error.value)
    assert water.fingerprint in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(MismatchError, match="of initialisation elastic, the fallback of cauchy"):
        CachedLaw(Surrogate(), TrueLaw(initialisation="cauchy-born"))


class Leaving(TrueLaw):
    """Leaves at accepted steps where F₁₁ > 1.6, and has a stress of 7 everywhere from there."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, state)
        return replace(answer, state=PointStates(F.copy(), leaves_above=1.6))

    def accept(self, F, F_dot, response):
        left = response.state.left_points
        stress = np.where(left[:, None, None], 7.0, response.stress)
        return replace(response, stress=stress, left_bifurcation=left)


def test_stress_beyond_a_bifurcation_is_passed_on_but_neither_kept_nor_learnt():
    cached, kept, learnt = observed(Leaving())
    F, F_dot = stretched(1.1, 1.7, 1.55)
    first = cached.respond(F, F_dot)
    accepted = cached.accept(F, F_dot, first)
    assert accepted.left_bifurcation.tolist() == [False, True, False]
    assert (accepted.stress[1] == 7.0).all()
    np.testing.assert_array_equal(accepted.stress[[0, 2]], first.stress[[0, 2]])
    for ((at, *_),) in (kept, learnt):
        assert at[:, 0, 0].tolist() == [1.55]


def strain(F):
    return abs(F - np.eye(2)).max(axis=(1, 2))


def law_by_strain(tolerance=0.01):
    """Out of range above a strain of 0.02, bound above the tolerance from 0.01 on."""
    surrogate = Learnt(
        error=lambda F, F_dot: np.zeros(len(F)),
        bound=lambda F, F_dot: strain(F),
        outside=lambda F: strain(F) > 0.02,
    )
    return CachedLaw(surrogate, Truth(), CacheSettings(tolerance=tolerance / 10.0, audit=0.0))


def test_sources_and_risks_of_an_answer():
    F = np.tile(np.eye(2), (3, 1, 1))
    F[:, 0, 1] = 0.005, 0.015, 0.025
    told = law_by_strain().respond(F, 0.0 * F).sources()
    assert told.source.tolist() == [SURROGATE, Status.NOT_TRUSTED, Status.OUT_OF_RANGE]
    np.testing.assert_allclose(told.risk, [0.5, 0.0, 0.0])


def test_frames_keep_the_largest_of_each_element():
    load = LoadCase(duration=20.0, body_force=(0.0, -0.2), elements=(4, 2))
    frames = simulate(load, law_by_strain(), MacroSettings(frames=6)).frames
    assert frames.source.shape == frames.risk.shape == (len(frames.t), 8)
    assert (frames.source[0] == SURROGATE).all()
    hit = frames.source == SURROGATE
    assert 0 < hit.sum() < hit.size
    known = {SURROGATE, Status.NOT_TRUSTED, Status.OUT_OF_RANGE}
    assert known.issuperset(frames.source.ravel())
    assert (frames.risk <= 1.0).all()
    # Of the points of an element the middle one is among those whose largest risk is told.
    middle = strain(frames.F.reshape(-1, 2, 2)).reshape(hit.shape)
    assert (frames.risk[hit] >= middle[hit] / 0.01 * (1.0 - 1e-12)).all()
