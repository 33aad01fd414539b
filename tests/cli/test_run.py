import json
import logging
import os
import platform
import signal
import sys
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from surrofe2.base import clock, interruption
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import compare_runs
from surrofe2.report.page import write_report
from surrofe2.run.displacement_curve import difference
from surrofe2.store.hdf5 import read, write
from surrofe2.store.run_folder import STATE, read_record, read_run
from surrofe2.store.store import read_columns
from surrofe2.workflow.run import run_study
from tests.cli.conftest import RUN_FILES
from tests.laws import SoftLaw, SquareLaw, StoppingLaw


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out" / "rve"


@pytest.fixture
def run(invoke, recipe_path, folder):
    """run(*options): that of the small recipe by RVEs in the folder."""
    return partial(invoke, "run", recipe_path, "--law", "rve", "--out", folder)


def test_run_folder(run, recipe_path, folder, recipe):
    done = run()
    assert sorted(path.name for path in folder.iterdir()) == RUN_FILES
    stored = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert stored["status"] == "finished"
    assert stored["error"] is None
    assert stored["recipe"] == recipe.to_dict()
    text = (folder / "run.json").read_text(encoding="utf-8")
    assert str(recipe_path.parent) not in text
    assert platform.node() not in text
    assert stored["cell_fingerprint"] == recipe.study().cell.parameters.fingerprint
    assert stored["units"]["time"] == "µs"
    wall = stored["wall_time"]
    assert wall["total"] == pytest.approx(wall["law"] + wall["macro"], abs=1e-6)
    assert wall["compilation"] >= 0.0
    counts = stored["counts"]
    assert counts["stress_points"] == 20 * counts["stress_calls"]
    assert counts["rve_solves"] >= counts["stress_points"]
    low, high = stored["met"]["stretch"]
    assert 0.9 < low <= 1.0 <= high < 1.1
    curve = read_run(folder).curve
    np.testing.assert_array_equal(curve.t, recipe.problem().output_times())
    assert curve.displacement[-1, 1] < 0.0
    assert done.stdout.startswith(f"{folder}: 4 µs by rve in ")


@pytest.mark.parametrize("call", [1, 60])
def test_an_error_after_a_signal_is_the_interruption(run, folder, monkeypatch, call):
    """Numpy may turn what a signal raises within its machine code into another error."""
    respond, calls = SoftLaw.respond, []

    def cut(self, *arguments, **keywords):
        calls.append(1)
        if len(calls) == call:
            monkeypatch.setattr(interruption._state, "number", signal.SIGTERM)
            raise SystemError("a function returned a result with an exception set")
        return respond(self, *arguments, **keywords)

    with monkeypatch.context() as patched:
        patched.setattr(SoftLaw, "respond", cut)
        cut_short = run(code=128 + signal.SIGTERM)
    assert "SystemError" not in cut_short.output
    assert cut_short.stderr.splitlines()[-1].startswith(
        f"interrupted by SIGTERM: {folder} keeps the run"
    )
    assert read_record(folder).status == "interrupted"
    assert (folder / "checkpoint.h5").exists() == (call > 1)
    monkeypatch.setattr(interruption._state, "number", 0)
    run()
    assert read_record(folder).status == "finished"
    assert len(calls) == call  # no more by the law that was cut short


def test_an_error_without_a_signal_stays_one(run):
    failed = run(law=StoppingLaw(0, SystemError("a defect")), code=1)
    assert isinstance(failed.exception, SystemError)


def test_existing_folder(run, folder):
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("mine")
    told = f"error: {folder}: has files but no run; write elsewhere or say --fresh\n"
    assert run(code=1).stderr == told
    run("--fresh")
    assert (folder / "notes.txt").read_text() == "mine"


def test_no_write_permission(run, unwritable):
    refused = run("--out", unwritable, code=1)
    assert refused.stderr == f"error: {unwritable}: cannot be written: Not a directory\n"


def test_a_finished_run_is_kept(run, folder):
    run()
    before = (folder / "run.json").read_bytes()
    law = SoftLaw()
    lines = run(law=law).stdout.splitlines()
    assert lines[0] == f"{folder}: finished before; --fresh starts over"
    assert lines[1].startswith(f"{folder}: 4 µs by rve in ")
    assert law.calls == 0
    assert (folder / "run.json").read_bytes() == before


def test_another_run_is_refused(run, changed_recipe, folder):
    run(law=StoppingLaw(calls=62), code=130)
    for options, told in (
        (["--integrator", "implicit"], "macro.integrator: this call has implicit, what is there "),
        (["--initialisation", "elastic"], "rve.initialisation: this call has elastic, what is "),
        ([], "conditions.load.acceleration: this call has [0.0, -0.2], what is there [0.0, -0.1]"),
    ):
        if not options:
            changed_recipe("-0.1]", "-0.2]")
        assert run(*options, code=1).stderr.startswith(f"error: {folder}: {told}")
    run("--fresh", "--initialisation", "elastic")
    record = read_record(folder)
    assert record.initialisation == record.recipe["rve"]["initialisation"] == "elastic"


def test_failed_run_keeps_what_it_computed(run, folder):
    failed = run(law=SoftLaw(fails_above=1.002), code=1)
    record = read_record(folder)
    assert record.status == "failed"
    assert failed.stderr.splitlines()[-1] == f"error: {record.error}"
    assert 0.0 < read_columns(folder / "curve.csv")["t_us"][-1] < 4.0
    assert (folder / "fields.xdmf").exists()


def test_a_table_has_implicit_runs(run, folder):
    """By the tangents of what it answers."""
    run("--law", "table", "--integrator", "implicit", law=SquareLaw())
    record = read_record(folder)
    assert record.counts["hits"] > record.counts["fallbacks"]
    table = read_run(folder)
    run("--law", "rve", "--integrator", "implicit", "--fresh", law=SquareLaw())
    assert difference(table.curve, read_run(folder).curve).largest < 0.02


def test_names_that_are_no_utf8_are_no_obstacle(
    recipe_path, tmp_path, stand_in, monkeypatch, caplog
):
    """In the lock, in run.json, in pictures and on the page they stand with escapes."""
    caplog.set_level(logging.ERROR, "surrofe2.store")  # workers cannot send such names to pytest
    path = recipe_path.rename(tmp_path / os.fsdecode(b"r\xff.toml"))
    folders = [tmp_path / os.fsdecode(name) for name in (b"o\xff", b"p\xff")]
    monkeypatch.setattr(sys, "argv", ["surrofe2", "run", str(path)])
    stand_in()
    for folder in folders:
        run_study(load_recipe(path), "rve", folder)
        run_study(load_recipe(path), "rve", folder)
    assert read_record(folders[0]).recipe["recipe"] == "r\\udcff.toml"
    assert compare_runs(folders, tmp_path / os.fsdecode(b"c\xff")).reference == "o\\udcff"
    write_report(folders, tmp_path / os.fsdecode(b"q\xff"))


def test_only_a_checkpoint_without_a_state_of_the_run_is_blamed(run, folder):
    run(law=StoppingLaw(calls=62), code=130)
    faulty = run(law=StoppingLaw(0, ZeroDivisionError("a fault of the law")), code=1)
    assert isinstance(faulty.exception, ZeroDivisionError)
    path = folder / "checkpoint.h5"
    header, arrays = read(path, STATE)
    write(path, STATE, header, {name: arrays[name] for name in arrays if "macro" not in name})
    told = f"error: {path}: no state of this run (state of a run: "
    assert run(code=1).stderr.startswith(told)
    run("--fresh")


class CompilingLaw(SoftLaw):
    """Compiles for a second in its fourth answer."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        if self.calls == 3:
            with clock.waiting():
                time.sleep(1.0)
        return super().respond(F, F_dot, state, tangents=tangents)


def test_the_clock_of_a_run_stands_while_kernels_are_compiled(recipe, folder, stand_in):
    """A longer first call would count in full by any other clock."""
    short = replace(recipe, time=replace(recipe.time, duration=0.2, output_interval=0.2))
    stand_in()
    run_study(short, "rve", folder / "warm")
    law = CompilingLaw()
    stand_in(law)
    wall = run_study(short, "rve", folder / "cold").wall_time
    assert law.calls > 3
    assert wall["compilation"] >= 1.0
    assert wall["law"] <= wall["total"] < 0.9
