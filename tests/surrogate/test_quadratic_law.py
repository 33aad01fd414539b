"""`QuadraticLaw`: the tangents of a law at rest as an objective law of its own."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import sample
from surrofe2.base.tensors import stress_error, transpose
from surrofe2.surrogate.piola import QuadraticLaw
from tests.laws import (
    RANGE,
    SoftLaw,
    TrueLattice,
    lattice_stress,
    tangents_by_differences,
)

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
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    F, F_dot = turn @ F @ np.diag([1.4, 0.7]), turn @ F_dot
    found = LAW.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(stress, F, F_dot)
    np.testing.assert_allclose(found.P_by_F, expected.P_by_F, rtol=0, atol=2e-6)
    np.testing.assert_allclose(found.P_by_F_dot, expected.P_by_F_dot, rtol=0, atol=2e-6)


def test_it_turns_with_the_material_and_has_an_energy():
    F, F_dot = sample(RANGE, 5, 3)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    np.testing.assert_allclose(
        stress(turn @ F, turn @ F_dot), turn @ stress(F, F_dot) @ transpose(turn), atol=1e-12
    )
    answer = LAW.respond(F, 0.0 * F, tangents=True)
    by_F = answer.tangents.P_by_F
    np.testing.assert_allclose(by_F, by_F.transpose(0, 3, 4, 1, 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(answer.stress, transpose(answer.stress), rtol=0, atol=1e-12)


def test_a_law_without_tangents_is_refused():
    with pytest.raises(InputError, match="quadratic law: SoftLaw has no tangents"):
        QuadraticLaw.of(SoftLaw())
