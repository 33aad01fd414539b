"""The bound holds on fresh paths, and planted faults show."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import stress_error, stress_spread, unrotated
from surrofe2.store.store import plain
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from surrofe2.surrogate import calibration
from surrofe2.surrogate.calibration import (
    Truth,
    _failures,
    calibrate,
    confidence,
    conformal_quantile,
    errors_along,
)
from surrofe2.surrogate.deformation_paths import DeformationPaths, random_walks
from surrofe2.surrogate.settings import MARGIN, CalibrationSettings
from tests.laws import RANGE, lattice_stress

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


def test_a_biased_surrogate_is_not_trusted(law, samples):
    """A constant error of 2 % of the spread everywhere: at 1e-3 nothing is accepted."""
    bias = 0.02 * law.stress_spread * np.diag([1.0, 0.0])

    def biased(part):
        return [replace(one, stress=one.stress + bias) for one in part]

    found = calibrate(law, samples, biased(true_paths(60, 10)), biased(true_paths(120, 20)), ALPHA)
    F, F_dot = sample(RANGE, 2000, seed=3)
    assert found.error_bound(F, F_dot).min() > 0.019 * law.stress_spread
    assert found.lookup(F, F_dot, 1e-3 * law.stress_spread)[1].all()


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
        monkeypatch.setattr(calibration, "_TIMES", fits)
        shaping, testing = faulty(true_paths(150, 10)), faulty(true_paths(400, 20))
        return np.median(calibrate(law, samples, shaping, testing, ALPHA).error_bound(*inner))

    F, F_dot = sample(RANGE, 2000, seed=3)
    inner = np.eye(2) + 0.5 * (F - np.eye(2)), 0.5 * F_dot
    honest = found_by(calibration._TIMES, lambda part: part)
    assert found_by(calibration._TIMES) - honest < 0.5 * (found_by(1) - honest)


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


def test_the_bound_holds_on_random_states(calibrated):
    F, F_dot = sample(RANGE, 20_000, seed=31)
    stress, status, bound = calibrated.lookup(F, F_dot)
    inside = status == 0
    assert inside.mean() > 0.98
    error = stress_error(stress, lattice_stress(F, F_dot))
    assert (error[inside] > bound[inside]).mean() <= ALPHA
    typical = np.median(error[inside])
    assert np.quantile(bound[inside], 0.99) < 30.0 * MARGIN * typical  # and it says something
