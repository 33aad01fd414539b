"""Data sets: what they hold, how they survive a kill, what they refuse."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.metadata import version

import h5py
import numpy as np
import pytest

from surrofe2.base import interruption
from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.base.sampling import SEQUENCE, sample
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import Status, describe
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store import samples, store
from surrofe2.store.hdf5 import ANY, reading, write_checkpoint, writing
from surrofe2.store.samples import (
    DATA_SET,
    HarvestWriter,
    read_data_set,
    read_harvest,
    writing_data_set,
)
from tests.laws import SoftLaw
from tests.store.small_data_set import HEADER, RANGE, append_chunk, write_all


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
    assert (attributes["schema"], attributes["schema_version"]) == ("surrofe2-data-set", 2)
    assert attributes["status"] == "finished"
    assert attributes["package_version"] == version("surrofe2")
    assert attributes["cell_fingerprint"] == HEADER.cell.fingerprint
    assert json.loads(attributes["recipe"]) == HEADER.recipe
    assert json.loads(attributes["rve"])["tolerance"] == 1e-8


class Interrupting:
    """Ctrl-C while it is copied."""

    def __array__(self, *_, **__):
        raise KeyboardInterrupt


def test_rows_are_taken_whole_or_not_at_all(tmp_path):
    path, law = tmp_path / "cells.h5", SoftLaw(fails_above=1.03)
    F, F_dot = sample(RANGE, 8, 3, start=8)
    with writing_data_set(path, HEADER) as data:
        append_chunk(data, law)
        with pytest.raises(KeyboardInterrupt):
            data.append(F, F_dot, replace(law.respond(F, F_dot), stress=Interrupting()))
    write_all(path)
    write_all(tmp_path / "whole.h5")
    assert read_data_set(path).fingerprint == read_data_set(tmp_path / "whole.h5").fingerprint


def test_a_file_can_be_written_while_one_that_was_interrupted_is_open(tmp_path):
    path = tmp_path / "cells.h5"
    interrupted = writing(path, ANY, {})
    interrupted.__enter__()
    write_all(path)
    assert len(read_data_set(path).F) == HEADER.count


def test_an_interruption_waits_while_hdf5_is_at_work(tmp_path):
    path = tmp_path / "a.h5"
    with writing(path, ANY, {}) as file:
        assert interruption._state.held
        file["x"] = 1.0
    assert not interruption._state.held
    with reading(path):
        assert interruption._state.held
    assert not interruption._state.held


def test_answers_are_harvested_whole_or_not_at_all(tmp_path):
    writer = HarvestWriter(tmp_path / "harvest.h5", HEADER)
    F, F_dot = sample(RANGE, 8, 3)
    codes = np.zeros(8, np.int8)
    writer(F, F_dot, F, codes, codes)
    with pytest.raises(KeyboardInterrupt):
        writer(F, F_dot, F, Interrupting(), codes)
    writer.flush()
    np.testing.assert_array_equal(read_harvest(tmp_path / "harvest.h5").F, F)


def test_every_moment_of_writing_leaves_a_file_to_continue(tmp_path):
    """The file as the disk has it after each writing is copied, continued and compared."""
    path, whole = tmp_path / "cells.h5", tmp_path / "whole.h5"
    write_all(whole)
    copies = []
    with writing_data_set(path, HEADER) as data:
        for k in range(3):
            copies.append(tmp_path / f"copy{k}.h5")
            copies[-1].write_bytes(path.read_bytes())
            append_chunk(data, SoftLaw(fails_above=1.03))
            data.store()
    for k, copy in enumerate(copies):
        with writing_data_set(copy, HEADER) as data:
            assert data.completed == 8 * k
            while data.completed < HEADER.count:
                append_chunk(data, SoftLaw(fails_above=1.03))
            data.finish()
        assert read_data_set(copy).fingerprint == read_data_set(whole).fingerprint


def test_unfinished_is_not_sealed(tmp_path):
    path = tmp_path / "cells.h5"
    with writing_data_set(path, HEADER) as data:
        append_chunk(data, SoftLaw())
        with pytest.raises(InputError, match="12 samples are missing; it cannot be finished"):
            data.finish()


def test_points_of_another_sequence_are_not_gone_on_with(tmp_path, monkeypatch):
    path = tmp_path / "cells.h5"
    with monkeypatch.context() as before:
        before.setattr(samples, "SEQUENCE", "Sobol")
        write_all(path)
    told = f"samples.sequence: this call has {SEQUENCE}, what is there Sobol"
    with pytest.raises(MismatchError, match=told), writing_data_set(path, HEADER):
        pass
    with writing_data_set(path, HEADER, fresh=True) as data:
        assert data.completed == 0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 4}, "samples.seed: this call has 4, what is there 3"),
        ({"cell": CellParameters(viscosity=0.2)}, "cell.viscosity: this call has 0.2, what is th"),
        ({"range": replace(RANGE, shear=0.04)}, "range.shear: this call has 0.04, what is there 0"),
        ({"version": "9"}, "surrofe2.version: this call has 9, what is there 0.1.0"),
    ],
)
def test_a_data_set_of_another_recipe_is_refused(tmp_path, change, told):
    path = tmp_path / "cells.h5"
    with writing_data_set(path, HEADER):
        pass
    other = replace(HEADER, **change)
    with pytest.raises(MismatchError) as caught, writing_data_set(path, other):
        pass
    assert str(caught.value).startswith(f"{path}: {told}")


def test_what_is_no_data_set(tmp_path):
    path = tmp_path / "cells.h5"
    for write, told in (
        (lambda: None, "cannot be read: No such file or directory"),
        (lambda: path.write_text("F = 1"), "not an HDF5 file"),
        (lambda: write_checkpoint(path, {}, "a run"), "an HDF5 file, but not a surrofe2 data set"),
        (lambda: h5py.File(path, "w").close(), "no SHA-256 in it; it is damaged, foreign or older"),
    ):
        write()
        with pytest.raises(FileError) as caught:
            read_data_set(path)
        assert str(caught.value) == f"{path}: {told}"


def test_every_changed_byte_is_seen(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    content = path.read_bytes()
    for place in np.random.default_rng(0).integers(len(content), size=200):
        changed = bytearray(content)
        changed[place] ^= 1
        path.write_bytes(changed)
        with pytest.raises(FileError) as caught:
            read_data_set(path)
        assert str(path) in str(caught.value)


def test_later_schema(tmp_path, monkeypatch):
    path = tmp_path / "cells.h5"
    with monkeypatch.context() as later:
        later.setattr(samples, "DATA_SET", replace(samples.DATA_SET, version=3))
        write_all(path)
    with pytest.raises(FileError, match="data set schema 3; this surrofe2 reads 2"):
        read_data_set(path)


def test_a_sealed_name_that_is_no_utf8_is_damage(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    content = path.read_bytes().replace(b"stress\0", b"str\xffss\0")
    begin, end = store._place(content)
    path.write_bytes(store.sealed(content[:begin] + store.NO_DIGEST.encode() + content[end:]))
    with pytest.raises(FileError, match="not a whole surrofe2 data set"):
        read_data_set(path)


def test_numbers_in_other_units_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "cells.h5"
    with monkeypatch.context() as other:
        columns = DATA_SET.columns | {"stress": replace(DATA_SET.columns["stress"], unit="Pa")}
        other.setattr(samples, "DATA_SET", replace(DATA_SET, columns=columns))
        write_all(path)
    with pytest.raises(FileError, match="stress: in units 'Pa'; they must be 'µN/µm'"):
        read_data_set(path)


def test_a_data_set_with_the_fingerprint_of_another_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "cells.h5"
    with monkeypatch.context() as other:
        other.setattr(StressSamples, "fingerprint", "0" * 16)
        write_all(path)
    with pytest.raises(FileError, match="fingerprint: not that of its samples"):
        read_data_set(path)


@pytest.mark.parametrize("content", ["F = 1", "surrofe2-harvest"])
def test_starting_over_replaces_no_file_of_another_kind(tmp_path, content):
    path = tmp_path / "cells.h5"
    path.write_text(content)
    with (
        pytest.raises(FileError, match="so --fresh does not replace it"),
        writing_data_set(path, HEADER, fresh=True),
    ):
        pass
    assert path.read_text() == content


@pytest.mark.parametrize("kind", ["external", "virtual"])
@pytest.mark.parametrize("name", ["F", "of/no/schema"])
def test_numbers_in_other_files_are_refused(tmp_path, kind, name):
    (tmp_path / "elsewhere").write_bytes(bytes(32))
    with writing(tmp_path / "a.h5", DATA_SET, {}) as file:
        if kind == "external":
            file.create_dataset(name, (4,), float, external=[(str(tmp_path / "elsewhere"), 0, 32)])
        else:
            layout = h5py.VirtualLayout((4,), float)
            layout[:] = h5py.VirtualSource(tmp_path / "elsewhere", "F", (4,))
            file.create_virtual_dataset(name, layout)
    with (
        pytest.raises(FileError, match=f"{name}: its numbers are in other files"),
        reading(tmp_path / "a.h5", DATA_SET),
    ):
        pass
