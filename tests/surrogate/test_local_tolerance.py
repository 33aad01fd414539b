"""What is allowed near rest, what audits make of it, and that a surrogate can keep it."""

import numpy as np
import pytest

from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import INPUTS, from_inputs, stress_error, to_inputs
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.surrogate import TrainingSettings, train
from surrofe2.workflow.generate import sample_stress
from tests.laws import RANGE, Learnt, Truth, stretched
from tests.numerics import assert_tangents_near
from tests.surrogate.twins import G, with_bound

TOLERANCE, RELATIVE = 0.4, 0.05
NEAR = SamplingRange(stretch=(0.96, 1.04), shear=0.04, rate=0.01)
REST = np.eye(2)[None], np.zeros((1, 2, 2))


@pytest.fixture(scope="module")
def trusted(law):
    """The analytic law's surrogate with an arbitrary bound, which is small beside `TOLERANCE`."""
    return with_bound(law, quantile=0.01)


@pytest.fixture(scope="module")
def held(trusted):
    return trusted.with_tolerance(TOLERANCE, RELATIVE)


def small_states(count, seed):
    """Drawn towards rest by factors of 1 to 0.001, each component by another, down to 0.1."""
    F, F_dot = sample(RANGE, count, seed)
    rng = np.random.default_rng(seed)
    whole, each = 1e-3 ** rng.random((count, 1, 1)), 0.1 ** rng.random((count, 7))
    stretch, rate = each[:, [0, 2, 2, 1]].reshape(-1, 2, 2), each[:, 3:].reshape(-1, 2, 2)
    return np.eye(2) + whole * stretch * (F - np.eye(2)), whole * rate * F_dot


@pytest.fixture(scope="module", params=["any", "small"])
def states(request, trusted):
    F, F_dot = small_states(2000, 5) if request.param == "small" else sample(RANGE, 2000, seed=5)
    inside = trusted.in_range(F, F_dot)
    return F[inside], F_dot[inside]


def test_the_kernel_is_its_numpy_twin(trusted, held, states):
    allowed = held.local_tolerance(*states)
    assert (allowed <= 1.0).all()
    assert allowed.min() < 0.8
    _, found = held.status_and_risk(*states)
    most = TOLERANCE * trusted.stress_spread
    np.testing.assert_allclose(found, trusted.error_bound(*states) / allowed / most, rtol=1e-10)
    assert np.array_equal(held.error_bound(*states), trusted.error_bound(*states))
    _, status, risk = held.lookup(*states, float(np.median(found)))
    assert np.array_equal(risk, found)
    assert np.array_equal(status == Status.NOT_TRUSTED, found > np.median(found))


def test_what_is_allowed_is_as_stated(trusted, held, states):
    h = 1e-6
    F, F_dot = from_inputs(h * np.eye(INPUTS), np.tile(np.eye(2), (INPUTS, 1, 1)))
    sizes = stress_error(trusted.extrapolate(F, F_dot), 0.0 * F) / h
    local = np.sqrt(to_inputs(*states)[0] ** 2 @ sizes**2)
    at_rest = 2.0 * trusted.error_bound(*REST)
    most = TOLERANCE * trusted.stress_spread
    allowed = np.minimum(most, at_rest + RELATIVE * local)
    np.testing.assert_allclose(held.local_tolerance(*states), allowed / most, rtol=5e-3)


def test_rotation_and_D4_make_no_difference(held):
    F, F_dot = small_states(300, seed=2)
    risk = held.lookup(F, F_dot)[2]
    for g in G:
        left = np.eye(2) if np.linalg.det(g) > 0 else g.T
        image = held.lookup(left @ F @ g, left @ F_dot @ g)[2]
        np.testing.assert_allclose(image, risk, rtol=1e-9)


def test_rest_itself_is_far_from_the_limit(held):
    assert held.lookup(*REST)[2][0] == pytest.approx(0.5)


@pytest.mark.parametrize("given", [(np.inf, RELATIVE), (TOLERANCE, np.inf)])
def test_without_one_of_them_the_other_counts_everywhere(trusted, held, states, given):
    free = held.with_tolerance(*given)
    risk = trusted.error_bound(*states) / (given[0] * trusted.stress_spread)
    np.testing.assert_allclose(free.lookup(*states)[2], risk, rtol=1e-12)
    assert (free.local_tolerance(*states) == 1.0).all()


@pytest.mark.parametrize(("tolerance", "risk"), [(TOLERANCE, np.inf), (np.inf, 0.0)])
def test_the_risk_of_a_surrogate_without_a_bound(law, tolerance, risk):
    free = law.with_tolerance(tolerance, RELATIVE)
    assert (free.lookup(*REST)[2] == risk).all()
    assert (free.local_tolerance(*REST) == 1.0).all()


class Strict(Learnt):
    """Where F₁₂ is small, a quarter of the tolerance is allowed."""

    def local_tolerance(self, F, F_dot):
        return np.where(abs(F[:, 0, 1]) < 0.05, 0.25, 1.0)


def test_audits_judge_by_the_same_rule():
    """An error of half the tolerance breaks it where a quarter of that is allowed."""
    F, F_dot = stretched(*np.linspace(1.0, 1.2, 40))
    F[::2, 0, 1] = 0.1
    size = 0.5e-3 * Learnt.stress_spread
    for kind, broken in ((Learnt, 0), (Strict, 20)):
        surrogate = kind(lambda F, F_dot: np.full(len(F), size), lambda F, F_dot: 1e-3 * F[:, 0, 0])
        law = CachedLaw(surrogate, Truth(), CacheSettings(audit=1.0))
        assert not law.accept(F, F_dot, law.respond(F, F_dot)).status.any()
        audit = law.report()["audit"]
        assert (audit["audited"], audit["violations"]) == (40, broken)
        assert audit["largest"] == pytest.approx((4.0 if broken else 1.0) * size)


@pytest.mark.parametrize("preset", ["printed", "water"])
def test_stress_and_moduli_at_rest_are_those_of_the_RVE(preset):
    """However little was learnt; so the error falls with the square of the load."""
    rve = RveLaw(CellParameters.preset(preset))
    samples = sample_stress(rve, NEAR, 64)
    surrogate = train(samples, TrainingSettings(hidden=(4,), iterations=3))
    found, true = (law.respond(*REST, tangents=True) for law in (surrogate, rve))
    assert np.abs(true.stress).max() < 1e-9 * surrogate.stress_spread
    assert (found.stress == 0.0).all()
    assert_tangents_near(found.tangents, true.tangents, 1e-6)
    F, F_dot = sample(NEAR, 100, seed=3)
    errors = [
        stress_error(*(law.respond(REST[0] + t * (F - REST[0]), t * F_dot).stress for law in both))
        for t, both in ((0.1, (surrogate, rve)), (0.01, (surrogate, rve)))
    ]
    assert errors[1].max() < 0.02 * errors[0].max()
