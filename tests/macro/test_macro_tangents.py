"""Tangents of the tissue, slopes of pressure, foundation and contact, and Newton that uses them."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, find_rest
from surrofe2.macro.elements import (
    deformation_gradient,
    gradient_matrix,
    internal_force,
    point_tangents,
    summed,
    with_transpose,
)
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.forces import Grip
from surrofe2.macro.system import make_system
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import (
    BodyForce,
    Circle,
    Corner,
    Fixed,
    Foundation,
    Plane,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    rectangle,
)
from surrofe2.rve import RveLaw, RveSettings
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola
from tests.macro.bars import distorted_bar, random_state, state_vector
from tests.macro.meshes import HEIGHT, WIDTH, plate
from tests.numerics import assert_near, differences


def force_of(bar, law, u, v, state=None):
    F, F_dot, _ = deformation_gradient(bar.discretisation, u, v)
    stress = law.respond(F, F_dot, state).stress
    return bar.pick(internal_force(bar.discretisation, F, stress))


def exact(bar, law, u, v):
    F, F_dot, _ = deformation_gradient(bar.discretisation, u, v)
    answer = law.respond(F, F_dot, tangents=True)
    space, P, slopes = bar.discretisation, answer.first_piola(F), answer.tangents
    S = with_transpose(gradient_matrix(space, bar.n_rows)[:, bar.free])
    by_u = point_tangents(space, F, P, slopes.P_by_F)
    by_v = point_tangents(space, F, 0.0 * P, slopes.P_by_F_dot)
    return (summed(S, by_u), summed(S, by_v)), answer.state


def assert_tangents(bar, law, u, v, step, share):
    """Tangents are ∂f/∂u and ∂f/∂v of the free unknowns; the largest entries."""
    tangents, state = exact(bar, law, u, v)
    slopes = (
        differences(lambda at: force_of(bar, law, at, v, state), u, step),
        differences(lambda at: force_of(bar, law, u, at, state), v, step),
    )
    slopes = [slope.reshape(bar.free.size, -1)[:, bar.free] for slope in slopes]
    for tangent, slope in zip(tangents, slopes, strict=True):
        assert_near(tangent.toarray(), slope, share)
    return [abs(slope).max() for slope in slopes]


@pytest.mark.parametrize("law", [KelvinVoigt(), LinearFirstPiola(), Fibres()], ids=repr)
@pytest.mark.parametrize("kind", ["distorted", "triangles", "curved triangles"])
def test_tangents_are_the_slopes_of_the_internal_force(rng, kind, law):
    if kind == "distorted":
        system = distorted_bar(rng, elements=(3, 2))
    else:
        problem = Problem(mesh=plate(kind, rng, (2, 2)), conditions=(Fixed(on="left"),))
        system = make_system(problem, 1.0)
    u, v = random_state(system, rng)
    assert_tangents(system, law, u, v, 1e-5, 1e-7)


@pytest.mark.parametrize("initialisation", ["elastic", "constrained-runs", "slow-manifold"])
def test_tangents_of_rves_are_the_slopes_of_the_internal_force(rng, initialisation):
    settings = RveSettings(initialisation=initialisation, tolerance=1e-10)
    law = RveLaw(CellParameters.preset("printed"), settings)
    load_case = LoadCase(width=50.0, height=50.0, watched=(50.0, 25.0), elements=(2, 1))
    bar = make_system(load_case, law.density)
    u, v = random_state(bar, rng, 0.4)
    v *= 0.2
    assert min(assert_tangents(bar, law, u, v, 2e-5, 1e-6)) > 1.0


def test_tangents_over_a_step_are_stiffness_and_damping_together(rng):
    """With forces that have slopes of both kinds."""
    held = Fixed(on="left"), Foundation(on="bottom", stiffness=0.3, damping=0.7)
    problem = Problem(mesh=plate("quads", rng, (3, 2)), conditions=held)
    system = make_system(problem, 0.08)
    equations = EquationsOfMotion(system, KelvinVoigt())
    y = state_vector(system, *random_state(system, rng))
    now = equations.evaluate(0.0, y, tangents=True)
    K, C = equations.tangents(now)
    whole = equations.slope(now, 1.0, 5.0)
    assert abs(whole - K - C / 0.2).max() < 1e-13 * abs(whole).max()


LAW = KelvinVoigt()
SHAPES = {
    "plane": Plane(normal=(0.1, -1.0)),
    "circle": Circle(radius=12.0),
    "corner": Corner(axis=(0.2, 1.0), angle=120.0, radius=5.0),
}
ABOVE = {"plane": -0.4, "circle": 10.0, "corner": -2.0}
"""Height of a body's position above the top's middle: each is in the tissue by 0.4 to 2 µm."""


def body(shape, **settings):
    """A body that overlaps the top."""
    settings = {"position": (0.5 * WIDTH, HEIGHT + ABOVE[shape]), **settings}
    settings = {"name": "body", "on": "top", **settings}
    return RigidBody(shape=SHAPES[shape], **settings)


def assert_slopes(force, u, v, step=1e-6):
    """slopes() is −∂f/∂u and −∂f/∂v to 1e-6 of their largest entry."""
    slopes = [slope.toarray() for slope in force.slopes(0.3, 0.3, u, v)]
    scale = abs(slopes[0]).max()
    assert scale > 0.1
    expected = (
        differences(lambda at: -force.at(0.3, 0.3, at, v), u, step),
        differences(lambda at: -force.at(0.3, 0.3, u, at), v, step),
    )
    for slope, wanted in zip(slopes, expected, strict=True):
        allowed = 1e-6 * max(scale, abs(slope).max())
        np.testing.assert_allclose(slope, wanted.reshape(slope.shape), rtol=0, atol=allowed)
    return slopes


def contact_of(body, mesh, modulus=1.0):
    """The contact of a body that alone acts on a mesh, and the number of nodes with the body's."""
    problem = Problem(mesh=mesh, conditions=(), bodies=(body,))
    system = make_system(problem, 0.08, modulus=modulus)
    (contact,) = system.contacts
    return contact, system.n_rows


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_slopes_of_pressure_and_foundation(kind, rng):
    loads = Pressure(on="right", pressure=-3.0), Foundation(on="top", stiffness=2.0, damping=0.7)
    system = make_system(Problem(mesh=plate(kind, rng, (2, 2)), conditions=loads), 0.08)
    u, v = rng.uniform(-0.5, 0.5, (2, system.n_rows, 2))
    for force in system.forces:
        slopes = assert_slopes(force, u, v)
    assert abs(slopes[1]).max() > 0.1


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_slopes_of_contact(kind, shape, friction, rng):
    """By displacement and velocity of the nodes and of the body itself."""
    settings = {"mass": 40.0, "stiffness": 50.0, "smoothing": 0.8, "damping": 30.0}
    struck = body(shape, friction=friction, slip_speed=0.05, **settings)
    contact, rows = contact_of(struck, plate(kind, rng, (3, 2)))
    u, v = rng.uniform(-0.1, 0.1, (2, rows, 2))
    gap, _, _ = contact._gaps(u)
    assert 1 <= (gap < -contact.smoothing).sum() < (gap < 0.0).sum() < gap.size
    assert abs((contact.relative @ v)[gap < 0.0]).max() > contact.slip_speed
    for motion in (v, -v):  # what closes by one opens by the other
        slopes = assert_slopes(contact, u, motion)
    assert abs(slopes[0][-2:, -2:]).max() > 1.0
    assert abs(slopes[1]).max() > 1.0


@pytest.mark.parametrize("shape", SHAPES)
def test_slopes_of_friction_at_rest(shape, rng):
    """From an equilibrium with friction: some points stick, others slip, and the body is curved."""
    struck = body(shape, friction=0.2, mass=40.0, stiffness=50.0, smoothing=0.8)
    contact, rows = contact_of(struck, plate("quads", rng, (6, 4)))
    u, before = rng.uniform(-0.1, 0.1, (2, rows, 2))
    contact = replace(contact, grip=Grip(before, rng.uniform(-9.0, 9.0, contact.lengths.size)))
    pressure, *_ = contact._pressure(-contact._gaps(u)[0], np.zeros(contact.lengths.size))
    share = abs(contact.drag(u, 0.0 * u))[pressure > 0.0] / pressure[pressure > 0.0]
    assert share.max() == pytest.approx(0.2)
    assert share.min() < 0.19
    assert_slopes(replace(contact, damping=0.0), u, 0.0 * u)
    for damping in (0.3, 3.0):
        assert_slopes(replace(contact, damping=damping), u, before)


@pytest.mark.parametrize("shape", SHAPES)
def test_contact_force_is_the_slope_of_its_energy_and_balances(shape, rng):
    contact, rows = contact_of(body(shape, mass=40.0), plate("quads", rng), modulus=100.0)
    u = rng.uniform(-0.1, 0.1, (rows, 2))
    force = contact.at(0.0, 0.0, u, 0.0 * u)
    assert abs(force).max() > 1.0
    assert abs(force.sum(axis=0)).max() < 1e-12 * abs(force).max()
    assert_near(-differences(contact.energy, u, 1e-6), force, 1e-6)


def test_default_contact_is_as_stiff_as_a_slow_compression_needs():
    """Four elements between two plates, by 5 and 1 %: the force is that of plates that hold."""
    mesh, law = rectangle(20.0, 40.0, (2, 4)), LAW
    lower = RigidBody(name="lower", shape=Plane(normal=(0.0, 1.0)), on="bottom", position=(0, 0))
    mirror = Symmetry(on="left")
    for share, allowed in ((0.05, 0.004), (0.01, 0.01)):
        down = (None, -40.0 * share)
        upper = RigidBody(
            name="upper", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, 40.0),
            displacement=(0.0, down[1]),
        )  # fmt: skip
        held = (Fixed(on="bottom", components="y"), PrescribedMotion(on="top", displacement=down))
        forces = []
        for conditions, bodies in (((mirror,), (lower, upper)), ((mirror, *held), ())):
            rest = find_rest(Problem(mesh=mesh, conditions=conditions, bodies=bodies), law)
            names = rest.system.force_names
            name = "upper" if bodies else "prescribed_motion top"
            forces.append(rest.forces[names.index(name), 1])
        assert 1.0 - allowed < forces[0] / forces[1] < 1.0


@pytest.mark.parametrize("shape", SHAPES)
def test_friction_brakes_by_coulombs_law_where_sliding_is_fast(shape, rng):
    """At a hundred times the slip speed: µ times the pressure force, against the sliding."""
    rough = body(shape, friction=0.3, slip_speed=1e-4)
    contact, rows = contact_of(rough, plate("quads", rng), modulus=100.0)
    u, v = np.zeros((rows, 2)), np.tile([1e-2, 0.0], (rows, 1))
    v[-1] = 0.0
    pressure = contact.at(0.0, 0.0, u, 0.0 * v)
    drag = contact.at(0.0, 0.0, u, v) - pressure
    power = np.vdot(drag, v)
    assert power < 0.0
    # Power of friction µ p |w| over the points, w the sliding along the surface.
    gap, normal, _ = contact._gaps(u)
    along = 1e-2 * abs(normal[:, 1])
    expected = -0.3 * (contact._pressure(-gap, 0.0 * gap)[0] * along) @ contact.lengths.ravel()
    assert power == pytest.approx(expected, rel=1e-3)


PULL = Traction(on="right", traction=(8.0, 8.0))
NEWTON = {
    "motion": (Symmetry(on="left"), Symmetry(on="bottom"),
               PrescribedMotion(on="right", displacement=(3.0, None))),
    "pressure": (Fixed(on="bottom"), Pressure(on="top", pressure=20.0)),
    "body force": (Fixed(on="left"), BodyForce(acceleration=(0.0, -3.0))),
    "foundation": (Foundation(on="bottom", stiffness=3.0), PULL),
    **dict.fromkeys(SHAPES, (Fixed(on="bottom"), Traction(on="right", traction=(4.0, 0.0)))),
}  # fmt: skip


@pytest.mark.parametrize("name", NEWTON)
@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_newton_converges_quadratically(kind, name, rng):
    """r₊ ≤ c r² from 0.01 on, down to rounding, with every condition and every body."""
    bodies = ()
    if name in SHAPES:
        struck = body(name, stiffness=20.0, smoothing=0.5, friction=0.3)
        x, y = struck.position
        # A rest refuses a body that begins inside the tissue, so each begins 3 µm higher.
        bodies = (replace(struck, position=(x, y + 3.0), displacement=(0.3, -3.5)),)
    problem = Problem(mesh=plate(kind, rng, (3, 3)), conditions=NEWTON[name], bodies=bodies)
    rest = find_rest(problem, LAW, MacroSettings(newton_tolerance=1e-12))
    residuals = np.array(rest.residuals)
    assert abs(rest.F - np.eye(2)).max() > 0.02
    assert residuals[-1] < 1e-12
    near = np.flatnonzero(residuals < 3e-2)
    assert near.size >= 2
    for before, after in zip(residuals[near[:-1]], residuals[near[1:]], strict=True):
        assert after < max(20.0 * before**2, 1e-12), residuals
