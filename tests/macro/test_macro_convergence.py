"""Rates: in element size, in time step and in tolerance, each beside its theoretical value."""

import numpy as np
import pytest
import skfem
from skfem.helpers import ddot, dot

from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.bars import bar_system

UNIT_SQUARE = LoadCase(width=1.0, height=1.0, watched=(1.0, 0.5), body_force=(0.0, 0.0))


def manufactured(x, y):
    """A divergence-free field that is zero at x = 0: the curl of ψ = x² sin(2 y + 1) eˣ."""
    e, s, c = np.exp(x), np.sin(2 * y + 1), np.cos(2 * y + 1)
    return np.array([2 * x**2 * e * c, -(2 * x + x**2) * e * s])


def manufactured_gradient(x, y):
    e, s, c = np.exp(x), np.sin(2 * y + 1), np.cos(2 * y + 1)
    shared = 2 * (2 * x + x**2) * e * c
    return np.array([[shared, -4 * x**2 * e * s], [-(2 + 4 * x + x**2) * e * s, -shared]])


def static_error(n, law):
    """L² error of the static solution whose loads belong to the manufactured field.

    The loads ∫ P(u*) : ∇N dV contain its tractions; the stiffness is that of the internal force
    at small displacements, column by column.
    """
    system = bar_system(UNIT_SQUARE, (n, n), law.density)
    bar, free = system.discretisation, system.free
    small = 1e-6
    still = np.zeros_like(bar.nodes)
    stiffness = np.empty((free.size, free.size))
    for k in range(free.size):
        u = np.zeros(bar.nodes.size)
        u[free[k]] = small
        columns = []
        for sign in (1.0, -1.0):
            F, F_dot, _ = deformation_gradient(bar, sign * u.reshape(-1, 2), still)
            columns.append(system.pick(internal_force(bar, F, law.respond(F, F_dot).stress)))
        stiffness[:, k] = (columns[0] - columns[1]) / (2 * small)

    mesh = skfem.MeshQuad(bar.nodes.T.copy(), bar.elements.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1()), intorder=6)

    def traction_and_body_load(v, w):
        gradient = manufactured_gradient(*w.x)
        strain = 0.5 * (gradient + gradient.transpose(1, 0, 2, 3))
        return 2.0 * law.shear_modulus * ddot(strain, v.grad)

    load = skfem.LinearForm(traction_and_body_load).assemble(basis)
    solution = np.zeros(basis.N)
    free_dofs = basis.nodal_dofs.T.ravel()[free]
    solution[free_dofs] = np.linalg.solve(stiffness, load[free_dofs])
    squared = skfem.Functional(
        lambda w: dot(w["u"] - manufactured(*w.x), w["u"] - manufactured(*w.x))
    )
    return np.sqrt(squared.assemble(basis, u=basis.interpolate(solution)))


@pytest.mark.parametrize("lame", [1.0, 1e5])
def test_static_error_falls_with_the_square_of_the_element_size(lame):
    """Bilinear elements: second order in L². With λ = 10⁵ µ full integration of the pressure
    would lock, with an error of the size of the solution."""
    law = LinearFirstPiola(shear_modulus=1.0, lame=lame)
    errors = [static_error(n, law) for n in (4, 8, 16)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert rates == pytest.approx(2.0, abs=0.25)
    assert errors[0] < 0.3


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
    load_case = LoadCase(
        width=100.0, height=10.0, body_force=(0.1, 0.0), watched=(100.0, 5.0), duration=16.0
    )
    errors = []
    for n in (4, 8, 16):
        settings = MacroSettings(elements=(n, 2), absolute_tolerance=1e-8, relative_tolerance=1e-8)
        curve = simulate(load_case, law, settings).curve
        exact = wave(curve.t, load_case.width, law, 0.1)
        errors.append(abs(curve.displacement[:, 0] - exact).max() / abs(exact).max())
        assert abs(curve.displacement[:, 1]).max() < 1e-10
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert rates == pytest.approx(2.0, abs=0.3)
    assert errors[-1] < 2e-3


def lost_at_fixed_step(step):
    load_case = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0), duration=6.4)
    settings = MacroSettings(
        elements=(2, 2), absolute_tolerance=1e3, relative_tolerance=1e3, largest_step=step
    )
    run = simulate(load_case, KelvinVoigt(), settings)
    return abs(run.energies["numerical"][-1]) / run.energies["kinetic"].max()


def test_what_the_method_dissipates_is_of_fifth_order_in_the_step():
    """Work integrals and equations of motion are both fifth order at the ends of steps."""
    errors = [lost_at_fixed_step(step) for step in (0.2, 0.1, 0.05)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (rates > 4.6).all()


def test_what_the_method_dissipates_follows_the_tolerance_and_the_balance_closes():
    load_case = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0), duration=20.0)
    errors = []
    for tolerance in (1e-3, 1e-5, 1e-7):
        settings = MacroSettings(
            elements=(2, 2), absolute_tolerance=1e-2 * tolerance, relative_tolerance=tolerance
        )
        energies = simulate(load_case, KelvinVoigt(), settings).energies
        errors.append(abs(energies["numerical"]).max() / energies["load"].max())
        assert abs(energies["balance"]).max() < 1e-12 * energies["load"].max()
    assert 1e-6 < errors[0] < 1e-4
    assert errors[1] < 3e-2 * errors[0]
    assert errors[2] < 3e-2 * errors[1]
