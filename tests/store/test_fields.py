import subprocess
import sys
from pathlib import Path
from shutil import copytree
from types import SimpleNamespace
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.store import fields
from surrofe2.store.fields import (
    DISPLACEMENT_NAME,
    F_DOT_NAME,
    F_NAME,
    POINTS,
    RISK_NAME,
    SOURCE_NAME,
    STRESS_NAME,
    FrameWriter,
    add_to_elements,
    open_fields,
    read_fields,
    write_fields,
    write_point_fields,
    write_series,
)

NODES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
QUADS = np.array([[0, 1, 2, 3]])
FRAME = "frames/fields-{:04d}.h5"


@pytest.fixture
def frames():
    numbers = np.random.default_rng(0)
    return SimpleNamespace(
        t=np.array([0.0, 0.5, 1.0]),
        displacement=numbers.normal(size=(3, 4, 2)),
        velocity=numbers.normal(size=(3, 4, 2)),
        stress=numbers.normal(size=(3, 1, 2, 2)),
        F=numbers.normal(size=(3, 1, 2, 2)),
        F_dot=numbers.normal(size=(3, 1, 2, 2)),
        source=np.array([[0.0], [3.0], [6.0]]),
        risk=np.array([[0.1], [0.0], [0.0]]),
        dissipated=np.array([[0.0], [0.2], [0.3]]),
        beyond=np.array([[0.0], [0.0], [1.0]]),
    )


def test_fields_read_back(tmp_path, frames):
    here = Path.cwd()
    write_fields(tmp_path, NODES, QUADS, frames)
    for factor in (2.0, 1.0):
        add_to_elements(tmp_path, {"swelling": factor * np.arange(1.0, 4.0)[:, None]})
    assert Path.cwd() == here
    files = [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*.*"))]
    of_frames = [FRAME.format(k) for k in range(3)]
    assert files == ["fields-last.xdmf", "fields.h5", "fields.xdmf", *of_frames]
    with meshio.xdmf.TimeSeriesReader(tmp_path / "fields.xdmf") as reader:
        nodes, cells = reader.read_points_cells()
        np.testing.assert_array_equal(nodes[:, :2], NODES)
        np.testing.assert_array_equal(cells[0].data, QUADS)
        assert reader.num_steps == 3
        for k in range(3):
            t, at_nodes, in_quads = reader.read_data(k)
            assert t == frames.t[k]
            u, v = at_nodes["displacement_um"], at_nodes["velocity_um_per_us"]
            np.testing.assert_array_equal(u[:, :2], frames.displacement[k])
            np.testing.assert_array_equal(v[:, :2], frames.velocity[k])
            (dissipated,) = in_quads["dissipated_energy_pJ_per_um2"]
            np.testing.assert_array_equal(dissipated, frames.dissipated[k])
            (stress,) = in_quads["cauchy_stress_uN_per_um"]
            (F,) = in_quads["deformation_gradient"]
            np.testing.assert_array_equal(stress[:, :2, :2], frames.stress[k])
            np.testing.assert_array_equal(F[:, :2, :2], frames.F[k])
            assert (F[:, 2, 2] == 1.0).all()
            assert in_quads["stress_source"][0] == frames.source[k]
            assert in_quads["risk"][0] == frames.risk[k]
            np.testing.assert_array_equal(in_quads["swelling"][0], 1.0 + k)
    read = read_fields(tmp_path, [F_DOT_NAME, F_NAME, DISPLACEMENT_NAME], [STRESS_NAME, "absent"])
    np.testing.assert_array_equal(read.points, NODES)
    np.testing.assert_array_equal(read.cells, QUADS)
    np.testing.assert_array_equal(read.t, frames.t)
    written = {F_DOT_NAME: frames.F_dot, F_NAME: frames.F, STRESS_NAME: frames.stress}
    written |= {DISPLACEMENT_NAME: frames.displacement}
    assert read.values.keys() == written.keys()
    for name, values in written.items():
        np.testing.assert_array_equal(read.values[name], values)


def test_one_grid_a_time_and_no_mesh_beside_them(tmp_path, frames):
    write_fields(tmp_path, NODES, QUADS, frames)
    (domain,) = ElementTree.parse(tmp_path / "fields.xdmf").getroot()
    (series,) = domain
    assert (series.get("GridType"), series.get("CollectionType")) == ("Collection", "Temporal")
    assert [float(grid.find("Time").get("Value")) for grid in series] == frames.t.tolist()
    for k, grid in enumerate(series):
        assert grid.get("GridType") == "Uniform"
        for kind in ("Topology", "Geometry"):
            assert len(grid.findall(kind)) == 1
        for item in grid.iter("DataItem"):
            name, _, inner = item.text.partition(":/")
            assert name == ("fields.h5" if inner in ("cells", "points") else FRAME.format(k))
            with h5py.File(tmp_path / name) as file:
                assert file[inner].shape == tuple(map(int, item.get("Dimensions").split()))
    assert {item.text for item in series.iter("DataItem") if "points" in item.text} == {
        "fields.h5:/points"
    }


def test_invariants_of_known_stresses(tmp_path, frames):
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    frames.stress = (turn @ np.diag([3.0, -1.0]) @ turn.T)[None, None].repeat(3, axis=0)
    write_fields(tmp_path, NODES, QUADS, frames)
    with meshio.xdmf.TimeSeriesReader(tmp_path / "fields.xdmf") as reader:
        reader.read_points_cells()
        _, _, in_quads = reader.read_data(1)
    expected = {"pressure": -1.0, "largest_shear": 2.0, "von_mises": np.sqrt(9.0 + 3.0 + 1.0)}
    for name, value in expected.items():
        np.testing.assert_allclose(in_quads[f"{name}_in_plane_uN_per_um"][0], [value], rtol=1e-13)


def test_points_of_the_law_read_back(tmp_path):
    """A cloud of six points of two elements at two times; what has no points is left out."""
    numbers = np.random.default_rng(1)
    at, t = numbers.normal(size=(6, 2)), np.array([0.0, 2.5])
    tensors = {
        name: numbers.normal(size=(2, 6, 2, 2)) for name in (STRESS_NAME, F_NAME, F_DOT_NAME)
    }
    values = {DISPLACEMENT_NAME: numbers.normal(size=(2, 6, 2)), **tensors}
    values |= {SOURCE_NAME: np.arange(12.0).reshape(2, 6), RISK_NAME: np.empty((2, 0))}
    write_point_fields(tmp_path, at, t, values, per_element=3)
    read = read_fields(tmp_path, (), values, POINTS)
    assert {*read.values} == {DISPLACEMENT_NAME, SOURCE_NAME, *tensors}
    np.testing.assert_array_equal(read.t, t)
    np.testing.assert_array_equal(read.points, at)
    for name, expected in read.values.items():
        np.testing.assert_array_equal(values[name], expected)
    with meshio.xdmf.TimeSeriesReader(tmp_path / "points.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert [(block.type, block.data.tolist()) for block in cells] == [
            ("vertex", [[k] for k in range(6)])
        ]
        time, of_points, _ = reader.read_data(1)
    assert time == 2.5
    np.testing.assert_array_equal(points[:, :2], at)
    np.testing.assert_array_equal(of_points["element"], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(of_points["displacement_um"][:, :2], values[DISPLACEMENT_NAME][1])
    np.testing.assert_array_equal(of_points[SOURCE_NAME], values[SOURCE_NAME][1])


def test_triangles_with_six_nodes(tmp_path):
    nodes = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    write_series(tmp_path, nodes, np.arange(6)[None], np.zeros(1), {}, {})
    with meshio.xdmf.TimeSeriesReader(tmp_path / "fields.xdmf") as reader:
        points, cells = reader.read_points_cells()
    assert (cells[0].type, cells[0].data.tolist()) == ("triangle6", [[0, 1, 2, 3, 4, 5]])
    np.testing.assert_array_equal(points[:, :2], nodes)


def write_frame(writer, k, t, factor=1.0):
    writer.write(k, t, {DISPLACEMENT_NAME: np.full((4, 2), factor * t)}, {RISK_NAME: np.ones(1)})


def series_of(folder):
    """Times that XDMF names, and the displacement of the first node at each."""
    with meshio.xdmf.TimeSeriesReader(folder / "fields.xdmf") as reader:
        reader.read_points_cells()
        steps = [reader.read_data(k) for k in range(reader.num_steps)]
    return {t: float(at_nodes[DISPLACEMENT_NAME][0, 0]) for t, at_nodes, _ in steps}


def test_a_series_under_way_is_read_by_whoever_looks(tmp_path):
    writer = FrameWriter(tmp_path, NODES, QUADS)
    for k in range(3):
        write_frame(writer, k, 0.5 * k)
    writer.flush()
    write_frame(writer, 3, 1.5)  # waits
    assert series_of(tmp_path) == {0.0: 0.0, 0.5: 0.5, 1.0: 1.0}
    assert open_fields(tmp_path).t.tolist() == [0.0, 0.5, 1.0]
    writer.close()
    assert open_fields(tmp_path).t.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert writer.count == 4


def test_many_frames_are_named_now_and_then(tmp_path, monkeypatch):
    """The file that names all frames is written whole: at each frame that would be a square."""
    monkeypatch.setattr(fields, "_MOST_WAITING", 0.0)
    naming = []
    write_text = fields.write_text

    def counted(path, text):
        naming.append(path.name)
        write_text(path, text)

    monkeypatch.setattr(fields, "write_text", counted)
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        for k in range(40):
            write_frame(writer, k, 0.5 * k)
        assert (tmp_path / FRAME.format(39)).exists()
        writer.flush()
        assert [*series_of(tmp_path)] == [0.5 * k for k in range(40)]
        writer._naming._due = 0.0
        write_frame(writer, 40, 20.0)
        assert len(series_of(tmp_path)) == 41
    assert naming.count("fields.xdmf") < 6


def test_a_run_that_goes_back_replaces_what_it_wrote(tmp_path):
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        for k in range(4):
            write_frame(writer, k, 0.5 * k)
        writer.flush()
        write_frame(writer, 4, 2.0)
        write_frame(writer, 2, 1.2)
        assert series_of(tmp_path) == {0.0: 0.0, 0.5: 0.5}  # nothing names what is gone
    assert series_of(tmp_path) == {0.0: 0.0, 0.5: 0.5, 1.2: 1.2}
    assert read_fields(tmp_path, [DISPLACEMENT_NAME]).displacement[:, 0, 0].tolist() == [
        0,
        0.5,
        1.2,
    ]


def test_frames_that_a_checkpoint_counts_stay_until_there_is_another(tmp_path):
    """A run goes back behind its checkpoint, writes some frames anew, and is killed."""
    writer = FrameWriter(tmp_path, NODES, QUADS)
    counted = [0.0, 0.5, 1.0, 1.5]
    for k, t in enumerate(counted):
        write_frame(writer, k, t)
    writer.flush()
    write_frame(writer, 1, 0.5, factor=3.0)
    write_frame(writer, 2, 1.0, factor=3.0)
    writer.flush()
    assert series_of(tmp_path) == {0.0: 0.0, 0.5: 1.5, 1.0: 3.0}
    assert open_fields(tmp_path).t.tolist() == [0.0, 0.5, 1.0]  # at 1.5 is what was taken back
    killed = copytree(tmp_path, tmp_path / "killed")

    writer.remove_surplus()
    assert not (tmp_path / FRAME.format(3)).exists()
    assert (tmp_path / FRAME.format(2)).exists()

    again = FrameWriter(killed, NODES, QUADS)
    again.resume(counted)
    write_frame(again, 1, 0.5, factor=3.0)
    again.close()
    assert series_of(killed) == {0.0: 0.0, 0.5: 1.5}
    assert (killed / FRAME.format(3)).exists()  # the checkpoint that was resumed counts it still


def test_frames_of_others_stay(tmp_path):
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        for k in range(3):
            write_frame(writer, k, 0.5 * k)
    for name in ("fields-notes.h5", "movie-0001.h5"):
        (tmp_path / "frames" / name).touch()
    FrameWriter(tmp_path, NODES, QUADS).resume([0.0])
    there = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert there == ["fields-0000.h5", "fields-notes.h5", "movie-0001.h5"]


def test_a_series_is_continued_behind_its_frames(tmp_path):
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        for k in range(5):
            write_frame(writer, k, 0.5 * k)
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        writer.resume([0.0, 0.5])
        assert series_of(tmp_path) == {0.0: 0.0, 0.5: 0.5}
        assert open_fields(tmp_path).count == 2
        write_frame(writer, 2, 1.0, factor=3.0)
    assert series_of(tmp_path) == {0.0: 0.0, 0.5: 0.5, 1.0: 3.0}
    (tmp_path / FRAME.format(1)).unlink()
    with pytest.raises(FileError, match=r"fields-0001\.h5: no such file; start over with --fresh"):
        FrameWriter(tmp_path, NODES, QUADS).resume([0.0, 0.5, 1.0])


@pytest.mark.parametrize("damage", ["cut", "changed", "missing"])
def test_a_damaged_frame_is_refused(tmp_path, damage):
    with FrameWriter(tmp_path, NODES, QUADS) as writer:
        for k in range(3):
            write_frame(writer, k, 0.5 * k)
    path = tmp_path / FRAME.format(1)
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(content[:-10] if damage == "cut" else content[:-10] + bytes(10)[:9] + b"x")
    with pytest.raises(FileError, match=r"fields-0001\.h5"):
        read_fields(tmp_path, [DISPLACEMENT_NAME])


def test_a_frame_is_written_as_hdf5_writes_it(tmp_path, frames):
    """Only the numbers of a frame are replaced in what was made once."""
    write_fields(tmp_path, NODES, QUADS, frames)
    for k in range(3):
        with h5py.File(tmp_path / FRAME.format(k)) as file:
            np.testing.assert_array_equal(file[STRESS_NAME][:, :2, :2], frames.stress[k])
            assert file["t"][0] == frames.t[k]


def test_one_frame_is_read_by_programs_that_know_no_time(tmp_path, frames):
    """meshio.read ends the interpreter where it cannot read a file; of a run under way, too."""
    writer = FrameWriter(tmp_path, NODES, QUADS)
    for k in range(2):
        write_frame(writer, k, 0.5 + k)
    writer.flush()
    code = (
        "import meshio; mesh = meshio.read('fields-last.xdmf'); "
        "print(mesh.points.shape, float(mesh.point_data['displacement_um'][0, 0]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, "(4, 3) 1.5"), done.stderr
