"""Tables and harvests in files: what they hold, what they refuse, what a kill leaves."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from surrofe2.errors import FileError, MismatchError
from surrofe2.io.harvest import (
    CHUNK,
    HarvestWriter,
    check_harvest,
    read_harvest,
)
from surrofe2.io.provenance import Origin
from surrofe2.io.tables import check_table, read_table, stored, write_table
from surrofe2.plant_cell.parameters import CellParameters
from tests.cache.tables import make, states, taught

CELL = CellParameters()
HEADER = Origin(
    cell=CELL,
    rve={"initialisation": "constrained-runs", "tolerance": 1e-8},
    recipe={"recipe": "recipe.toml"},
)


@pytest.fixture
def table_file(tmp_path):
    path = tmp_path / "table.h5"
    write_table(path, stored(taught(*states(30)), {"recipe": "recipe.toml"}))
    return path


def test_a_table_comes_back_and_answers_the_same(table_file):
    table = taught(*states(30))
    there = read_table(table_file)
    again = make()
    again.restore(there.records)
    new = states(200, angle=0.1)
    for a, b in zip(table.lookup(*new), again.lookup(*new), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (there.tolerance, there.spread) == (table.tolerance, table.stress_spread)
    assert (there.cell, there.range) == (table.cell, table.range)
    assert there.recipe == {"recipe": "recipe.toml"}


def test_a_tables_file_says_what_it_is_of(table_file):
    with h5py.File(table_file) as file:
        assert file["stress"].attrs["unit"] == "µN/µm"
        assert file.attrs["cell_fingerprint"] == CELL.fingerprint
        assert file.attrs["initialisation"] == "constrained-runs"
        assert json.loads(file.attrs["recipe"]) == {"recipe": "recipe.toml"}
        assert file.attrs["package_version"]


@pytest.mark.parametrize("what", ["nan", "cut", "cell", "foreign", "later"])
def test_a_damaged_table_is_refused(table_file, what):
    with h5py.File(table_file, "r+") as file:
        if what == "nan":
            file["slope"][0, 0, 0] = np.nan
        elif what == "cut":
            del file["stress"]
            file["stress"] = np.zeros((1, 4))
        elif what == "cell":
            file.attrs["cell_fingerprint"] = "0" * 16
        elif what == "foreign":
            file.attrs["schema"] = "surrofe2-data-set"
        else:
            file.attrs["schema_version"] = 99
    with pytest.raises(FileError) as error:
        read_table(table_file)
    assert "\n" not in str(error.value)


def test_a_table_of_other_parameters_is_refused(table_file):
    there = read_table(table_file)
    with pytest.raises(MismatchError, match=r"a table for cell\.viscosity = 0\.1, not 0\.2"):
        check_table(table_file, there, CellParameters(viscosity=0.2), "constrained-runs")
    with pytest.raises(MismatchError, match="initialisation constrained-runs, not elastic"):
        check_table(table_file, there, CELL, "elastic")
    check_table(table_file, there, CELL, "constrained-runs")


def answers(count, start=0.0):
    F = np.tile(np.eye(2), (count, 1, 1))
    F[:, 0, 1] = start + np.arange(count)
    status = np.zeros(count, dtype=np.int8)
    return F, 2.0 * F, 3.0 * F, status, status + 1


def test_a_harvest_comes_back_each_state_once(tmp_path):
    path = tmp_path / "harvest.h5"
    writer = HarvestWriter(path, HEADER)
    writer(*answers(3))
    assert not path.exists()
    writer.flush()
    writer(*answers(3))
    writer(*answers(2, start=3.0))
    writer.flush()
    writer.flush()
    there = read_harvest(path)
    F, F_dot, stress, status, why = answers(5)
    for name, values in (("F", F), ("F_dot", F_dot), ("stress", stress), ("status", status)):
        np.testing.assert_array_equal(getattr(there, name), values)
    np.testing.assert_array_equal(there.why, why)
    assert (there.cell, there.initialisation) == (CELL, "constrained-runs")


def test_a_harvest_grows_and_is_continued(tmp_path):
    path = tmp_path / "harvest.h5"
    writer = HarvestWriter(path, HEADER)
    for k in range(5):
        writer(*answers(CHUNK - 1, start=1.0 * k * CHUNK))
    writer.flush()
    again = HarvestWriter(path, HEADER)
    again(*answers(7, start=-7.0))
    again.flush()
    there = read_harvest(path)
    assert len(there.F) == 5 * (CHUNK - 1) + 7
    np.testing.assert_array_equal(there.stress, 3.0 * there.F)
    with h5py.File(path) as file:
        assert file["F"].attrs["unit"] == "1"
        assert file["stress"].attrs["unit"] == "µN/µm"
        assert "audit" in json.loads(file["why"].attrs["meaning"])["1"]


def test_every_moment_of_harvesting_leaves_a_whole_file(tmp_path, monkeypatch):
    """The file as the disk has it after each flush holds the rows before or after, all sound."""
    path, copies = tmp_path / "harvest.h5", []
    flush = h5py.File.flush

    def flush_and_copy(file):
        flush(file)
        copies.append(path.read_bytes())

    writer = HarvestWriter(path, HEADER)
    writer(*answers(10))
    writer.flush()
    monkeypatch.setattr(h5py.File, "flush", flush_and_copy)
    writer(*answers(5, start=10.0))
    writer.flush()
    assert len(copies) == 2
    monkeypatch.undo()
    for copy, count in zip(copies, (10, 15), strict=True):
        (tmp_path / "copy.h5").write_bytes(copy)
        there = read_harvest(tmp_path / "copy.h5")
        assert len(there.F) == count
        np.testing.assert_array_equal(there.stress, 3.0 * there.F)


def test_a_harvest_of_other_parameters_is_not_continued_or_added(tmp_path):
    path = tmp_path / "harvest.h5"
    writer = HarvestWriter(path, HEADER)
    writer(*answers(3))
    writer.flush()
    water = replace(HEADER, cell=CellParameters.preset("water"))
    with pytest.raises(MismatchError, match=r"harvested for cell\.fluid_particle_mass = 2\.7"):
        HarvestWriter(path, water)
    with pytest.raises(MismatchError, match="initialisation constrained-runs, not elastic"):
        check_harvest(path, read_harvest(path), CELL, "elastic")


@pytest.mark.parametrize("schema", ["surrofe2-table", None])
def test_what_is_no_harvest(tmp_path, schema):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        if schema:
            file.attrs["schema"] = schema
    with pytest.raises(FileError, match="not a surrofe2 harvest"):
        read_harvest(path)
