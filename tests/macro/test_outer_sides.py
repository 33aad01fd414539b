"""Outer sides of one tissue that meet are counted, since nothing keeps them apart."""

from types import SimpleNamespace

import numpy as np
import pytest
import skfem

from surrofe2 import Fixed, PrescribedMotion, Problem
from surrofe2.macro import find_rest
from surrofe2.macro.outer_sides import OuterSides
from surrofe2.problem.mesh import rectangle
from surrofe2.run.journal import CROSSINGS
from surrofe2.workflow.run import crossed, crossing_notes
from tests.laws import KelvinVoigt


def notched():
    """A block of 30 × 30 µm with a notch, 2 µm wide, from the middle of its right side."""
    x = np.linspace(0.0, 30.0, 7)
    y = np.array([0.0, 7.0, 14.0, 16.0, 23.0, 30.0])
    mesh = skfem.MeshQuad.init_tensor(x, y)
    centre = mesh.p[:, mesh.t].mean(axis=1)
    notch = (centre[0] > 10.0) & (abs(centre[1] - 15.0) < 1.0)
    mesh = mesh.remove_elements(np.flatnonzero(notch))
    sides = {"bottom": lambda at: at[1] == 0.0, "top": lambda at: at[1] == 30.0}
    return mesh.with_boundaries(sides)


def pressed(depth):
    motion = PrescribedMotion(on="top", displacement=(0.0, -depth))
    conditions = Fixed(on="bottom"), motion
    return Problem(mesh=notched(), conditions=conditions, duration=1.0)


def test_a_notch_that_closes_is_reported_from_the_load_step_on():
    rest = find_rest(pressed(3.0), KelvinVoigt(), load_steps=6)
    gap = np.interp(2.0, 3.0 * rest.path[:, 0], rest.path[:, 0])
    crossings = rest.history[CROSSINGS]
    begin = rest.path[np.flatnonzero(crossings)[0], 0]
    assert gap <= begin < 1.0
    assert (crossings[rest.path[:, 0] < gap - 0.2] == 0.0).all()
    record = SimpleNamespace(
        met=crossed(rest.path[:, 0], rest.history), recipe={"rest": {"factor": 1.0}}
    )
    ((warning, is_warning),) = crossing_notes(record)
    assert is_warning
    assert f"cross each other from load factor {begin:.4g} on" in warning
    assert "there is no contact of tissue with tissue" in warning


def test_an_open_notch_is_not_mentioned():
    rest = find_rest(pressed(1.0), KelvinVoigt(), load_steps=2)
    assert CROSSINGS not in rest.history
    assert not [*crossing_notes(SimpleNamespace(met=crossed(rest.path[:, 0], rest.history)))]


@pytest.mark.parametrize("kind", [skfem.MeshQuad, skfem.MeshTri, skfem.MeshTri2])
def test_sides_beside_one_another_do_not_cross(kind):
    """Whatever the mesh is turned and sheared by; folded over they do."""
    mesh = rectangle(4.0, 2.0, (4, 2))
    if kind is not skfem.MeshQuad:
        mesh = mesh.to_meshtri()
    if kind is skfem.MeshTri2:
        mesh = skfem.MeshTri2.from_mesh(mesh)
    sides = OuterSides.of(mesh)
    x = mesh.doflocs.T
    for F in (np.eye(2), np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([[1.0, 1.5], [0.0, 1.0]])):
        assert sides.crossings(x @ F.T) == 0
    folded = np.stack([x[:, 0], np.where(x[:, 0] > 3.0, 3.0 - x[:, 1], x[:, 1])], axis=1)
    assert sides.crossings(folded) > 0
