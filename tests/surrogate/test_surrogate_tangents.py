"""Tangents and symmetry of a surrogate, whatever its weights."""

import numpy as np
import pytest

from surrofe2.base.sampling import sample
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.piola import to_piola, to_slopes, to_tangents
from tests.laws import RANGE, lattice_stress, tangents_by_differences
from tests.surrogate.networks import make_law


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=5)
    Q = np.array([[0.6, -0.8], [0.8, 0.6]])
    F = np.eye(2) + 0.99 * (F - np.eye(2))
    return Q @ F, 0.99 * Q @ F_dot


@pytest.mark.parametrize("symmetry", ["D4", "none"])
def test_tangents_are_the_slopes_of_the_stress(symmetry):
    law = make_law(symmetry)
    F, F_dot = turned_points(10)
    found = law.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(lambda *at: law.respond(*at).stress, F, F_dot, 1e-6)
    for name in ("P_by_F", "P_by_F_dot"):
        wanted = getattr(expected, name)
        assert np.abs(getattr(found, name) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_slopes_and_tangents_are_each_others_inverse():
    """Slopes by the inputs, differenced from the lattice's stress, against those of tangents."""
    F, F_dot = turned_points(10)
    exact = tangents_by_differences(lattice_stress, F, F_dot, 1e-6)
    slopes = to_slopes(F, exact.P_by_F, exact.P_by_F_dot)
    found = to_tangents(F, F_dot, to_piola(F, lattice_stress(F, F_dot)), slopes)
    for name in ("P_by_F", "P_by_F_dot"):
        wanted = getattr(exact, name)
        assert np.abs(getattr(found, name) - wanted).max() < 1e-7 * np.abs(wanted).max()


def test_no_tangents_where_there_is_no_stress():
    F = np.stack([np.eye(2), 1.5 * np.eye(2)])
    answer = make_law().respond(F, np.zeros((2, 2, 2)), tangents=True)
    assert answer.status.tolist() == [Status.OK, Status.OUT_OF_RANGE]
    for tangent in (answer.tangents.P_by_F, answer.tangents.P_by_F_dot):
        assert np.isfinite(tangent[0]).all()
        assert np.isnan(tangent[1]).all()
    assert make_law().respond(F, np.zeros((2, 2, 2))).tangents is None
