"""Prescribed motion and loads with corners: energy, momentum, runs that resume."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.system import make_system
from surrofe2.problem import (
    BodyForce,
    Circle,
    Fixed,
    Foundation,
    InitialVelocity,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Traction,
    rectangle,
)
from surrofe2.problem.amplitude import ONE, Pulse, Ramp, Sine, Table
from tests.laws import KelvinVoigt
from tests.macro.bars import assert_same_run, random_state, resumed, state_vector
from tests.macro.meshes import HEIGHT, WIDTH, plate, sides_of

LAW = KelvinVoigt()
JERK = Table(points=((0.0, 0.0), (0.5, 0.0), (1.5, 1.0), (2.2, 0.4)))
"""Velocity jumps at 0.5, 1.5 and 2.2 µs."""


def pulled(kind, rng, amplitude=JERK, **settings):
    conditions = (
        Fixed(on="left"),
        PrescribedMotion(on="right", displacement=(1.5, None), amplitude=amplitude),
    )
    settings = {"duration": 3.0, "output_interval": 0.1, **settings}
    return Problem(mesh=plate(kind, rng, (3, 2)), conditions=conditions, **settings)


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_a_jump_of_velocity_keeps_the_momentum_of_what_is_free(kind, rng):
    """Work of the jump is the gain of kinetic energy, and no free unknown feels an impulse."""
    system = make_system(pulled(kind, rng), LAW.density)
    y = state_vector(system, *random_state(system, rng, 0.1))
    after, work = system.across_corner(y, 1.5, 1.4, 1.6)
    u_before, v_before = system.spread(y, 1.5, 1.4)
    u_after, v_after = system.spread(after, 1.5, 1.6)
    np.testing.assert_array_equal(u_after, u_before)
    right = np.unique(sides_of(system.problem.mesh, "right"))
    np.testing.assert_allclose(v_before[right, 0], 1.5, rtol=1e-14)
    np.testing.assert_allclose(v_after[right, 0], 1.5 * -0.6 / 0.7, rtol=1e-14)
    impulse = system.inertia(v_after - v_before)
    assert abs(impulse).max() > 1.0
    assert abs(system.pick(impulse)).max() < 1e-13 * abs(impulse).max()
    gain = 0.5 * (
        np.vdot(v_after, system.inertia(v_after)) - np.vdot(v_before, system.inertia(v_before))
    )
    assert work[-2:] == pytest.approx(gain, rel=1e-12)
    assert not work[:-2].any()


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_energy_balance_with_prescribed_motion(kind, rng):
    """Work of the supports, jumps included, is what the tissue gains and dissipates."""
    settings = MacroSettings(absolute_tolerance=1e-9, relative_tolerance=1e-8, frames=2)
    run = simulate(pulled(kind, rng), LAW, settings)
    energies = run.energies
    largest = abs(energies["motion"]).max()
    assert largest > 10.0
    assert abs(energies["balance"]).max() < 1e-6 * largest
    right = run.history["mean displacement right x"]
    t = run.curve.t
    np.testing.assert_allclose(
        right, 1.5 * np.interp(t, *zip(*JERK.points, strict=True)), atol=1e-12
    )
    # Between the corners the work is ∫ force · velocity; the jump at 0.5 µs comes as ½ m v².
    force = run.history["force prescribed_motion right x"]
    inner = (t > 0.75) & (t < 1.45)
    power = np.gradient(energies["motion"], t)[inner]
    np.testing.assert_allclose(power, 1.5 * force[inner], atol=0.05 * abs(power).max())


def test_equations_count_the_acceleration_of_what_is_prescribed(rng):
    """M ü = forces − f − M ü_prescribed on the free unknowns, and the reaction takes the rest."""
    problem = pulled("quads", rng, Sine(frequency=0.3))
    system = make_system(problem, LAW.density)
    equations = EquationsOfMotion(system, LAW)
    u, v = random_state(system, rng, 0.1)
    equations.enter_piece(0)
    now = equations.evaluate(0.7, state_vector(system, u, v))
    a = np.zeros(2 * system.n_rows)
    a[system.free] = now.acceleration
    a = a.reshape(-1, 2)
    omega = 0.6 * np.pi
    right = np.unique(sides_of(problem.mesh, "right"))
    a[right, 0] = -1.5 * omega**2 * np.sin(omega * 0.7)
    unbalanced = system.inertia(a) + now.internal
    assert abs(system.pick(unbalanced)).max() < 1e-12 * abs(unbalanced).max()
    reaction = equations.reaction(now)
    np.testing.assert_allclose(reaction, unbalanced, atol=1e-12 * abs(unbalanced).max())
    assert now.powers[-2] == pytest.approx(np.vdot(unbalanced, now.v), rel=1e-10)
    assert abs(system.free_mass @ now.acceleration).max() > 0.0


@pytest.mark.parametrize(
    ("amplitude", "message"),
    [
        (ONE, r"prescribed_motion right\.amplitude: jumps from 0 to 1 at t = 0 µs; .* must begin"),
        (Pulse(begin=1.0, length=1.0, shape="rectangle"),
         r"prescribed_motion right\.amplitude: jumps from 0 to 1 at t = 1 µs"),
    ],
)  # fmt: skip
def test_motion_that_does_not_begin_at_zero_or_jumps_is_refused(amplitude, message, rng):
    with pytest.raises(InputError, match=message):
        simulate(pulled("quads", rng, amplitude), LAW)


def everything(rng):
    """All that acts, each with corners of its own."""
    conditions = (
        Fixed(on="left"),
        PrescribedMotion(on="right", displacement=(0.8, None), amplitude=JERK),
        BodyForce(acceleration=(0.2, -0.4), amplitude=Ramp(begin=0.3, end=1.1)),
        Traction(
            on="top",
            traction=(0.5, 0.0),
            amplitude=Pulse(begin=0.7, length=0.4, shape="rectangle"),
        ),
        Pressure(on="bottom", pressure=1.0, amplitude=Ramp(begin=1.0, end=2.0, smooth=True)),
        Foundation(on="bottom", stiffness=0.5, damping=0.1),
    )
    ball = RigidBody(
        name="ball", shape=Circle(radius=6.0), on="top", mass=3.0, velocity=(0.0, -0.9),
        position=(0.5 * WIDTH, HEIGHT + 6.8), friction=0.2,
    )  # fmt: skip
    return Problem(
        mesh=plate("quads", rng, (3, 2)),
        conditions=conditions,
        bodies=(ball,),
        duration=2.6,
        output_interval=0.05,
    )


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_run_resumes_to_the_bit_across_corners(integrator, rng):
    """From a state in a piece, from one at a corner, and from one behind it."""
    problem, states = everything(rng), []
    settings = MacroSettings(integrator=integrator, frames=5)
    whole = simulate(problem, LAW, settings, checkpoint=states.append, checkpoint_interval=0.0)
    t = np.array([state.t for state in states])
    corners = problem.corners()[1:-1]
    assert np.isin(corners, t).all(), "every corner is the end of a step"
    at_corner = int(np.flatnonzero(t == corners[3])[0])
    assert whole.history["penetration ball"].max() > 0.0
    for number in (2, at_corner, at_corner + 1):
        assert_same_run(resumed(problem, LAW, settings, states[number]), whole)


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_balance_closes_with_everything_that_acts_at_the_default_tolerance(integrator, rng):
    """Works of all loads, bodies, springs and supports, to 1e-6 of the largest term and better."""
    problem = everything(rng)
    settings = MacroSettings(integrator=integrator, frames=2, record_dissipation=False)
    energies = simulate(problem, LAW, settings).energies
    largest = max(abs(values).max() for name, values in energies.items() if name != "balance"
                  and np.isfinite(values).all())  # fmt: skip
    worked = {name for name, values in energies.items() if abs(np.nan_to_num(values)).max() > 1e-4}
    assert {"motion", "body_force", "traction top", "pressure bottom", "foundation bottom",
            "ball", "contact", "internal", "kinetic"} <= worked  # fmt: skip
    assert abs(energies["balance"]).max() < 1e-9 * largest
    assert abs(energies["numerical"]).max() < 1e-4 * largest
    assert energies["balance"].size == problem.output_times().size


def test_an_initial_velocity_of_all_leaves_what_is_held_at_rest_without_a_blow():
    """Kinetic energy at t = 0 is that of the free nodes' velocity, and no work was done."""
    mesh = rectangle(30.0, 20.0, (3, 2))
    thrown = Problem(
        mesh=mesh,
        conditions=(Fixed(on="left"), InitialVelocity(velocity=(0.0, 0.3))),
        duration=1.0,
    )
    run = simulate(thrown, KelvinVoigt())
    held = mesh.p.T[:, 0] == 0.0
    assert not run.frames.velocity[0, held].any()
    np.testing.assert_array_equal(run.frames.velocity[0, ~held], [[0.0, 0.3]] * (~held).sum())
    assert run.energies["balance"][0] == 0.0
