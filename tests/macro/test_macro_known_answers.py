"""Whole runs with an answer in closed form: one element of fibres along x is one oscillator.

Its two free nodes move alike by u, with mass m = ρ W H / 3 (consistent), stiffness k = E H / W,
dashpot c = η H / W and load ρ g W H / 2.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, simulate
from tests.laws import DryFriction, Fibres
from tests.macro.bars import with_load
from tests.numerics import rates

W, H, G = 30.0, 20.0, 0.05
ONE_ELEMENT = LoadCase(
    width=W,
    height=H,
    body_force=(G, 0.0),
    watched=(W, 4.0),
    elements=(1, 1),
    duration=12.0,
    output_interval=0.1,
)
FINE = MacroSettings(absolute_tolerance=1e-10, relative_tolerance=1e-9)
LAW = Fibres(modulus=100.0, viscosity=20.0)


def oscillator(t, law):
    """u and u̇ of m ü + c u̇ + k u = f from rest: period 2π/ω, decrement 2π δ/ω."""
    mass, load = law.density * W * H / 3.0, law.density * G * W * H / 2.0
    stiffness, dashpot = law.modulus * H / W, law.viscosity * H / W
    decay = 0.5 * dashpot / mass
    omega = np.sqrt(stiffness / mass - decay**2)
    damped = np.exp(-decay * t)
    u = load / stiffness * (1 - damped * (np.cos(omega * t) + decay / omega * np.sin(omega * t)))
    return u, load / (mass * omega) * damped * np.sin(omega * t)


@pytest.fixture(scope="module")
def run():
    return simulate(ONE_ELEMENT, LAW, FINE)


def test_damped_oscillator(run):
    u, _ = oscillator(run.curve.t, LAW)
    assert run.finished
    np.testing.assert_array_equal(run.curve.t, ONE_ELEMENT.output_times())
    np.testing.assert_allclose(run.curve.displacement[:, 0], u, atol=2e-7 * u.max())
    np.testing.assert_allclose(run.curve.displacement[:, 1], 0.0, atol=1e-13)
    # The extremes lie in the middle of the run: u swings over and comes back.
    assert u.argmax() < u.size - 20
    assert run.met.F[1][0, 0] == pytest.approx(1.0 + u.max() / W, abs=1e-3 * u.max() / W)
    assert run.met.stretch == pytest.approx((1.0, run.met.F[1][0, 0]), rel=1e-12)


def test_energies_of_damped_oscillator(run):
    """Kinetic, internal = elastic + dissipated, load."""
    t = run.curve.t
    u, v = oscillator(t, LAW)
    elastic = 0.5 * LAW.modulus * H / W * u**2
    load = LAW.density * G * W * H / 2.0 * u
    for name, expected, tolerance in (
        ("kinetic", 0.5 * LAW.density * W * H / 3.0 * v**2, 1e-6),
        ("load", load, 1e-6),
        ("internal", elastic + dissipated_by_oscillator(t), 1e-6),
        ("balance", 0.0, 1e-12),
        ("numerical", 0.0, 1e-6),
    ):
        assert abs(run.energies[name] - expected).max() < tolerance * load.max(), name


def dissipated_by_oscillator(t):
    """∫ c u̇² dt by a fine trapezoidal rule."""
    dense = np.linspace(0.0, t[-1], 40001)
    power = LAW.viscosity * H / W * oscillator(dense, LAW)[1] ** 2
    return np.interp(t, dense, cumulative_trapezoid(power, dense, initial=0.0))


def test_dissipated_energy_is_of_second_order_in_the_samples():
    errors, few = [], replace(FINE, frames=2)  # where there is a frame there is a sample
    for interval in (0.1, 0.05, 0.025):
        run = simulate(replace(ONE_ELEMENT, output_interval=interval), LAW, few)
        found = run.energies["dissipated"]
        assert (np.diff(found) >= 0.0).all()
        errors.append(abs(found - dissipated_by_oscillator(run.curve.t)).max())
    assert rates(errors) == pytest.approx(2.0, abs=0.3)


def test_dry_friction_takes_its_energy_once():
    """Largest displacement of an oscillator with dry friction under a sudden load.

    There the velocity is zero, so load work = ½ E ε² + (limit ε − limit²/(2 spring)), per volume,
    with the load ρ g W/2 per strain. A history committed at trials or rejected steps, or not at
    all, gives another answer. The kinks leave an error of the order of the step.
    """
    law = DryFriction()
    settings = MacroSettings(largest_step=0.005)
    run = simulate(with_load(ONE_ELEMENT, acceleration=(6.0 * G, 0.0)), law, settings)
    drive = law.density * 6.0 * G * W / 2.0
    # ½ E ε² − (drive − limit) ε − limit²/(2 spring) = 0
    b = drive - law.limit
    strain = (b + np.sqrt(b**2 + law.modulus * law.limit**2 / law.spring)) / law.modulus
    u = run.curve.displacement[:, 0]
    assert strain > 5.0 * law.limit / law.spring
    assert u.max() == pytest.approx(W * strain, rel=2e-3)
    assert len(law.committed) == run.counts["steps"] + 1
