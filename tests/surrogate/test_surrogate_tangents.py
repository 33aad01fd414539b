"""Tangents of a surrogate, whatever its weights, and `QuadraticLaw`, which is made of tangents."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import sample
from surrofe2.base.tensors import stress_error, transpose
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.piola import QuadraticLaw, to_piola, to_slopes, to_tangents
from tests.laws import (
    RANGE,
    SoftLaw,
    TrueLattice,
    lattice_stress,
    tangents_by_differences,
)
from tests.numerics import assert_tangents_near
from tests.surrogate.twins import make_law

Q = np.array([[0.6, -0.8], [0.8, 0.6]])


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=5)
    F = np.eye(2) + 0.99 * (F - np.eye(2))
    return Q @ F, 0.99 * Q @ F_dot


@pytest.mark.parametrize("symmetry", ["D4", "none"])
def test_tangents_are_the_slopes_of_the_stress(symmetry):
    law = make_law(symmetry)
    F, F_dot = turned_points(10)
    found = law.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(lambda *at: law.respond(*at).stress, F, F_dot, 1e-6)
    assert_tangents_near(found, expected, 1e-6)


def test_slopes_and_tangents_are_each_others_inverse():
    """Slopes by the inputs, differenced from the lattice's stress, against those of tangents."""
    F, F_dot = turned_points(10)
    exact = tangents_by_differences(lattice_stress, F, F_dot, 1e-6)
    slopes = to_slopes(F, exact.P_by_F, exact.P_by_F_dot)
    found = to_tangents(F, F_dot, to_piola(F, lattice_stress(F, F_dot)), slopes)
    assert_tangents_near(found, exact, 1e-7)


def test_no_tangents_where_there_is_no_stress():
    F = np.stack([np.eye(2), 1.5 * np.eye(2)])
    answer = make_law().respond(F, np.zeros((2, 2, 2)), tangents=True)
    assert answer.status.tolist() == [Status.OK, Status.OUT_OF_RANGE]
    for tangent in (answer.tangents.P_by_F, answer.tangents.P_by_F_dot):
        assert np.isfinite(tangent[0]).all()
        assert np.isnan(tangent[1]).all()
    assert make_law().respond(F, np.zeros((2, 2, 2))).tangents is None


LAW = QuadraticLaw.of(TrueLattice())


def stress(F, F_dot):
    return LAW.respond(F, F_dot).stress


def test_it_agrees_with_the_law_to_first_order():
    """The error falls with the square of strain and rate, the stress with the first power."""
    F, F_dot = sample(RANGE, 40, 1)
    errors = []
    for factor in (0.2, 0.1):
        at = np.eye(2) + factor * (F - np.eye(2)), factor * F_dot
        errors.append(stress_error(stress(*at), lattice_stress(*at)).max() / factor)
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.1 * np.abs(stress(F, F_dot)).max()


def test_its_tangents_are_exact_far_from_rest():
    F, F_dot = sample(RANGE, 5, 2)
    F, F_dot = Q @ F @ np.diag([1.4, 0.7]), Q @ F_dot
    found = LAW.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(stress, F, F_dot)
    np.testing.assert_allclose(found.P_by_F, expected.P_by_F, rtol=0, atol=2e-6)
    np.testing.assert_allclose(found.P_by_F_dot, expected.P_by_F_dot, rtol=0, atol=2e-6)


def test_it_turns_with_the_material_and_has_an_energy():
    F, F_dot = sample(RANGE, 5, 3)
    np.testing.assert_allclose(stress(Q @ F, Q @ F_dot), Q @ stress(F, F_dot) @ Q.T, atol=1e-12)
    answer = LAW.respond(F, 0.0 * F, tangents=True)
    by_F = answer.tangents.P_by_F
    np.testing.assert_allclose(by_F, by_F.transpose(0, 3, 4, 1, 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(answer.stress, transpose(answer.stress), rtol=0, atol=1e-12)


def test_a_law_without_tangents_is_refused():
    with pytest.raises(InputError, match="quadratic law: SoftLaw has no tangents"):
        QuadraticLaw.of(SoftLaw())
