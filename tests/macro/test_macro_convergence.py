"""Rates: in element size, in time step and in tolerance, each beside its theoretical value."""

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, simulate
from tests.laws import Fibres, KelvinVoigt
from tests.numerics import rates


def wave(t, length, law, g, terms=400):
    """End displacement of a fibre bar at rest, loaded by ρ g from t = 0 on: the modes
    sin(k x), k = (j + ½) π / length, each a damped oscillator about its static share."""
    k = (np.arange(terms) + 0.5) * np.pi / length
    static = 2.0 * law.density * g / (law.modulus * length * k**3)
    omega, decay = np.sqrt(law.modulus / law.density) * k, 0.5 * law.viscosity / law.density * k**2
    root = np.sqrt((decay**2 - omega**2).astype(complex))
    t = t[:, None]
    # cosh and sinh of root t, each times exp(−decay t), without overflow.
    slow, fast = np.exp((root - decay) * t), np.exp((-root - decay) * t)
    free = 0.5 * (slow + fast) + decay * 0.5 * (slow - fast) / root
    return ((1.0 - free.real) * static * np.sin(k * length)).sum(axis=1)


def test_longitudinal_wave_converges_with_the_square_of_the_element_size():
    """Consistent mass, linear in x: second order."""
    law = Fibres(modulus=100.0, viscosity=40.0)
    length, errors = 100.0, []
    for n in (4, 8, 16):
        load_case = LoadCase(
            width=length, height=10.0, body_force=(0.1, 0.0), watched=(length, 5.0), duration=16.0,
            elements=(n, 2),
        )  # fmt: skip
        settings = MacroSettings(absolute_tolerance=1e-8, relative_tolerance=1e-8)
        curve = simulate(load_case, law, settings).curve
        exact = wave(curve.t, length, law, 0.1)
        errors.append(abs(curve.displacement[:, 0] - exact).max() / abs(exact).max())
        assert abs(curve.displacement[:, 1]).max() < 1e-10
    assert rates(errors) == pytest.approx(2.0, abs=0.3)
    assert errors[-1] < 2e-3


def test_what_the_method_dissipates_follows_the_tolerance_and_the_balance_closes():
    load_case = LoadCase(
        width=60.0, height=60.0, watched=(60.0, 30.0), duration=20.0, elements=(2, 2)
    )
    errors = []
    for tolerance in (1e-3, 1e-5, 1e-7):
        settings = MacroSettings(absolute_tolerance=1e-2 * tolerance, relative_tolerance=tolerance)
        energies = simulate(load_case, KelvinVoigt(), settings).energies
        errors.append(abs(energies["numerical"]).max() / energies["load"].max())
        assert abs(energies["balance"]).max() < 1e-12 * energies["load"].max()
    assert 1e-6 < errors[0] < 1e-4
    assert errors[1] < 3e-2 * errors[0]
    assert errors[2] < 3e-2 * errors[1]
