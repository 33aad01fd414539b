"""Run folders: round trips, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError, MismatchError, SimulationError
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.store import run_folder
from surrofe2.store.hdf5 import write
from surrofe2.store.run_folder import (
    STATE,
    RunFolder,
    read_record,
    read_run,
    write_curves,
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


def write_tip(folder, curve):
    write_curves(folder, {"tip": curve}, {}, {})


def test_curves_come_back_to_the_last_bit(tmp_path, record, curve):
    both = {"tip": curve, "a b": replace(curve, displacement=2.0 * curve.displacement)}
    history, energies = {"force hold x": curve.t, "position": -curve.t}, {"kinetic": 2.0 * curve.t}
    write_curves(tmp_path, both, history, energies)
    write_record(tmp_path, replace(record, problem={"watched": {"tip": [0.0, 0.0]}}))
    back = read_run(tmp_path)
    assert list(back.curves) == ["tip", "a b"]
    for name, each in both.items():
        np.testing.assert_array_equal(back.curves[name].displacement, each.displacement)
    for found, wanted in ((back.history, history), (back.energies, energies)):
        assert found.keys() == wanted.keys()
        for name, values in wanted.items():
            np.testing.assert_array_equal(found[name], values)
    heads = {name: (tmp_path / f"{name}.csv").read_text().split("\n")[0]
             for name in ("curve", "history", "energies")}  # fmt: skip
    assert heads == {
        "curve": "t_us,u_x_um,u_y_um,u_x_um a b,u_y_um a b",
        "history": "t_us,force hold x_uN,position_um",
        "energies": "t_us,kinetic_pJ",
    }


def test_a_record_names_files_of_its_folder_alone(tmp_path, record, curve):
    write_tip(tmp_path, curve)
    write_record(tmp_path, record)
    entries = read_json(tmp_path / "run.json")
    write_json(tmp_path / "run.json", entries | {"files": {"/dev/zero": "0"}})
    with pytest.raises(FileError, match="'/dev/zero' is no file of a run"):
        read_run(tmp_path)


def opened(folder, record, **how):
    """A run that was begun, or found, in a folder."""
    with RunFolder.open(folder, record, lambda record, result: record, **how) as run:
        return run


def test_fresh_replaces_the_run_and_nothing_else(tmp_path, record, curve):
    folder = tmp_path / "run"
    write_tip(folder, curve)
    write_record(folder, record)
    (folder / "frames").mkdir()
    for name in ("notes.txt", "frames/movie-01.h5", "frames/fields-0000.h5"):
        (folder / name).write_text("mine")
    opened(folder, replace(record, status="running"), fresh=True)
    there = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*"))
    assert there == ["frames/movie-01.h5", "notes.txt", "run.json"]


def of_cells(record, law, *names):
    """The record of a run by this law, of plant cells of these names."""
    recipe = {**record.recipe, "cells": {name: {} for name in names}}
    return replace(record, law=law, recipe=recipe)


USERS = ("harvest-old.h5", "table-2.h5", "table-skin.h5", "harvest-skin.h5", "table.h5")


@pytest.mark.parametrize(
    ("law", "cells", "lost"),
    [
        ("rve", (), set()),
        ("table", (), {"table.h5"}),
        ("cached", ("skin", "flesh"), {"harvest-skin.h5"}),
        ("table", ("skin", "flesh"), {"harvest-skin.h5", "table-skin.h5"}),
        ("table", ("../skin",), set()),
    ],
)
def test_fresh_removes_harvests_and_tables_of_the_former_run_alone(
    tmp_path, record, law, cells, lost
):
    """Users give such names to files of their own, too."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in USERS:
        (folder / name).write_text("mine")
    write_record(folder, of_cells(record, law, *cells))
    opened(folder, replace(record, status="running"), fresh=True)
    assert {path.name for path in folder.iterdir()} == {*USERS, "run.json"} - lost
    assert not read_record(folder).replaces


@pytest.mark.parametrize("end", [KeyboardInterrupt(), MemoryError(), FileError("a full disk")])
def test_what_ends_the_beginning_of_a_run_is_what_its_record_says(
    tmp_path, record, monkeypatch, end
):
    """While its inputs are written, which may be large, run.json is its own already."""

    def fail(path, content):
        raise end

    folder = tmp_path / "run"
    running = replace(record, status="running")
    inputs = {"recipe.toml": b"[cell]"}
    with monkeypatch.context() as patched:
        patched.setattr(run_folder, "write_bytes", fail)
        with pytest.raises(type(end)), RunFolder.open(folder, running, None, inputs=inputs):
            pytest.fail("it has not begun")
    is_interrupted = isinstance(end, KeyboardInterrupt)
    assert read_record(folder).status == ("interrupted" if is_interrupted else "failed")
    with RunFolder.open(folder, running, None, inputs=inputs) as run:
        assert not run.resumes
    assert (folder / "input" / "recipe.toml").read_bytes() == b"[cell]"


def test_what_an_interruption_kept_from_being_removed_is_removed_by_the_next_start(
    tmp_path, record, monkeypatch
):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "table-skin.h5").touch()
    write_record(folder, of_cells(record, "table", "skin"))

    def killed(path):
        if path.name == "table-skin.h5":
            raise KeyboardInterrupt
        run_folder_remove(path)

    run_folder_remove = run_folder.remove
    running = replace(record, status="running")
    with monkeypatch.context() as patched:
        patched.setattr(run_folder, "remove", killed)
        with pytest.raises(KeyboardInterrupt):
            opened(folder, running, fresh=True)
    assert (folder / "table-skin.h5").exists()
    ended = read_record(folder)
    assert ended.status == "interrupted"
    assert "table-skin.h5" in ended.replaces
    write_record(folder, replace(ended, status="running"))  # as a kill leaves it
    opened(folder, running)
    assert [path.name for path in folder.iterdir()] == ["run.json"]


def test_a_run_that_cannot_begin_leaves_the_former_one(tmp_path, record, curve, monkeypatch):
    """Neither a record of its own nor a part of it: it has computed nothing."""
    folder = tmp_path / "run"
    write_tip(folder, curve)
    write_record(folder, record)
    (folder / "checkpoint.h5").touch()
    before = (folder / "run.json").read_bytes()

    def fail(path):
        raise FileError(f"{path}: cannot be removed: Operation not permitted")

    monkeypatch.setattr(run_folder, "remove", fail)
    with pytest.raises(FileError, match="cannot be removed"):
        opened(folder, replace(record, status="running"), fresh=True)
    assert (folder / "run.json").read_bytes() == before


def test_fresh_keeps_what_lies_in_a_folder_without_a_run(tmp_path, record):
    path = tmp_path / "frames" / "movie-01.h5"
    path.parent.mkdir()
    path.write_text("mine")
    opened(tmp_path, replace(record, status="running"), fresh=True)
    assert path.read_text() == "mine"


OF_A_RUN = [
    "run.json", "curve.csv", "fields.h5", "harvest-skin.h5", "table-skin.h5",
    "frames/fields-0000.h5", "frames/points-12345.h5",
]  # fmt: skip


@pytest.mark.parametrize("name", OF_A_RUN)
def test_fresh_replaces_no_file_that_is_not_of_a_run(tmp_path, record, name):
    folder = tmp_path / "run"
    path = folder / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    with pytest.raises(FileError, match="so --fresh does not replace it"):
        opened(folder, record, fresh=True)
    assert [*folder.rglob("*.*")] == [path]
    assert path.read_text() == "mine"


def test_a_run_without_a_checkpoint_starts_with_nothing_of_another(tmp_path, record, curve):
    folder = tmp_path / "run"
    write_tip(folder, curve)
    write_record(folder, replace(record, status="interrupted"))
    (folder / "frames").mkdir()
    (folder / "frames" / "fields-0000.h5").touch()
    assert not opened(folder, replace(record, status="running")).resumes
    assert [path.name for path in folder.rglob("*.*")] == ["run.json"]
    assert read_record(folder).status == "running"


def test_a_checkpoint_of_something_else_is_refused(tmp_path, record):
    folder, running = tmp_path / "run", replace(record, status="running")
    opened(folder, running)
    path = folder / "checkpoint.h5"
    write(path, STATE, {"of": "a training"}, {})
    with pytest.raises(FileError) as caught, RunFolder.open(folder, running, None) as run:
        run.restored(dict)
    assert str(caught.value) == f"{path}: a checkpoint of a training, not of a rve run"


ENDS = {
    "no such entry": (InputError("no such entry"), "failed", "no such entry"),
    "other settings": (MismatchError("other settings"), "failed", "other settings"),
    "a fault of the disk": (FileError("a fault of the disk"), "failed", "a fault of the disk"),
    "no equilibrium": (SimulationError("no equilibrium"), "failed", "no equilibrium"),
    "no memory": (MemoryError(), "failed", "MemoryError"),
    "a fault of the program": (KeyError("width"), "failed", "KeyError: 'width'"),
    "a signal": (KeyboardInterrupt(), "interrupted", None),
    "the host ends": (SystemExit(1), "interrupted", None),
}


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("is_stored", [True, False], ids=["stored", "no room"])
def test_whatever_ends_a_run_is_what_its_record_says(tmp_path, record, name, is_stored):
    """Also where its results cannot be stored: the error is still the one that ended the run, but
    for what a failed simulation or an interrupt computed, whose loss is reported."""
    error, status, message = ENDS[name]
    kept = []

    def store(record, result):
        if not is_stored:
            raise MemoryError("no room for results")
        kept.append(result)
        return record

    loses = isinstance(error, SimulationError | KeyboardInterrupt) and not is_stored
    raised = MemoryError if loses else type(error)

    def work():
        with RunFolder.open(tmp_path / "run", replace(record, status="running"), store) as run:
            run.partial = "a part"
            raise error

    with pytest.raises(raised):
        work()
    found = read_record(tmp_path / "run")
    assert (found.status, found.error) == (status, message)
    assert kept == ["a part"] * (is_stored and not isinstance(error, FileError))


def test_an_error_after_the_end_of_a_run_changes_nothing(tmp_path, record):
    folder, running = tmp_path / "run", replace(record, status="running")

    def work(error):
        with RunFolder.open(folder, running, lambda record, result: record) as run:
            if not run.is_finished:
                run.finish("all of it")
            raise error

    for error in (InputError("too late"), SimulationError("too late"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            work(error)
        assert read_record(folder).status == "finished"


def test_a_record_in_other_units_or_of_another_schema_is_refused(tmp_path, record):
    write_record(tmp_path, record)
    entries = read_json(tmp_path / "run.json")
    for change, message in (
        ({"units": {**entries["units"], "time": "s"}}, "numbers of the run: in units "),
        ({"schema_version": 2}, "run schema 2; this surrofe2 reads 3"),
        ({"schema": "foreign"}, "not the record of a surrofe2 run"),
    ):
        write_json(tmp_path / "run.json", entries | change)
        with pytest.raises(FileError, match=message):
            read_record(tmp_path)


def test_unfinished_run_is_not_read(tmp_path, record, curve):
    write_record(tmp_path, replace(record, status="interrupted"))
    write_tip(tmp_path, curve)
    with pytest.raises(InputError) as caught:
        read_run(tmp_path)
    assert str(caught.value) == f"{tmp_path}: the run is interrupted; its command resumes it"


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "t_us,u_x_um,u_y_um\n1,2\n", "t_us,u_x_um,u_y_um\n1,x,3\n"]
)
def test_damaged_curve(tmp_path, record, text):
    (tmp_path / "curve.csv").write_text(text)
    write_record(tmp_path, record)
    with pytest.raises(FileError) as caught:
        read_run(tmp_path)
    path = tmp_path / "curve.csv"
    assert str(caught.value) == f"{path}: not a table of t_us,u_x_um,u_y_um"
