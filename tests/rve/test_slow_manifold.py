"""Slow manifold: what defines it, and its error against the RVE integrated in time."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import unpack
from surrofe2.law.stress_law import Status
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.rve.parameter_gradients import parameter_gradients
from tests.laws import tangents_by_differences
from tests.numerics import slope_along
from tests.rve.rves import PRESETS, assert_balanced, deformations, law, positions


def shear(t):
    """The first drive of the prototype."""
    return np.array([[1.0, 0.01 * t], [0.0, 1.0]]), np.array([[0.0, 0.01], [0.0, 0.0]])


def oscillation(t):
    """The second drive of the prototype."""
    omega = 2.0 * np.pi / 40.0
    way = np.array([[0.04, 0.05], [0.0, 0.0]])
    return np.eye(2) + np.sin(omega * t) * way, omega * np.cos(omega * t) * way


DRIVES = {"shear": shear, "oscillation": oscillation}
TIMES = np.arange(0.0, 21.0, 2.0)


@cache
def driven(preset, drive):
    return integrate_rve(law(preset), DRIVES[drive], TIMES)


def error(preset, drive, initialisation):
    F, F_dot = (np.array(part) for part in zip(*map(DRIVES[drive], TIMES), strict=True))
    stress = law(preset, initialisation).respond(F, F_dot).stress
    return np.abs(stress - driven(preset, drive))[1:].max()


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "drive"), list(zip(PRESETS, DRIVES, strict=True)))
def test_initialisations_rank_as_the_model_reports(preset, drive):
    """The prototype: Cauchy–Born 0.8 to 2.2, elastic 0.013 to 0.040, constrained runs 0.005 to
    0.010, slow manifold 0.0001 to 0.0009 µN/µm."""
    assert 0.7 < error(preset, drive, "cauchy-born") < 2.3
    assert 0.012 < error(preset, drive, "elastic") < 0.041
    runs = error(preset, drive, "constrained-runs")
    assert 0.005 < runs < 0.0105
    assert error(preset, drive, "slow-manifold") < min(0.00095, runs / 5.0)


@pytest.mark.slow
def test_error_falls_with_the_rate_to_the_power_one_and_two():
    """The same way through F, half as fast: elastic and constrained runs O(Ḟ), slow manifold
    O(Ḟ², F̈), Cauchy–Born O(1)."""
    errors = {}
    for slowness in (1.0, 2.0):

        def path(t, slowness=slowness):
            F, F_dot = oscillation(t / slowness)
            return F, F_dot / slowness

        times = slowness * np.array([0.0, 8.0, 14.0])
        exact = integrate_rve(law("printed"), path, times)[1:]
        F, F_dot = (np.array(part)[1:] for part in zip(*map(path, times), strict=True))
        for name in ("cauchy-born", "elastic", "constrained-runs", "slow-manifold"):
            stress = law("printed", name).respond(F, F_dot).stress
            errors[name, slowness] = np.abs(stress - exact).max()

    def order(name):
        return np.log2(errors[name, 1.0] / errors[name, 2.0])

    assert order("cauchy-born") == pytest.approx(0.0, abs=0.1)
    assert order("elastic") == pytest.approx(1.0, abs=0.2)
    assert order("constrained-runs") == pytest.approx(1.0, abs=0.2)
    assert order("slow-manifold") > 1.7


@pytest.mark.parametrize("preset", PRESETS)
def test_velocities_are_those_of_the_moving_equilibrium_and_forces_vanish_with_them(preset):
    F, F_dot = deformations(preset, n=6)
    answer = law(preset, "slow-manifold").respond(F, F_dot)
    assert (answer.status == Status.OK).all()
    beyond = unpack(answer.state.fluctuation, 6).transpose(0, 2, 1)
    assert_balanced(law(preset), answer, F, F_dot, range(6), beyond=beyond)

    def moving(t):
        at = F + t * F_dot
        z = positions(law(preset, "elastic").respond(at, 0.0 * F).state)
        return z @ at.transpose(0, 2, 1)

    velocities = positions(answer.state) @ F_dot.transpose(0, 2, 1) + beyond
    expected = slope_along(moving, 0.0, 1.0, 1e-3)
    np.testing.assert_allclose(velocities, expected, rtol=0, atol=1e-6)


def test_micro_integration_is_of_fourth_order_where_no_pair_crosses_the_cut_off():
    """A jump of the strain, then free motion; steps of 2, 1 and ½ ns."""

    def held(t):
        return np.eye(2) * (1.0 + 1e-4 * min(t, 1.0)), 1e-4 * np.eye(2) * (t < 1.0)

    times = np.array([0.0, 0.3])
    ends = [integrate_rve(law("water"), held, times, step)[-1] for step in (2e-3, 1e-3, 5e-4)]
    coarse, fine = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert np.log2(coarse / fine) > 3.0


def test_micro_integration_with_too_long_a_step_says_so():
    with pytest.raises((SimulationError, FloatingPointError), match=r"apart|overflow|invalid"):
        integrate_rve(law("printed"), shear, np.array([0.0, 5.0]), 0.02)


WAY = np.array([[-0.067905, 0.0412889], [-0.117382, 0.00033]])
"""Of the plant cell in the corner of a clamped bar of `water`, from rest to where walls buckle."""


def through_a_bifurcation():
    """(F, answer of the step) along 1.2 times the way, each from the state before."""
    slow, state, passed = law("water", "slow-manifold"), None, []
    for part in np.linspace(0.0, 1.2, 61)[1:]:
        F = np.eye(2)[None] + part * WAY
        answer = slow.respond(F, 0.02 * WAY[None], state, tangents=True)
        accepted = slow.accept(F, 0.02 * WAY[None], answer)
        assert accepted.status[0] == Status.OK
        state = accepted.state
        passed.append((F, answer))
    return passed


def test_from_a_bifurcation_on_velocities_are_affine():
    """So the law has a stress all the way, and its tangents are those of what it does."""
    passed = through_a_bifurcation()
    left = np.array([answer.state.left_points[0] for _, answer in passed])
    assert 0 < left.argmax() < 60
    assert left[left.argmax() :].all()
    for (_, answer), is_left in zip(passed, left, strict=True):
        assert answer.state.beyond_affine.any() != is_left
    slow, (F, answer) = law("water", "slow-manifold"), passed[-1]
    stress_of = lambda F, F_dot: slow.respond(F, F_dot, answer.state).stress  # noqa: E731
    slopes = tangents_by_differences(stress_of, F, 0.02 * WAY[None], 1e-6)
    for name in ("P_by_F", "P_by_F_dot"):
        tangent, wanted = getattr(answer.tangents, name), getattr(slopes, name)
        np.testing.assert_allclose(tangent, wanted, rtol=1e-5, atol=1e-3)


@pytest.mark.slow
def test_beyond_a_bifurcation_it_is_constrained_runs():
    """Both leave at the same place: stress, tangents and gradients by parameters are the same."""
    F, F_dot = np.diag([0.92, 1.0])[None], 0.02 * WAY[None]
    slow, runs = law("water", "slow-manifold"), law("water", "constrained-runs")
    here, there = (each.respond(F, F_dot, tangents=True) for each in (slow, runs))
    assert here.state.left_points.all()
    assert there.state.left_points.all()
    np.testing.assert_allclose(here.stress, there.stress, rtol=0, atol=1e-8)
    for name in ("P_by_F", "P_by_F_dot"):
        pair = (getattr(each.tangents, name) for each in (here, there))
        np.testing.assert_allclose(*pair, rtol=1e-6, atol=1e-6)
    names = ("wall_stiffness", "viscosity")
    by = [parameter_gradients(each, F, F_dot, names).P_by for each in (slow, runs)]
    for name in names:
        np.testing.assert_allclose(by[0][name], by[1][name], rtol=1e-6, atol=1e-12)
