from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from surrofe2.errors import FileError
from surrofe2.io.fields import write_fields

NODES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
QUADS = np.array([[0, 1, 2, 3]])


@pytest.fixture
def frames():
    numbers = np.random.default_rng(0)
    return SimpleNamespace(
        t=np.array([0.0, 0.5, 1.0]),
        displacement=numbers.normal(size=(3, 4, 2)),
        velocity=numbers.normal(size=(3, 4, 2)),
        stress=numbers.normal(size=(3, 1, 2, 2)),
        F=numbers.normal(size=(3, 1, 2, 2)),
    )


def test_fields_read_back(tmp_path, frames):
    here = Path.cwd()
    write_fields(tmp_path, NODES, QUADS, frames)
    assert Path.cwd() == here
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fields.h5", "fields.xdmf"]
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
            (stress,) = in_quads["cauchy_stress_uN_per_um"]
            (F,) = in_quads["deformation_gradient"]
            np.testing.assert_array_equal(stress[:, :2, :2], frames.stress[k])
            np.testing.assert_array_equal(F[:, :2, :2], frames.F[k])
            assert (F[:, 2, 2] == 1.0).all()


def test_no_write_permission(unwritable, frames):
    with pytest.raises(FileError) as caught:
        write_fields(unwritable, NODES, QUADS, frames)
    assert str(caught.value) == f"{unwritable / 'fields.h5'}: cannot be written: Not a directory"
