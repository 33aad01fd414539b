"""Tables and harvests in files: what they hold, what they refuse, what a kill leaves."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import FileError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store import tables
from surrofe2.store.hdf5 import origin
from surrofe2.store.samples import HarvestWriter, read_harvest
from surrofe2.store.tables import TABLE, check_table, read_table, write_table
from tests.cache.tables import make, states, taught

CELL = CellParameters()
HEADER = origin(CELL, "constrained-runs", rve={}, recipe={"recipe": "recipe.toml"})


@pytest.fixture
def table_file(tmp_path):
    path = tmp_path / "table.h5"
    write_table(path, taught(*states(30)), {"recipe": "recipe.toml"})
    return path


def test_a_table_comes_back_and_answers_the_same(table_file):
    table = taught(*states(30))
    there = read_table(table_file)
    again = make()
    again.restore(there.records)
    new = states(200, angle=0.1)
    for a, b in zip(table.lookup(*new), again.lookup(*new), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (there.tolerance, there.stress_spread) == (table.tolerance, table.stress_spread)
    assert (there.cell, there.range) == (table.cell, table.range)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda records: records._replace(slope=records.slope * np.nan), TABLE),
        (lambda records: records._replace(stress=records.stress[:1]), TABLE),
        (lambda records: records, replace(TABLE, name="data set")),
        (lambda records: records, replace(TABLE, version=99)),
    ],
    ids=["nan", "cut", "foreign", "later"],
)
def test_a_damaged_table_is_refused(table_file, monkeypatch, change, kind):
    there = read_table(table_file)
    with monkeypatch.context() as other:
        other.setattr(tables, "TABLE", kind)
        write_table(table_file, replace(there, records=change(there.records)), {})
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


def test_a_harvest_goes_on_from_what_it_held(tmp_path):
    writer = HarvestWriter(tmp_path / "harvest.h5", HEADER)
    writer(*answers(3))
    held = {name: values.copy() for name, values in writer.to_arrays().items()}
    writer(*answers(4, start=9.0))
    writer.flush()
    again = HarvestWriter(tmp_path / "harvest.h5", HEADER)
    again.restore(held)
    again.flush()
    np.testing.assert_array_equal(read_harvest(again.path).F, answers(3)[0])
    again(*answers(2, start=3.0))
    again.flush()
    np.testing.assert_array_equal(read_harvest(again.path).F, answers(5)[0])
