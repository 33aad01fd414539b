"""The bound holds on fresh paths, and planted faults show; what paths of calibration are."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, contains, sample
from surrofe2.base.tensors import stress_error, stress_spread, unrotated
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import Status
from surrofe2.store.store import plain
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from surrofe2.surrogate import calibration
from surrofe2.surrogate.calibration import (
    _failures,
    calibrate,
    confidence,
    conformal_quantile,
    errors_along,
)
from surrofe2.surrogate.deformation_paths import (
    CHUNK,
    DeformationPaths,
    Truth,
    WatchedLaw,
    random_walks,
    run_paths,
    true_stress,
)
from surrofe2.surrogate.settings import MARGIN, CalibrationSettings
from tests.laws import RANGE, KelvinVoigt, SoftLaw, failing, lattice_stress

ALPHA = 0.01


def truth(paths):
    F, F_dot = paths.states
    return Truth(paths, lattice_stress(F, F_dot), np.zeros(len(F), dtype=np.int8))


def single_states(count, seed):
    """Paths of a single state each, another kind than walks."""
    F, F_dot = sample(RANGE, count, seed)
    return DeformationPaths("runs", F[None], F_dot[None], np.arange(count))


def true_paths(count, seed):
    return [
        truth(random_walks(RANGE, count, 20, seed)),
        truth(single_states(3 * count, seed + 1)),
    ]


@pytest.fixture(scope="module")
def calibrated(law, samples):
    return calibrate(law, samples, true_paths(150, 10), true_paths(400, 20), ALPHA)


@pytest.mark.parametrize(
    ("count", "share", "rank"),
    [(98, 0.01, np.inf), (99, 0.01, 99), (400, 0.01, 400), (1000, 0.01, 996), (60, 0.1, 59)],
)
def test_quantile_is_the_rank_of_split_conformal_prediction(count, share, rank):
    scores = np.random.default_rng(1).permutation(count) + 1.0
    assert conformal_quantile(scores, share) == rank


@pytest.mark.parametrize(
    ("count", "alpha", "expected"), [(299, 0.01, 0.95), (298, 0.01, 0.94996), (9, 0.1, 0.61258)]
)
def test_the_confidence_of_so_many_paths(count, alpha, expected):
    """By simulation too: how often new scores exceed the quantile of these with at most alpha."""
    assert confidence(count, alpha) == pytest.approx(expected, abs=1e-5)
    rng = np.random.default_rng(4)
    quantiles = [conformal_quantile(rng.exponential(size=count), alpha) for _ in range(2000)]
    kept = (np.exp(-np.array(quantiles)) <= alpha).mean()
    assert kept > expected - 3.0 * np.sqrt(expected * (1.0 - expected) / 2000)
    if count < 299:
        assert kept == pytest.approx(expected, abs=0.04)


def test_the_bound_holds_on_fresh_paths(calibrated):
    """Share of broken paths: mean 1 %, ±√(0.01·0.99 (1/400 + 1/2000)), three of them."""
    fresh = truth(random_walks(RANGE, 2000, 20, seed=41))
    error, inside = errors_along(calibrated, fresh)
    bound = calibrated.error_bound(*fresh.paths.states)
    broken = fresh.paths.largest(np.where(inside & (error > bound), 1.0, 0.0)) > 0.0
    assert broken.mean() <= ALPHA + 3.0 * np.sqrt(ALPHA * (1 - ALPHA) * (1 / 400 + 1 / 2000))
    assert broken.mean() < 0.03


def test_what_is_recorded(calibrated, samples):
    record = calibrated.calibration
    assert calibrated.is_calibrated
    assert record.alpha == ALPHA
    assert record.confidence == 0.95
    assert {kind: figures["paths"] for kind, figures in record.kinds.items()} == {
        "walks": 400,
        "runs": 1200,
    }
    largest = max(figures["quantile"] for figures in record.kinds.values())
    assert record.quantile == MARGIN * largest
    assert record.stress_spread == pytest.approx(stress_spread(samples.stress))
    assert calibrated.stress_spread == record.stress_spread
    assert record.data_fingerprint == samples.fingerprint


@pytest.mark.parametrize("quantile", [None, np.inf])
def test_through_its_file(calibrated, tmp_path, quantile):
    """Be it infinite, too."""
    if quantile is not None:
        kinds = {"walks": {"paths": 9, "states": 90, "quantile": quantile}}
        record = replace(calibrated.calibration, quantile=quantile, kinds=kinds)
        calibrated = replace(calibrated, calibration=record)
    write_surrogate(calibrated, tmp_path / "a-surrogate.h5")
    loaded = read_surrogate(tmp_path / "a-surrogate.h5")
    F, F_dot = sample(RANGE, 1000, seed=3)
    assert np.array_equal(loaded.error_bound(F, F_dot), calibrated.error_bound(F, F_dot))
    assert loaded.is_calibrated
    assert plain(loaded.calibration) == plain(calibrated.calibration)


def corrupted(law, factor=1.001):
    """The largest weight of the last layer is off by a factor."""
    last = f"factors.{len(law.network.layers) - 1}.weight"
    matrix = law.network.tensors[last].copy()
    matrix.flat[np.abs(matrix).argmax()] *= factor
    tensors = {**law.network.tensors, last: matrix}
    return replace(law, network=replace(law.network, tensors=tensors))


def test_a_weight_corrupted_after_calibration_takes_the_bound_away(calibrated):
    F, F_dot = sample(RANGE, 100, seed=3)
    for fault in (
        corrupted(calibrated),
        replace(calibrated, range=SamplingRange(stretch=(0.9, 1.1), shear=0.08, rate=0.02)),
    ):
        assert not fault.is_calibrated
        assert fault.lookup(F, F_dot, 1e6)[1].all()
        assert np.isinf(fault.error_bound(F, F_dot)).all()


@pytest.mark.slow
def test_a_biased_surrogate_is_not_trusted(law, samples):
    """A constant error of 2 % of the spread everywhere: at 1e-3 nothing is accepted."""
    bias = 0.02 * law.stress_spread * np.diag([1.0, 0.0])

    def biased(part):
        return [replace(one, stress=one.stress + bias) for one in part]

    found = calibrate(law, samples, biased(true_paths(60, 10)), biased(true_paths(120, 20)), ALPHA)
    F, F_dot = sample(RANGE, 2000, seed=3)
    assert found.error_bound(F, F_dot).min() > 0.019 * law.stress_spread
    assert found.lookup(F, F_dot, 1e-3 * law.stress_spread)[1].all()


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.005, 0.05])
def test_an_error_in_one_corner_hardly_widens_the_bound_elsewhere(law, samples, monkeypatch, size):
    """By a share of the spread, where stretches differ and are sheared: the second fit sees it."""

    def faulty(part):
        found = []
        for one in part:
            U, _, _ = unrotated(*one.paths.states)
            there = (U[:, 0, 0] - U[:, 1, 1] > 0.08) & (U[:, 0, 1] < -0.04)
            fault = size * law.stress_spread * there[:, None, None] * np.diag([1.0, 0.0])
            found.append(replace(one, stress=one.stress + fault))
        return found

    def found_by(fits, faulty=faulty):
        monkeypatch.setattr(calibration, "_PROGRAMS", fits)
        shaping, testing = faulty(true_paths(150, 10)), faulty(true_paths(400, 20))
        return np.median(calibrate(law, samples, shaping, testing, ALPHA).error_bound(*inner))

    F, F_dot = sample(RANGE, 2000, seed=3)
    inner = np.eye(2) + 0.5 * (F - np.eye(2)), 0.5 * F_dot
    honest = found_by(calibration._PROGRAMS, lambda part: part)
    assert found_by(calibration._PROGRAMS) - honest < 0.5 * (found_by(1) - honest)


@pytest.mark.slow
def test_failures_within_the_domain_leave_no_bound(law, samples):
    """The true law has no stress on a tenth of the paths, anywhere on them."""
    tests = true_paths(120, 20)
    walks = tests[0]
    status = np.where(np.tile(walks.paths.owner, 20) % 10 == 0, 1, 0).astype(np.int8)
    tests[0] = replace(walks, status=status)
    found = calibrate(law, samples, true_paths(60, 10), tests, ALPHA)
    assert found.calibration.quantile == np.inf
    F, F_dot = sample(RANGE, 100, seed=3)
    assert found.lookup(F, F_dot, 1e300)[1].all()


@pytest.mark.slow
def test_a_path_ends_where_the_true_law_has_no_stress(law, samples):
    """What follows a failure is neither an error nor a failure, wherever it is."""
    walks = truth(random_walks(RANGE, 120, 20, seed=20))
    status = np.zeros((20, 120), dtype=np.int8)
    status[12, 7], status[13:, 7] = 1, 2
    lost = replace(walks, status=status.ravel())
    assert lost.reached.reshape(20, 120)[:13].all()
    assert not lost.reached.reshape(20, 120)[13:, 7].any()
    _, inside = errors_along(law, lost)
    assert not inside.reshape(20, 120)[13:, 7].any()
    F, _ = _failures([lost])
    np.testing.assert_array_equal(F, walks.paths.F[12, [7]])


def test_an_exact_surrogate_has_a_tiny_bound(law, samples):
    def exact(paths):
        stress, status, _ = law.lookup(*paths.states)
        stress[status != 0] = 0.0
        return Truth(paths, stress, np.zeros_like(status))

    parts = [[exact(random_walks(RANGE, 120, 5, seed))] for seed in (1, 2)]
    found = calibrate(law, samples, *parts, ALPHA)
    assert found.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0] < 1e-9


def test_no_path_at_all(law, samples):
    nothing = [truth(single_states(0, 1))]
    with pytest.raises(InputError, match="calibration: no path"):
        calibrate(law, samples, nothing, nothing, ALPHA)


def test_too_few_runs_for_the_confidence_are_refused():
    with pytest.raises(InputError, match=r"calibration\.runs: 98; it must be 0 or at least 99"):
        CalibrationSettings(runs=98)


@pytest.mark.parametrize("alpha", [0.3, 0.007, 7e-5, 1e-5])
def test_as_many_walks_as_the_message_asks_for_are_enough(alpha):
    with pytest.raises(InputError, match=r"calibration\.walks: 1; ") as refused:
        CalibrationSettings(walks=1, runs=0, alpha=alpha)
    needed = int(str(refused.value).partition("at least ")[2].partition(",")[0])
    CalibrationSettings(walks=needed, runs=0, alpha=alpha)
    with pytest.raises(InputError, match="at least"):
        CalibrationSettings(walks=needed - 1, runs=0, alpha=alpha)


def test_the_bound_holds_on_random_states(calibrated):
    F, F_dot = sample(RANGE, 20_000, seed=31)
    stress, status, bound = calibrated.lookup(F, F_dot)
    inside = status == 0
    assert inside.mean() > 0.98
    error = stress_error(stress, lattice_stress(F, F_dot))
    assert (error[inside] > bound[inside]).mean() <= ALPHA
    typical = np.median(error[inside])
    assert np.quantile(bound[inside], 0.99) < 30.0 * MARGIN * typical  # and it says something


WIDE = SamplingRange(stretch=(0.9, 1.05), shear=0.08, rate=0.01)


def components(F, F_dot):
    """(n, 7) U₁₁, U₂₂, U₁₂ and the entries of RᵀḞ."""
    U, A, _ = unrotated(F, F_dot)
    return np.hstack([U.reshape(-1, 4)[:, [0, 3, 1]], A.reshape(-1, 4)])


def scaled(range, x):
    """Within ±1 over the range."""
    lower, upper = range.ends
    return (2.0 * x - lower - upper) / (upper - lower)


def test_walks_begin_at_rest_and_are_smooth():
    walks = random_walks(WIDE, 50, 2001, seed=2)
    assert np.array_equal(walks.F[0], np.broadcast_to(np.eye(2), (50, 2, 2)))
    assert not walks.F_dot[0].any()
    for path, largest in ((walks.F, 0.3), (walks.F_dot, 0.05)):
        assert np.abs(np.diff(path, axis=0)).max() < 0.02 * largest


def test_walks_end_anywhere_in_the_range_many_in_corners():
    walks = random_walks(WIDE, 8000, 2, seed=3)
    x = scaled(WIDE, components(walks.F[-1], walks.F_dot[-1]))
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
    walks = random_walks(WIDE, 36_000, 2, seed=3)
    rest = scaled(WIDE, np.array([[1.0, 1.0, *[0.0] * 5]]))
    x = abs(scaled(WIDE, components(walks.F[-1], walks.F_dot[-1])) - rest)
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
    walks = random_walks(WIDE, count, 4, seed=6)
    done = []
    found = true_stress(walks, ForgetfulLaw(), done.append)
    F, F_dot = walks.states
    assert not found.status.any()
    assert np.array_equal(found.stress, SoftLaw().respond(F, F_dot).stress)
    assert done == sorted(done)
    assert done[-1] == len(F)


def test_where_no_stress_is_found_the_status_says_so():
    walks = random_walks(WIDE, 60, 4, seed=6)
    found = true_stress(walks, SoftLaw(fails_above=1.0))
    failed = walks.states[0][:, 0, 0] > 1.0
    assert 10 < failed.sum() < 150
    assert np.array_equal(found.status != 0, failed)
    assert np.array_equal(np.isnan(found.stress).all(axis=(1, 2)), failed)


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
    walks = random_walks(WIDE, 200, 12, seed=6)
    found = true_stress(walks, LawOfTwoBranches())
    left = np.maximum.accumulate(walks.F[:, :, 0, 1] > 0.03)
    beyond, other = walks.F[:, :, 0, 1] > 0.03, walks.F[:, :, 0, 0] > 1.0
    lost = (beyond | (left & other)).reshape(-1)
    assert 100 < lost.sum() < left.sum() - 100
    assert np.array_equal(found.status == Status.UNSTABLE, lost)
    F, F_dot = walks.states
    assert np.array_equal(found.stress[~lost], SoftLaw().respond(F, F_dot).stress[~lost])


class Counting(KelvinVoigt):
    """A law that counts the steps which it has committed."""

    steps = 0

    def accept(self, F, F_dot, response):
        return self.commit(F, F_dot, self.check(F, F_dot, response))

    def check(self, F, F_dot, response):
        return response

    def commit(self, F, F_dot, checked):
        self.steps += 1
        return checked


def test_a_learning_law_that_is_watched_commits_what_all_regions_accept():
    counting = Counting()
    watched = WatchedLaw(counting, lambda F, F_dot: None)
    other = failing(KelvinVoigt(), refuses=lambda F, F_dot: F[:, 0, 0] > 1.05)
    law = RegionalLaw({"a": watched, "b": other}, {"a": np.arange(2), "b": np.arange(2, 4)})
    for stretch in (1.01, 1.1, 1.04):
        F = np.tile(np.diag([stretch, 1.0]), (4, 1, 1))
        law.accept(F, 0.0 * F, law.respond(F, 0.0 * F))
    assert counting.steps == 2


@pytest.mark.parametrize("is_regional", [False, True])
def test_only_ends_of_steps_that_nobody_rejects_are_noted(is_regional):
    """Neither the law that is watched, nor that of another region, rejects what is noted."""
    noted, rejects = [], lambda F, F_dot: F[:, 0, 0] > 1.05
    watched = WatchedLaw(
        KelvinVoigt() if is_regional else failing(KelvinVoigt(), refuses=rejects),
        lambda F, F_dot: noted.append(F.copy()),
    )
    law = watched
    if is_regional:
        other = failing(KelvinVoigt(), refuses=rejects)
        law = RegionalLaw({"a": watched, "b": other}, {"a": np.arange(2), "b": np.arange(2, 4)})
    for stretch in (1.01, 1.1, 1.04):
        F = np.tile(np.diag([stretch, 1.0]), (4, 1, 1))
        accepted = law.accept(F, 0.0 * F, law.respond(F, 0.0 * F))
        assert accepted.status.any() == (stretch > 1.05)
    assert [F[0, 0, 0] for F in noted] == [1.01, 1.04]
    assert {len(F) for F in noted} == {2 if is_regional else 4}
