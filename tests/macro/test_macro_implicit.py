"""Generalised-α: order, Newton's convergence, energy, failures, the same motion as explicit."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.generalised_alpha import Weights
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from tests.laws import DryFriction, KelvinVoigt
from tests.macro.bars import SQUARE, run_and_states
from tests.numerics import rates

LOAD_CASE = replace(SQUARE, duration=12.8)
IMPLICIT = MacroSettings(integrator="implicit")
TIGHT = MacroSettings(absolute_tolerance=1e-9, relative_tolerance=1e-9)


def at_fixed_step(h, law, **settings):
    return simulate(
        LOAD_CASE, law, replace(IMPLICIT, relative_tolerance=1e6, largest_step=h, **settings)
    )


def difference(run, other):
    scale = abs(other.curve.displacement).max()
    return abs(run.curve.displacement - other.curve.displacement).max() / scale


@pytest.mark.parametrize("spectral_radius", [0.0, 0.9, 1.0])
def test_second_order_in_the_step(spectral_radius):
    """Against Dormand–Prince at 1e-9, large displacement, a viscous law."""
    law = KelvinVoigt()
    exact = simulate(LOAD_CASE, law, TIGHT)
    runs = [at_fixed_step(h, law, spectral_radius=spectral_radius) for h in (0.2, 0.1, 0.05)]
    errors = [difference(run, exact) for run in runs]
    assert rates(errors) == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-3


def test_energy_balances_with_what_the_method_dissipates():
    """The latter is second order in the step; at ϱ = 1 it is interpolation alone, of fourth."""
    for spectral_radius, order, least in ((0.5, 2.0, 1e-4), (1.0, 4.0, 1e-8)):
        radius = {"spectral_radius": spectral_radius}
        energies = [at_fixed_step(h, KelvinVoigt(), **radius).energies for h in (0.2, 0.1, 0.05)]
        found = [abs(each["numerical"]).max() / each["load"].max() for each in energies]
        assert np.log2(found[1] / found[2]) > order - 0.5
        assert found[-1] < least
        for each in energies:
            assert abs(each["balance"]).max() < 1e-8 * each["load"].max()
        # The last output time is the end of a step.
        assert (abs(each["numerical"][-1]) < 1e-9 * each["load"].max()) == (spectral_radius == 1.0)


def test_error_follows_the_tolerance():
    law = KelvinVoigt()
    exact = simulate(LOAD_CASE, law, TIGHT)
    errors, steps = [], []
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-5):
        settings = replace(
            IMPLICIT, absolute_tolerance=1e-2 * tolerance, relative_tolerance=tolerance
        )
        run = simulate(LOAD_CASE, law, settings)
        errors.append(difference(run, exact))
        steps.append(run.counts["steps"])
    # Second order with a third-order local error: errors as tolerance^(2/3), steps as its −1/3.
    assert np.log10(errors[0] / errors[-1]) == pytest.approx(2.0, abs=0.5)
    assert np.log10(steps[-1] / steps[0]) == pytest.approx(1.0, abs=0.3)
    assert errors[1] < 1e-2


def amplification(rho, omega2):
    """Largest modulus of the eigenvalues of a step of one mass on a spring, ω² h² = omega2."""
    w = Weights.of(rho)
    # Unknowns (u₁, v₁, a₁), known (u₀, v₀, a₀), h = 1.
    end = [[1.0, 0.0, -w.beta], [0.0, 1.0, -w.gamma], [(1 - w.alpha_f) * omega2, 0, 1 - w.alpha_m]]
    start = [[1.0, 1.0, 0.5 - w.beta], [0, 1.0, 1 - w.gamma], [-w.alpha_f * omega2, 0, -w.alpha_m]]
    return abs(np.linalg.eigvals(np.linalg.solve(end, start))).max()


def test_weights_keep_their_amplification():
    """The spectral radius of fast modes; a slow one is damped by O((ω h)⁴), at radius 1 not."""
    for rho in (0.0, 0.5, 0.9, 1.0):
        # A triple eigenvalue: its modulus comes out to the cube root of rounding.
        assert amplification(rho, 1e12) == pytest.approx(rho, abs=2e-2)
    lost = [1.0 - amplification(0.5, h**2) for h in (0.2, 0.1)]
    assert np.log2(lost[0] / lost[1]) == pytest.approx(4.0, abs=0.1)
    assert abs(1.0 - amplification(1.0, 0.01)) < 1e-12


def test_stiff_viscosity_costs_the_explicit_run_its_steps():
    """Viscosity a hundred times the usual: explicit steps are bound by stability."""
    law = KelvinVoigt(shear_viscosity=2000.0, bulk_viscosity=3000.0)
    implicit = simulate(LOAD_CASE, law, IMPLICIT)
    explicit = simulate(LOAD_CASE, law, replace(IMPLICIT, integrator="explicit"))
    assert difference(implicit, explicit) < 2e-2
    assert implicit.counts["right_hand_sides"] < 0.1 * explicit.counts["right_hand_sides"]


@pytest.mark.parametrize("begun", ["explicit", "implicit"])
def test_a_checkpoint_of_the_other_integrator_is_refused(begun):
    first = replace(IMPLICIT, integrator=begun)
    _, states = run_and_states(LOAD_CASE, KelvinVoigt(), first)
    other = {"explicit": "implicit", "implicit": "explicit"}[begun]
    with pytest.raises(
        MismatchError, match=rf"integrator: {other}; the checkpoint is of an {begun}"
    ):
        simulate(LOAD_CASE, KelvinVoigt(), replace(first, integrator=other), resume=states[3])


def test_law_without_tangents_is_named():
    with pytest.raises(InputError, match="integrator implicit: DryFriction has no tangents"):
        simulate(LOAD_CASE, DryFriction(), IMPLICIT)


@pytest.mark.slow
def test_bar_of_rves_moves_as_the_explicit_run_says():
    law = RveLaw(CellParameters.preset("water"), initialisation="slow-manifold")
    load_case = LoadCase(duration=15.0, elements=(2, 2))
    explicit = simulate(load_case, law, MacroSettings())
    implicit = simulate(load_case, law, MacroSettings(integrator="implicit"))
    assert difference(implicit, explicit) < 1e-2
