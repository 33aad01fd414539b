"""The two-mode fit gives back what a curve was made of."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from validation.damped_fit import first_minimum, fit_damped_modes

T = np.arange(0.0, 250.25, 0.5)


def curve(period, decrement, amplitude, phase):
    omega = 2.0 * np.pi / period
    return amplitude * np.exp(-decrement / period * T) * np.cos(omega * T + phase)


@pytest.mark.parametrize("second", [17.0, 8.3, 31.0])
def test_recovers_both_modes(second):
    u = -15.0 + curve(49.5, 0.045, 16.0, 0.1) + curve(second, 0.2, 1.1, 2.0)
    fit = fit_damped_modes(T, u)
    assert fit.constant == pytest.approx(-15.0, abs=1e-6)
    assert fit.first.period == pytest.approx(49.5, rel=1e-6)
    assert fit.first.decrement == pytest.approx(0.045, rel=1e-6)
    assert fit.first.amplitude == pytest.approx(16.0, rel=1e-6)
    assert fit.second.period == pytest.approx(second, rel=1e-6)
    assert fit.second.decrement == pytest.approx(0.2, rel=1e-6)
    assert fit.residual < 1e-6


def test_residual_is_what_two_modes_leave():
    third = curve(11.0, 0.0, 0.01, 0.0)
    u = curve(50.0, 0.05, 16.0, 0.0) + curve(17.0, 0.1, 1.0, 1.0) + third
    fit = fit_damped_modes(T, u)
    assert fit.rms == pytest.approx(0.01 / np.sqrt(2.0), rel=0.05)
    assert fit.rms < fit.residual < 0.02


def test_first_minimum_lies_between_samples():
    t, depth = first_minimum(T, -np.sin(2.0 * np.pi * (T + 0.13) / 50.0))
    assert t == pytest.approx(12.37, abs=1e-3)
    assert depth == pytest.approx(-1.0, abs=1e-5)


def test_refusals():
    with pytest.raises(InputError, match="m ≥ 20"):
        fit_damped_modes(T[:5], T[:5])
    with pytest.raises(InputError, match="must be finite and move"):
        fit_damped_modes(T, 0.0 * T)
    with pytest.raises(InputError, match="has none"):
        first_minimum(T, T)
