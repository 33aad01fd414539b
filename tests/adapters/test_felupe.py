"""A stress law in FElupe: exact slopes; blocks at rest and in motion as by our finite elements."""

from __future__ import annotations

import numpy as np
import pytest

from surrofe2 import MacroSettings, Problem, Sine
from surrofe2.adapters.felupe import FelupeMaterial, Inertia, Substeps
from surrofe2.errors import InputError, SimulationError
from surrofe2.macro.conditions import Fixed, Traction
from surrofe2.macro.discretisation import reference_shapes
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.generalised_alpha import GeneralisedAlpha
from surrofe2.macro.quasi_static import find_rest
from surrofe2.macro.system import make_system
from surrofe2.stress_law import Status
from tests.laws import KelvinVoigt
from tests.macro.meshes import plate

felupe = pytest.importorskip("felupe")

WIDTH, HEIGHT, PULL = 40.0, 20.0, 0.4


def points(count=12):
    rng = np.random.default_rng(1)
    F = np.eye(2)[:, :, None, None] + 0.02 * rng.uniform(-1.0, 1.0, (2, 2, 3, count // 3))
    before = 0.01 * rng.uniform(-1.0, 1.0, (4, 3, count // 3))
    return F, before


@pytest.mark.parametrize("spectral_radius", [None, 0.6])
def test_the_slope_over_a_substep_is_that_of_the_stress(spectral_radius):
    material = FelupeMaterial(KelvinVoigt(), spectral_radius)
    material.dt = 0.7
    F, before = points()
    before = np.resize(before, (*material.x[-1].shape, 3, 4))
    (slope,) = material.hessian([F, before])
    assert slope.shape == (2, 2, 2, 2, 3, 4)
    h = 1e-6
    for c in range(2):
        for d in range(2):
            moved = [F.copy(), F.copy()]
            moved[0][c, d] += h
            moved[1][c, d] -= h
            ahead, behind = (material.gradient([each, before])[0] for each in moved)
            found = (ahead - behind) / (2.0 * h)
            assert np.abs(found - slope[:, :, c, d]).max() < 1e-6 * np.abs(slope).max()


def test_the_state_is_what_the_next_substep_begins_with():
    material = FelupeMaterial(KelvinVoigt())
    material.dt = 2.0
    F, before = points()
    after = material.gradient([F, before])[1]
    assert np.allclose(after.reshape(2, 2, 3, 4), F - np.eye(2)[:, :, None, None], atol=1e-15)
    rested, moving = (material.gradient([F, state])[0] for state in (after, before))
    assert np.abs(rested - moving).max() > 1e-3


def test_a_block_at_rest_is_that_of_our_finite_elements():
    """Six-node triangles with three points, both."""
    law = KelvinVoigt()
    mesh = plate("curved triangles", np.random.default_rng(2), (4, 2), (WIDTH, HEIGHT))
    pull = Traction(name="pull", on="right", traction=(PULL, 0.1 * PULL))
    ours = find_rest(Problem(mesh=mesh, conditions=(Fixed(on="left"), pull), duration=1.0), law)

    theirs = felupe.Mesh(mesh.nodes, mesh.elements, "triangle6")
    rule = felupe.TriangleQuadrature(order=2)
    region = felupe.Region(theirs, Triangle(), rule)
    field = felupe.FieldContainer([felupe.Field(region, dim=2)])
    clamped = {"left": felupe.Boundary(field[0], fx=0.0)}
    body = felupe.SolidBody(FelupeMaterial(law), field)
    force = nodal_forces(mesh)
    load = felupe.PointLoad(field, np.arange(len(mesh.nodes)), values=force)
    step = felupe.Step(items=[body, load], boundaries=clamped)
    felupe.Job(steps=[step]).evaluate(verbose=False, x0=field, tol=1e-12)
    assert np.abs(field[0].values - ours.u).max() < 1e-8 * np.abs(ours.u).max()


class Triangle(felupe.QuadraticTriangle):
    """With the slopes of the six shape functions; those of FElupe 11.3 are wrong in one entry."""

    def gradient(self, rs):
        return reference_shapes(6, np.reshape(rs, (2, 1)))[1][0]


def test_which_slope_of_felupe_s_triangle_is_wrong():
    """Where this fails, docs/usage.md may say that it is mended."""
    at, h = np.array([0.2, 0.3]), 1e-6
    steps = h * np.eye(2)
    element = felupe.QuadraticTriangle()
    found = np.stack(
        [(element.function(at + step) - element.function(at - step)) / (2 * h) for step in steps],
        axis=1,
    )
    assert np.abs(Triangle().gradient(at) - found).max() < 1e-9
    wrong = np.argwhere(np.abs(element.gradient(at) - found) > 1e-9).tolist()
    assert wrong == [[0, 1], [2, 1], [5, 1]]


def test_a_block_in_motion_is_that_of_our_finite_elements():
    """Under a traction that swings, 24 steps; quadrature of both is exact for the mass."""
    law, rho, h, steps = KelvinVoigt(), 0.7, 0.5, 24
    mesh = plate("triangles", np.random.default_rng(2), (4, 2), (WIDTH, HEIGHT))
    swing = Sine(frequency=0.15)
    pull = Traction(name="pull", on="right", traction=(PULL, 0.1 * PULL), amplitude=swing)
    problem = Problem(mesh=mesh, conditions=(Fixed(on="left"), pull), duration=h * steps)
    equations = EquationsOfMotion(make_system(problem, law.density), law)
    settings = MacroSettings(integrator="implicit", spectral_radius=rho, newton_tolerance=1e-10)
    method = GeneralisedAlpha(equations, settings)
    end, memory = equations.begin(0.0, np.zeros(2 * equations.system.free.size)), np.empty(0)
    ours = []
    times = h * np.arange(steps + 1)
    for t in times[1:]:
        result = method.step(end, memory, t)
        end, memory = result.end, result.memory
        ours.append(end.u)

    theirs = felupe.Mesh(mesh.nodes, mesh.elements, "triangle6")
    fields = [
        felupe.FieldContainer(
            [felupe.Field(felupe.Region(theirs, Triangle(), felupe.TriangleQuadrature(k)), dim=2)]
        )
        for k in (2, 5)
    ]
    field = fields[0]
    material = FelupeMaterial(law, rho)
    body = felupe.SolidBody(material, field)
    mass = felupe.SolidBody(None, fields[1]).assemble.mass(law.density)
    inertia = Inertia(mass, field, rho)
    load = felupe.PointLoad(field, np.arange(len(mesh.nodes)))
    forces = [swing.at(t, t)[0] * nodal_forces(mesh) for t in times[1:]]
    step = felupe.Step(
        items=[body, inertia, load],
        ramp={load: forces},
        boundaries={"left": felupe.Boundary(field[0], fx=0.0)},
    )
    found = []
    plugins = [
        Substeps(times, material, inertia),
        lambda context, state: found.append(context.substep.x[0].values.copy()),
    ]
    felupe.Job(steps=[step], plugins=plugins).evaluate(verbose=False, x0=field, tol=1e-9)
    largest = np.abs(ours).max()
    assert len(found) == steps
    assert np.abs(np.array(found) - ours).max() < 1e-8 * largest
    assert np.abs(ours[12]).max() > 0.3 * largest  # inertia, for the traction is all but 0 then


def test_inertia_says_what_it_needs():
    mesh = plate("triangles", np.random.default_rng(2), (2, 1), (WIDTH, HEIGHT))
    region = felupe.Region(
        felupe.Mesh(mesh.nodes, mesh.elements, "triangle6"),
        Triangle(),
        felupe.TriangleQuadrature(2),
    )
    field = felupe.FieldContainer([felupe.Field(region, dim=2)])
    size = 2 * len(mesh.nodes)
    with pytest.raises(InputError, match=r"mass: shape \(3, 3\); it must be that of the field's"):
        Inertia(np.eye(3), field)
    with pytest.raises(InputError, match="dt: infinite; give the inertia to Substeps"):
        Inertia(np.eye(size), field).vector()
    with pytest.raises(InputError, match=r"spectral_radius: 1.2; it must be within \[0, 1\]"):
        FelupeMaterial(KelvinVoigt(), 1.2)


def nodal_forces(mesh):
    """The traction on the right side, by Simpson's rule of each three-node side."""
    force = np.zeros_like(mesh.nodes)
    right = np.flatnonzero(mesh.nodes[:, 0] == WIDTH)
    right = right[np.argsort(mesh.nodes[right, 1])]
    for first in range(0, len(right) - 2, 2):
        length = mesh.nodes[right[first + 2], 1] - mesh.nodes[right[first], 1]
        for node, share in zip(right[first : first + 3], (1 / 6, 4 / 6, 1 / 6), strict=True):
            force[node] += share * length * np.array([PULL, 0.1 * PULL])
    return force


def test_substeps_have_their_lengths():
    materials = FelupeMaterial(KelvinVoigt()), FelupeMaterial(KelvinVoigt())
    plugin = Substeps([0.0, 1.0, 1.5], *materials)
    for length in (1.0, 0.5):
        plugin.before_substep(None, None)
        assert [material.dt for material in materials] == [length, length]
    with pytest.raises(InputError, match="3 of them, but the job has more substeps"):
        plugin.before_substep(None, None)
    with pytest.raises(InputError, match="times: they must rise"):
        Substeps([0.0, 0.0], *materials)


class Torn(KelvinVoigt):
    """Without stress where F₁₁ is above 1.1."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, state, tangents=tangents)
        answer.status[F[:, 0, 0] > 1.1] = Status.NOT_CONVERGED
        return answer


def test_a_point_without_stress_is_named():
    material = FelupeMaterial(Torn())
    F, before = points()
    F[0, 0, 1, 2] = 1.2
    with pytest.raises(SimulationError, match="point 6 of 12: the RVE solve did not converge"):
        material.gradient([F, before])
