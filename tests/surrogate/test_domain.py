"""Where the data are: every valid sample inside, every failed one outside, D4 and rotation."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, contains, sample
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.deformation_paths import random_states
from surrofe2.surrogate.domain import Domain, why_outside
from surrofe2.surrogate.domain_fit import fit_domain
from surrofe2.tensors import to_inputs
from tests.laws import CELL, RANGE, lattice_samples
from tests.surrogate.domain_twin import within
from tests.surrogate.failing_samples import G, buckles, samples_that_fail


@pytest.mark.parametrize("fails", [lambda x: np.zeros(len(x), bool), buckles])
def test_valid_samples_are_inside_failed_ones_are_not(fails):
    samples = samples_that_fail(fails)
    domain = fit_domain(samples)
    inside = within(domain, samples.F, samples.F_dot)
    failed = samples.status != 0
    assert not inside[failed].any()
    share = inside[~failed].mean()
    assert share == 1.0 if not failed.any() else share > 0.9
    assert within(domain, np.eye(2)[None], np.zeros((1, 2, 2))).all()


def test_failures_it_has_not_seen_are_outside_too():
    samples = samples_that_fail(buckles)
    assert 200 < (samples.status != 0).sum() < 2000
    domain = fit_domain(samples)
    F, F_dot = random_states(RANGE, 20_000, seed=8).states
    failed = buckles(to_inputs(F, F_dot)[0])
    inside = within(domain, F, F_dot)
    assert failed.sum() > 4000
    assert inside[failed].mean() < 1e-3
    assert inside[~failed].mean() > 0.85


@pytest.mark.parametrize("count", [1, 3, 20])
def test_a_few_failures_are_outside(count):
    """The most compressed samples of all fail."""
    compressed = lattice_samples(4000)
    lowest = to_inputs(compressed.F, compressed.F_dot)[0][:, 0]
    samples = samples_that_fail(lambda x: x[:, 0] <= np.sort(lowest)[count - 1])
    inside = within(fit_domain(samples), samples.F, samples.F_dot)
    assert (samples.status != 0).sum() == count
    assert not inside[samples.status != 0].any()
    assert inside[samples.status == 0].mean() > 0.7


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


def test_it_is_no_box():
    """Data along a diagonal do not make the other diagonal known."""
    samples = lattice_samples(4000)
    x = to_inputs(samples.F, samples.F_dot)[0]
    diagonal = np.abs(x[:, 0] - 8.0 * x[:, 3]) < 0.06
    narrow = replace(
        samples,
        **{k: getattr(samples, k)[diagonal] for k in ("F", "F_dot", "stress", "status")},
    )
    domain = fit_domain(narrow)
    inside = within(domain, samples.F, samples.F_dot)
    assert inside[diagonal].all()
    far = np.abs(x[:, 0] - 8.0 * x[:, 3]) > 0.061
    assert far.sum() > 500
    assert not inside[far].any()
    assert contains(RANGE, samples.F[far], samples.F_dot[far]).all()


@pytest.mark.parametrize("fails", [lambda x: np.zeros(len(x), bool), buckles])
def test_rotation_and_D4_make_no_difference(fails):
    rng = np.random.default_rng(0)
    domain = fit_domain(samples_that_fail(fails, 600))
    F = np.eye(2) + rng.uniform(-0.1, 0.1, (2000, 2, 2))
    F_dot = rng.uniform(-0.012, 0.012, (2000, 2, 2))
    inside = within(domain, F, F_dot)
    assert 50 < inside.sum() < 1950
    angle = 1.234
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for g in G:
        left = Q if np.linalg.det(g) > 0 else Q @ g.T
        assert np.array_equal(within(domain, left @ F @ g, left @ F_dot @ g), inside)


def test_without_symmetry_only_rotation_is_used():
    samples = samples_that_fail(lambda x: (x[:, 2] > 0.05) | (x[:, 1] < -0.1), 1500)
    irregular = CellParameters.preset("printed", arrangement="voronoi", cells=9)
    samples = replace(samples, cell=irregular)
    domain = fit_domain(samples)
    inside = within(domain, samples.F, samples.F_dot)
    assert not domain.square
    assert not inside[samples.status != 0].any()
    assert inside[samples.status == 0].mean() > 0.7
    mirror = np.diag([1.0, -1.0])
    mirrored = within(domain, mirror @ samples.F @ mirror, mirror @ samples.F_dot @ mirror)
    assert not np.array_equal(inside, mirrored)


def test_what_is_not_a_number_is_outside():
    domain = fit_domain(lattice_samples(300))
    for value in (np.nan, np.inf, -np.inf):
        for k in range(8):
            F, F_dot = np.eye(2)[None].copy(), np.zeros((1, 2, 2))
            (F if k < 4 else F_dot).flat[k % 4] = value
            assert not within(domain, F, F_dot).any()


def test_a_range_of_no_width_in_some_directions():
    flat = SamplingRange(stretch=(0.95, 1.05), shear=0.0, rate=0.0)
    F, F_dot = sample(flat, 100, seed=1)
    samples = StressSamples(
        F=F, F_dot=F_dot, stress=np.zeros_like(F), status=np.zeros(100, dtype=np.int8),
        cell=CELL, initialisation="elastic", range=flat, seed=1,
    )  # fmt: skip
    domain = fit_domain(samples)
    assert within(domain, F, F_dot).all()
    assert not within(domain, F, F_dot + 0.01).any()


def test_what_is_beyond_the_samples_is_named():
    one = Domain(
        scale=np.ones(7),
        square=True,
        pairs=np.array([[0, 0], [2, 5]]),
        signs=np.array([[-1.0, 0.0], [1.0, 1.0]]),
        limits=np.array([0.1, 0.05]),
        cliff=np.empty(0),
    )
    F, F_dot = np.array([[[0.9, 0.0], [0.0, 0.95]]]), np.zeros((1, 2, 2))
    assert why_outside(one, F, F_dot).startswith("− (U₁₁ + U₂₂ − 2) = 0.15 of at most 0.1 that")
    F, F_dot = np.array([[[1.0, -0.02], [-0.02, 1.0]]]), np.full((1, 2, 2), 0.01)
    found = why_outside(one, F, F_dot)
    assert found.startswith("|2 U₁₂| + |(A₁₂ + A₂₁)| = 0.06 of at most 0.05 that samples reach")
    assert found.endswith("after the rotation is taken out, 0.01 beyond")
