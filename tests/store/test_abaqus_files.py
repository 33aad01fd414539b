"""Abaqus input files: plane elements of all kinds, sets and surfaces, as Abaqus/CAE writes them."""

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.problem.mesh import area_of, length_of
from surrofe2.store.mesh_reader import read
from surrofe2.store.meshes import load_mesh, mesh_of

NODES = """*Heading
 by hand
*Node
 1, 0., 0.
 2, 100., 0.
 3, 200., 0., 0.
 14, 0., 100.
 15, 100., 1.e2
 16, 200., 100.
 21, 50., 0.
 22, 100., 50.
 23, 50., 100.
 24, 0., 50.
 25, 150., 0.
 26, 200., 50.
 27, 150., 100.
 31, 50., 50.
 32, 150., 50.
"""
"""Corners of two squares, middles of their sides, and of the diagonals."""

QUADS = """*Element, type={kind}, elset=first
 1, 1, 2, 15, 14
*Element, type={kind}
 7, 2, 3, 16, 15
"""
QUADS_8 = """*Element, type={kind}, elset=first
 1, 1, 2, 15, 14, 21, 22, 23,
 24
*Element, type={kind}
 7, 2, 3, 16, 15, 25, 26, 27, 22
"""
TRIANGLES = """*Element, type={kind}, elset=first
 1, 1, 2, 15
 2, 1, 15, 14
*Element, type={kind}
 7, 2, 3, 16
 8, 2, 16, 15
"""
TRIANGLES_6 = """*Element, type={kind}, elset=first
 1, 1, 2, 15, 21, 22, 31
 2, 1, 15, 14, 31, 23, 24
*Element, type={kind}
 7, 2, 3, 16, 25, 26, 32
 8, 2, 16, 15, 32, 27, 22
"""
SETS = """*Nset, nset=Left
 1, 14, 24
*Nset, nset=bottom, generate
 1, 3, 1
*Nset, nset=bottom
 21, 25
*Elset, elset=whole
 first, 7, 8
*Elset, elset=_right_S2, internal
 7,
*Surface, type=ELEMENT, name=right
 _right_S2, S2
** a remark
*Material, name=tissue
*Elastic
 1000., 0.3
"""
KINDS = {
    QUADS: "CPS4 CPS4R CPS4I CPE4 CPE4R CPE4H CPE4RT CPEG4 S4 S4R S4R5 M3D4 M3D4R R3D4 SFM3D4",
    QUADS_8: "CPS8 CPS8R CPE8 CPE8R CPE8RH CPEG8R S8R S8R5 M3D8R",
    TRIANGLES: "CPS3 CPE3 CPE3T CPEG3 S3 S3R STRI3 M3D3 R3D3",
    TRIANGLES_6: "CPS6 CPS6M CPE6 CPE6MH CPEG6 STRI65 M3D6",
}


def written(tmp_path, text):
    path = tmp_path / "leaf.inp"
    path.write_text(text, encoding="utf-8")
    return path


def read_here(path):
    return mesh_of(path, read("abaqus", str(path)))


def only(elements):
    """A file of elements, the nodes that they have, and sets of them."""
    words = elements.replace("\n", ",").split(",")
    used = {word.strip() for word in words}
    lines = []
    for line in NODES.splitlines():
        is_node = line.startswith(" ") and "," in line
        if not is_node or line.split(",")[0].strip() in used:
            lines.append(line)
    sets = SETS
    if "24" not in used:  # no middles of sides
        sets = sets.replace(", 24\n", "\n").replace(" 21, 25\n", " 3\n")
    if "8" not in used:
        sets = sets.replace("first, 7, 8", "first, 7")
    return "\n".join([*lines, elements, sets])


@pytest.mark.parametrize(
    ("elements", "kind"), [(text, kind) for text, kinds in KINDS.items() for kind in kinds.split()]
)
def test_plane_elements_of_all_kinds(tmp_path, elements, kind):
    mesh = read_here(written(tmp_path, only(elements.format(kind=kind))))
    assert area_of(mesh, mesh.subdomains["first"]) == pytest.approx(10_000.0, rel=1e-12)
    assert area_of(mesh, mesh.subdomains["whole"]) == pytest.approx(20_000.0, rel=1e-12)
    assert {*mesh.subdomains} == {"first", "whole"}
    assert {name: length_of(mesh, of) for name, of in mesh.boundaries.items()} == pytest.approx(
        {"Left": 100.0, "bottom": 200.0, "right": 100.0}, rel=1e-12
    )


ASSEMBLY = f"""*Part, name=Leaf
{NODES.partition("by hand")[2]}
{TRIANGLES_6.format(kind="CPS6")}
*Nset, nset=Set-1
 1, 2, 3, 14, 15, 16, 21, 22, 23, 24, 25, 26, 27, 31, 32
*Elset, elset=Set-1, generate
 1, 2, 1
*Elset, elset=SET-1
 7, 8
*End Part
*Assembly, name=Assembly
*Instance, name=Leaf-1, part=Leaf
*End Instance
*Node
 1, 500., 50., 0.
*Nset, nset=Reference
 1,
*Nset, nset=Grip, instance=Leaf-1
 1, 14, 24
*Elset, elset=Grip, instance=Leaf-1
 2,
*Elset, elset=_Tip_S2, internal, instance=Leaf-1
 7,
*Surface, type=ELEMENT, name=Tip
_Tip_S2, S2
*End Assembly
"""


def test_a_file_of_abaqus_cae(tmp_path):
    """Sets of a face in a part; in the assembly those of an edge, a reference point, a surface."""
    mesh = load_mesh(written(tmp_path, ASSEMBLY), "mm")
    assert {name: len(of) for name, of in mesh.subdomains.items()} == {"first": 2, "Set-1": 4}
    assert {name: length_of(mesh, of) for name, of in mesh.boundaries.items()} == pytest.approx(
        {"Grip": 1e5, "Tip": 1e5}, rel=1e-12
    )
    np.testing.assert_array_equal(mesh.p.max(axis=1), [2e5, 1e5])


@pytest.mark.parametrize(
    ("old", "new", "error", "sentence"),
    [
        ("CPS6", "C3D10", InputError, r"2 elements of type C3D10; they must be plane, such"),
        ("CPS6", "CAX6", InputError, r"2 elements of type CAX6; they must be plane"),
        ("*End Instance", "*End Instance\n*Instance, name=Leaf-2, part=Leaf\n*End Instance",
         InputError, "it has several parts; write a file of one part"),
        ("part=Leaf\n", "part=Leaf\n 0., 5., 0.\n", InputError, "its instance is moved"),
        ("*Assembly", "*Include, input=more.inp\n*Assembly", InputError, "includes another file"),
        ("_Tip_S2, S2", "_Tip_S2, S4", InputError, "surface Tip: S4; it must be of sides S1 to S3"),
        (" 7, 8\n*End Part", " 7, 99\n*End Part", FileError, "set Set-1: element 99 is not there"),
        (" 1, 1, 2, 15, 21", " 1, 1, 2, 77, 21", FileError, "an element: node 77 is not there"),
        (" 1, 1, 2, 15, 21,", " 1, 1, 2, 15,", FileError, "element of type CPS6 must have 6 nodes"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, old, new, error, sentence):
    assert old in ASSEMBLY
    with pytest.raises(error, match=sentence):
        load_mesh(written(tmp_path, ASSEMBLY.replace(old, new, 1)))
