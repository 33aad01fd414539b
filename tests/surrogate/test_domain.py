"""The failure boundary: every failed sample outside, few others, D4 and rotation; what is said."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.sampling import contains, sample
from surrofe2.base.tensors import to_inputs
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surrogate.deformation_paths import random_walks
from surrofe2.surrogate.domain import fit_domain
from tests.laws import RANGE, lattice_samples
from tests.surrogate.twins import buckles, samples_that_fail, with_bound, within


@pytest.mark.parametrize("fails", [lambda x: np.zeros(len(x), bool), buckles])
def test_valid_samples_are_inside_failed_ones_are_not(fails):
    samples = samples_that_fail(fails)
    domain = fit_domain(samples)
    inside = within(domain, samples.F, samples.F_dot)
    failed = samples.status != 0
    assert not inside[failed].any()
    share = inside[~failed].mean()
    assert share == 1.0 if not failed.any() else share > 0.9
    assert bool(len(domain.boundary)) == failed.any()
    assert within(domain, np.eye(2)[None], np.zeros((1, 2, 2))).all()


def test_failures_it_has_not_seen_are_outside_too():
    samples = samples_that_fail(buckles)
    assert 200 < (samples.status != 0).sum() < 2000
    domain = fit_domain(samples)
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
        assert why in answer.reasons[0], answer.reasons
