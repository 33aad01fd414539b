"""Tangents of a surrogate, whatever its weights, and `QuadraticLaw`, which is made of tangents."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import stress_error, transpose
from surrofe2.cache import CachedLaw
from surrofe2.cache.settings import CacheSettings
from surrofe2.law.stress_law import Status
from surrofe2.macro import MacroSettings, simulate
from surrofe2.surrogate.piola import QuadraticLaw, to_piola, to_slopes, to_tangents
from tests.laws import (
    CELL,
    RANGE,
    SoftLaw,
    TrueLattice,
    Untaught,
    lattice_stress,
    tangents_by_differences,
)
from tests.surrogate.twins import make_law


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


LOAD_CASE = LoadCase(
    width=60.0, height=60.0, body_force=(0.0, -0.2), watched=(60.0, 30.0), elements=(2, 2),
    duration=6.0,
    output_interval=0.5,
)  # fmt: skip
EXPLICIT = MacroSettings(absolute_tolerance=1e-8, relative_tolerance=1e-6)
IMPLICIT = replace(
    EXPLICIT, integrator="implicit", absolute_tolerance=1e-7, relative_tolerance=1e-5
)


class Unbounded(Untaught):
    """A surrogate that knows no bound of its error: its range alone decides, narrower than met."""

    has_tangents, stress_spread = True, np.inf

    def __init__(self, law):
        self.cell, self.initialisation, self.density = CELL, law.initialisation, law.density
        law = replace(law, range=SamplingRange(stretch=(0.9995, 1.0005), shear=0.08, rate=0.01))
        free = replace(law, domain=None).with_tolerance(np.inf, np.inf)
        self.lookup, self.tangents = free.lookup, law.tangents


@pytest.fixture
def cached(law):
    return CachedLaw(Unbounded(law), TrueLattice(), CacheSettings(audit=0.0))


def difference(run, other):
    scale = abs(other.curve.displacement).max()
    return abs(run.curve.displacement - other.curve.displacement).max() / scale


def test_the_cached_law_moves_implicitly_as_it_does_explicitly(cached):
    runs = []
    for settings in (EXPLICIT, IMPLICIT):
        cached.reset_counts()
        runs.append(simulate(LOAD_CASE, cached, settings))
        assert min(cached.counts["hits"], cached.counts["fallbacks"]) > 20
    assert difference(runs[1], runs[0]) < 1e-3


def test_tangents_of_each_point_are_those_of_who_answers(cached):
    F = np.eye(2) + np.array([[[0.0002, 0.01], [0.0, 0.0001]], [[0.03, 0.02], [0.0, 0.002]]])
    F_dot = np.array([[[0.001, 0.002], [-0.003, 0.001]]] * 2)
    answer = cached.respond(F, F_dot, tangents=True)
    assert cached.surrogate.lookup(F, F_dot)[1].tolist() == [Status.OK, Status.OUT_OF_RANGE]
    assert answer.effort["hits"] == answer.effort["fallbacks"] == 1
    expected = tangents_by_differences(lambda *at: cached.respond(*at).stress, F, F_dot)
    for found, slope in (
        (answer.tangents.P_by_F, expected.P_by_F),
        (answer.tangents.P_by_F_dot, expected.P_by_F_dot),
    ):
        assert abs(found - slope).max() < 1e-6 * abs(slope).max()
    alone = cached.surrogate.tangents(F, F_dot).P_by_F
    np.testing.assert_array_equal(answer.tangents.P_by_F[0], alone[0])
    assert not np.array_equal(answer.tangents.P_by_F[1], alone[1])
