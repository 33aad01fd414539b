"""Data sets: what they hold, how they survive a kill, what they refuse."""

import json
from dataclasses import replace
from importlib.metadata import version

import h5py
import numpy as np
import pytest

from surrofe2.base import interruption
from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.base.sampling import SEQUENCE, sample
from surrofe2.law.stress_law import Status, StressResponse, Tangents, describe
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store import samples, store
from surrofe2.store.hdf5 import ANY, read, reading, write, writing
from surrofe2.store.run_folder import STATE
from surrofe2.store.samples import (
    DATA_SET,
    HarvestWriter,
    read_data_set,
    read_harvest,
    writing_data_set,
)
from tests.laws import SoftLaw
from tests.store.small_data_set import HEADER, RANGE, append_chunk, write_all


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cells.h5"


def test_what_was_written_is_read(path):
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
    assert samples.P_by_F is samples.P_by_F_dot is None


def test_schema(path):
    write_all(path)
    with h5py.File(path) as file:
        units = {name: file[name].attrs["unit"] for name in ("F", "F_dot", "stress")}
        assert units == {"F": "1", "F_dot": "1/µs", "stress": "µN/µm"}
        status = file["status"][:]
        assert status.dtype == np.int8
        assert 0 < (status != 0).sum() < 20
        reasons = json.loads(file["status"].attrs["meaning"])
        assert {reasons[str(code)] for code in status if code} == {describe(Status.NOT_CONVERGED)}
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


def test_a_file_can_be_written_while_one_that_was_interrupted_is_open(path):
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
    with reading(path, ANY):
        assert interruption._state.held
    assert not interruption._state.held


def test_answers_are_harvested_whole_or_not_at_all(tmp_path):
    writer = HarvestWriter(tmp_path / "harvest.h5", HEADER.entries())
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


def test_points_of_another_sequence_are_not_gone_on_with(path, monkeypatch):
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
        ({"tangents": True}, "samples.tangents: this call has True, what is there False"),
        ({"version": "9"}, "surrofe2.version: this call has 9, what is there 0.1.0"),
    ],
)
def test_a_data_set_of_another_recipe_is_refused(path, change, told):
    with writing_data_set(path, HEADER):
        pass
    other = replace(HEADER, **change)
    with pytest.raises(MismatchError) as caught, writing_data_set(path, other):
        pass
    assert str(caught.value).startswith(f"{path}: {told}")


def test_what_is_no_data_set(path):
    for make, told in (
        (lambda: None, "cannot be read: No such file or directory"),
        (lambda: path.write_text("F = 1"), "not an HDF5 file"),
        (lambda: write(path, ANY, {}, {}), "an HDF5 file, but not a surrofe2 data set"),
        (lambda: h5py.File(path, "w").close(), "no SHA-256 in it; it is damaged, foreign or older"),
    ):
        make()
        with pytest.raises(FileError) as caught:
            read_data_set(path)
        assert str(caught.value) == f"{path}: {told}"


def test_a_sealed_name_that_is_no_utf8_is_damage(path):
    write_all(path)
    content = path.read_bytes().replace(b"stress\0", b"str\xffss\0")
    begin, end = store._place(content)
    path.write_bytes(store.sealed(content[:begin] + store.NO_DIGEST.encode() + content[end:]))
    with pytest.raises(FileError, match="not a whole surrofe2 data set"):
        read_data_set(path)


def test_numbers_in_other_units_are_refused(path, monkeypatch):
    with monkeypatch.context() as other:
        columns = DATA_SET.columns | {"stress": replace(DATA_SET.columns["stress"], unit="Pa")}
        other.setattr(samples, "DATA_SET", replace(DATA_SET, columns=columns))
        write_all(path)
    with pytest.raises(FileError, match="stress: in units 'Pa'; they must be 'µN/µm'"):
        read_data_set(path)


@pytest.mark.parametrize("kind", ["external", "virtual", "link"])
@pytest.mark.parametrize("name", ["F", "of/no/schema"])
def test_numbers_in_other_files_are_refused(tmp_path, kind, name):
    (tmp_path / "elsewhere").write_bytes(bytes(32))
    with writing(tmp_path / "a.h5", DATA_SET, {}) as file:
        if kind == "external":
            file.create_dataset(name, (4,), float, external=[(str(tmp_path / "elsewhere"), 0, 32)])
        elif kind == "link":
            file[name] = h5py.ExternalLink(str(tmp_path / "elsewhere"), "F")
        else:
            layout = h5py.VirtualLayout((4,), float)
            layout[:] = h5py.VirtualSource(tmp_path / "elsewhere", "F", (4,))
            file.create_virtual_dataset(name, layout)
    with (
        pytest.raises(FileError, match=f"{name}: .*; (they|it) must be in this one"),
        reading(tmp_path / "a.h5", DATA_SET),
    ):
        pass


def test_arrays_come_back_as_they_were(tmp_path):
    path = tmp_path / "checkpoint.h5"
    arrays = {
        "t": np.array(0.1 + 0.2),
        "y": np.random.default_rng(0).normal(size=(3, 2)),
        "counts.steps": np.array(7),
        "empty": np.empty((0, 2)),
    }
    write(path, STATE, {"of": "an rve run"}, arrays)
    header, back = read(path, STATE)
    assert header == {"of": "an rve run"}
    assert back.keys() == arrays.keys()
    for name, values in arrays.items():
        np.testing.assert_array_equal(back[name], values)
        assert back[name].dtype == values.dtype


def test_tangents_are_kept_to_the_bit(tmp_path):
    path, header = tmp_path / "cells.h5", replace(HEADER, tangents=True)
    law = SoftLaw(fails_above=1.03)
    F, F_dot = sample(RANGE, 20, 3)
    answer = law.respond(F, F_dot)
    values = np.random.default_rng(5).normal(size=(2, 20, 2, 2, 2, 2))
    values[:, answer.status != 0] = np.nan
    with writing_data_set(path, header) as data:
        for rows in (slice(0, 8), slice(8, 20)):
            slopes = Tangents(values[0, rows], values[1, rows])
            part = StressResponse(answer.stress[rows], answer.status[rows], tangents=slopes)
            data.append(F[rows], F_dot[rows], part)
        data.finish()
    samples = read_data_set(path)
    np.testing.assert_array_equal(samples.P_by_F, values[0])
    np.testing.assert_array_equal(samples.P_by_F_dot, values[1])
    with h5py.File(path) as file:
        assert file["P_by_F"].attrs["unit"] == "µN/µm"
        assert file["P_by_F_dot"].attrs["unit"] == "µN µs/µm"


def test_samples_beyond_a_bifurcation_are_marked_and_not_valid(path):
    F, F_dot = sample(RANGE, 20, 3)
    answer = SoftLaw(fails_above=1.03).respond(F, F_dot)
    failed = answer.status != 0
    assert failed[8:].any()
    left = (np.arange(20) % 5 == 0) | failed  # what failed is not counted once more
    with writing_data_set(path, HEADER) as data:
        data.append(F[:8], F_dot[:8], StressResponse(answer.stress[:8], answer.status[:8]))
        rest = StressResponse(answer.stress[8:], answer.status[8:], left_bifurcation=left[8:])
        data.append(F[8:], F_dot[8:], rest)
        data.finish()
    samples = read_data_set(path)
    assert (samples.left_bifurcation & ~failed).nonzero()[0].tolist() == [10, 15]
    kept = np.flatnonzero((answer.status == 0) & ~samples.left_bifurcation)
    np.testing.assert_array_equal(samples.valid.F, F[kept])
    assert replace(samples, left_bifurcation=None).fingerprint != samples.fingerprint
    with pytest.raises(InputError, match="left_bifurcation"):
        replace(samples, left_bifurcation=left[:3])


@pytest.mark.parametrize("status", [-1, 5, 7, 127])
def test_a_status_that_means_nothing_is_refused(path, status):
    F, F_dot = sample(RANGE, 20, 3)
    answer = SoftLaw().respond(F, F_dot)
    codes = answer.status.copy()
    codes[3] = status
    stress = answer.stress.copy()
    stress[3] = np.nan

    def write():
        with writing_data_set(path, HEADER) as data:
            data.append(F, F_dot, StressResponse(stress, codes))
            data.finish()  # which reads it

    with pytest.raises(FileError, match=rf"{path.name}: .*status: {status}; it must be one of 0"):
        write()
