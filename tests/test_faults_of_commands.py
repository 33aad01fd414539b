"""After a fault of the disk at any operation of a command, going on gives what it would have given.

`SURROFE2_FAULT_STRIDE` takes every so many operations in the long tests; default: 3; 1: all.
"""

import math
import os
import re
import shutil

import pytest

from surrofe2.base.errors import MismatchError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store import run_folder
from surrofe2.store.run_folder import read_record
from surrofe2.store.store import read_json, write_json
from surrofe2.workflow.run import run_study
from tests import commands
from tests.faults import KINDS, each_fault, fault_at
from tests.folders import assert_same, numbers

STRIDE = int(os.environ.get("SURROFE2_FAULT_STRIDE", "3"))


def check(name, kind, folders, learnt, stride=None, faults=6):
    """How many faults a command met: at every so many operations, or about so many, evenly."""
    whole = folders / "whole"
    commands.prepare(name, whole, learnt)
    with fault_at(kind, math.inf) as none:
        commands.execute(name, whole)
    wanted = numbers(whole)
    met = 0
    if stride is None:
        # odd, since each file takes the same few operations
        stride = none.done // faults | 1

    def work(folder):
        commands.prepare(name, folder, learnt)
        commands.execute(name, folder)

    for folder in each_fault(kind, folders, work, stride):
        met += 1
        record = folder / "out" / "run.json"
        if kind != "killed" and record.exists():
            assert read_record(record.parent).status != "running"
        commands.execute(name, folder)
        assert_same(folder, wanted)
        shutil.rmtree(folder)
    return met


@pytest.mark.parametrize("name", ["cached", pytest.param("table", marks=pytest.mark.slow)])
def test_a_killed_run_goes_on_to_the_bit(name, tmp_path, learnt):
    assert check(name, "killed", tmp_path, learnt) >= 4


def test_a_finished_run_stays_so_when_interrupted(tmp_path, monkeypatch):
    commands.prepare("rve", tmp_path / "study", None)
    out = tmp_path / "study" / "out"
    remove = run_folder.remove

    def interrupted(path):
        if path.name == "checkpoint.h5" and path.exists() and read_record(out).status == "finished":
            raise KeyboardInterrupt
        remove(path)

    with monkeypatch.context() as patched:
        patched.setattr(run_folder, "remove", interrupted)
        with pytest.raises(KeyboardInterrupt):
            commands.execute("rve", tmp_path / "study")
    before = (out / "run.json").read_bytes()
    assert read_record(out).status == "finished"
    assert (out / "checkpoint.h5").exists()
    commands.execute("rve", tmp_path / "study")
    assert (out / "run.json").read_bytes() == before
    assert not (out / "checkpoint.h5").exists()


def test_a_run_whose_disk_failed_says_so_and_goes_on_to_the_bit(tmp_path, learnt):
    assert check("surrogate", "input/output error", tmp_path, learnt, faults=4) >= 3


@pytest.mark.parametrize(
    ("kind", "stride"),
    [("killed", 3), *(pytest.param(each, 1, marks=pytest.mark.slow) for each in KINDS)],
)
def test_starting_over_leaves_the_former_run_or_the_new_one(kind, stride, tmp_path, learnt):
    former, new = tmp_path / "former", tmp_path / "new"
    for folder, duration in ((former, "1.0"), (new, "0.5")):
        commands.prepare("surrogate", folder, learnt)
        set_duration(folder, duration)
        commands.execute("surrogate", folder)
    # as a cached run of a cell called skin leaves it
    shutil.copy(new / "out" / "fields.h5", former / "out" / "harvest-skin.h5")
    record = read_json(former / "out" / "run.json")
    cells = {"cells": {"skin": {}}}
    changed = {"law": "cached", "recipe": record["recipe"] | cells}
    write_json(former / "out" / "run.json", record | changed)
    wanted, before = numbers(new / "out"), numbers(former / "out")

    def start_over(folder):
        shutil.copytree(former, folder)
        set_duration(folder, "0.5")
        with commands.checkpointed("surrogate"):
            run_study(load_recipe(folder / "recipe.toml"), "surrogate", folder / "out", fresh=True)

    started = 0
    for folder in each_fault(kind, tmp_path, start_over, stride, most=24):
        try:
            commands.execute("surrogate", folder)
        except MismatchError:
            found = numbers(folder / "out")
            assert_same({file: found[file] for file in before}, before)
        else:
            started += 1
            assert_same(folder / "out", wanted)
    assert started >= 3


def set_duration(folder, duration):
    path = folder / "recipe.toml"
    text = re.sub(r"duration = .*", f"duration = {duration}", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")


@pytest.mark.nightly
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", commands.COMMANDS)
def test_every_fault_of_every_command(name, kind, tmp_path, learnt):
    assert check(name, kind, tmp_path, learnt, STRIDE) * STRIDE >= 20
