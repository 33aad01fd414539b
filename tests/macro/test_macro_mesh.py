"""Meshes: what is wrong is one line that names what and where; parts by name."""

from dataclasses import replace

import numpy as np
import pytest
import skfem

from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.macro.elements import deformation_gradient, internal_force, make_discretisation
from surrofe2.problem import (
    BodyForce,
    Box,
    Disc,
    Fixed,
    HalfPlane,
    PrescribedMotion,
    Problem,
    Symmetry,
    Traction,
    rectangle,
    with_boundaries,
    with_regions,
)
from surrofe2.problem.mesh import check_mesh, element_nodes, facet_nodes
from tests.laws import KelvinVoigt
from tests.macro.meshes import plate, sides_of, triangles

SQUARE = rectangle(2.0, 2.0, (2, 2))
NODES, QUADS = SQUARE.p.T, SQUARE.t.T


def moved(node, to):
    nodes = NODES.copy()
    nodes[node] = to
    return nodes


FAR = np.array([10.0, 0.0])
CORNERS = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])


def bent(*amounts):
    """One triangle, the middles of its sides moved."""
    mesh = triangles(CORNERS, np.array([[0, 1, 2]]))
    nodes = mesh.p.copy()
    for node, amount in zip(element_nodes(mesh)[0, 3:], amounts, strict=False):
        nodes[:, node] += amount
    return replace(mesh, doflocs=nodes)


def quads(nodes, elements):
    return skfem.MeshQuad1(nodes.T, elements.T)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (quads(moved(4, (3.0, 1.0)), QUADS), r"element [23] at .* µm is inverted"),
        (quads(NODES, QUADS[:, [0, 2, 1, 3]]), r"element 0 at .* µm is inverted"),
        (quads(moved(4, (0.0, 1.0)), QUADS), r"element \d at .* µm is degenerate"),
        (bent((0.0, 0.9)), r"element 0 at .* µm is inverted"),
        (quads(np.vstack([NODES, [7.0, 8.0]]), QUADS),
         r"1 nodes without an element, the first is 9 at \(7, 8\) µm"),
        (quads(np.concatenate([NODES, NODES + FAR]), np.concatenate([QUADS, QUADS + 9])),
         r"2 pieces that do not touch, the smallest of 4 elements at \(0, 0\) µm"),
        (quads(NODES, np.vstack([QUADS, [0, 3, 4, 2]])), r"mesh: 3 elements share the"),
        (quads(NODES, QUADS[:0]), r"mesh: it has no element"),
        (skfem.MeshQuad2(), r"mesh: MeshQuad2; it must be a skfem\.MeshQuad1, MeshTri1 or"),
        (SQUARE.with_boundaries({"cut": np.arange(SQUARE.nfacets)}),
         r"mesh: boundary cut: the line from .* is no outer side of an element"),
    ],
)  # fmt: skip
def test_a_bad_mesh_is_one_line(mesh, message):
    with pytest.raises(InputError, match=message) as caught:
        Problem(mesh=mesh, conditions=())
    assert "\n" not in str(caught.value)


def test_a_triangle_that_folds_within_is_found():
    """Its middles are near enough to their sides for the mesh; the map says otherwise."""
    mesh = check_mesh(bent((0.55, 0.3), (-0.45, -0.45), (0.3, 0.55)))
    with pytest.raises(InputError, match=r"element 0 at .* is inverted within"):
        make_discretisation(mesh)


def test_a_mesh_of_scikit_fem_is_taken_as_it_is():
    """Elements either way round, names by functions; three-node triangles get middles."""
    mesh = skfem.MeshQuad1.init_tensor(np.linspace(0.0, 3.0, 4), np.linspace(0.0, 2.0, 3))
    mesh = mesh.with_boundaries({"left": lambda x: x[0] == 0.0})
    mesh = mesh.with_subdomains({"upper": lambda x: x[1] > 1.0})
    tri = mesh.to_meshtri().with_boundaries({"left": lambda x: x[0] == 0.0})
    for kind, plain in ((skfem.MeshQuad1, mesh), (skfem.MeshTri2, tri)):
        problem = Problem(mesh=plain, conditions=(Fixed(on="left"), BodyForce(acceleration=(0, 1))))
        assert type(problem.mesh) is kind
        space = make_discretisation(problem.mesh)
        assert space.areas.sum() == pytest.approx(6.0, rel=1e-12)
        u = space.nodes @ np.array([[0.01, 0.02], [0.0, -0.03]])
        F, _, _ = deformation_gradient(space, u, 0.0 * u)
        uniform = np.broadcast_to([[1.01, 0.0], [0.02, 0.97]], F.shape)
        np.testing.assert_allclose(F, uniform, atol=1e-14)
        force = internal_force(space, F, KelvinVoigt().respond(F, 0.0 * F).stress)
        assert abs(force.sum(axis=0)).max() < 1e-12 * abs(force).max()
        ends = space.nodes[sides_of(problem.mesh, "left")[:, :2]]
        assert (ends[:, 1, 1] < ends[:, 0, 1]).all()  # down: the tissue is on the left of the way


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
    mesh = with_regions(SQUARE, half=Box((0.0, 0.0), (1.0, 2.0)))
    with pytest.raises(InputError, match=message) as caught:
        find_rest(Problem(mesh=mesh, conditions=conditions), KelvinVoigt())
    assert "\n" not in str(caught.value)


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
    mesh = with_boundaries(
        plate(kind, rng, (4, 4), (4.0, 4.0), distortion=0.0),
        upper=HalfPlane((0.0, 2.0), (0.0, 1.0)),
        corner=Disc((0.0, 0.0), 1.0),
    )
    mesh = with_regions(mesh, strip=Box((0.0, 0.0), (4.0, 1.0)), all=Disc((2.0, 2.0), 9.0))
    # Sides of the outline: 4 of the top, the upper 2 of left and of right; 2 at the corner.
    assert len(mesh.boundaries["upper"]) == 8
    assert len(mesh.boundaries["corner"]) == 2
    assert len(mesh.subdomains["strip"]) == (4 if kind == "quads" else 8)
    np.testing.assert_array_equal(mesh.subdomains["all"], np.arange(mesh.nelements))
    # The tissue is on the left of every side.
    ends = mesh.p.T[facet_nodes(mesh, mesh.boundaries["upper"])[:, :2]]
    along, inwards = ends[:, 1] - ends[:, 0], [2.0, 2.0] - ends.mean(axis=1)
    assert (along[:, 0] * inwards[:, 1] - along[:, 1] * inwards[:, 0] > 0.0).all()
