"""Whole runs with an answer in closed form: an oscillator, a bar that strikes a plate, a free body.

One element of fibres along x is one oscillator. Its two free nodes move alike by u, with mass
m = ρ W H / 3 (consistent), stiffness k = E H / W, dashpot c = η H / W and load ρ g W H / 2.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.system import make_system, system_of
from surrofe2.problem import (
    BodyForce,
    InitialVelocity,
    Plane,
    Problem,
    RigidBody,
    Symmetry,
    rectangle,
)
from surrofe2.problem.amplitude import Ramp
from tests.laws import DryFriction, Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.bars import run_and_states, with_load
from tests.macro.meshes import HEIGHT, WIDTH, plate
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


LENGTH, DEPTH, SPEED = 100.0, 2.0, 0.5
ELASTIC = LinearFirstPiola(shear_modulus=50.0, lame=0.0, density=0.1)
"""Without lateral contraction: E = 100 µN/µm, c = √(E/ρ) = 31.6 µm/µs."""
WALL = RigidBody(name="plate", shape=Plane(normal=(1.0, 0.0)), on="left", position=(-1.0, 0.0))


@pytest.fixture(scope="module")
def impact():
    """A bar between mirrors flies at a plate 1 µm away."""
    problem = Problem(
        mesh=rectangle(LENGTH, DEPTH, (100, 1)),
        conditions=(
            InitialVelocity(velocity=(-SPEED, 0.0)),
            Symmetry(on="bottom"),
            Symmetry(on="top"),
        ),
        bodies=(WALL,),
        duration=11.0,
        output_interval=0.02,
        watched={"tip": (LENGTH, 0.0)},
    )
    settings = MacroSettings(
        relative_tolerance=1e-5, absolute_tolerance=1e-7, frames=2, record_dissipation=False
    )
    return simulate(problem, ELASTIC, settings)


@pytest.mark.slow
def test_contact_time_and_mean_force_are_those_of_the_wave(impact):
    """The wave runs to the free end and back, 2 L/c; the force meanwhile is ρ c v₀ h."""
    speed = np.sqrt(100.0 / ELASTIC.density)
    t, force = impact.curve.t, impact.history["force plate x"]
    touching = t[force > 0.01 * force.max()]
    time = touching[-1] - touching[0]
    assert touching[0] == pytest.approx(1.0 / SPEED, abs=0.05)
    assert time == pytest.approx(2.0 * LENGTH / speed, rel=0.01)
    mean = np.trapezoid(force, t) / time
    assert mean == pytest.approx(ELASTIC.density * speed * SPEED * DEPTH, rel=0.01)
    assert abs(impact.history["force plate y"]).max() < 1e-9


def test_it_neither_sticks_nor_chatters(impact):
    """One contact without a gap in it, no pull, and the bar leaves as fast as it came."""
    t, force = impact.curve.t, impact.history["force plate x"]
    on = force > 0.0
    assert np.count_nonzero(np.diff(on.astype(int))) == 2
    assert force.min() >= 0.0
    # The mesh rings; the mean over the time in which the wave passes 20 elements is flat.
    speed = np.sqrt(100.0 / ELASTIC.density)
    level = ELASTIC.density * speed * SPEED * DEPTH
    width = round(20.0 / speed / (t[1] - t[0]))
    smooth = np.convolve(force, np.full(width, 1.0 / width), mode="same")
    inner = (t > t[on][0] + 0.5) & (t < t[on][-1] - 0.5)
    np.testing.assert_allclose(smooth[inner], level, rtol=0.05)
    assert 0.4 * level < force[inner].min() < force[inner].max() < 1.7 * level
    impulse = np.trapezoid(force, t)
    assert impulse == pytest.approx(2.0 * ELASTIC.density * LENGTH * DEPTH * SPEED, rel=0.01)


def test_energy_is_kept_with_that_of_contact_counted(impact):
    energies = impact.energies
    start = energies["kinetic"][0]
    assert start == pytest.approx(0.5 * ELASTIC.density * LENGTH * DEPTH * SPEED**2, rel=1e-12)
    assert abs(energies["balance"]).max() < 1e-4 * start
    stored, lost = energies["contact"], energies["contact dissipated"]
    kept = energies["kinetic"] + energies["internal"] + stored + lost
    assert abs(kept / start - 1.0).max() < 1e-3
    np.testing.assert_allclose(energies["plate"], -stored - lost, atol=1e-12 * start)
    assert stored.max() > 1e-5 * start
    assert stored[-1] == 0.0


def test_the_dashpot_takes_what_the_outermost_nodes_bring(impact):
    """They stop at once, as the true boundary does: ½ m v² of the mass m = ρ h/√12 a length that a
    stiff contact moves; it is a share of 1/(√12 · 100), twice over for the rebound."""
    lost = impact.energies["contact dissipated"] / impact.energies["kinetic"][0]
    share = 1.0 / (np.sqrt(12.0) * 100.0)
    assert np.diff(lost).min() > -2e-5  # interpolated within steps
    assert share < lost[-1] < 1.5 * share


def rebound(elements, law, damping=None):
    """Let a bar between mirrors fly at a plate, by so many elements.

    Returns the momentum with which it leaves, over that with which it came, and the part of its
    energy that the dashpot took.
    """
    mirrors = (Symmetry(on="bottom"), Symmetry(on="top"))
    problem = Problem(
        mesh=rectangle(LENGTH, DEPTH, (elements, 1)),
        conditions=(InitialVelocity(velocity=(-SPEED, 0.0)), *mirrors),
        bodies=(replace(WALL, damping=damping),),
        duration=16.0,
        output_interval=0.5,
    )
    settings = MacroSettings(
        relative_tolerance=1e-5, absolute_tolerance=1e-7, frames=2, record_dissipation=False
    )
    run = simulate(problem, law, settings)
    came = law.density * LENGTH * DEPTH * SPEED
    lost = run.energies["contact dissipated"][-1] / run.energies["kinetic"][0]
    return run.history["impulse plate x"][-1] / came - 1.0, lost


def test_the_dashpot_does_not_depend_on_the_mesh_and_its_loss_vanishes_with_the_elements():
    """Its c is 7.6 impedances √(E ρ); its loss is of first order, since it is that of stopping the
    nodes of the boundary."""
    for elements in (2, 16):
        mesh = rectangle(LENGTH, DEPTH, (elements, 1))
        problem = Problem(mesh=mesh, conditions=(), bodies=(WALL,))
        (contact,) = system_of(problem, ELASTIC).contacts
        expected = np.sqrt(200.0 / np.sqrt(12.0) * 100.0 * ELASTIC.density)
        assert contact.damping == pytest.approx(expected, rel=1e-4)
    lost = [rebound(elements, ELASTIC)[1] for elements in (2, 4, 8)]
    assert rates(lost) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_viscous_tissue_rebounds_from_few_elements_as_without_a_dashpot():
    """Its own viscosity would take the motion of the outermost nodes. Figures of docs/theory.md."""
    law = KelvinVoigt(shear_viscosity=4.0, bulk_viscosity=6.0)
    found = np.array([[rebound(n, law, damping)[0] for n in (4, 8, 16)] for damping in (None, 0.0)])
    np.testing.assert_allclose(found[0], [0.795, 0.818, 0.822], atol=1e-3)
    np.testing.assert_allclose(found[1], [0.785, 0.813, 0.821], atol=1e-3)
    np.testing.assert_allclose(found[0, 1:], found[1, 1:], atol=0.006)


@pytest.mark.parametrize(
    "integrator", ["explicit", pytest.param("implicit", marks=pytest.mark.slow)]
)
def test_few_elements_and_the_default_tolerance_keep_energy_too(integrator):
    """The stiff contact is damped at the explicit steps' stability limit: the step sees that."""
    problem = Problem(
        mesh=rectangle(LENGTH, LENGTH, (8, 8)),
        conditions=(InitialVelocity(velocity=(-SPEED, 0.0)),),
        bodies=(WALL,),
        duration=12.0,
    )
    settings = MacroSettings(frames=2, record_dissipation=False, integrator=integrator)
    energies = simulate(problem, ELASTIC, settings).energies
    assert abs(energies["balance"]).max() < 1e-3 * energies["kinetic"][0]
    assert energies["contact"].max() > 0.0


def slid(share):
    """How far a block slides on a plate, to which its weight presses it, within 70 µs, µm: dragged
    by a share of Coulomb's limit, from 50 to 80 µs on.
    """
    friction, weight = 0.3, 0.02
    floor = RigidBody(
        name="floor", shape=Plane(normal=(0.0, 1.0)), on="bottom", position=(0.0, 0.0),
        friction=friction,
    )  # fmt: skip
    weighs = BodyForce(
        name="weight", acceleration=(0.0, -weight), amplitude=Ramp(end=50.0, smooth=True)
    )
    drags = BodyForce(
        name="drag",
        acceleration=(share * friction * weight, 0.0),
        amplitude=Ramp(begin=50.0, end=80.0, smooth=True),
    )
    block = Problem(
        mesh=rectangle(40.0, 20.0, (2, 2)),
        conditions=(weighs, drags),
        bodies=(floor,),
        duration=150.0,
        watched={"foot": (20.0, 0.0)},
    )
    law = KelvinVoigt(shear_viscosity=20.0, bulk_viscosity=20.0)
    settings = MacroSettings(integrator="implicit", frames=2, record_dissipation=False)
    x = simulate(block, law, settings).curve.displacement[:, 0]
    return x[-1] - x[len(x) * 8 // 15]


@pytest.mark.slow
def test_a_block_below_coulombs_limit_does_not_creep():
    """At 0.9 of the limit less than 0.01 % of what it slides at 1.1, which is half the excess of
    acceleration times the square of the time."""
    slides = slid(1.1)
    assert slides == pytest.approx(0.5 * 0.1 * 0.3 * 0.02 * 75.0**2, rel=0.2)
    assert abs(slid(0.9)) < 1e-4 * slides


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
@pytest.mark.parametrize(
    ("friction", "slip_speed"),
    [(0.0, None), (0.3, None), pytest.param(0.3, 0.02, marks=pytest.mark.slow)],
)
def test_momentum_of_tissue_and_free_body_is_kept(friction, slip_speed, integrator, rng):
    """A plate thrown at tissue in free flight, obliquely: to 1e-10 of what it gives away. It slides
    without friction or with it, or sticks."""
    law = KelvinVoigt(shear_viscosity=2.0, bulk_viscosity=3.0)
    thrown = RigidBody(
        name="plate", shape=Plane(normal=(0.1, -1.0)), on="top", mass=20.0, friction=friction,
        position=(0.5 * WIDTH, HEIGHT + 1.7), velocity=(0.3, -0.8), slip_speed=slip_speed,
    )  # fmt: skip
    mesh = plate("triangles", rng, (3, 2))
    problem = Problem(mesh=mesh, conditions=(), bodies=(thrown,), duration=3.0)
    settings = MacroSettings(
        integrator=integrator, frames=2, record_dissipation=False, newton_tolerance=1e-12
    )
    run, states = run_and_states(problem, law, settings)
    assert run.history["penetration plate"].max() > 1e-3
    system = make_system(problem, law.density)
    velocities = [system.spread(each.y, each.t, each.t)[1] for each in states]
    momentum = np.array([system.inertia(v).sum(axis=0) for v in velocities])
    start = 20.0 * np.array([0.3, -0.8])
    given = 20.0 * abs(velocities[-1][-1] - [0.3, -0.8]).max()
    assert given > 1.0
    assert abs(momentum - start).max() < 1e-10 * abs(start).max()
    # Integrated along the steps, and not from the forces at the output times.
    lost = 20.0 * (velocities[0][-1] - velocities[-1][-1])
    impulse = [run.history[f"impulse plate {axis}"][-1] for axis in "xy"]
    allowed = {"explicit": 1e-9, "implicit": 1e-3}[integrator] * given
    np.testing.assert_allclose(impulse, lost, rtol=0, atol=allowed)
