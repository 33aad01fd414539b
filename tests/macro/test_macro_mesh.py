"""Meshes: what is wrong is one line that names what and where; parts by name."""

import time
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
from surrofe2.problem.mesh import (
    area_of,
    check_mesh,
    element_nodes,
    facet_nodes,
    length_of,
    nodes_on,
    region,
)
from tests.laws import KelvinVoigt
from tests.macro.meshes import KINDS, plate, sides_of, triangles

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


def part(elements, nodes=NODES):
    """A mesh of these elements and the nodes that they have."""
    used, number = np.unique(elements, return_inverse=True)
    return quads(nodes[used], number.reshape(elements.shape))


TWICE = np.vstack([NODES, NODES[3:6]])
UNGLUED = np.array([[0, 3, 4, 1], [1, 4, 5, 2], [9, 6, 7, 10], [10, 7, 8, 11]])
"""The right half of SQUARE with nodes of its own, which are 3 to 5 again."""
HANGING = np.array([[0, 3, 5, 2], [3, 6, 7, 4], [4, 7, 8, 5]])
"""One element on the left of SQUARE."""


def bulging(bulge):
    """A triangle with a curved right side, on which a node of two straight ones lies."""
    nodes = np.array([[0.0, 1.0], [2.0, 0.0], [2.0, 2.0], [2.0 + bulge, 1.0], [4.0, 1.0]])
    mesh = triangles(nodes, np.array([[0, 1, 2], [1, 4, 3], [3, 4, 2]]))
    moved = mesh.p.copy()
    moved[:, element_nodes(mesh)[0, 4]] = nodes[3]
    return replace(mesh, doflocs=moved)


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
        (part(UNGLUED, TWICE),
         r"mesh: two nodes at \(1, [012]\) µm, .* not glued; merge such nodes \(in Gmsh: Cohe"),
        (part(UNGLUED, TWICE + (np.arange(12) > 8)[:, None] * [5e-4, 0.0]), r"two nodes at \(1"),
        (part(HANGING),
         r"node at \(1, 1\) µm lies on the side of an element from \(1, [02]\) µm to \(1, [02]"),
        (bulging(0.2), r"the node at \(2.2, 1\) µm lies on the side of an element from \(2, 0\)"),
        (part(QUADS[[0, 3]]),
         r"mesh: two parts share the node at \(1, 1\) µm and no side, so that they would turn"),
    ],
)  # fmt: skip
def test_a_bad_mesh_is_one_line(mesh, message):
    with pytest.raises(InputError, match=message) as caught:
        Problem(mesh=mesh, conditions=())
    assert "\n" not in str(caught.value)


def test_gaps_and_notches_that_are_meant_are_no_cracks():
    """A crack that is open by more than a thousandth of a side; a corner near a long side."""
    opened = TWICE.copy()
    opened[11, 0] += 0.01
    cracked = np.where(UNGLUED == 11, 11, np.where(UNGLUED > 8, UNGLUED - 6, UNGLUED))
    for mesh in (
        part(cracked, opened),
        *(plate(kind, np.random.default_rng(1)) for kind in KINDS),
    ):
        assert check_mesh(mesh).nelements == mesh.nelements


def test_seams_of_a_large_mesh_are_found_in_no_time():
    """Every element with nodes of its own, so that all sides are outer ones, and a whole mesh."""
    mesh = rectangle(256.0, 256.0, (256, 256))
    apart = mesh.p[:, mesh.t.T.ravel()] + 0.01 * np.tile(
        [[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]], mesh.nelements
    )
    began = time.process_time()
    check_mesh(mesh)
    with pytest.raises(InputError, match="65536 pieces that do not touch"):
        check_mesh(skfem.MeshQuad1(apart, np.arange(4 * mesh.nelements).reshape(-1, 4).T))
    assert time.process_time() - began < 10.0


@pytest.mark.parametrize("twin", ["half", "Half", "ha lf"])
def test_one_name_of_two_things_is_refused_where_it_is_used(twin):
    """Names that capitals or blanks alone tell apart are one."""
    mesh = with_regions(SQUARE, half=Box((0.0, 0.0), (1.0, 2.0)))
    mesh = with_boundaries(mesh, **{twin: Box((2.0, 0.0), (2.0, 2.0))})
    sentence = rf"it may mean the boundary '{twin}' or the region 'half'; name them apart"
    for acts in (Fixed(on=twin), Traction(on=twin, traction=(1.0, 0.0)),
                 BodyForce(on="half", acceleration=(1.0, 0.0))):  # fmt: skip
        with pytest.raises(InputError, match=sentence):
            Problem(mesh=mesh, conditions=(acts,))
    with pytest.raises(InputError, match=sentence):
        region(mesh, "half")
    with pytest.raises(InputError, match=sentence):
        nodes_on(mesh, twin)
    Problem(mesh=mesh, conditions=(Fixed(on="left"),))


def test_sides_within_the_tissue_may_be_held_but_not_loaded():
    cut = SQUARE.with_boundaries({"cut": np.arange(SQUARE.nfacets)})
    hold = Fixed(on="left")
    assert len(nodes_on(cut, "cut")) == SQUARE.p.shape[1]
    with pytest.raises(
        InputError, match=r"traction\.on: cut; 4 of its 12 sides are within the tis"
    ):
        find_rest(
            Problem(mesh=cut, conditions=(hold, Traction(on="cut", traction=(1.0, 0.0)))),
            KelvinVoigt(),
        )


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_places_are_found_within_single_precision(kind, scale, rng):
    """Sides at 100 scale that a file of single precision, or of six digits, has beside it."""
    exact = plate(kind, rng, (8, 5), (200.0 * scale, 100.0 * scale), distortion=0.0)
    for rounded in (
        exact.p.astype(np.float32) * (1.0 + 6e-8),
        np.vectorize(lambda x: float(f"{x:.6g}"))(exact.p * 1.0000003),
    ):
        mesh = replace(exact, doflocs=np.asarray(rounded, dtype=np.float64))
        mesh = with_boundaries(
            mesh,
            upper=Box((0.0, 100.0 * scale), (200.0 * scale, 100.0 * scale)),
            rim=HalfPlane((200.0 * scale, 0.0), (1.0, 0.0)),
            disc=Disc((0.0, 0.0), 200.0 * scale),
        )
        assert len(mesh.boundaries["upper"]) == 8
        assert len(mesh.boundaries["rim"]) == 5
        # All nodes of the bottom and the left side, and of the top those as near as its end.
        assert len(mesh.boundaries["disc"]) >= 8 + 5
        space = make_discretisation(mesh)
        corner = np.array([200.0, 100.0]) * scale
        nodes, weights = space.locate(corner)
        np.testing.assert_allclose(weights @ space.nodes[nodes], corner, rtol=2e-6)
        Problem(mesh=mesh, conditions=(Symmetry(on="rim"),))


def test_lengths_and_areas_of_curved_triangles(rng):
    """Of a square with a round hole, in the limit; of a straight plate, exactly."""
    for kind in KINDS:
        mesh = plate(kind, rng)
        assert area_of(mesh, np.arange(mesh.nelements)) == pytest.approx(600.0, rel=1e-12)
        assert length_of(mesh, mesh.boundaries["top"]) == pytest.approx(30.0, rel=1e-12)
    disc = skfem.MeshTri2.init_circle(4)
    assert area_of(disc, np.arange(disc.nelements)) == pytest.approx(np.pi, rel=1e-5)
    assert length_of(disc, disc.boundary_facets()) == pytest.approx(2.0 * np.pi, rel=1e-5)
    assert length_of(disc, disc.boundary_facets()[:0]) == 0.0


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
