"""Labelled surfaces as PLY, written by meshio and by PyVista."""

import meshio
import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.questions.cell_image import measure_cells
from surrofe2.store.labelled_surface import read_surface
from tests.cli.conftest import call
from tests.questions.test_cell_image import squares

STEP = 2.0
TILT = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def surface(bent=None):
    """Points, triangles and labels of 5 × 5 cells of 20 µm; unlabelled every tenth vertex."""
    label = squares(5, 5, side=10)
    label = np.where((np.arange(label.size) % 10 == 3).reshape(label.shape), -1, label)
    rows, columns = label.shape
    y, x = np.mgrid[:rows, :columns] * STEP
    z = np.zeros_like(x)
    if bent:  # a piece of a cylinder
        x, z = bent * np.sin(x / bent), bent * np.cos(x / bent)
    number = np.arange(label.size).reshape(label.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return points, triangles, label.ravel().astype(np.int32)


def write(path, points, triangles, *, binary=True, **data):
    meshio.ply.write(path, meshio.Mesh(points, [("triangle", triangles)], data), binary=binary)
    return path


@pytest.mark.parametrize("binary", [True, False])
def test_cells_of_a_surface_have_their_areas_however_it_lies(tmp_path, binary):
    points, triangles, label = surface()
    signal = np.linspace(0.0, 1.0, len(label))
    path = write(
        tmp_path / "a.ply", points @ TILT.T, triangles, binary=binary, label=label, signal=signal
    )
    found = read_surface(path)
    assert found.flatness == pytest.approx(1.0)
    assert found.remarks == ()
    cells = measure_cells(found.labels, found.pixel)
    assert list(cells.label) == [*range(1, 26)]  # those at its edge are whole
    # a row of vertices less than 50, shared by two cells at their walls
    assert cells.area.sum() == pytest.approx(98.0**2, rel=0.01)
    np.testing.assert_allclose(cells.area, 380.0, rtol=0.08)
    np.testing.assert_allclose(cells.aspect, 1.0, atol=0.12)


def test_a_flat_surface_is_not_turned_or_mirrored(tmp_path):
    path = write(tmp_path / "a.ply", *surface()[:2], label=surface()[2])
    cells = measure_cells(read_surface(path).labels, read_surface(path).pixel)
    at = dict(zip(cells.label.tolist(), cells.centre, strict=True))
    assert at[8][0] > at[7][0] + 15.0
    assert at[12][1] > at[7][1] + 15.0


def test_a_curved_surface_is_named_or_refused(tmp_path):
    points, triangles, label = surface(bent=80.0)
    found = read_surface(write(tmp_path / "bent.ply", points, triangles, label=label))
    assert "curved: projected to a plane it has 9" in found.remarks[0]
    points, triangles, label = surface(bent=30.0)
    with pytest.raises(InputError, match="cut out a flatter piece"):
        read_surface(write(tmp_path / "round.ply", points, triangles, label=label))


def test_what_is_no_labelled_surface_is_refused(tmp_path):
    points, triangles, label = surface()
    with pytest.raises(InputError, match="have x, y, z, signal and no property label"):
        read_surface(write(tmp_path / "a.ply", points, triangles, signal=1.0 * label))
    with pytest.raises(InputError, match="1 label besides 0; at least 3 are needed"):
        read_surface(write(tmp_path / "b.ply", points, triangles, label=np.ones_like(label)))
    (tmp_path / "c.ply").write_text("no ply", encoding="utf-8")
    with pytest.raises(FileError, match="cannot be read as PLY"):
        read_surface(tmp_path / "c.ply")
    unlabelled = 1.0 * label
    unlabelled[0] = np.nan
    with pytest.raises(InputError, match="label of its vertices: float64; it must be whole"):
        read_surface(write(tmp_path / "e.ply", points, triangles, label=unlabelled))
    with pytest.raises(InputError, match="its triangles have no area"):
        read_surface(write(tmp_path / "f.ply", 0.0 * points, triangles, label=label))
    whole = write(tmp_path / "d.ply", points, triangles, label=label).read_bytes()
    (tmp_path / "d.ply").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match="cannot be read as PLY"):
        read_surface(tmp_path / "d.ply")


def test_a_surface_that_is_cut_off_is_refused_at_once(tmp_path):
    points, triangles, label = surface()
    path = write(tmp_path / "a.ply", points, triangles, binary=False, label=label)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(lines[:4]), encoding="utf-8")
    with pytest.raises(FileError, match="its header has no end_header; the file is cut off"):
        read_surface(path)
    path.write_text("".join(lines[:-3]), encoding="utf-8")
    with pytest.raises(FileError, match="it ends before what its header states"):
        read_surface(path)


def test_a_file_of_pyvista_is_measured_by_the_command(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    points, triangles, label = surface()
    mesh = pyvista.PolyData.from_regular_faces(points, triangles)
    plain = tmp_path / "plain.ply"
    mesh.save(plain)
    refused = call("cells", plain, code=1)
    assert "no property label" in refused.stderr
    path = write(tmp_path / "a.ply", points, triangles, label=label)
    assert "whole cells" in call("cells", path).stdout
    assert "a PLY is in µm: leave it out" in call("cells", path, "--pixel", 1.0, code=1).stderr
