"""Patch tests: a homogeneous stress is an exact answer on any mesh, whatever holds it."""

import numpy as np
import pytest
import skfem
from scipy.optimize import brentq

from surrofe2.macro import MacroSettings, find_rest
from surrofe2.problem import (
    BodyForce,
    Box,
    Fixed,
    Foundation,
    Plane,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    with_regions,
)
from tests.laws import KelvinVoigt
from tests.macro.meshes import HEIGHT, KINDS, WIDTH, plate
from tests.numerics import assert_near

LAW = KelvinVoigt()
SETTINGS = MacroSettings(newton_tolerance=1e-12)
MIRRORS = Symmetry(on="left"), Symmetry(on="bottom")
NORMALS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "bottom": (0.0, -1.0), "top": (0.0, 1.0)}


def first_piola(F):
    """(2, 2) P of a homogeneous F at rest."""
    stress = LAW.stress(F[None], np.zeros((1, 2, 2)))[0]
    return np.linalg.det(F) * stress @ np.linalg.inv(F).T


def tractions(F, *sides):
    P = first_piola(F)
    return [Traction(on=side, traction=tuple(P @ NORMALS[side])) for side in sides]


def assert_homogeneous(mesh, conditions, F, bodies=()):
    """At rest the tissue has this F and its stress at every point, to 1e-10; the forces by name."""
    problem = Problem(mesh=mesh, conditions=tuple(conditions), bodies=bodies)
    rest = find_rest(problem, LAW, SETTINGS)
    assert abs(F - np.eye(2)).max() > 0.03, "nothing is deformed"
    np.testing.assert_allclose(rest.F, np.broadcast_to(F, rest.F.shape), rtol=0, atol=1e-10)
    stress = LAW.stress(F[None], np.zeros((1, 2, 2)))
    assert_near(rest.stress, np.broadcast_to(stress, rest.F.shape), 1e-10)
    np.testing.assert_allclose(
        rest.u[: len(mesh.p.T)], mesh.p.T @ (F - np.eye(2)).T, rtol=0, atol=1e-10 * WIDTH
    )
    return dict(zip(rest.system.force_names, rest.forces, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_symmetry_and_prescribed_motion(kind, rng):
    F = np.diag([1.12, 0.93])
    motions = (
        PrescribedMotion(on="right", displacement=(0.12 * WIDTH, None)),
        PrescribedMotion(on="top", displacement=(None, -0.07 * HEIGHT)),
    )
    forces = assert_homogeneous(plate(kind, rng), (*MIRRORS, *motions), F)
    pull = HEIGHT * first_piola(F)[0, 0]
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
    pull = Traction(on="top", traction=(0.0, first_piola(F)[1, 1] + spring))
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
        return first_piola(np.diag([1.0, stretch]))[1, 1] + stiffness * (depth - 0.5 * smoothing)

    F = np.diag([1.0, brentq(excess, 0.9, 0.99, xtol=1e-15)])
    lid = RigidBody(
        name="lid", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, HEIGHT),
        displacement=(0.0, -pushed), stiffness=stiffness, smoothing=smoothing,
    )  # fmt: skip
    mirrors = (*MIRRORS, Symmetry(on="right"))
    forces = assert_homogeneous(plate(kind, rng), mirrors, F, bodies=(lid,))
    push = WIDTH * first_piola(F)[1, 1]
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
    np.testing.assert_allclose(
        forces["pressure top"], 0.8 * np.array([chord[1], -chord[0]]), rtol=1e-10
    )
    largest = max(abs(force).max() for force in forces.values())
    np.testing.assert_allclose(sum(forces.values()), 0.0, atol=1e-10 * largest)
