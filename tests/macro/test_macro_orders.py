"""Patch tests: a homogeneous stress is exact on any mesh. Rates in element size, time step and
tolerance, each beside its theoretical value; no locking.

Exact stresses make the loads, ∫ P : ∇N dV, so tractions and body forces come along.
"""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from scipy.optimize import brentq

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, find_rest, simulate, simulation
from surrofe2.macro.elements import element_mean_stress
from surrofe2.macro.forces import LinearForce
from surrofe2.macro.system import make_system
from surrofe2.problem import (
    BodyForce,
    Box,
    Fixed,
    Foundation,
    InitialVelocity,
    Plane,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    with_regions,
)
from surrofe2.problem.amplitude import Proportional, Sine
from surrofe2.problem.mesh import element_nodes
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.bars import SQUARE
from tests.macro.meshes import HEIGHT, KINDS, WIDTH, distance, plate, quadrature, weak_load
from tests.numerics import assert_near, rates

LAW = KelvinVoigt()
SETTINGS = MacroSettings(newton_tolerance=1e-12)
MIRRORS = Symmetry(on="left"), Symmetry(on="bottom")
NORMALS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "bottom": (0.0, -1.0), "top": (0.0, 1.0)}


def first_piola(law, F):
    """(..., 2, 2) P at rest."""
    flat = F.reshape(-1, 2, 2)
    return law.respond(flat, 0.0 * flat).first_piola(flat).reshape(F.shape)


def tractions(F, *sides):
    P = first_piola(LAW, F)
    return [Traction(on=side, traction=tuple(P @ NORMALS[side])) for side in sides]


def assert_homogeneous(mesh, conditions, F, bodies=()):
    """At rest the tissue has this F and its stress at every point, to 1e-10; the forces by name."""
    problem = Problem(mesh=mesh, conditions=tuple(conditions), bodies=bodies)
    rest = find_rest(problem, LAW, SETTINGS)
    assert abs(F - np.eye(2)).max() > 0.03, "nothing is deformed"
    np.testing.assert_allclose(rest.F, np.broadcast_to(F, rest.F.shape), rtol=0, atol=1e-10)
    stress = LAW.stress(F[None], np.zeros((1, 2, 2)))
    assert_near(rest.stress, np.broadcast_to(stress, rest.F.shape), 1e-10)
    means = element_mean_stress(rest.system.discretisation, rest.F, rest.stress)
    assert_near(means, np.broadcast_to(stress, means.shape), 1e-10)
    u = mesh.p.T @ (F - np.eye(2)).T
    np.testing.assert_allclose(rest.u[: len(u)], u, rtol=0, atol=1e-10 * WIDTH)
    return dict(zip(rest.system.force_names, rest.forces, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_symmetry_and_prescribed_motion(kind, rng):
    F = np.diag([1.12, 0.93])
    motions = (
        PrescribedMotion(on="right", displacement=(0.12 * WIDTH, None)),
        PrescribedMotion(on="top", displacement=(None, -0.07 * HEIGHT)),
    )
    forces = assert_homogeneous(plate(kind, rng), (*MIRRORS, *motions), F)
    pull = HEIGHT * first_piola(LAW, F)[0, 0]
    np.testing.assert_allclose(forces["prescribed_motion right"], [pull, 0.0], atol=1e-9 * pull)
    np.testing.assert_allclose(forces["symmetry left"], [-pull, 0.0], atol=1e-9 * pull)


@pytest.mark.parametrize("kind", KINDS)
def test_fixed_side_and_traction(kind, rng):
    """Shear and stretch off a side that is held; the tractions of P on the three others."""
    F = np.array([[1.0, 0.15], [0.0, 1.06]])
    loads = tractions(F, "left", "right", "top")
    assert_homogeneous(plate(kind, rng), [Fixed(on="bottom"), *loads], F)


@pytest.mark.parametrize(("kind", "bulge"), [*((kind, 0.0) for kind in KINDS), ("triangles", 0.3)])
def test_follower_pressure(kind, bulge, rng):
    """Hydrostatic stress −p I: also where triangles have curved outer sides under pressure."""
    F = 0.95 * np.eye(2)
    pressure = -LAW.stress(F[None], np.zeros((1, 2, 2)))[0, 0, 0]
    assert pressure > 1.0
    loads = [Pressure(on=side, pressure=pressure) for side in ("right", "top")]
    assert_homogeneous(plate(kind, rng, bulge=bulge), [*MIRRORS, *loads], F)


@pytest.mark.parametrize("kind", KINDS)
def test_foundation(kind, rng):
    """A traction less springs −k u on the top, along y alone: the sides are mirrors."""
    F, stiffness = np.diag([1.0, 1.08]), 1.7
    spring = stiffness * (F[1, 1] - 1.0) * HEIGHT
    pull = Traction(on="top", traction=(0.0, first_piola(LAW, F)[1, 1] + spring))
    springs = Foundation(on="top", stiffness=stiffness, components="y")
    mirrors = (*MIRRORS, Symmetry(on="right"))
    forces = assert_homogeneous(plate(kind, rng), [*mirrors, springs, pull], F)
    np.testing.assert_allclose(forces["foundation top"], [0.0, -spring * WIDTH], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_contact_with_a_plane(kind, rng):
    """A plane pushed into the top between mirrors: uniform pressure k (d − δ/2) at depth d."""
    pushed, stiffness, smoothing = 2.0, 30.0, 0.05

    def excess(stretch):
        depth = pushed - (1.0 - stretch) * HEIGHT
        pull = first_piola(LAW, np.diag([1.0, stretch]))[1, 1]
        return pull + stiffness * (depth - 0.5 * smoothing)

    F = np.diag([1.0, brentq(excess, 0.9, 0.99, xtol=1e-15)])
    lid = RigidBody(
        name="lid", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, HEIGHT),
        displacement=(0.0, -pushed), stiffness=stiffness, smoothing=smoothing,
    )  # fmt: skip
    mirrors = (*MIRRORS, Symmetry(on="right"))
    forces = assert_homogeneous(plate(kind, rng), mirrors, F, bodies=(lid,))
    push = WIDTH * first_piola(LAW, F)[1, 1]
    assert push < -10.0
    np.testing.assert_allclose(forces["lid"], [0.0, push], atol=1e-9 * abs(push))
    np.testing.assert_allclose(forces["symmetry bottom"], [0.0, -push], atol=1e-9 * abs(push))


@pytest.mark.parametrize("kind", KINDS)
def test_support_bears_the_weight_and_all_other_loads(kind, rng):
    """Its force is minus the sum of the loads; that of a body force is ρ g times its area."""
    mesh = with_regions(plate(kind, rng), half=Box((0.0, 0.0), (0.5 * WIDTH, HEIGHT)))
    area = skfem.Basis(mesh, mesh.elem(), elements="half").dx.sum()
    weight = LAW.density * np.array([0.1, -0.3])
    conditions = (
        Fixed(on="bottom", name="support"),
        BodyForce(acceleration=(0.1, -0.3), name="weight"),
        BodyForce(on="half", acceleration=(0.1, -0.3), name="half"),
        Traction(on="right", traction=(0.4, 0.2)),
        Pressure(on="top", pressure=0.8),
        Foundation(on="left", stiffness=0.05),
    )
    rest = find_rest(Problem(mesh=mesh, conditions=conditions), LAW, SETTINGS)
    forces = dict(zip(rest.system.force_names, rest.forces, strict=True))
    np.testing.assert_allclose(forces["weight"], weight * WIDTH * HEIGHT, rtol=1e-10)
    np.testing.assert_allclose(forces["half"], weight * area, rtol=1e-10)
    np.testing.assert_allclose(forces["traction right"], HEIGHT * np.array([0.4, 0.2]), rtol=1e-10)
    # Pressure times the chord between the moved ends of the top, turned.
    ends = [np.flatnonzero(([x, HEIGHT] == mesh.p.T).all(axis=1))[0] for x in (0.0, WIDTH)]
    chord = np.diff((mesh.p.T + rest.u)[ends], axis=0)[0]
    push = 0.8 * np.array([chord[1], -chord[0]])
    np.testing.assert_allclose(forces["pressure top"], push, rtol=1e-10)
    largest = max(abs(force).max() for force in forces.values())
    np.testing.assert_allclose(sum(forces.values()), 0.0, atol=1e-10 * largest)


STRAIGHT = KINDS[:2]
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


def clamped_square(kind, n, duration=1.0):
    mesh = plate(kind, np.random.default_rng(3), (n, n), (1.0, 1.0), distortion=0.12)
    times = {"duration": duration, "output_interval": duration}
    return Problem(mesh=mesh, conditions=(Fixed(on="left"),), **times)


@pytest.mark.parametrize(
    ("law", "size"),
    [(KelvinVoigt(), 0.1), (LinearFirstPiola(lame=1.0), 1e-4), (LinearFirstPiola(lame=1e5), 1e-6)],
    ids=["finite strain", "compressible", "incompressible"],
)
@pytest.mark.parametrize("kind", STRAIGHT)
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


@pytest.mark.parametrize("kind", STRAIGHT)
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
    for kind in STRAIGHT:
        flight = InitialVelocity(velocity=(0.3, -0.1))
        problem = Problem(mesh=plate(kind, rng), conditions=(flight,), duration=1.0)
        law = KelvinVoigt(shear_viscosity=0.0, bulk_viscosity=0.0)
        run = simulate(problem, law, MacroSettings(frames=3, largest_step=0.01))
        moved = np.tile([0.3, -0.1], (len(run.nodes), 1))
        np.testing.assert_allclose(run.frames.displacement[-1], moved, rtol=1e-10)
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
    with np.errstate(under="ignore"):
        slow, fast = np.exp((root - decay) * t), np.exp((-root - decay) * t)
    free = 0.5 * (slow + fast) + decay * 0.5 * (slow - fast) / root
    return ((1.0 - free.real) * static * np.sin(k * length)).sum(axis=1)


def test_longitudinal_wave_converges_with_the_square_of_the_element_size():
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
    load_case, errors = replace(SQUARE, duration=20.0), []
    for tolerance in (1e-3, 1e-5, 1e-7):
        settings = MacroSettings(absolute_tolerance=1e-2 * tolerance, relative_tolerance=tolerance)
        energies = simulate(load_case, KelvinVoigt(), settings).energies
        errors.append(abs(energies["numerical"]).max() / energies["load"].max())
        assert abs(energies["balance"]).max() < 1e-12 * energies["load"].max()
    assert 1e-6 < errors[0] < 1e-4
    assert errors[1] < 3e-2 * errors[0]
    assert errors[2] < 3e-2 * errors[1]
