"""Run folders: round trips, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.store.run_folder import (
    open_run_folder,
    read_curve,
    read_record,
    read_run,
    write_curve,
    write_energies,
    write_record,
)
from surrofe2.store.store import read_json, write_json
from tests.run_records import finished_record


@pytest.fixture
def record(recipe):
    wall_time = {"total": 3.0, "law": 2.0, "macro": 1.0}
    return finished_record(recipe, "rve", wall_time, {"stress_points": 80})


@pytest.fixture
def curve():
    t = np.linspace(0.0, 4.0, 9)
    return DisplacementCurve(t, np.stack([0.1 * t, -np.sqrt(t)], axis=1))


def test_record_comes_back(tmp_path, record):
    write_record(tmp_path, record)
    assert read_record(tmp_path) == record


def test_curve_comes_back_to_the_last_bit(tmp_path, curve):
    write_curve(tmp_path, curve)
    back = read_curve(tmp_path)
    np.testing.assert_array_equal(back.t, curve.t)
    np.testing.assert_array_equal(back.displacement, curve.displacement)
    assert (tmp_path / "curve.csv").read_text().splitlines()[0] == "t_us,u_x_um,u_y_um"


def test_energies_name_their_units(tmp_path):
    write_energies(tmp_path, np.array([0.0, 1.0]), {"kinetic": np.array([0.0, 2.5])})
    assert (tmp_path / "energies.csv").read_text() == "t_us,kinetic_pJ\n0.0,0.0\n1.0,2.5\n"


def test_a_record_names_files_of_its_folder_alone(tmp_path, record, curve):
    write_curve(tmp_path, curve)
    write_record(tmp_path, record)
    entries = read_json(tmp_path / "run.json")
    write_json(tmp_path / "run.json", entries | {"files": {"/dev/zero": "0"}})
    with pytest.raises(FileError, match="'/dev/zero' is no file of a run"):
        read_run(tmp_path)


def test_fresh_replaces_the_run_and_nothing_else(tmp_path, record, curve):
    folder = tmp_path / "run"
    write_curve(folder, curve)
    (folder / "notes.txt").write_text("mine")
    assert open_run_folder(folder, replace(record, status="running"), fresh=True) is None
    assert sorted(path.name for path in folder.iterdir()) == ["notes.txt", "run.json"]


def test_the_same_run_gives_its_earlier_record(tmp_path, record):
    write_record(tmp_path, replace(record, status="interrupted"))
    (tmp_path / "checkpoint.h5").touch()
    earlier = open_run_folder(tmp_path, replace(record, threads=1))
    assert earlier == replace(record, status="interrupted")


def test_a_run_without_a_checkpoint_starts_with_nothing_of_another(tmp_path, record, curve):
    folder = tmp_path / "run"
    write_curve(folder, curve)
    write_record(folder, replace(record, status="interrupted"))
    (folder / "harvest-skin.h5").touch()
    assert open_run_folder(folder, replace(record, status="running")) is None
    assert [path.name for path in folder.iterdir()] == ["run.json"]
    assert read_record(folder).status == "running"


def test_unfinished_run_is_not_read(tmp_path, record, curve):
    write_record(tmp_path, replace(record, status="interrupted"))
    write_curve(tmp_path, curve)
    with pytest.raises(InputError) as caught:
        read_run(tmp_path)
    assert str(caught.value) == f"{tmp_path}: the run is interrupted; its command goes on with it"


def test_foreign_record(tmp_path):
    write_json(tmp_path / "run.json", {})
    with pytest.raises(FileError) as caught:
        read_record(tmp_path)
    assert str(caught.value) == f"{tmp_path / 'run.json'}: not the record of a surrofe2 run"


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "t_us,u_x_um,u_y_um\n1,2\n", "t_us,u_x_um,u_y_um\n1,x,3\n"]
)
def test_damaged_curve(tmp_path, text):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(FileError) as caught:
        read_curve(tmp_path)
    path = tmp_path / "curve.csv"
    assert str(caught.value) == f"{path}: not a table of t_us,u_x_um,u_y_um"


def test_a_run_of_a_bar_from_earlier_versions_is_the_one_of_today():
    """Its record has [load] and the elements in [macro]."""
    data = Path(__file__).parents[2] / "data"
    earlier, now = read_record(data / "large-bar-true").recipe, load_recipe(data / "large-bar.toml")
    assert "load" not in earlier
    for name in ("conditions", "bodies", "watch"):
        assert earlier[name] == now.to_dict()[name]
    assert earlier["mesh"]["elements"] == list(now.stated.mesh.elements)
    assert earlier["time"]["duration"] == now.duration
