"""Mesh files: what they give, and the one sentence each wrong one gets."""

import os
import subprocess
import sys

import meshio
import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.problem.mesh import area_of, element_nodes, length_of, rectangle, region
from surrofe2.store import meshes
from surrofe2.store.fields import CELL, DISPLACEMENT_NAME, write_series
from surrofe2.store.meshes import load_mesh
from tests.conftest import ROOT
from tests.macro.meshes import KINDS, plate, sides_of
from tests.store.gmsh_files import QUADS, TRIANGLES

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMBA")}


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "leaf.msh"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def refusal(path, error=InputError):
    with pytest.raises(error) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def changed(text, *pairs):
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def names(mesh):
    """Elements of regions, and nodes of boundaries."""
    regions = {name: each.tolist() for name, each in mesh.subdomains.items()}
    return regions, {name: sides_of(mesh, name).tolist() for name in mesh.boundaries}


def test_quadrilaterals_of_gmsh(written):
    mesh = load_mesh(written(QUADS), "mm")
    np.testing.assert_array_equal(
        mesh.p.T, 1e3 * np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]])
    )
    np.testing.assert_array_equal(mesh.t.T, [[0, 1, 4, 3], [1, 4, 5, 2]])
    # Both sides go round with the tissue on their left, whichever way the file has them.
    assert names(mesh) == (
        {"skin": [0], "flesh": [1]}, {"left": [[3, 0]], "right": [[2, 5]]}
    )  # fmt: skip


def test_triangles_of_three_nodes_get_middles(written):
    mesh = load_mesh(written(TRIANGLES))
    assert mesh.p.shape == (2, 13)  # 5 corners, 8 sides
    nodes, elements = mesh.p.T, element_nodes(mesh)
    for a, b, middle in ((0, 1, 3), (1, 2, 4), (0, 2, 5)):
        expected = 0.5 * (nodes[elements[:, a]] + nodes[elements[:, b]])
        np.testing.assert_array_equal(nodes[elements[:, middle]], expected)
    (base,), (tip,) = sides_of(mesh, "base"), sides_of(mesh, "tip")
    assert nodes[base].tolist() == [[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]]
    assert nodes[tip].tolist() == [[2.0, 2.0], [0.0, 2.0], [1.0, 2.0]]
    assert mesh.subdomains["leaf"].tolist() == [0, 1, 2, 3]


def test_curved_lines_of_three_nodes_are_sides_of_triangles_of_six(tmp_path, written):
    """Middles come first in the file, corners after them."""
    straight = load_mesh(written(TRIANGLES))
    (side,) = sides_of(straight, "base")
    number = np.arange(13)[::-1]
    made = meshio.Mesh(
        np.pad(straight.p.T[number], ((0, 0), (0, 1))),
        [("triangle6", number[element_nodes(straight)]), ("line3", number[side[None, [1, 0, 2]]])],
        cell_data={"gmsh:physical": [np.full(4, 3), np.array([1])],
                   "gmsh:geometrical": [np.full(4, 1), np.array([1])]},
        field_data={"leaf": np.array([3, 2]), "base": np.array([1, 1])},
    )  # fmt: skip
    path = tmp_path / "curved.msh"
    made.write(path, file_format="gmsh22")
    back = load_mesh(path)
    np.testing.assert_array_equal(back.p.T[sides_of(back, "base")], [straight.p.T[side]])
    np.testing.assert_array_equal(back.subdomains["leaf"], [0, 1, 2, 3])
    for nodes in (back.p.T[element_nodes(back)], straight.p.T[element_nodes(straight)]):
        np.testing.assert_array_equal(nodes[:, 3], 0.5 * (nodes[:, 0] + nodes[:, 1]))


@pytest.mark.parametrize("kind", ["msh", "vtk", "vtu", "inp"])
def test_triangles_of_six_nodes_from_any_format(tmp_path, written, kind):
    mesh = load_mesh(written(TRIANGLES))
    gmsh_order = element_nodes(mesh)
    points = np.pad(mesh.p.T, ((0, 0), (0, 1)), constant_values=3.0)
    path = tmp_path / f"six.{kind}"
    made = meshio.Mesh(points, [("triangle6", gmsh_order)])
    made.write(path, file_format="gmsh" if kind == "msh" else None)
    back = load_mesh(path, "m")
    np.testing.assert_allclose(
        back.p.T[element_nodes(back)], 1e6 * mesh.p.T[gmsh_order], rtol=1e-12
    )
    assert len(back.boundary_facets()) == 4


MIXED = changed(QUADS, ("5 5 1 5", "5 6 1 6"), ("2 2 3 1\n", "2 2 2 1\n6 2 6 3\n2 2 3 1\n"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (MIXED.replace("5 6 1 6", "6 6 1 6"), "mesh: 2 elements of the same nodes at (1.6"),
        (changed(TRIANGLES, ("1 1 5\n$EndNodes", "1 1 6\n$EndNodes")),
         "z from 5 to 6; the mesh must lie in a plane of constant z"),
        (changed(TRIANGLES, ("1 2 1 1\n2 3 4", "1 2 1 1\n2 3 1")),
         "boundary tip: the line from (2, 2) to (0, 0) is no side of an element"),
        (changed(TRIANGLES, ("0 2 5\n1 1 5", "0 nan 5\n1 1 5")),
         "point 3 at [0.0, nan, 5.0]; coordinates must be finite"),
    ],
)  # fmt: skip
def test_wrong_gmsh_files(written, text, sentence):
    assert refusal(written(text)).startswith(f"leaf.msh: {sentence}")


def test_a_group_of_nothing_is_refused_where_it_is_used(written):
    text = changed(TRIANGLES, ('"leaf"\n', '"leaf"\n2 4 "stem"\n'), ("\n3\n1 1", "\n4\n1 1"))
    mesh = load_mesh(written(text))
    with pytest.raises(InputError, match="region: stem; the mesh has that name, and no region of"):
        region(mesh, "stem")


def test_elements_in_space_and_lines_alone(tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    path = tmp_path / "solid.vtk"
    known = "triangle, quad, triangle6, quad8, quad9"
    meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])]).write(path)
    assert refusal(path) == f"solid.vtk: 1 elements of kind tetra; they must be one of {known}"
    meshio.Mesh(points, [("line", [[0, 1]])]).write(path)
    assert refusal(path) == f"solid.vtk: no element; it must have elements of kind {known}"


def test_what_cannot_be_read(tmp_path, written, capfd):
    none = tmp_path / "none.msh"
    assert refusal(none, FileError) == f"{none}: cannot be read: No such file or directory"
    damaged = written("nonsense")
    assert refusal(damaged, FileError).startswith(f"{damaged}: not a mesh that can be read (")
    foreign = tmp_path / "leaf.txt"
    foreign.write_text("nonsense")
    assert refusal(foreign, FileError) == (
        f"{foreign}: not a mesh file: its name must end in .msh, .vtk, .vtu, .xdmf, .xmf, .inp, "
        ".mesh, .meshb"
    )
    assert capfd.readouterr() == ("", "")


def test_elements_without_a_group_are_in_no_region(written):
    mesh = load_mesh(written(changed(QUADS, ("1 0 0 0 1 1 0 1 3 0", "1 0 0 0 1 1 0 0 0"))))
    assert mesh.nelements == 2
    assert mesh.subdomains["flesh"].tolist() == [1]


def test_numbers_that_a_file_has_no_points_for(written):
    path = written(changed(QUADS, ("6\n12\n0 0 0", "6\n4000000000\n0 0 0")))
    assert "an element has node 12, which is not there" in refusal(path, FileError)
    vtk = path.with_suffix(".vtk")
    vtk.write_text(
        "# vtk DataFile Version 2.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n"
        "0 0 0 1 0 0 1 1 0 0 1 0\nCELLS 1 5\n4 0 1 2 9\nCELL_TYPES 1\n9\n"
    )
    assert "cells of points that are not there; there are 4" in refusal(vtk)


def test_a_reader_that_does_not_end(written, monkeypatch):
    path = written("")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    sentence = "cannot be read: the program that reads meshes did not start (exit code 1)"
    assert refusal(path, FileError) == f"{path}: {sentence}"
    endless = path.with_name("reader")
    endless.write_text("#!/bin/sh\nulimit -S -t 1\nwhile true; do :; done\n")
    endless.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(endless))
    assert "reading it takes more than 20 s" in refusal(path, FileError)


def test_a_mesh_is_read_under_lower_limits(tmp_path, written):
    """Those of a batch queue, which a process cannot raise."""
    by_us, by_meshio = written(QUADS), tmp_path / "leaf.vtu"
    meshio.read(by_us).write(by_meshio)
    script = (
        "import sys; from resource import *; from surrofe2.store.meshes import load_mesh\n"
        "setrlimit(RLIMIT_AS, (1_900_000_000,) * 2); setrlimit(RLIMIT_CPU, (15, 15))\n"
        "print(*(load_mesh(path).nelements for path in sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(by_us), str(by_meshio)],
        capture_output=True, text=True, check=False, env=os.environ | ONE_THREAD,
    )  # fmt: skip
    assert done.stdout == "2 2\n", done.stderr


def test_the_reader_needs_no_installed_package(tmp_path, written):
    """A script finds the package by a path of its own, which a new process does not inherit."""
    script = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "from surrofe2.store.meshes import load_mesh; print(load_mesh(sys.argv[1]).nelements)"
    )
    away = {"PYTHONPATH": str(tmp_path)}  # another's folder, which stays
    done = subprocess.run(
        [sys.executable, "-c", script, str(written(QUADS))],
        capture_output=True, text=True, check=False, cwd=tmp_path, env=os.environ | away,
    )  # fmt: skip
    assert done.stdout == "2\n", done.stderr


def test_a_reader_that_cannot_start_does_not_blame_the_mesh(written, monkeypatch, tmp_path):
    (tmp_path / "numpy.py").write_text("raise ImportError('no NumPy here')")
    path = written(QUADS)
    monkeypatch.setattr(meshes, "_PACKAGES", str(tmp_path))
    assert refusal(path, FileError).endswith(
        "the program that reads meshes did not start (ImportError: no NumPy here)"
    )


SHEET = np.array([[50.0 * i, 50.0 * j, 0.0] for j in range(3) for i in range(5)])
CELLS = np.array([[5 * j + i + k for k in (0, 1, 6, 5)] for j in range(2) for i in range(4)])
TISSUE = np.array([11, 11, 12, 12] * 2)


def labelled(path, **arrays):
    """A sheet of 4 × 2 quadrilaterals with arrays of its elements."""
    cell_data = {name.replace("_", " "): [each] for name, each in arrays.items()}
    meshio.Mesh(SHEET, [("quad", CELLS)], cell_data=cell_data).write(path)
    return path


@pytest.mark.parametrize("kind", ["vtu", "vtk", "xdmf"])
def test_whole_numbers_of_elements_are_regions(tmp_path, kind):
    path = labelled(tmp_path / f"sheet.{kind}", tissue=TISSUE, stiffness=0.5 * TISSUE)
    mesh = load_mesh(path)
    numbers = {name: mesh.subdomains[name].tolist() for name in mesh.subdomains}
    assert numbers == {"11": [0, 1, 4, 5], "12": [2, 3, 6, 7]}


def test_several_arrays_of_numbers_are_told_apart_by_their_names(tmp_path):
    rows = np.array([1] * 4 + [11] * 4)
    of_vtk = np.arange(8)
    mesh = load_mesh(labelled(tmp_path / "a.vtu", tissue=TISSUE, row=rows, vtkOriginalIds=of_vtk))
    assert {*mesh.subdomains} == {"tissue 11", "tissue 12", "row 1", "row 11"}
    assert mesh.subdomains["row 11"].tolist() == [4, 5, 6, 7]


def test_numbers_of_lines_are_boundaries(tmp_path):
    """Medit's references, which lines and elements share."""
    path = tmp_path / "sheet.mesh"
    lines = np.array([[0, 5], [5, 10], [4, 9]])
    meshio.Mesh(
        SHEET[:, :2], [("quad", CELLS), ("line", lines)],
        cell_data={"medit:ref": [TISSUE, np.array([11, 11, 5])]},
    ).write(path)  # fmt: skip
    mesh = load_mesh(path)
    assert {name: len(of) for name, of in mesh.boundaries.items()} == {"curve 11": 2, "5": 1}
    assert {name: len(of) for name, of in mesh.subdomains.items()} == {"surface 11": 4, "12": 4}


def test_mixed_elements_keep_their_labels(tmp_path, caplog):
    """Quadrilaterals become two triangles each, and area and sides stay."""
    path = tmp_path / "mixed.vtu"
    halves = np.concatenate([CELLS[6:, [0, 1, 2]], CELLS[6:, [0, 2, 3]]])
    labels = [TISSUE[:6], np.array([12, 12, 12, 12])]
    meshio.Mesh(
        SHEET, [("quad", CELLS[:6]), ("triangle", halves)], cell_data={"tissue": labels}
    ).write(path)
    with caplog.at_level("INFO", "surrofe2.store"):
        mesh = load_mesh(path)
    assert "mixed.vtu: 4 of kind triangle and 6 of kind quad; each quad" in caplog.text
    assert (type(mesh).__name__, mesh.nelements) == ("MeshTri2", 16)
    assert area_of(mesh, mesh.subdomains["11"]) == pytest.approx(10_000.0, rel=1e-12)
    assert area_of(mesh, mesh.subdomains["12"]) == pytest.approx(10_000.0, rel=1e-12)
    assert length_of(mesh, mesh.boundary_facets()) == pytest.approx(600.0, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS[:2])
def test_fields_of_a_run_are_a_mesh(tmp_path, kind, rng):
    mesh = plate(kind, rng)
    t, number = np.arange(3.0), np.arange(mesh.nelements) % 2
    series = np.broadcast_to(number, (3, mesh.nelements))
    at_points = {DISPLACEMENT_NAME: np.zeros((3, mesh.p.shape[1], 2))}
    write_series(
        tmp_path, mesh.p.T, element_nodes(mesh), t, at_points, {CELL: series.astype(np.float64)}
    )
    back = load_mesh(tmp_path / "fields.xdmf")
    assert type(back) is type(mesh)
    np.testing.assert_allclose(
        back.p.T[element_nodes(back)], mesh.p.T[element_nodes(mesh)], rtol=1e-15
    )


def test_greek_mu_in_a_name_is_the_micro_sign(written):
    mesh = load_mesh(written(changed(QUADS, ('"skin"', '"skin of 5 \u03bcm"'))), "\u03bcm")
    assert "skin of 5 \u00b5m" in mesh.subdomains


def test_a_large_mesh_is_read_without_a_word(tmp_path, caplog, capfd):
    """scikit-fem logs a warning where the arrays of more than 1000 nodes are not contiguous."""
    mesh = rectangle(1.0, 1.0, (40, 40))
    path = tmp_path / "large.vtu"
    in_space = np.pad(mesh.p.T, ((0, 0), (0, 1)))
    meshio.Mesh(in_space, [("quad", mesh.t.T)]).write(path)
    assert load_mesh(path).nelements == 1600
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


def test_a_byte_order_mark_is_read_and_utf_16_is_named(tmp_path):
    path = tmp_path / "mesh.msh"
    path.write_text(QUADS, encoding="utf-8-sig")
    assert load_mesh(path, "\u03bcm").nelements > 0
    for encoding in ("utf-16", "utf-16-le"):
        path.write_text(QUADS, encoding=encoding)
        with pytest.raises(FileError, match=r"mesh\.msh: this is UTF-16 text; save it as UTF-8"):
            load_mesh(path)
