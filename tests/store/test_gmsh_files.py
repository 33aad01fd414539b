"""Meshes that Gmsh itself writes, in all its formats, against what Gmsh says of them."""

import os
import subprocess
import sys

import meshio
import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.macro import find_rest
from surrofe2.problem import Fixed, HalfPlane, Problem, Traction
from surrofe2.problem.mesh import area_of, facets_of, length_of, nodes_on
from surrofe2.store.mesh_reader import read
from surrofe2.store.meshes import load_mesh, mesh_of
from tests.conftest import ROOT
from tests.laws import KelvinVoigt
from tests.store import gmsh_meshes as drawn
from tests.store.gmsh_meshes import DRAWINGS, FORMATS

try:
    import gmsh
except (ImportError, OSError) as error:  # its wheel needs libGLU and libraries of X
    pytest.skip(f"Gmsh does not start: {error}", allow_module_level=True)


@pytest.fixture(scope="module", autouse=True)
def _gmsh():
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0.0)
    yield
    gmsh.finalize()


def read_here(path):
    """As `load_mesh`, without a process of its own, whose start takes most of the time."""
    return mesh_of(path, read("gmsh", str(path)))


def same_places(ours, theirs):
    """Whether two lists of places are the same but for their order."""

    def in_order(places):
        rounded = np.round(places, 6) + 0.0
        return rounded[np.lexsort(rounded.T)]

    return np.array_equal(in_order(ours), in_order(theirs))


@pytest.mark.parametrize("draw", DRAWINGS)
@pytest.mark.parametrize("recombine", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_groups_are_those_of_gmsh(tmp_path, draw, order, recombine):
    """Nodes, lengths and areas of every group, in the three formats, as text and as bytes."""
    drawn.meshed(gmsh, draw, order, recombine=recombine)
    known, area = drawn.known_groups(gmsh), drawn.whole_area(gmsh)
    for version, binary in FORMATS:
        path = tmp_path / f"{draw.__name__}-{version}-{binary}.msh"
        mesh = read_here(drawn.written(gmsh, path, version, binary=binary))
        assert area_of(mesh, np.arange(mesh.nelements)) == pytest.approx(area, rel=1e-12)
        boundaries, regions = mesh.boundaries or {}, mesh.subdomains or {}
        assert {(1, name) for name in boundaries} | {(2, name) for name in regions} == {*known}
        for name, elements in regions.items():
            assert area_of(mesh, elements) == pytest.approx(known[2, name].size, rel=1e-12)
        for name, facets in boundaries.items():
            there = known[1, name]
            assert len(facets) == there.elements
            assert length_of(mesh, facets) == pytest.approx(there.size, rel=1e-12)
            nodes = nodes_on(mesh, name) if order == 2 else np.unique(mesh.facets[:, facets])
            assert same_places(mesh.p.T[nodes], there.nodes)


def test_a_mesh_of_gmsh_is_read_by_a_process_of_its_own(tmp_path):
    drawn.meshed(gmsh, drawn.strip, 2, recombine=False)
    path = drawn.written(gmsh, tmp_path / "strip.msh", 4.1, binary=True)
    mesh = load_mesh(path, "mm")
    here = read_here(path)
    np.testing.assert_array_equal(mesh.p, 1e3 * here.p)
    np.testing.assert_array_equal(mesh.t, here.t)
    assert {*mesh.boundaries} == {"left side, clamped", "tip µ/β"}


@pytest.mark.parametrize("incomplete", [False, True])
def test_quadrilaterals_of_second_order_become_triangles_on_their_nodes(
    tmp_path, incomplete, caplog
):
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", float(incomplete))
    drawn.meshed(gmsh, drawn.holed, 2, recombine=True)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0.0)
    kinds = {int(kind) for kind in gmsh.model.mesh.getElements(2)[0]}
    assert (16 if incomplete else 10) in kinds
    with caplog.at_level("INFO", "surrofe2.store"):
        mesh = read_here(drawn.written(gmsh, tmp_path / f"{incomplete}.msh", 4.1, binary=False))
    assert "each quadrilateral becomes two triangles" in caplog.text
    stored = gmsh.model.mesh.getNodes()[1].reshape(-1, 3)[:, :2]
    quads = sum(len(tags) for kind, tags in zip(*gmsh.model.mesh.getElements(2)[:2], strict=True)
                if kind in (10, 16))  # fmt: skip
    assert mesh.p.shape[1] == len(stored) + (quads if incomplete else 0)
    if not incomplete:
        assert same_places(mesh.p.T, stored)


@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_partitioned_meshes_are_whole(tmp_path, version, binary):
    drawn.meshed(gmsh, drawn.layered, 2, recombine=False)
    known = drawn.known_groups(gmsh)
    gmsh.model.mesh.partition(3)
    mesh = read_here(drawn.written(gmsh, tmp_path / "parts.msh", version, binary=binary))
    for name in ("cortex", "skin", "all"):
        assert area_of(mesh, mesh.subdomains[name]) == pytest.approx(known[2, name].size, rel=1e-12)
    for name in ("left", "interface"):
        assert length_of(mesh, mesh.boundaries[name]) == pytest.approx(
            known[1, name].size, rel=1e-12
        )


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("recombine", [False, True])
@pytest.mark.parametrize("draw", [drawn.holed, drawn.layered])
def test_abaqus_files_of_gmsh_have_its_groups(tmp_path, draw, recombine, order):
    """Gmsh writes curves as trusses."""
    drawn.meshed(gmsh, draw, order, recombine=recombine)
    path = tmp_path / "mesh.inp"
    gmsh.write(str(path))
    mesh = mesh_of(path, read("abaqus", str(path)))
    for (dimension, name), known in drawn.known_groups(gmsh).items():
        if dimension == 1:
            size = length_of(mesh, mesh.boundaries[name])
        else:
            size = area_of(mesh, mesh.subdomains[name])
        assert size == pytest.approx(known.size, rel=1e-10)


def test_one_file_of_several_parts_is_refused(tmp_path):
    drawn.meshed(gmsh, drawn.layered, 1, recombine=False)
    gmsh.model.mesh.partition(2)
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", 1.0)
    drawn.written(gmsh, tmp_path / "parts.msh", 4.1, binary=False)
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", 0.0)
    with pytest.raises(InputError, match="1 of the 2 parts of a partitioned mesh; write all of it"):
        load_mesh(tmp_path / "parts_1.msh")


@pytest.mark.parametrize("version", [2.2, 4.0, 4.1])
def test_curves_alone_name_the_remedy(tmp_path, version, caplog):
    """Gmsh leaves out surfaces without a group as soon as there is one of curves."""
    drawn.meshed(gmsh, drawn.strip, 1, recombine=False)
    gmsh.model.removePhysicalGroups([(2, gmsh.model.getPhysicalGroups(2)[0][1])])
    path = drawn.written(gmsh, tmp_path / "curves.msh", version, binary=False)
    with pytest.raises(InputError, match=r"no element; .* Physical Surface.* Mesh\.SaveAll = 1"):
        load_mesh(path)
    gmsh.option.setNumber("Mesh.SaveAll", 1.0)
    with caplog.at_level("INFO", "surrofe2.store"):
        mesh = read_here(drawn.written(gmsh, path, version, binary=False))
    assert area_of(mesh, np.arange(mesh.nelements)) == pytest.approx(20000.0, rel=1e-12)
    if version > 2.2:
        assert length_of(mesh, mesh.boundaries["tip µ/β"]) == pytest.approx(100.0, rel=1e-12)
        return
    assert "format 2.2 loses them with Mesh.SaveAll = 1; write format 4.1" in caplog.text
    with pytest.raises(InputError, match="on: tip µ/β; the mesh has that name, and no boundary"):
        nodes_on(mesh, "tip µ/β")


def test_a_curve_within_the_tissue_is_held_and_not_loaded(tmp_path):
    drawn.meshed(gmsh, drawn.layered, 2, recombine=False)
    mesh = read_here(drawn.written(gmsh, tmp_path / "layers.msh", 4.1, binary=False))
    nodes = nodes_on(mesh, "interface")
    np.testing.assert_allclose(mesh.p[1, nodes], 40.0, rtol=1e-12)
    Problem(mesh=mesh, conditions=(Fixed(on="interface"),))
    loaded = Problem(mesh=mesh, conditions=(
        Fixed(on="left"), Traction(on="interface", traction=(1.0, 0.0))))  # fmt: skip
    sentence = r"traction\.on: interface; 9 of its 9 sides are within the tissue, the first from"
    with pytest.raises(InputError, match=sentence):
        find_rest(loaded, KelvinVoigt())
    held = Problem(mesh=mesh, conditions=(
        Fixed(on="interface"), Traction(on="left", traction=(1.0, 0.0))))  # fmt: skip
    rest = find_rest(held, KelvinVoigt())
    assert np.all(rest.u[nodes] == 0.0)


def test_parametric_nodes_and_other_sections_are_read(tmp_path):
    drawn.meshed(gmsh, drawn.holed, 2, recombine=False)
    area = drawn.whole_area(gmsh)
    gmsh.option.setNumber("Mesh.SaveParametric", 1.0)
    for version, binary in FORMATS:
        path = drawn.written(gmsh, tmp_path / "parametric.msh", version, binary=binary)
        if version == 2.2:
            with pytest.raises(ValueError, match=r"write 4\.1, or Mesh\.SaveParametric = 0"):
                read_here(path)
            continue
        path.write_bytes(path.read_bytes() + b"$Comments\nby hand\n$EndComments\n")
        mesh = read_here(path)
        assert area_of(mesh, np.arange(mesh.nelements)) == pytest.approx(area, rel=1e-12)
    gmsh.option.setNumber("Mesh.SaveParametric", 0.0)


def test_elements_of_third_order_and_volumes_are_named(tmp_path):
    drawn.meshed(gmsh, drawn.strip, 3, recombine=False)
    path = drawn.written(gmsh, tmp_path / "third.msh", 4.1, binary=False)
    with pytest.raises(InputError, match=r"of kind (triangle10|line4); they must be of order 1 or"):
        load_mesh(path)
    gmsh.clear()
    gmsh.model.occ.addBox(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(3)
    path = drawn.written(gmsh, tmp_path / "solid.msh", 4.1, binary=False)
    with pytest.raises(InputError, match=r"elements of kind tetra; they must be one of triangle"):
        load_mesh(path)
    gmsh.clear()


def test_halves_that_are_not_glued_are_refused(tmp_path):
    """Gmsh meshes two rectangles that touch one by one, unless they are made coherent."""
    gmsh.clear()
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 100.0, 100.0)
    gmsh.model.occ.addRectangle(100.0, 0.0, 0.0, 100.0, 100.0)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 45.0)
    gmsh.model.mesh.generate(2)
    path = drawn.written(gmsh, tmp_path / "halves.msh", 4.1, binary=False)
    with pytest.raises(InputError, match=r"two nodes at \(100, .* not glued; .* Coherence"):
        load_mesh(path)
    gmsh.model.mesh.removeDuplicateNodes()
    gmsh.model.mesh.removeDuplicateElements()
    mesh = read_here(drawn.written(gmsh, path, 4.1, binary=False))
    assert length_of(mesh, mesh.boundary_facets()) == pytest.approx(600.0, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_nodes_that_hang_are_refused(tmp_path, order):
    """Halves that touch along a curve and are meshed with different sizes, in one file."""
    gmsh.clear()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 200.0)
    for x, counts in ((0.0, (3, 3)), (100.0, (3, 4))):
        surface = gmsh.model.occ.addRectangle(x, 0.0, 0.0, 100.0, 100.0)
        gmsh.model.occ.synchronize()
        for _, curve in gmsh.model.getBoundary([(2, surface)], oriented=False):
            gmsh.model.mesh.setTransfiniteCurve(abs(curve), counts[x > 0.0])
        gmsh.model.mesh.setTransfiniteSurface(surface)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
    gmsh.model.mesh.removeDuplicateNodes()
    path = drawn.written(gmsh, tmp_path / "hanging.msh", 4.1, binary=False)
    sentences = {
        1: r"node at \(100, .* lies on the side of an element from \(100, .* share whole sides",
        2: r"node at \(100, 50\) hangs: it is a corner of one element and the middle of a side of",
    }
    with pytest.raises(InputError, match=sentences[order]):
        load_mesh(path)


def test_places_of_a_mesh_in_metres_and_single_precision(tmp_path):
    drawn.meshed(gmsh, drawn.strip, 2, recombine=False)
    gmsh.model.mesh.affineTransform([1e-6, 0, 0, 1e-3, 0, 1e-6, 0, 0, 0, 0, 1e-6, 0])
    path = drawn.written(gmsh, tmp_path / "metres.msh", 4.1, binary=False)
    exact = load_mesh(path, "m")
    single = path.with_suffix(".vtu")
    stored = meshio.Mesh(
        (1e-6 * exact.p.T).astype(np.float32) @ np.eye(2, 3, dtype=np.float32),
        [("triangle6", exact.dofs.element_dofs.T)],
    )
    stored.write(single)
    top = HalfPlane((0.0, 100.0), (0.0, 1.0))
    for mesh in (exact, load_mesh(single, "m")):
        problem = Problem(mesh=mesh, conditions=(), boundaries={"top": top})
        facets = facets_of(problem.mesh, "top")
        assert length_of(problem.mesh, facets) == pytest.approx(200.0, rel=1e-4)


def test_the_mesh_of_the_notched_leaf_is_what_gmsh_writes(tmp_path):
    """By the command of its page: the same groups and, by the same version, the same bytes."""
    source = ROOT / "examples" / "notched-leaf.geo"
    shipped = load_mesh(source.with_suffix(".msh"))
    path = tmp_path / "leaf.msh"
    command = [sys.executable, "-c", "import gmsh, sys; gmsh.initialize(sys.argv, run=True)"]
    subprocess.run(
        [*command, str(source), "-2", "-order", "2", "-format", "msh41", "-o", str(path)],
        check=True, capture_output=True, env=os.environ,
    )  # fmt: skip
    mesh = load_mesh(path)
    for name in ("base", "tip", "notch"):
        assert length_of(mesh, mesh.boundaries[name]) == pytest.approx(
            length_of(shipped, shipped.boundaries[name]), rel=1e-6
        )
    assert area_of(mesh, mesh.subdomains["leaf"]) == pytest.approx(
        area_of(shipped, shipped.subdomains["leaf"]), rel=1e-6
    )


def test_damaged_files_are_one_line(tmp_path):
    drawn.meshed(gmsh, drawn.strip, 2, recombine=False)
    for version, binary in FORMATS:
        path = drawn.written(gmsh, tmp_path / "whole.msh", version, binary=binary)
        content = path.read_bytes()
        cut = tmp_path / "cut.msh"
        for share in (0.02, 0.3, 0.6, 0.9):
            cut.write_bytes(content[: int(share * len(content))])
            with pytest.raises((ValueError, InputError)):
                read_here(cut)
    with pytest.raises(FileError, match="not a mesh that can be read"):
        load_mesh(cut)
