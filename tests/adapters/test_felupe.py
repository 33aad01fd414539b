"""A stress law in FElupe: exact slopes; a block at rest as by our finite elements."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import Problem
from surrofe2.adapters.felupe import FelupeMaterial
from surrofe2.base.errors import SimulationError
from surrofe2.macro.elements import reference_shapes
from surrofe2.macro.rest import find_rest
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem.conditions import Fixed, Traction
from surrofe2.problem.mesh import element_nodes
from surrofe2.rve import RveLaw
from tests.laws import KelvinVoigt, failing
from tests.macro.meshes import plate

felupe = pytest.importorskip("felupe")

WIDTH, HEIGHT, PULL = 40.0, 20.0, 0.4


def points(count=12):
    rng = np.random.default_rng(1)
    F = np.eye(2)[:, :, None, None] + 0.02 * rng.uniform(-1.0, 1.0, (2, 2, 3, count // 3))
    before = 0.01 * rng.uniform(-1.0, 1.0, (4, 3, count // 3))
    return F, before


def test_the_slope_over_a_substep_is_that_of_the_stress():
    material = FelupeMaterial(KelvinVoigt())
    material.dt = 0.7
    F, before = points()
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
    for state in (after, before):
        points_first = np.moveaxis((F - np.eye(2)[:, :, None, None]).reshape(4, -1), -1, 0)
        rate = (points_first - state.reshape(4, -1).T).reshape(-1, 2, 2) / 2.0
        at = points_first.reshape(-1, 2, 2) + np.eye(2)
        sigma = KelvinVoigt().respond(at, rate).stress
        P = np.linalg.det(at)[:, None, None] * sigma @ np.linalg.inv(at).swapaxes(1, 2)
        found = material.gradient([F, state])[0].reshape(2, 2, -1)
        assert np.abs(np.moveaxis(found, -1, 0) - P).max() < 1e-12 * np.abs(P).max()


def test_a_block_at_rest_is_that_of_our_finite_elements():
    """Six-node triangles with three points, both."""
    law = KelvinVoigt()
    mesh = plate("curved triangles", np.random.default_rng(2), (4, 2), (WIDTH, HEIGHT))
    pull = Traction(name="pull", on="right", traction=(PULL, 0.1 * PULL))
    ours = find_rest(Problem(mesh=mesh, conditions=(Fixed(on="left"), pull), duration=1.0), law)

    theirs = felupe.Mesh(mesh.p.T, element_nodes(mesh), "triangle6")
    rule = felupe.TriangleQuadrature(order=2)
    region = felupe.Region(theirs, Triangle(), rule)
    field = felupe.FieldContainer([felupe.Field(region, dim=2)])
    clamped = {"left": felupe.Boundary(field[0], fx=0.0)}
    body = felupe.SolidBody(FelupeMaterial(law), field)
    force = nodal_forces(mesh)
    load = felupe.PointLoad(field, np.arange(len(mesh.p.T)), values=force)
    step = felupe.Step(items=[body, load], boundaries=clamped)
    felupe.Job(steps=[step]).evaluate(verbose=False, x0=field, tol=1e-12)
    assert np.abs(field[0].values - ours.u).max() < 1e-8 * np.abs(ours.u).max()


class Triangle(felupe.QuadraticTriangle):
    """With the slopes of the six shape functions; those of FElupe 11.3 are wrong in one entry."""

    def gradient(self, rs):
        return reference_shapes(6, np.reshape(rs, (2, 1)))[1][0]


def test_which_slope_of_felupe_s_triangle_is_wrong():
    """Where this fails, docs/howto/law.md may say that it is fixed."""
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


class Counted(KelvinVoigt):
    """Counts what it is asked; a point whose accepted F₁₁ exceeds `limit` leaves its branch."""

    def __init__(self, limit=np.inf):
        super().__init__()
        self.asked, self.accepted, self.limit = [], [], limit

    def respond(self, F, F_dot, state=None, *, tangents=False):
        self.asked.append(state)
        return super().respond(F, F_dot, state, tangents=tangents)

    def accept(self, F, F_dot, response):
        self.accepted.append(F)
        left = F[:, 0, 0] > self.limit
        found = left if left.any() else None
        return replace(response, state=len(self.accepted), left_bifurcation=found)


def stretched(material, substeps, plugins, along=0.1, n=4):
    """A square pulled `along` in `substeps`: iterations of Newton's method of each."""
    region = felupe.RegionQuad(felupe.Rectangle(n=n))
    field = felupe.FieldContainer([felupe.Field(region, dim=2)])
    boundaries = felupe.dof.uniaxial(field, clamped=True, return_loadcase=False)
    ramp = {boundaries["move"]: np.linspace(0.0, along, substeps + 1)[1:]}
    body, iterations = felupe.SolidBody(material, field), []
    step = felupe.Step(items=[body], ramp=ramp, boundaries=boundaries)
    plugins = [lambda context, state: iterations.append(state.result.iterations), *plugins]
    felupe.Job(steps=[step], plugins=plugins).evaluate(verbose=False)
    return iterations


@pytest.mark.parametrize("dt", [np.inf, 3.0])
def test_the_law_is_asked_once_an_iteration_and_commits_each_substep(dt):
    """Each substep begins with one question more, at its start; all from what was committed."""
    material = FelupeMaterial(Counted())
    material.dt = dt
    iterations = stretched(material, 3, [material])
    law = material.law
    assert len(law.asked) == sum(iterations) + 3
    assert len(law.accepted) == 3
    assert max(law.accepted[-1][:, 0, 0]) > 1.1 - 1e-9
    assert [state for state in law.asked if state is None] == [None] * (iterations[0] + 1)
    assert law.asked[-1] == 2
    later = FelupeMaterial(Counted())
    stretched(later, 3, [])
    assert len(later.law.accepted) == 2


def test_a_bifurcation_is_reported():
    material = FelupeMaterial(Counted(limit=1.06))
    with pytest.warns(RuntimeWarning, match=r"of 36 points left their branch .* shorter substeps"):
        stretched(material, 3, [material])
    assert 0 < material.left_bifurcation.sum() <= 36


@pytest.mark.slow
@pytest.mark.parametrize(("compressed", "substeps"), [(0.1, 1), (0.06, 3)])
def test_rves_that_leave_a_bifurcation_are_reported_without_the_plugin(compressed, substeps):
    """Within an iteration of a long substep, or at the end of a short one, by 5 % of the stress."""
    material = FelupeMaterial(RveLaw(CellParameters.preset("water")))
    with warnings.catch_warnings(record=True, action="always") as told:
        stretched(material, substeps, [], -compressed, n=3)
        material.after_substep()
    assert "16 of 16 points left their branch" in str(told[0].message)
    assert material.left_bifurcation.all()


def nodal_forces(mesh):
    """The traction on the right side, by Simpson's rule of each three-node side."""
    force = np.zeros_like(mesh.p.T)
    right = np.flatnonzero(mesh.p.T[:, 0] == WIDTH)
    right = right[np.argsort(mesh.p.T[right, 1])]
    for first in range(0, len(right) - 2, 2):
        length = mesh.p.T[right[first + 2], 1] - mesh.p.T[right[first], 1]
        for node, share in zip(right[first : first + 3], (1 / 6, 4 / 6, 1 / 6), strict=True):
            force[node] += share * length * np.array([PULL, 0.1 * PULL])
    return force


def test_a_point_without_stress_is_named():
    material = FelupeMaterial(failing(KelvinVoigt(), fails_above=1.1))
    F, before = points()
    F[0, 0, 1, 2] = 1.2
    with pytest.raises(SimulationError, match="point 6 of 12: the RVE solve did not converge"):
        material.gradient([F, before])
