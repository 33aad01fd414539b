"""Tangents against central differences of the stress, and the symmetries they must have."""

import numpy as np
import pytest

from surrofe2.law.stress_law import Status
from surrofe2.rve import INITIALISATIONS
from tests.laws import tangents_by_differences
from tests.numerics import differences
from tests.rve.rves import PRESETS, clear_of_the_cut_off, deformations, law

STEP = 2e-6


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", INITIALISATIONS)
def test_tangents_are_the_slopes_of_the_stress(preset, initialisation):
    this = law(preset, initialisation, tolerance=1e-10)
    F, F_dot = deformations(preset, n=100, corners=False)
    answer = this.respond(F, F_dot, tangents=True)
    clear = clear_of_the_cut_off(answer, F)
    assert clear.sum() > 50
    stress_of = lambda F, F_dot: this.respond(F, F_dot, answer.state).stress  # noqa: E731
    slopes = tangents_by_differences(stress_of, F, F_dot, STEP)
    for name in ("P_by_F", "P_by_F_dot"):
        tangent = getattr(answer.tangents, name)
        error = np.abs(tangent - getattr(slopes, name)).max(axis=(1, 2, 3, 4))
        scale = np.abs(tangent).max(axis=(1, 2, 3, 4))
        assert (error / scale)[clear].max() < 1e-6


def test_cauchy_forms_are_the_slopes_of_the_cauchy_stress():
    this = law("printed", "constrained-runs", tolerance=1e-10)
    F, F_dot = deformations("printed", n=16, corners=False)
    answer = this.respond(F, F_dot, tangents=True)
    clear = clear_of_the_cut_off(answer, F)
    exact = answer.tangents.cauchy(F, answer.stress)
    slopes = (
        differences(lambda at: this.respond(at, F_dot, answer.state).stress, F, STEP),
        differences(lambda at: this.respond(F, at, answer.state).stress, F_dot, STEP),
    )
    for tangent, slope in zip(exact, slopes, strict=True):
        np.testing.assert_allclose(tangent[clear], slope[clear], rtol=0, atol=1e-5)


@pytest.mark.parametrize("preset", PRESETS)
def test_elastic_tangent_has_major_symmetry(preset):
    F, F_dot = deformations(preset)
    for initialisation in ("elastic", "constrained-runs", "slow-manifold"):
        A = law(preset, initialisation).respond(F, 0.0 * F_dot, tangents=True).tangents.P_by_F
        np.testing.assert_allclose(A, A.transpose(0, 3, 4, 1, 2), rtol=0, atol=1e-6)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["elastic", "slow-manifold"])
def test_viscous_tangent_at_rest_is_symmetric_and_dissipates(preset, initialisation):
    F, F_dot = deformations(preset)
    answer = law(preset, initialisation).respond(F, 0.0 * F_dot, tangents=True)
    B = answer.tangents.P_by_F_dot.reshape(-1, 4, 4)
    np.testing.assert_allclose(B, B.swapaxes(1, 2), rtol=0, atol=1e-7 * np.abs(B).max())
    assert np.linalg.eigvalsh(B).min() > -1e-9 * np.abs(B).max()


def test_viscous_tangent_of_constrained_runs_is_not_symmetric():
    """docs/theory.md: a limit on what a dissipation potential can represent."""
    F, F_dot = deformations("water")
    B = law("water").respond(F, 0.0 * F_dot, tangents=True).tangents.P_by_F_dot.reshape(-1, 4, 4)
    assert np.abs(B - B.swapaxes(1, 2)).max() > 1e-3 * np.abs(B).max()


def test_points_without_stress_have_no_tangents():
    F = np.array([np.eye(2), [[0.905, 0.486], [0.0, 0.7585]]])
    answer = law("printed").respond(F, np.zeros_like(F), tangents=True)
    assert answer.status[1] == Status.UNSTABLE
    assert np.isfinite(answer.tangents.P_by_F[0]).all()
    assert np.isnan(answer.tangents.P_by_F[1]).all()
    assert law("printed").respond(F, np.zeros_like(F)).tangents is None
