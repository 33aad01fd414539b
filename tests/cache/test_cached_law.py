"""Which part answers which point, what is counted, and what becomes of the fallback's state."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from surrofe2.cache import CachedLaw
from surrofe2.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.stress_law import Acceptance, Status, StressResponse
from surrofe2.tensors import det

CELL = CellParameters.preset("printed")
ZERO = np.zeros((1, 2, 2))


def exact(F, F_dot):
    return F - np.swapaxes(np.linalg.inv(F), 1, 2) + 3.0 * F_dot


@dataclass(frozen=True)
class Warmth:
    """A state that knows F of each of its points."""

    F: np.ndarray

    def take(self, indices):
        return Warmth(self.F[indices])

    def put(self, indices, state):
        F = self.F.copy()
        F[indices] = state.F
        return Warmth(F)


class TrueLaw:
    """Exact, remembers F, fails where F₁₁ > 2, notes what it was asked."""

    def __init__(self, cell=CELL, initialisation="elastic"):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density
        self.asked, self.accepted = [], []

    def respond(self, F, F_dot, state=None):
        self.asked.append((F.copy(), state))
        stress, status = exact(F, F_dot), np.zeros(len(F), dtype=np.int8)
        status[F[:, 0, 0] > 2.0] = Status.UNSTABLE
        stress[status != 0] = np.nan
        return StressResponse(stress, status, Warmth(F.copy()), {"rve_solves": len(F)})

    def accept(self, F, F_dot, response):
        self.accepted.append((F.copy(), response))
        status = response.status.copy()
        status[F[:, 0, 0] > 1.8] = Status.UNSTABLE
        return Acceptance(status, Warmth(response.state.F + 100.0))


class Surrogate:
    """Off by one, so that it can be told apart; out of range from F₁₁ = 1.5, NaN below 0.5."""

    def __init__(self, cell=CELL, initialisation="elastic"):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density

    def lookup(self, F, F_dot, tolerance=np.inf):
        with np.errstate(invalid="ignore"):
            stress = exact(F, F_dot) + 1.0
        status = np.zeros(len(F), dtype=np.int8)
        status[F[:, 0, 0] >= 1.5] = Status.OUT_OF_RANGE
        status[F[:, 0, 0] < 0.5] = Status.NOT_FINITE
        status[~(det(F) > 0.0)] = Status.OUT_OF_RANGE
        stress[status != 0] = np.nan
        return stress, status, np.full(len(F), 1.0)


def stretched(*stretches):
    F = np.eye(2) * np.ones((len(stretches), 1, 1))
    F[:, 0, 0] = stretches
    return F, np.full_like(F, 0.01)


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
    assert len(fallback.asked) == 1
    assert np.array_equal(fallback.asked[0][0], F[[1, 3, 4]])


def test_counts_and_effort_name_the_reason(cached):
    F, F_dot = stretched(1.0, 1.6, 1.1, 0.4, 1.7)
    counted = {
        "hits": 2,
        "fallbacks": 3,
        "fallbacks_out_of_range": 2,
        "fallbacks_not_finite": 1,
    }
    assert dict(cached.respond(F, F_dot).effort) == {**counted, "rve_solves": 3}
    assert cached.counts == counted
    cached.respond(F[:1], F_dot[:1])
    assert cached.counts == {**counted, "hits": 3}
    cached.counts["hits"] = 99
    assert cached.counts["hits"] == 3
    cached.reset_counts()
    assert set(cached.counts.values()) == {0}
    assert cached.respond(F, F_dot).effort["hits"] == 2  # effort is of one call, not of all


def test_without_a_miss_the_fallback_rests(cached, fallback):
    answer = cached.respond(*stretched(1.0, 1.2))
    accepted = cached.accept(*stretched(1.0, 1.2), answer)
    cached.respond(*stretched(1.0, 1.2), accepted.state)
    assert not fallback.asked
    assert not fallback.accepted
    assert not accepted.status.any()


def test_asked_twice_it_says_the_same(cached, fallback):
    F, F_dot = stretched(1.6, 1.0, 0.4)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    warm_before = state.fallback.F.copy()
    first, second = (cached.respond(1.01 * F, F_dot, state) for _ in range(2))
    assert np.array_equal(first.stress, second.stress)
    assert np.array_equal(first.state.fallback.F, second.state.fallback.F)
    assert np.array_equal(state.fallback.F, warm_before)
    starts = [start.F for _, start in fallback.asked[1:]]
    assert np.array_equal(starts[0], starts[1])


def test_accepted_warm_start_comes_back_to_its_points(cached, fallback):
    F, F_dot = stretched(1.0, 1.6, 1.1, 1.7)
    accepted = cached.accept(F, F_dot, cached.respond(F, F_dot))
    assert np.array_equal(fallback.accepted[0][0], F[[1, 3]])
    cached.respond(F, F_dot, accepted.state)
    assert np.array_equal(fallback.asked[1][1].F, F[[1, 3]] + 100.0)


def test_a_point_that_leaves_the_range_later_is_solved_cold(cached, fallback):
    F, F_dot = stretched(1.0, 1.6, 1.1, 1.7)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    later, _ = stretched(1.51, 1.52, 1.1, 1.54)
    answer = cached.respond(later, F_dot, state)
    (warm_F, warm), (cold_F, cold) = fallback.asked[1:]
    assert np.array_equal(warm_F, later[[1, 3]])
    assert np.array_equal(warm.F, F[[1, 3]] + 100.0)
    assert np.array_equal(cold_F, later[[0]])
    assert cold is None
    assert answer.state.points.tolist() == [0, 1, 3]
    assert np.array_equal(answer.state.fallback.F, later[[0, 1, 3]])
    assert answer.effort["rve_solves"] == 3
    off = np.array([0.0, 0.0, 1.0, 0.0])[:, None, None]
    np.testing.assert_allclose(answer.stress, exact(later, F_dot) + off, rtol=1e-14)


def test_points_that_came_back_and_others_that_left(cached, fallback):
    F, F_dot = stretched(1.6, 1.0)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    cached.respond(F[::-1], F_dot, state)
    asked, start = fallback.asked[1]
    assert np.array_equal(asked, F[[0]])
    assert start is None


def test_a_failure_of_the_fallback_is_passed_on(cached):
    F, F_dot = stretched(1.0, 2.5, 1.6)
    answer = cached.respond(F, F_dot)
    assert answer.status.tolist() == [Status.OK, Status.UNSTABLE, Status.OK]
    assert np.isnan(answer.stress[1]).all()
    assert cached.counts["fallbacks"] == 2


def test_the_fallback_may_refuse_a_step(cached):
    F, F_dot = stretched(1.9, 1.0, 1.6)
    answer = cached.respond(F, F_dot)
    accepted = cached.accept(F, F_dot, answer)
    assert accepted.status.tolist() == [Status.UNSTABLE, Status.OK, Status.OK]
    assert not answer.status.any()


def test_a_fallback_without_state_is_enough():
    class Stateless(TrueLaw):
        def respond(self, F, F_dot, state=None):
            assert state is None
            return StressResponse(exact(F, F_dot), np.zeros(len(F), dtype=np.int8))

        def accept(self, F, F_dot, response):
            return Acceptance(response.status, response.state)

    cached = CachedLaw(Surrogate(), Stateless())
    F, F_dot = stretched(1.6, 1.0)
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    answer = cached.respond(F, F_dot, state)
    np.testing.assert_allclose(answer.stress[0], exact(F, F_dot)[0], rtol=1e-14)


def test_no_points(cached):
    answer = cached.respond(np.empty((0, 2, 2)), np.empty((0, 2, 2)))
    assert answer.stress.shape == (0, 2, 2)


def test_other_parameters_or_initialisation_are_refused():
    water = CellParameters.preset("water")
    with pytest.raises(MismatchError) as error:
        CachedLaw(Surrogate(), TrueLaw(water))
    assert CELL.fingerprint in str(error.value)
    assert water.fingerprint in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(MismatchError, match="of initialisation elastic, the fallback of cauchy"):
        CachedLaw(Surrogate(), TrueLaw(initialisation="cauchy-born"))


@pytest.mark.parametrize(
    ("F", "message"),
    [
        (np.eye(2), "shape"),
        (np.nan * np.eye(2)[None], "not finite"),
        (np.diag([1.0, -1.0])[None], "det F"),
    ],
)
def test_wrong_input_is_refused(cached, F, message):
    with pytest.raises(InputError, match=message):
        cached.respond(F, ZERO)
    assert set(cached.counts.values()) == {0}


def test_lists_and_views_are_taken(cached):
    F, F_dot = stretched(1.0, 1.6, 1.1)
    expected = cached.respond(F, F_dot).stress
    assert np.array_equal(cached.respond(F.tolist(), F_dot.tolist()).stress, expected)
    assert np.array_equal(cached.respond(F[::-1], F_dot[::-1]).stress, expected[::-1])
    with pytest.raises(InputError, match="does not match"):
        cached.respond(F, F_dot[:2])


def test_density_is_the_cells(cached):
    assert cached.density == CELL.density


def test_a_corrupted_surrogate_falls_back_at_every_point():
    """The real surrogate, with a weight that is not a number."""
    torch = pytest.importorskip("torch")
    from dataclasses import replace

    from surrofe2.surrogate import TrainingSettings, train
    from tests.surrogate.lattice_law import lattice_samples, lattice_stress

    samples = lattice_samples(200)
    law = train(samples, TrainingSettings(hidden=(4,), baseline_degree=1, iterations=5))
    true_law = SimpleNamespace(
        cell=samples.cell,
        initialisation=samples.initialisation,
        density=samples.cell.density,
        respond=lambda F, F_dot, state: StressResponse(
            lattice_stress(F, F_dot), np.zeros(len(F), dtype=np.int8)
        ),
    )
    sound = CachedLaw(law, true_law)
    sound.respond(samples.F, samples.F_dot)
    assert sound.counts["hits"] == 200
    with torch.no_grad():
        law.network.layers[0].weight[0, 0] = float("nan")
    corrupted = CachedLaw(replace(law), true_law)
    answer = corrupted.respond(samples.F, samples.F_dot)
    assert corrupted.counts["fallbacks_not_finite"] == 200
    np.testing.assert_allclose(answer.stress, samples.stress)
