"""Domain, bound and local tolerance against their numpy twins, and what audits make of them."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.sampling import SamplingRange, contains, sample
from surrofe2.base.tensors import INPUTS, from_inputs, stress_error, to_inputs
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.surrogate import TrainingSettings, train
from surrofe2.surrogate.deformation_paths import random_walks
from surrofe2.surrogate.domain import fit_domain, scale_products, scaled_inputs, values_of
from surrofe2.surrogate.lookup import MANY
from surrofe2.workflow.generate import sample_stress
from tests.laws import RANGE, Learnt, Truth, lattice_samples, stretched
from tests.numerics import assert_tangents_near, turn
from tests.surrogate.twins import G, buckles, samples_that_fail, with_bound, within


@pytest.fixture(scope="module")
def trusted(law):
    """The analytic law's surrogate with a failure boundary and an arbitrary bound."""
    return with_bound(law)


def turned(count, seed=1):
    """States of the range and beyond it, in any orientation; some inside out."""
    F, F_dot = sample(replace(RANGE, stretch=(0.9, 1.1), rate=0.011), count, seed)
    R = turn(np.random.default_rng(seed).uniform(-np.pi, np.pi, count))
    F = R @ F
    F[5::40, 0] *= -1.0
    return F, R @ F_dot


@pytest.mark.parametrize("count", [1, 41, 3001])
def test_the_kernel_is_its_numpy_twin(trusted, count):
    F, F_dot = turned(count)
    inside = contains(RANGE, F, F_dot) & within(trusted.domain, F, F_dot)
    x = scaled_inputs(F, F_dot, trusted.domain.scale)
    scale = values_of(scale_products(), x, trusted.calibration.near) @ trusted.calibration.scale
    bound = 0.7 * scale
    found = trusted.error_bound(F, F_dot)
    assert np.array_equal(np.isfinite(found), inside)
    assert np.array_equal(trusted.in_range(F, F_dot), inside)
    np.testing.assert_allclose(found[inside], bound[inside], rtol=1e-10)
    if count > 3000:
        assert 0.1 < inside.mean() < 0.9


def test_the_tolerance_decides_point_by_point(trusted):
    F, F_dot = turned(500)
    free, _, bound = trusted.lookup(F, F_dot)
    inside = np.isfinite(bound)
    tolerance = float(np.median(bound[inside]))
    stress, status, same = trusted.lookup(F, F_dot, tolerance)
    assert np.array_equal(same, bound)
    trusted_ones = bound <= tolerance
    expected = np.where(trusted_ones, Status.OK, Status.NOT_TRUSTED)
    assert np.array_equal(status, np.where(inside, expected, Status.OUT_OF_RANGE))
    assert np.array_equal(stress[trusted_ones], free[trusted_ones])
    assert np.isnan(stress[~trusted_ones]).all()
    at_bound = trusted.lookup(F[trusted_ones], F_dot[trusted_ones], bound[trusted_ones].max())
    assert not at_bound[1].any()


@pytest.mark.parametrize("count", [0, 7, MANY + 3])
def test_status_and_risk_need_no_stress(trusted, count):
    F, F_dot = turned(count)
    F[3::50] *= 2.0
    some = trusted.error_bound(*turned(200))
    some = np.median(some[np.isfinite(some)])
    _, status, bound = trusted.lookup(F, F_dot, some)
    found = trusted.status_and_risk(F, F_dot, some)
    assert count < MANY or len(set(status.tolist())) == 3
    assert np.array_equal(found[0], status)
    assert np.array_equal(found[1], bound)


def test_it_never_falls_on_the_way_out_and_ends_at_infinity(trusted):
    rng = np.random.default_rng(4)
    U = rng.uniform(-0.1, 0.1, (50, 2, 2))
    U = 0.5 * (U + np.swapaxes(U, 1, 2))
    A = rng.uniform(-0.012, 0.012, (50, 2, 2))
    steps = np.linspace(0.0, 2.0, 41)
    rays = np.stack([trusted.error_bound(np.eye(2) + t * U, t * A) for t in steps])
    assert np.isfinite(rays[0]).all()
    assert np.isinf(rays[-1]).all()
    known = np.isfinite(rays[1:])
    assert (rays[1:][known] >= rays[:-1][known]).all()


def test_what_is_not_a_number_has_no_bound(trusted):
    for value in (np.nan, np.inf, -np.inf):
        for k in range(8):
            F, F_dot = np.eye(2)[None].copy(), np.zeros((1, 2, 2))
            (F if k < 4 else F_dot).flat[k % 4] = value
            stress, status, bound = trusted.lookup(F, F_dot, 1e6)
            assert status[0] == Status.OUT_OF_RANGE
            assert np.isnan(stress).all()
            assert bound[0] == np.inf


def test_without_calibration_no_finite_tolerance_accepts(law):
    F, F_dot = sample(RANGE, 100, seed=1)
    for surrogate in (law, replace(law, domain=None)):
        stress, status, bound = surrogate.lookup(F, F_dot, 1e300)
        assert not surrogate.is_calibrated
        assert np.isinf(bound).all()
        assert np.isin(status, (Status.NOT_TRUSTED, Status.OUT_OF_RANGE)).all()
        assert np.isnan(stress).all()
        inside = surrogate.in_range(F, F_dot)
        assert np.array_equal(surrogate.lookup(F, F_dot)[1] == 0, inside)
        assert inside.mean() > 0.9


def share_inside(samples, domain):
    """Of the valid samples; no failed one is inside, and rest is."""
    inside, failed = within(domain, samples.F, samples.F_dot), samples.status != 0
    assert not inside[failed].any()
    assert within(domain, np.eye(2)[None], np.zeros((1, 2, 2))).all()
    return inside[~failed].mean()


def test_valid_samples_are_inside_failures_are_not_be_they_seen_or_not():
    samples = samples_that_fail(buckles)
    assert 200 < (samples.status != 0).sum() < 2000
    domain = fit_domain(samples)
    assert share_inside(samples, domain) > 0.9
    F, F_dot = sample(RANGE, 20_000, seed=8)
    failed = buckles(to_inputs(F, F_dot)[0])
    inside = within(domain, F, F_dot)
    assert failed.sum() > 4000
    assert inside[failed].mean() < 1e-3
    assert inside[~failed].mean() > 0.85


@pytest.mark.parametrize("count", [1, 20])
def test_a_few_failures_are_outside(count):
    """The most compressed samples of all fail."""
    compressed = lattice_samples(4000)
    lowest = to_inputs(compressed.F, compressed.F_dot)[0][:, 0]
    samples = samples_that_fail(lambda x: x[:, 0] <= np.sort(lowest)[count - 1])
    assert (samples.status != 0).sum() == count
    assert share_inside(samples, fit_domain(samples)) > 0.7


def test_failures_found_later_are_outside():
    samples = samples_that_fail(buckles)
    failed = samples.status != 0
    innocent = replace(
        samples,
        **{k: getattr(samples, k)[~failed] for k in ("F", "F_dot", "stress", "status")},
    )
    lost = samples.F[failed], samples.F_dot[failed]
    assert within(fit_domain(innocent), *lost).any()
    assert not within(fit_domain(innocent, lost), *lost).any()


def test_without_symmetry_only_rotation_is_used():
    samples = samples_that_fail(lambda x: (x[:, 2] > 0.05) | (x[:, 1] < -0.1), 1500)
    irregular = CellParameters.preset("printed", arrangement="voronoi", cells=9)
    samples = replace(samples, cell=irregular)
    domain = fit_domain(samples)
    inside = within(domain, samples.F, samples.F_dot)
    assert not domain.square
    assert share_inside(samples, domain) > 0.7
    mirror = np.diag([1.0, -1.0])
    mirrored = within(domain, mirror @ samples.F @ mirror, mirror @ samples.F_dot @ mirror)
    assert not np.array_equal(inside, mirrored)


def test_a_domain_without_boundary_is_the_range(law):
    """The corners of the box too, where no sample came as far in all directions at once."""
    F, F_dot = random_walks(RANGE, 2000, 2, seed=3).states
    assert not len(law.domain.boundary)
    assert contains(RANGE, F, F_dot).all()
    assert (law.respond(F, F_dot).status == Status.OK).all()


def test_why_there_is_no_stress_is_told(law):
    trusted = with_bound(law)
    F_dot = np.zeros((1, 2, 2))
    for F, why in (
        (np.diag([0.93, 0.93]), "beyond the failure boundary, where samples have no stress"),
        (np.diag([1.5, 1.0]), "U₁₁"),
    ):
        answer = trusted.respond(F[None], F_dot)
        assert answer.status[0] == Status.OUT_OF_RANGE
        assert np.isnan(answer.stress).all()
        assert why in answer.reasons[0], answer.reasons


TOLERANCE, RELATIVE = 0.4, 0.05
NEAR = SamplingRange(stretch=(0.96, 1.04), shear=0.04, rate=0.01)
REST = np.eye(2)[None], np.zeros((1, 2, 2))


@pytest.fixture(scope="module")
def narrow(law):
    """The analytic law's surrogate with an arbitrary bound, which is small beside `TOLERANCE`."""
    return with_bound(law, quantile=0.01)


@pytest.fixture(scope="module")
def held(narrow):
    return narrow.with_tolerance(TOLERANCE, RELATIVE)


def small_states(count, seed):
    """Drawn towards rest by factors of 1 to 0.001, each component by another, down to 0.1."""
    F, F_dot = sample(RANGE, count, seed)
    rng = np.random.default_rng(seed)
    whole, each = 1e-3 ** rng.random((count, 1, 1)), 0.1 ** rng.random((count, 7))
    stretch, rate = each[:, [0, 2, 2, 1]].reshape(-1, 2, 2), each[:, 3:].reshape(-1, 2, 2)
    return np.eye(2) + whole * stretch * (F - np.eye(2)), whole * rate * F_dot


@pytest.fixture(scope="module", params=["any", "small"])
def states(request, narrow):
    F, F_dot = small_states(2000, 5) if request.param == "small" else sample(RANGE, 2000, seed=5)
    inside = narrow.in_range(F, F_dot)
    return F[inside], F_dot[inside]


def test_the_risk_is_its_numpy_twin(narrow, held, states):
    allowed = held.local_tolerance(*states)
    assert (allowed <= 1.0).all()
    assert allowed.min() < 0.8
    _, found = held.status_and_risk(*states)
    most = TOLERANCE * narrow.stress_spread
    np.testing.assert_allclose(found, narrow.error_bound(*states) / allowed / most, rtol=1e-10)
    assert np.array_equal(held.error_bound(*states), narrow.error_bound(*states))
    _, status, risk = held.lookup(*states, float(np.median(found)))
    assert np.array_equal(risk, found)
    assert np.array_equal(status == Status.NOT_TRUSTED, found > np.median(found))


def test_what_is_allowed_is_as_stated(narrow, held, states):
    h = 1e-6
    F, F_dot = from_inputs(h * np.eye(INPUTS), np.tile(np.eye(2), (INPUTS, 1, 1)))
    sizes = stress_error(narrow.extrapolate(F, F_dot), 0.0 * F) / h
    local = np.sqrt(to_inputs(*states)[0] ** 2 @ sizes**2)
    at_rest = 2.0 * narrow.error_bound(*REST)
    most = TOLERANCE * narrow.stress_spread
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
def test_without_one_of_them_the_other_counts_everywhere(narrow, held, states, given):
    free = held.with_tolerance(*given)
    risk = narrow.error_bound(*states) / (given[0] * narrow.stress_spread)
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
