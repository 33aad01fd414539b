"""The paper's bending bar by full FE² moves as the prototype's did, by every initialisation."""

import numpy as np
import pytest

from surrofe2 import CellParameters, LoadCase, MacroSettings, RveLaw, simulate

# first minimum (µm) and, of `water`, the period (µs) on 4 × 4 elements, of the prototype
REPORTED = {
    ("printed", "cauchy-born"): (-25.4, None),
    ("printed", "constrained-runs"): (-26.9, None),
    ("printed", "elastic"): (-26.9, None),
    ("water", "cauchy-born"): (-25.8, 44.4),
    ("water", "elastic"): (-31.8, 49.5),
    ("water", "constrained-runs"): (-31.9, 49.5),
}


def minima(curve):
    u = curve.displacement[:, 1]
    inner = np.flatnonzero((u[1:-1] < u[:-2]) & (u[1:-1] <= u[2:])) + 1
    return curve.t[inner], u[inner]


QUICK = (("printed", "cauchy-born"), ("printed", "constrained-runs"), ("water", "elastic"))


@pytest.mark.parametrize(
    ("preset", "initialisation"),
    [pytest.param(*each, marks=[pytest.mark.slow] * (each not in QUICK)) for each in REPORTED],
)
def test_bar_moves_as_the_model_reports(preset, initialisation):
    law = RveLaw(CellParameters.preset(preset), initialisation=initialisation)
    run = simulate(LoadCase(), law, MacroSettings())
    assert run.finished
    first, period = REPORTED[preset, initialisation]
    t, depth = minima(run.curve)
    assert depth[0] == pytest.approx(first, abs=0.25)
    if period is not None:
        assert np.diff(t).mean() == pytest.approx(period, abs=0.4)
    assert run.met.stretch[0] > (0.95 if preset == "printed" else 0.96)
    assert run.met.rate < 0.0085

    energies = run.energies
    scale = np.abs(energies["load"]).max()
    assert np.abs(energies["balance"]).max() < 1e-9 * scale
    assert np.abs(energies["numerical"]).max() < 0.03 * scale  # the paper's tolerances are loose
    assert np.diff(energies["dissipated"]).min() > -1e-9 * scale
    assert energies["dissipated"][-1] > 0.01 * scale


def test_the_integration_dissipates_less_as_the_tolerances_tighten():
    cell, load = CellParameters.preset("water"), LoadCase(duration=25.0)
    errors = []
    for relative in (1e-3, 1e-5):
        settings = MacroSettings(relative_tolerance=relative, absolute_tolerance=1e-2 * relative)
        energies = simulate(load, RveLaw(cell), settings).energies
        errors.append(np.abs(energies["numerical"]).max() / np.abs(energies["load"]).max())
        assert np.abs(energies["balance"]).max() < 1e-9 * np.abs(energies["load"]).max()
    assert errors[1] < 1e-5
    assert errors[1] < 0.1 * errors[0]


@pytest.mark.slow
def test_the_papers_iteration_moves_the_bar_as_the_direct_solve_does():
    """At the paper's loose stop (1.0 µN) for a tenth of the run: within 1 %."""
    load, cell = LoadCase(duration=25.0), CellParameters.preset("printed")
    settings = MacroSettings(record_dissipation=False)
    direct = simulate(load, RveLaw(cell), settings).curve.displacement
    iterated = simulate(load, RveLaw(cell, solver="iterated"), settings).curve.displacement
    assert np.abs(iterated - direct).max() < 0.01 * np.abs(direct).max()
