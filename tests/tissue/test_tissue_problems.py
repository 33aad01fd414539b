"""Rigid bodies, prescribed motion and loads on a tissue, by identities."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.problem import (
    BodyForce,
    Box,
    Fixed,
    Foundation,
    NodeAt,
    PrescribedMotion,
    Pressure,
    Problem,
    Traction,
    rectangle,
    with_boundaries,
    with_regions,
)
from surrofe2.problem.amplitude import Ramp, Sine, Table
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody
from surrofe2.tissue import TissueSettings, TissueState, relax
from surrofe2.tissue.simulation import (
    advance,
    held_and_loaded,
    make_conditions,
    meet_bodies,
    step_at_rest,
)
from tests.macro.bars import assert_same_run
from tests.numerics import assert_near, differences, slope_along

SMOOTH = Ramp(end=2.0, smooth=True)
UPPER = RigidBody(
    name="upper", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, 50.0),
    displacement=(0.0, -1.5), amplitude=SMOOTH,
)  # fmt: skip
LOWER = RigidBody(name="lower", shape=Plane(normal=(0.0, 1.0)), on="bottom", position=(0.0, 0.0))
PRESSED = Problem(
    mesh=rectangle(50.0, 50.0, (2, 2)), conditions=(), bodies=(LOWER, UPPER), duration=3.0,
    output_interval=0.5, watched={"top": (25.0, 50.0)},
)  # fmt: skip


def ready(reference, problem, preset="water"):
    """Conditions and dynamics of a problem, relaxed, with its bodies."""
    conditions = make_conditions(problem, *reference(preset))
    dynamics = held_and_loaded(conditions, TissueSettings())
    relax(dynamics, 1e-6)
    meet_bodies(dynamics, conditions, dynamics.x)
    return conditions, dynamics


@pytest.mark.parametrize(
    "body",
    [replace(LOWER, on="top", position=(0.0, 50.0), shape=Plane(normal=(0.6, -0.8))),
     replace(LOWER, on="top", shape=Circle(radius=20.0), position=(25.0, 70.0)),
     replace(LOWER, on="top", position=(26.0, 50.0),
             shape=Corner(axis=(0.1, 1.0), angle=150.0, radius=4.0))],
    ids=["oblique plane", "circle", "corner"],
)  # fmt: skip
def test_contact_force_is_the_gradient_of_its_energy(reference, body):
    """On each particle, and in sum against the force on the body."""
    conditions = make_conditions(replace(PRESSED, bodies=(body,)), *reference("water"))
    dynamics = held_and_loaded(conditions, TissueSettings())
    free, x = dynamics.forces(), dynamics.x
    meet_bodies(dynamics, conditions, x)
    dynamics.bodies.x[0] += (10.0 if body.position[0] == 0.0 else 0.0, -1.5)
    pressed = dynamics.forces() - free
    assert (abs(pressed).sum(axis=1) > 1.0).sum() > 3
    total = dynamics.bodies.force[0].copy()
    np.testing.assert_allclose(pressed.sum(axis=0), total, rtol=0, atol=1e-10 * abs(total).max())

    def stored(x, place):
        dynamics.place(x)
        dynamics.bodies.x[0] = place
        dynamics.forces()
        return dynamics.bodies.stored[0]

    direction, place = np.random.default_rng(3).normal(size=x.shape), dynamics.bodies.x[0].copy()
    slope = slope_along(lambda at: stored(at, place), x, direction, 1e-5)
    assert slope == pytest.approx(-np.sum(pressed * direction), rel=1e-6)
    assert_near(differences(lambda at: stored(x, at), place, 1e-5, axes=1), total, 1e-6)


@pytest.mark.parametrize(
    "rough",
    [{}, {"friction": 0.4, "damping": 3.0},
     {"friction": 0.4, "shape": Corner(axis=(0.2, 1.0), angle=150.0, radius=4.0)}],
    ids=["smooth plate", "rough plate", "rough corner"],
)  # fmt: skip
def test_free_body_and_tissue_keep_their_momentum_and_energy(reference, run_tissue, rough):
    """A heavy body is thrown on a tissue that nothing holds, aslant where it is rough."""
    velocity = (0.5, -1.0) if rough else (0.0, -1.0)
    thrown = replace(
        UPPER, displacement=(0.0, 0.0), mass=30.0, velocity=velocity, position=(25.0, 50.3), **rough
    )
    conditions, dynamics = ready(reference, replace(PRESSED, bodies=(thrown,)))
    dynamics.start(conditions.velocity(), np.zeros(0))
    begin = 30.0 * np.array(velocity)
    forces = []
    for k in range(8):
        advance(dynamics, conditions, TissueSettings(), 0.25 * k, 0.25 * (k + 1))
        forces.append(dynamics.bodies.force[0].copy())
        momentum = dynamics.mass @ dynamics.v + 30.0 * dynamics.bodies.v[0]
        np.testing.assert_allclose(momentum, begin, rtol=0, atol=30e-11)
    assert min(force[1] for force in forces) < -5.0
    assert abs(dynamics.mass @ dynamics.v[:, 1]) > 0.1 * 30.0
    done = run_tissue(replace(PRESSED, bodies=(thrown,)), micro_step=5e-4, energy_steps=2)
    energies = done.energies
    start = 15.0 * np.dot(velocity, velocity)
    assert energies["kinetic"][0] == pytest.approx(start)
    assert abs(energies["balance"]).max() < 1e-3 * start
    assert done.history["position upper y"][0] == pytest.approx(0.0, abs=1e-12)
    assert energies["contact"].max() > 0.0
    # what the body gave away is what the tissue has, at every output time and not by samples
    total = np.einsum("p,kpi->ki", dynamics.mass, done.frames.velocity)
    impulse = np.stack([done.history[f"impulse upper {axis}"] for axis in "xy"], axis=1)
    at_frames = np.searchsorted(done.curve.t, done.frames.t - 1e-9)
    np.testing.assert_allclose(impulse[at_frames], total, rtol=0, atol=1e-11 * 30.0)
    assert abs(impulse[-1, 1]) > 0.1 * 30.0
    lost = energies["contact dissipated"]
    assert np.diff(lost).min() > -1e-9
    assert (lost[-1] > 0.01 * start) if rough else (lost[-1] == 0.0)


@pytest.mark.slow
def test_energy_balance_falls_with_the_step(run_tissue):
    """Motion of a boundary, of a plate and a load at once: first order, for the dashpots."""
    grip = PrescribedMotion(name="grip", on="right", displacement=(1.0, None), amplitude=SMOOTH)
    loads = (
        Traction(name="pull", traction=(2.0, 1.0), on="top", amplitude=Sine(frequency=0.3)),
        Pressure(name="gas", pressure=3.0, on="bottom", amplitude=Sine(frequency=0.2)),
        Foundation(name="base", stiffness=2.0, damping=1.0, on="top", components="x"),
    )
    problem = replace(
        PRESSED, conditions=(Fixed(name="clamp", on="left"), grip, *loads),
        bodies=(replace(UPPER, displacement=(0.0, -0.5), friction=0.3, damping=2.0),),
    )  # fmt: skip
    balances = []
    for step in (1e-3, 5e-4):
        energies = run_tissue(problem, micro_step=step, energy_steps=2).energies
        balances.append(abs(energies["balance"]).max())
    assert {"pull", "gas", "base", "motion", "contact", "contact dissipated"} < set(energies)
    assert min(abs(energies[name]).max() for name in ("gas", "base", "contact dissipated")) > 0.3
    assert np.log2(balances[0] / balances[1]) == pytest.approx(1.0, abs=0.4)
    assert balances[0] < 1e-3 * energies["motion"].max()


def test_forces_of_all_that_acts_are_the_rate_of_momentum(reference, run_tissue):
    """Reactions, loads and contact together move the tissue's centre of mass."""
    grip = PrescribedMotion(name="grip", on="right", displacement=(1.0, 0.5), amplitude=SMOOTH)
    loads = (
        BodyForce(name="weight", acceleration=(0.1, -0.4)),
        Pressure(name="gas", pressure=20.0, on="top"),
        Foundation(name="base", stiffness=20.0, damping=5.0, on="bottom"),
    )
    problem = replace(
        PRESSED, conditions=(Fixed(name="clamp", on="left"), grip, *loads), duration=1.0,
        output_interval=0.01, bodies=(replace(LOWER, friction=0.4), replace(UPPER, damping=2.0)),
    )  # fmt: skip
    done = run_tissue(problem, micro_step=5e-4)
    names = ("clamp", "grip", "weight", "gas", "base", "lower", "upper")
    total = np.stack(
        [sum(done.history[f"force {name} {axis}"] for name in names) for axis in "xy"], axis=1
    )
    tissue = make_conditions(problem, *reference("water")).tissue
    mass = tissue.to_particles(tissue.mass)
    impulse = 0.01 * (total.sum(axis=0) - 0.5 * (total[0] + total[-1]))
    end = mass @ done.frames.velocity[-1]
    np.testing.assert_allclose(impulse, end, rtol=0, atol=2e-3 * abs(end).max())


def test_friction_is_that_of_coulomb_where_a_plate_slides_and_of_a_grip_where_it_sticks(run_tissue):
    """A plate presses and then moves along: fast, against a held tissue; slowly, a free one."""
    press = Table(points=((0.0, 0.0), (1.0, 1.0)))
    held = Fixed(name="held", on="bottom")
    upper = replace(UPPER, friction=0.3, displacement=(0.0, -0.5), amplitude=press)
    found = {}
    for name, speed in (("slides", 6.0), ("sticks", 0.05)):
        along = replace(upper, displacement=(speed, -0.5), slip_speed=1e-3)
        problem = replace(PRESSED, conditions=(held,), bodies=(along,), duration=0.9)
        done = run_tissue(problem)
        force = [done.history[f"force upper {axis}"][-1] for axis in "xy"]
        found[name] = force[0] / -force[1], done.history["mean displacement top x"][-1]
    assert found["slides"][0] == pytest.approx(0.3, rel=0.01)
    assert found["slides"][1] < 3.0
    assert 0.0 < found["sticks"][0] < 0.29
    assert found["sticks"][1] == pytest.approx(0.9 * 0.05, abs=0.005)


def test_pressure_follows_and_is_the_gradient_of_the_area(reference):
    """All around no resultant; on each particle −p ∂A."""
    around = tuple(
        Pressure(name=side, on=side, pressure=7.0, amplitude=Table(points=((0.0, 2.0),)))
        for side in ("left", "right", "bottom", "top")
    )
    conditions, dynamics = ready(reference, replace(PRESSED, bodies=(), conditions=around))
    factors, x = np.full(4, 2.0), dynamics.x
    free = dynamics.forces(with_outline=False)
    pushed = dynamics.forces(amplitudes=factors) - free
    np.testing.assert_allclose(dynamics.outline.total[3], [0.0, -14.0 * 50.0], rtol=0, atol=1e-9)
    outline = conditions.outline_places
    outer = np.flatnonzero(np.isfinite(outline[:, 0]) & (abs(outline - 25.0).max(axis=1) > 24.9))
    order = outer[np.argsort(np.arctan2(*(outline[outer] - 25.0).T[::-1]))]
    direction = np.random.default_rng(5).normal(size=x.shape)

    def area(u):
        a = (outline[order] + u[order]).T
        return 0.5 * float(np.sum(a[0] * np.roll(a[1], -1) - a[1] * np.roll(a[0], -1)))

    slope = slope_along(area, 0.0 * x, direction, 1e-4)
    assert np.sum(pushed * direction) == pytest.approx(-14.0 * slope, rel=1e-9)
    dynamics.place(x + 0.5 * direction)
    moved = dynamics.forces(amplitudes=factors) - dynamics.forces(with_outline=False)
    assert abs(moved - pushed).max() > 1.0
    assert abs(moved.sum(axis=0)).max() < 1e-9


def test_foundation_holds_by_its_length_and_a_region_by_all_its_particles(reference):
    base = Foundation(name="base", on="bottom", stiffness=3.0, damping=0.7, components="y")
    held = Fixed(name="held", on="core", components="x")
    core = Box((0.0, 0.0), (25.0, 50.0))
    problem = replace(PRESSED, bodies=(), conditions=(base, held), regions={"core": core})
    _, dynamics = ready(reference, problem)
    x, lift = dynamics.x, np.array([0.2, 0.5])
    dynamics.place(x + lift, np.broadcast_to([1.0, 2.0], x.shape).copy())
    dynamics.forces()
    total = dynamics.outline.total[0]
    np.testing.assert_allclose(total, [0.0, -50.0 * (3.0 * 0.5 + 0.7 * 2.0)], rtol=1e-12)
    held = ~dynamics.free[:, 0]
    assert dynamics.free[:, 1].all()
    assert held.sum() == 2 * 16 + 2 * 21 + 3 * 9  # fluid of two cells, walls along y and along x


def test_stiff_plate_is_prescribed_motion(reference):
    """From the same rest, work and force of a plate tend to those of a driven side as 1/k."""
    found = []
    for stiffness in (1600.0, 6400.0, 25600.0):
        plate = replace(UPPER, stiffness=stiffness, smoothing=1e-7)
        held = Fixed(name="base", on="bottom", components="y")
        problem = replace(PRESSED, bodies=(plate,), conditions=(held,), duration=2.0)
        conditions, dynamics = ready(reference, problem)
        settings = TissueSettings(micro_step=2.5e-4)
        dynamics.start(conditions.velocity(), np.zeros(1))
        rest = dynamics.x
        _, works = advance(dynamics, conditions, settings, 0.0, 2.0)
        found.append((works.motion, dynamics.bodies.force[0, 1]))
    side = PrescribedMotion(name="side", on="top", displacement=(None, -1.5), amplitude=SMOOTH)
    driven = replace(problem, bodies=(), conditions=(held, side))
    conditions = make_conditions(driven, *reference("water"))
    dynamics = held_and_loaded(conditions, settings)
    dynamics.place(rest)
    at_rest = dynamics.forces()
    top = conditions.boundary("top")
    _, works = advance(dynamics, conditions, settings, 0.0, 2.0)
    force = -dynamics.forces()[top, 1].sum()
    assert abs(at_rest[top, 1].sum()) < 1e-3
    off = [abs(np.array(one) / (works.motion, force) - 1.0) for one in found]
    assert (off[0] > 3.0 * off[1]).all()
    assert (off[1] > 3.0 * off[2]).all()
    assert off[2].max() < 3e-3


def test_driven_side_arrives_where_it_is_led(run_tissue):
    grip = PrescribedMotion(
        name="grip", on="right", displacement=(0.8, -0.3), amplitude=Table(points=((0, 0), (1, 1)))
    )
    problem = replace(
        PRESSED, bodies=(), conditions=(Fixed(name="clamp", on="left"), grip), duration=1.5,
        watched={"corner": (50.0, 50.0)},
    )  # fmt: skip
    done = run_tissue(problem)
    np.testing.assert_allclose(done.curve.displacement[-1], [0.8, -0.3], rtol=0, atol=1e-10)
    np.testing.assert_allclose(done.curve.displacement[1], [0.4, -0.15], rtol=0, atol=1e-10)
    assert done.history["mean displacement right x"][-1] == pytest.approx(0.8, abs=1e-10)
    assert done.energies["motion"][0] > 0.0  # the impulse of a start at once


def test_run_with_bodies_resumes_bit_by_bit(run_tissue):
    thrown = replace(UPPER, name="thrown", displacement=(0.0, 0.0), mass=30.0, velocity=(0.1, -1.0))
    problem = replace(PRESSED, bodies=(LOWER, thrown), duration=1.5)
    states = []
    whole = run_tissue(problem, checkpoint=states.append, checkpoint_interval=0.0)
    state = TissueState.from_arrays(states[0].to_arrays())
    assert_same_run(run_tissue(problem, resume=state), whole)


def test_stiff_plate_shortens_the_step(reference, run_tissue):
    steps = [
        step_at_rest(make_conditions(replace(PRESSED, bodies=bodies), *reference("water")))
        for bodies in ((), (LOWER,), (replace(LOWER, stiffness=1e5),))
    ]
    assert steps[0] > steps[1] > 0.9 * steps[0]
    assert steps[2] < 0.6 * steps[0]
    done = run_tissue(replace(PRESSED, bodies=(replace(LOWER, stiffness=1e5), UPPER)))
    assert abs(done.energies["balance"]).max() < 1e-3 * done.energies["motion"].max()


def test_sides_and_elements_of_a_mesh_pick_what_regions_of_the_plane_do(reference):
    """A boundary and a region of a mesh alone, against the same ones stated by the plane."""
    parts = {"corner": Box((-1.0, 25.0), (1.0, 50.0))}, {"core": Box((25.0, 0.0), (50.0, 25.0))}
    mesh = with_regions(with_boundaries(PRESSED.mesh, **parts[0]), **parts[1])
    held = Fixed(name="held", on="corner")
    pull = BodyForce(name="pull", on="core", acceleration=(0.3, 0.1))
    stated = replace(PRESSED, conditions=(held, pull), bodies=(LOWER,))
    both = replace(stated, mesh=mesh), replace(stated, boundaries=parts[0], regions=parts[1])
    found = [make_conditions(each, *reference("water")) for each in both]
    assert found[0].held.sum() == 2 * 11
    np.testing.assert_array_equal(*(each.held for each in found))
    np.testing.assert_array_equal(*(each.dead_loads() for each in found))
    assert found[0].dead_loads()[0].sum(axis=0) == pytest.approx(
        0.25 * found[0].tissue.mass.sum() * np.array([0.3, 0.1])
    )


GRIP = PrescribedMotion(name="other", on="top", displacement=(0.0, 1.0), amplitude=SMOOTH)
CLAMP = Fixed(name="clamp", on="left")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"conditions": (CLAMP, GRIP)}, r"other: component y of the particle at \(0, 50\) µm; cl"),
        (
            {"conditions": (Fixed(name="held", on="seam"),), "mesh": rectangle(50.0, 50.0, (4, 4)),
             "regions": {"seam": Box((18.0, 0.0), (20.0, 50.0))}},
            "region seam: it holds the middle of no plant cell",
        ),
        (
            {"bodies": (replace(UPPER, on="patch"),), "mesh": rectangle(50.0, 50.0, (50, 1)),
             "boundaries": {"patch": Box((2.6, 49.0), (4.9, 51.0))}},
            "boundary patch: it holds no wall particle",
        ),
        (
            {"mesh": replace(PRESSED.mesh, doflocs=0.7 * PRESSED.mesh.p + 1.0)},
            r"mesh: its 1225 µm² hold the middles of 1 plant cells of 625 µm²; both areas may",
        ),
        (
            {"conditions": (Fixed(on=NodeAt((0.0, 0.0))),)},
            "conditions: one acts at 0 0, on a node of the mesh; a tissue of particles takes",
        ),
        ({"mesh": rectangle(60.0, 50.0, (2, 2))}, "mesh.width: 60; a tissue needs a whole number"),
        ({"mesh": rectangle(50.0, 20.0, (2, 2))}, "mesh.height: 20; a tissue needs a whole num"),
    ],
)  # fmt: skip
def test_what_a_tissue_cannot_bear_is_named(run_tissue, changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        run_tissue(replace(PRESSED, **{"bodies": (), **changes}))
