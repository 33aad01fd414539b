"""Meshes: what is wrong is one line that names what and where; parts by name."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.errors import InputError
from surrofe2.macro import (
    BodyForce,
    Box,
    Disc,
    Fixed,
    HalfPlane,
    MacroSettings,
    Mesh,
    Plane,
    PrescribedMotion,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    find_rest,
    simulate,
)
from surrofe2.macro.discretisation import make_discretisation
from tests.laws import KelvinVoigt
from tests.macro.meshes import plate, with_middles

SQUARE = Mesh.rectangle(2.0, 2.0, (2, 2))


def two_pieces():
    other = SQUARE.nodes + np.array([10.0, 0.0])
    elements = np.concatenate([SQUARE.elements, SQUARE.elements + 9])
    return np.concatenate([SQUARE.nodes, other]), elements


def moved(node, to):
    nodes = SQUARE.nodes.copy()
    nodes[node] = to
    return nodes


CORNERS = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])


def bent(amount):
    """One triangle, the middle of its first side moved into it."""
    nodes, elements = with_middles(CORNERS, np.array([[0, 1, 2]]))
    nodes[elements[0, 3]] += [0.0, amount]
    return nodes, elements


@pytest.mark.parametrize(
    ("nodes", "elements", "message"),
    [
        (SQUARE.nodes, SQUARE.elements[:, ::-1], r"element 0 at \(0\.5, 0\.5\) µm is inverted"),
        (moved(4, (3.0, 1.0)), SQUARE.elements, r"element [23] at .* µm is inverted"),
        (moved(4, (0.0, 1.0)), SQUARE.elements, r"element \d at .* µm is degenerate"),
        (*bent(0.9), r"element 0 at .* µm is inverted"),
        (np.vstack([SQUARE.nodes, [7.0, 8.0]]), SQUARE.elements,
         r"1 nodes without an element, the first is 9 at \(7, 8\) µm"),
        (*two_pieces(), r"2 pieces that do not touch, the smallest of 9 nodes at \("),
        (SQUARE.nodes, SQUARE.elements + 1, r"mesh\.elements: node 9; nodes are numbered .* to 8"),
        (SQUARE.nodes, SQUARE.elements[:0], r"mesh: it has no element"),
        (SQUARE.nodes, SQUARE.elements[:, :3], r"mesh\.elements: shape \(4, 3\); it must be"),
    ],
)  # fmt: skip
def test_a_bad_mesh_is_one_line(nodes, elements, message):
    with pytest.raises(InputError, match=message) as caught:
        Mesh(nodes, elements)
    assert "\n" not in str(caught.value)


def test_a_triangle_that_folds_within_is_found():
    """Its middles are near enough to their sides for the mesh; the map says otherwise."""
    nodes, elements = with_middles(CORNERS, np.array([[0, 1, 2]]))
    nodes[elements[0, 3:]] += [[0.55, 0.3], [-0.45, -0.45], [0.3, 0.55]]
    mesh = Mesh(nodes, elements)
    with pytest.raises(InputError, match=r"element 0 at .* is inverted within"):
        make_discretisation(mesh)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ((Fixed(on="lfet"),), r"fixed\.on: lfet; no such .*did you mean left\? known are"),
        ((Traction(on="half", traction=(1.0, 0.0)),), r"traction\.on: half; no such boundary"),
        ((BodyForce(on="left", acceleration=(1.0, 0.0)),), r"body_force\.on: left; no such region"),
        ((Symmetry(on="half"),), r"symmetry half\.on: half; a symmetry must be straight"),
        ((Fixed(on="left"), PrescribedMotion(on="top", displacement=(1.0, None))),
         r"prescribed_motion top: component x of the node at \(0, 2\) µm; fixed left prescribes"),
    ],
)  # fmt: skip
def test_a_condition_without_its_place_is_one_line(conditions, message):
    mesh = SQUARE.with_regions(half=Box((0.0, 0.0), (1.0, 2.0)))
    with pytest.raises(InputError, match=message) as caught:
        find_rest(Problem(mesh=mesh, conditions=conditions), KelvinVoigt())
    assert "\n" not in str(caught.value)


def test_a_body_on_an_unknown_boundary_is_one_line():
    body = RigidBody(name="wall", shape=Plane(normal=(0.0, -1.0)), on="roof", position=(0.0, 3.0))
    with pytest.raises(InputError, match=r"wall\.on: roof; no such boundary"):
        simulate(Problem(mesh=SQUARE, conditions=(), bodies=(body,)), KelvinVoigt())


def test_parts_that_hold_nothing_are_named():
    away = Box((5.0, 5.0), (6.0, 6.0))
    with pytest.raises(InputError, match=r"mesh\.boundaries\.far: .*both ends of an outer side"):
        SQUARE.with_boundaries(far=away)
    with pytest.raises(InputError, match=r"mesh\.regions\.far: .*the centre of an element"):
        SQUARE.with_regions(far=away)


def test_names_and_times_of_a_problem_are_checked():
    load = BodyForce(acceleration=(1.0, 0.0))
    for change, message in (
        ({"conditions": (load, load)}, r"2 conditions are called body_force"),
        ({"conditions": (replace(load, name="kinetic"),)}, r"called kinetic; an energy"),
        ({"duration": 0.0}, r"problem\.duration: 0\.0; it must be positive"),
        ({"output_interval": float("nan")}, r"problem\.output_interval: nan"),
    ):
        with pytest.raises(InputError, match=message):
            Problem(**{"mesh": SQUARE, "conditions": (load,), **change})
    outside = Problem(mesh=SQUARE, conditions=(load,), watched={"tip": (3.0, 1.0)})
    with pytest.raises(InputError, match=r"watched\.tip: \(3, 1\) µm; it must lie within"):
        simulate(outside, KelvinVoigt(), MacroSettings())


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_parts_pick_sides_and_elements(kind, rng):
    mesh = plate(kind, rng, (4, 4), (4.0, 4.0), distortion=0.0).with_boundaries(
        upper=HalfPlane((0.0, 2.0), (0.0, 1.0)), corner=Disc((0.0, 0.0), 1.0)
    )
    mesh = mesh.with_regions(strip=Box((0.0, 0.0), (4.0, 1.0)), all=Disc((2.0, 2.0), 9.0))
    # Sides of the outline: 4 of the top, the upper 2 of left and of right; 2 at the corner.
    assert len(mesh.boundaries["upper"]) == 8
    assert len(mesh.boundaries["corner"]) == 2
    assert len(mesh.regions["strip"]) == (4 if kind == "quads" else 8)
    np.testing.assert_array_equal(mesh.regions["all"], np.arange(len(mesh.elements)))
    # The tissue is on the left of every side.
    ends = mesh.nodes[mesh.boundaries["upper"][:, :2]]
    along, inwards = ends[:, 1] - ends[:, 0], [2.0, 2.0] - ends.mean(axis=1)
    assert (along[:, 0] * inwards[:, 1] - along[:, 1] * inwards[:, 0] > 0.0).all()
