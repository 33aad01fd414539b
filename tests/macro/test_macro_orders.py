"""Rates in element size, time step and tolerance, each beside its theoretical value; no locking.

Exact stresses make the loads, ∫ P : ∇N dV, so tractions and body forces come along.
"""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, find_rest, simulate, simulation
from surrofe2.macro.forces import LinearForce
from surrofe2.macro.system import make_system
from surrofe2.problem import Fixed, Foundation, InitialVelocity, Problem, Symmetry
from surrofe2.problem.amplitude import Proportional, Sine
from surrofe2.problem.mesh import element_nodes
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.meshes import distance, plate, quadrature, weak_load
from tests.numerics import rates

KINDS = ("quads", "triangles")
TIGHT = MacroSettings(newton_tolerance=1e-11)


def field(x):
    """U(x), zero on x = 0, divergence-free: the curl of 0.1 x² sin(2 y + 1) eˣ."""
    x, y = x[..., 0], x[..., 1]
    e, s, c = np.exp(x), np.sin(2 * y + 1), np.cos(2 * y + 1)
    return 0.1 * np.stack([2 * x**2 * e * c, -(2 * x + x**2) * e * s], axis=-1)


def gradient(x):
    x, y = x[..., 0], x[..., 1]
    e, s, c = np.exp(x), np.sin(2 * y + 1), np.cos(2 * y + 1)
    shared = 2 * (2 * x + x**2) * e * c
    rows = [[shared, -4 * x**2 * e * s], [-(2 + 4 * x + x**2) * e * s, -shared]]
    return 0.1 * np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def first_piola(law, F):
    flat = F.reshape(-1, 2, 2)
    return law.respond(flat, 0.0 * flat).first_piola(flat).reshape(F.shape)


def clamped_square(kind, n, duration=1.0):
    mesh = plate(kind, np.random.default_rng(3), (n, n), (1.0, 1.0), distortion=0.12)
    return Problem(
        mesh=mesh, conditions=(Fixed(on="left"),), duration=duration, output_interval=duration
    )


@pytest.mark.parametrize(
    ("law", "size"),
    [(KelvinVoigt(), 0.1), (LinearFirstPiola(lame=1.0), 1e-4), (LinearFirstPiola(lame=1e5), 1e-6)],
    ids=["finite strain", "compressible", "incompressible"],
)
@pytest.mark.parametrize("kind", KINDS)
def test_rest_is_of_second_order(kind, law, size, monkeypatch):
    """Finite strain, and λ up to 10⁵ µ where full integration of the pressure would lock."""
    errors = []
    for n in (4, 8, 16):
        problem = clamped_square(kind, n)
        system = make_system(problem, 1.0)
        load = weak_load(problem.mesh, lambda x: first_piola(law, np.eye(2) + size * gradient(x)))
        system = replace(system, forces=(LinearForce("load", load, Proportional()),))
        monkeypatch.setattr("surrofe2.macro.rest.system_of", lambda *of, found=system, **how: found)
        rest = find_rest(problem, law, TIGHT)
        exact = distance(problem.mesh, 0.0 * rest.u, lambda x: size * field(x))
        errors.append(distance(problem.mesh, rest.u, lambda x: size * field(x)) / exact)
    assert (rates(errors) > 1.75).all(), errors
    assert errors[-1] < 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_motion_is_of_second_order(kind, monkeypatch):
    """The load of u = sin(ω t) U for a linear law: s̈ times inertia, s times stiffness."""
    law, size, omega = LinearFirstPiola(shear_modulus=1.0, lame=2.0), 1e-4, 2.0
    errors = []
    for n in (3, 6, 12):
        problem = clamped_square(kind, n)
        mesh = problem.mesh
        x, weights, shape, _ = quadrature(mesh)
        inertia = np.zeros_like(mesh.p.T)
        nodal = np.einsum("eq,qa,eqi->eai", weights, shape, size * field(x))
        np.add.at(inertia, element_nodes(mesh), law.density * nodal)
        elastic = weak_load(mesh, lambda x: first_piola(law, np.eye(2) + size * gradient(x)))
        sine = Sine(frequency=omega / (2.0 * np.pi))
        system = replace(
            make_system(problem, law.density),
            forces=(LinearForce("load", elastic - omega**2 * inertia, sine),),
            initial_velocity=omega * size * field(mesh.p.T),
        )
        monkeypatch.setattr(simulation, "system_of", lambda *of, found=system, **how: found)
        settings = MacroSettings(
            absolute_tolerance=1e-11, relative_tolerance=1e-7, frames=2, record_dissipation=False
        )
        u = simulate(problem, law, settings).frames.displacement[-1]
        u /= size * np.sin(omega)
        errors.append(distance(mesh, u, field) / distance(mesh, 0.0 * u, field))
    assert (rates(errors) > 1.75).all(), errors
    assert errors[-1] < 0.02


@pytest.mark.parametrize("distortion", [0.0, 0.1])
@pytest.mark.parametrize(("kind", "lame"), [("quads", 1e4), ("triangles", 1.0), ("triangles", 1e4)])
def test_bending_without_locking(kind, lame, distortion, monkeypatch):
    """Pure bending, 16 × 4 elements on 80 × 10 µm: the tip within 2 % of κ L²/2.

    σ₁₁ = −E κ (y − H/2), E that of plane strain, and u₂ = κ x²/2 + ν/(1 − ν) κ (y − H/2)²/2 but
    for a shift: soft springs on the left hold the mean of u₂ there at zero.
    """
    length, height, curvature = 80.0, 10.0, 1e-5
    law = LinearFirstPiola(shear_modulus=1.0, lame=lame)
    nu = lame / (2.0 * (lame + 1.0))
    modulus = 2.0 * (1.0 + nu) / (1.0 - nu**2)
    mesh = plate(kind, np.random.default_rng(1), (16, 4), (length, height), distortion=distortion)

    def bending(x):
        P = np.zeros((*x.shape, 2))
        P[..., 0, 0] = -modulus * curvature * (x[..., 1] - 0.5 * height)
        return P

    held = Symmetry(on="left"), Foundation(on="left", stiffness=1e-3, components="y")
    problem = Problem(mesh=mesh, conditions=held, watched={"tip": (length, 0.5 * height)})
    system = make_system(problem, 1.0)
    load = LinearForce("moment", weak_load(mesh, bending), Proportional())
    system = replace(system, forces=(*system.forces, load))
    monkeypatch.setattr("surrofe2.macro.rest.system_of", lambda *of, **how: system)
    rest = find_rest(problem, law, replace(TIGHT, newton_tolerance=1e-9))
    shift = nu / (1.0 - nu) * height**2 / 12.0
    expected = 0.5 * curvature * (length**2 - shift)
    allowed = 0.02 if kind == "quads" else 1e-4
    assert rest.watched[1] == pytest.approx(expected, rel=allowed)


def test_body_in_free_flight_keeps_its_velocity(rng):
    """A dynamic patch: a uniform velocity is an exact motion, without any stress."""
    for kind in KINDS:
        flight = InitialVelocity(velocity=(0.3, -0.1))
        problem = Problem(mesh=plate(kind, rng), conditions=(flight,), duration=1.0)
        law = KelvinVoigt(shear_viscosity=0.0, bulk_viscosity=0.0)
        run = simulate(problem, law, MacroSettings(frames=3, largest_step=0.01))
        np.testing.assert_allclose(
            run.frames.displacement[-1], np.tile([0.3, -0.1], (len(run.nodes), 1)), rtol=1e-10
        )
        assert abs(run.frames.stress).max() < 1e-9


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
