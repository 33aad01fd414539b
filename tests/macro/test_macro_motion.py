"""What acts in time: amplitudes, prescribed motion, corners; energy, momentum, runs that resume."""

import math
from itertools import pairwise

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
    Plane,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Traction,
    rectangle,
)
from surrofe2.problem.amplitude import ONE, Amplitude, Constant, Pulse, Ramp, Sine, Table
from tests.laws import KelvinVoigt
from tests.macro.bars import assert_same_run, random_state, resumed, run_and_states, state_vector
from tests.macro.meshes import HEIGHT, WIDTH, plate, sides_of

AMPLITUDES = {
    "constant": Constant(value=-0.7),
    "table": Table(points=((0.5, 0.0), (1.0, 2.0), (3.0, -1.0))),
    "ramp": Ramp(begin=0.4, end=2.1),
    "smooth ramp": Ramp(begin=0.4, end=2.1, smooth=True),
    "sine": Sine(frequency=0.8, phase=30.0, offset=0.2, begin=0.3),
    "half sine": Pulse(begin=0.2, length=1.7),
    "triangle": Pulse(begin=0.2, length=1.7, shape="triangle"),
    "rectangle": Pulse(begin=0.2, length=1.7, shape="rectangle"),
}
# What happens at each corner: V: the factor jumps, R: its rate, S: the rate of that.
JUMPS = {
    "constant": "",
    "table": "RRR",
    "ramp": "RR",
    "smooth ramp": "--",
    "sine": "R",
    "half sine": "RR",
    "triangle": "RRR",
    "rectangle": "VV",
}


@pytest.mark.parametrize("name", AMPLITUDES)
def test_rates_are_those_of_differences_inside_every_piece(name):
    amplitude, step = AMPLITUDES[name], 1e-5
    assert isinstance(amplitude, Amplitude)
    assert list(amplitude.corners()) == sorted(amplitude.corners())
    for begin, end in pairwise([-1.0, *amplitude.corners(), 5.0]):
        for t in np.linspace(begin, end, 9)[1:-1]:
            value, *slopes = amplitude.at(t, t)
            before, after = (np.array(amplitude.at(t + h, t)) for h in (-step, step))
            assert ((after - before) / (2.0 * step))[:2] == pytest.approx(slopes, abs=1e-8)
            assert 0.5 * (after + before)[0] == pytest.approx(value, abs=1e-8)


@pytest.mark.parametrize("name", AMPLITUDES)
def test_a_piece_is_smooth_to_its_ends_and_jumps_behind_them(name):
    """At a corner `within` says whose value is asked; the other side has what it says."""
    amplitude = AMPLITUDES[name]
    found = ""
    for corner in amplitude.corners():
        left, right = (amplitude.at(corner, corner + side * 1e-9) for side in (-1.0, 1.0))
        for side, values in ((-1.0, left), (1.0, right)):
            near = amplitude.at(corner + side * 1e-7, corner + side * 1e-7)
            np.testing.assert_allclose(values, near, atol=1e-4)
        jumps = [abs(b - a) > 1e-9 for a, b in zip(left, right, strict=True)]
        found += "V" if jumps[0] else "R" if jumps[1] else "S" if jumps[2] else "-"
    assert found == JUMPS[name]


def test_known_values():
    table = AMPLITUDES["table"]
    assert [table.at(t, t)[0] for t in (0.0, 0.75, 2.0, 9.0)] == [0.0, 1.0, 0.5, -1.0]
    smooth = AMPLITUDES["smooth ramp"]
    assert smooth.at(1.25, 1.25)[0] == pytest.approx(0.5)
    sine = Sine(frequency=0.25, begin=1.0)
    assert [sine.at(t, t)[0] for t in (0.0, 2.0, 3.0, 4.0)] == pytest.approx([0.0, 1.0, 0.0, -1.0])
    for shape in ("half-sine", "triangle", "rectangle"):
        pulse = Pulse(begin=1.0, length=2.0, shape=shape)
        assert pulse.at(2.0, 2.0 + 1e-9)[0] == pytest.approx(1.0)
        assert pulse.at(0.5, 0.5)[0] == pulse.at(3.5, 3.5)[0] == 0.0


def test_a_step_that_sees_the_shape():
    assert AMPLITUDES["sine"].resolved_by == pytest.approx(1.0 / 8.0 / 0.8)
    assert AMPLITUDES["half sine"].resolved_by == pytest.approx(1.7 / 8.0)
    for name in ("constant", "table", "ramp", "triangle", "rectangle"):
        assert AMPLITUDES[name].resolved_by == math.inf


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Table(), r"amplitude\.points: \[\]; it must have at least one"),
        (lambda: Sine(frequency=0.0), r"amplitude\.frequency: .*must be"),
        (lambda: Pulse(length=1.0, shape="square"), r"amplitude\.shape: .*must be"),
        (lambda: Constant(value=math.nan), r"amplitude\.value: .*must be"),
    ],
)
def test_amplitudes_out_of_range_are_one_line(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


SQUARE = rectangle(10.0, 10.0, (2, 2))


def ran(*acting):
    bodies = tuple(each for each in acting if isinstance(each, RigidBody))
    problem = Problem(
        mesh=SQUARE,
        conditions=(Fixed(on="left"), *(each for each in acting if each not in bodies)),
        bodies=bodies,
        duration=1.0,
        output_interval=0.5,
    )
    return simulate(problem, KelvinVoigt(), MacroSettings(record_dissipation=False, frames=2))


@pytest.mark.parametrize("late", [Ramp(begin=2.0, end=3.0), Pulse(begin=1.0, length=2.0)])
def test_what_is_zero_during_the_whole_run_is_refused(late):
    """The same that acts at its end, or is a constant 0, is not."""
    push = BodyForce(acceleration=(0.1, 0.0), amplitude=late)
    pull = PrescribedMotion(on="right", displacement=(1.0, None), amplitude=late)
    plate = RigidBody(
        name="plate", shape=Plane(normal=(-1.0, 0.0)), on="right", position=(11.0, 0.0),
        displacement=(-1.0, 0.0), amplitude=late,
    )  # fmt: skip
    for acting, name in ((push, "body_force"), (pull, "prescribed_motion right"), (plate, "plate")):
        with pytest.raises(InputError, match=f"{name}.amplitude: zero during the whole run of 1"):
            ran(acting)
    for taken in (Ramp(begin=0.9, end=3.0), Pulse(begin=0.7, length=0.1), Constant(value=0.0)):
        assert ran(BodyForce(acceleration=(0.1, 0.0), amplitude=taken)).finished


@pytest.mark.parametrize("velocity", [(0.3, 0.0), (0.3, -0.1)])
def test_a_velocity_of_nothing_but_what_is_held_is_refused(velocity):
    with pytest.raises(InputError, match=r"initial_velocity left.on: left; supports hold or move"):
        ran(InitialVelocity(on="left", velocity=velocity))
    pull = PrescribedMotion(on="right", displacement=(1.0, None), amplitude=Ramp(end=1.0))
    thrown = InitialVelocity(on="right", velocity=velocity)
    if velocity[1] == 0.0:
        with pytest.raises(InputError, match=r"initial_velocity right.on: right; supports hold"):
            ran(pull, thrown)
    else:
        assert ran(pull, thrown).finished
    assert ran(InitialVelocity(on="top", velocity=velocity)).finished


LAW = KelvinVoigt()
JERK = Table(points=((0.0, 0.0), (0.5, 0.0), (1.5, 1.0), (2.2, 0.4)))
"""Velocity jumps at 0.5, 1.5 and 2.2 µs."""


def pulled(kind, rng, amplitude=JERK, **settings):
    pull = PrescribedMotion(on="right", displacement=(1.5, None), amplitude=amplitude)
    settings = {"duration": 3.0, "output_interval": 0.1, **settings}
    return Problem(mesh=plate(kind, rng, (3, 2)), conditions=(Fixed(on="left"), pull), **settings)


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
    before, after = (0.5 * np.vdot(v, system.inertia(v)) for v in (v_before, v_after))
    assert work[-2:] == pytest.approx(after - before, rel=1e-12)
    assert not work[:-2].any()


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_energy_balance_with_prescribed_motion(kind, rng):
    settings = MacroSettings(absolute_tolerance=1e-9, relative_tolerance=1e-8, frames=2)
    run = simulate(pulled(kind, rng), LAW, settings)
    energies = run.energies
    largest = abs(energies["motion"]).max()
    assert largest > 10.0
    assert abs(energies["balance"]).max() < 1e-6 * largest
    right = run.history["mean displacement right x"]
    t = run.curve.t
    moved = 1.5 * np.interp(t, *zip(*JERK.points, strict=True))
    np.testing.assert_allclose(right, moved, atol=1e-12)
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
    assert now.powers.motion == pytest.approx(np.vdot(unbalanced, now.v), rel=1e-10)
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
    kick = Pulse(begin=0.7, length=0.4, shape="rectangle")
    conditions = (
        Fixed(on="left"),
        PrescribedMotion(on="right", displacement=(0.8, None), amplitude=JERK),
        BodyForce(acceleration=(0.2, -0.4), amplitude=Ramp(begin=0.3, end=1.1)),
        Traction(on="top", traction=(0.5, 0.0), amplitude=kick),
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


@pytest.mark.parametrize(
    "integrator", ["explicit", pytest.param("implicit", marks=pytest.mark.slow)]
)
def test_run_resumes_to_the_bit_across_corners(integrator, rng):
    """From a state in a piece, from one at a corner, and from one behind it."""
    problem, settings = everything(rng), MacroSettings(integrator=integrator, frames=5)
    whole, states = run_and_states(problem, LAW, settings)
    t = np.array([state.t for state in states])
    corners = problem.corners()[1:-1]
    assert np.isin(corners, t).all(), "every corner is the end of a step"
    at_corner = int(np.flatnonzero(t == corners[-2])[0])
    assert whole.history["penetration ball"].max() > 0.0
    for number in (at_corner - 1, at_corner, at_corner + 1):
        assert_same_run(resumed(problem, LAW, settings, states[number]), whole)


@pytest.mark.parametrize(
    "integrator", ["explicit", pytest.param("implicit", marks=pytest.mark.slow)]
)
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
    conditions = Fixed(on="left"), InitialVelocity(velocity=(0.0, 0.3))
    run = simulate(Problem(mesh=mesh, conditions=conditions, duration=1.0), KelvinVoigt())
    held = mesh.p.T[:, 0] == 0.0
    assert not run.frames.velocity[0, held].any()
    np.testing.assert_array_equal(run.frames.velocity[0, ~held], [[0.0, 0.3]] * (~held).sum())
    assert run.energies["balance"][0] == 0.0
