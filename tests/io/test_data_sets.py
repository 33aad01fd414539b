"""Data sets: what they hold, how they survive a kill, what they refuse."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from surrofe2.errors import FileError, InputError, MismatchError
from surrofe2.io.data_sets import (
    finish_data_set,
    read_data_set,
    writing_data_set,
)
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, sample
from surrofe2.stress_law import Status, describe
from tests.io.small_data_set import HEADER, RANGE, append_chunk, write_all
from tests.laws import SoftLaw


def test_what_was_written_is_read(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    samples = read_data_set(path)
    F, F_dot = sample(RANGE, 20, 3)
    np.testing.assert_array_equal(samples.F, F)
    np.testing.assert_array_equal(samples.F_dot, F_dot)
    np.testing.assert_array_equal(
        samples.stress, SoftLaw(fails_above=1.03).respond(F, F_dot).stress
    )
    assert samples.cell == HEADER.cell
    assert samples.range == RANGE
    assert (samples.seed, samples.initialisation) == (3, "constrained-runs")
    assert samples.rest_length == 1.5


def test_schema(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    with h5py.File(path) as file:
        units = {name: file[name].attrs["unit"] for name in ("F", "F_dot", "stress")}
        assert units == {"F": "1", "F_dot": "1/µs", "stress": "µN/µm"}
        status = file["status"][:]
        assert status.dtype == np.int8
        assert 0 < (status != 0).sum() < 20
        np.testing.assert_array_equal(file["failed/index"][:], np.flatnonzero(status))
        assert set(file["failed/reason"].asstr()[:]) == {describe(Status.NOT_CONVERGED)}
        assert np.isnan(file["stress"][:][status != 0]).all()
        attributes = dict(file.attrs)
    assert (attributes["schema"], attributes["schema_version"]) == ("surrofe2-data-set", 1)
    assert attributes["status"] == "finished"
    assert attributes["package_version"] == "0.1.0"
    assert attributes["cell_fingerprint"] == HEADER.cell.fingerprint
    assert json.loads(attributes["recipe"]) == HEADER.recipe
    assert json.loads(attributes["rve"])["tolerance"] == 1e-8


def test_every_moment_of_writing_leaves_a_file_to_continue(tmp_path, monkeypatch):
    """The file as the disk has it after each flush is copied, continued and compared."""
    path, whole = tmp_path / "cells.h5", tmp_path / "whole.h5"
    write_all(whole)
    copies = []
    flush = h5py.File.flush

    def flush_and_copy(file):
        flush(file)
        copies.append(tmp_path / f"copy{len(copies)}.h5")
        copies[-1].write_bytes(path.read_bytes())

    monkeypatch.setattr(h5py.File, "flush", flush_and_copy)
    with writing_data_set(path, HEADER) as data:
        append_chunk(data, SoftLaw(fails_above=1.03))
        append_chunk(data, SoftLaw(fails_above=1.03))
    monkeypatch.undo()
    assert len(copies) == 4
    for copy in copies:
        with writing_data_set(copy, HEADER) as data:
            assert data.completed in (0, 8, 16)
            while data.completed < HEADER.count:
                append_chunk(data, SoftLaw(fails_above=1.03))
        finish_data_set(copy)
        assert read_data_set(copy).fingerprint == read_data_set(whole).fingerprint


def test_unfinished_is_not_read(tmp_path):
    path = tmp_path / "cells.h5"
    with writing_data_set(path, HEADER) as data:
        append_chunk(data, SoftLaw())
    with pytest.raises(InputError) as caught:
        read_data_set(path)
    assert str(caught.value) == (
        f"{path}: unfinished, 8 of 20 samples; continue it with `surrofe2 generate RECIPE`"
    )


def test_unfinished_is_not_sealed(tmp_path):
    path = tmp_path / "cells.h5"
    with writing_data_set(path, HEADER):
        pass
    with pytest.raises(InputError, match="20 samples are missing; it cannot be finished"):
        finish_data_set(path)


def test_a_finished_file_is_kept_unless_fresh(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    before = path.read_bytes()
    with writing_data_set(path, HEADER) as data:
        assert data.completed == HEADER.count
    assert path.read_bytes() == before
    with writing_data_set(path, HEADER, fresh=True) as data:
        assert data.completed == 0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 4}, "samples.seed: this call has 4, what is there 3"),
        (
            {"cell": CellParameters(viscosity=0.2)},
            "cell.viscosity: this call has 0.2, what is there 0.1",
        ),
        (
            {"range": SamplingRange(stretch=(0.95, 1.05), shear=0.04, rate=0.01)},
            "range.shear: this call has 0.04, what is there 0.05",
        ),
        ({"version": "9"}, "surrofe2.version: this call has 9, what is there 0.1.0"),
    ],
)
def test_a_data_set_of_another_recipe_is_refused(tmp_path, change, told):
    path = tmp_path / "cells.h5"
    with writing_data_set(path, HEADER):
        pass
    with (
        pytest.raises(MismatchError) as caught,
        writing_data_set(path, replace(HEADER, **change)),
    ):
        pass
    assert str(caught.value) == (
        f"{path}: {told}; change it back, write elsewhere or start over with --fresh"
    )


def test_truncated(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(FileError) as caught:
        read_data_set(path)
    assert str(caught.value) == f"{path}: truncated HDF5 file; write it anew"


def test_foreign_hdf5(tmp_path):
    path = tmp_path / "cells.h5"
    with h5py.File(path, "w") as file:
        file["F"] = np.zeros(3)
    with pytest.raises(FileError) as caught:
        read_data_set(path)
    assert str(caught.value) == f"{path}: an HDF5 file, but not a surrofe2 data set"


def test_not_hdf5(tmp_path):
    path = tmp_path / "cells.h5"
    path.write_text("F = 1")
    with pytest.raises(FileError) as caught:
        read_data_set(path)
    assert str(caught.value) == f"{path}: not an HDF5 file"


def test_missing(tmp_path):
    path = tmp_path / "cells.h5"
    with pytest.raises(FileError) as caught:
        read_data_set(path)
    assert str(caught.value) == f"{path}: cannot be read: No such file or directory"


def test_changed_numbers(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    with h5py.File(path, "r+") as file:
        file["stress"][0, 0, 0] += 1e-12
    with pytest.raises(FileError, match="its numbers changed since it was written"):
        read_data_set(path)


def test_later_schema(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = 2
    with pytest.raises(FileError, match="data set schema 2; this surrofe2 reads 1"):
        read_data_set(path)


def test_no_write_permission(unwritable):
    path = unwritable / "cells.h5"
    with pytest.raises(FileError) as caught, writing_data_set(path, HEADER):
        pass
    assert str(caught.value) == f"{path}: cannot be written: Not a directory"
