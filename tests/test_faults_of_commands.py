"""After a fault of the disk at any operation of a command, going on gives what it would have given.

`SURROFE2_FAULT_STRIDE` takes every so many operations in the long tests; default: 1, all.
"""

from __future__ import annotations

import os
import shutil

import pytest

from tests import commands
from tests.faults import KINDS, each_fault

STRIDE = int(os.environ.get("SURROFE2_FAULT_STRIDE", "1"))


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A folder with a data set and a surrogate."""
    folder = tmp_path_factory.mktemp("learnt") / "train"
    commands.prepare("train", folder, None)
    commands.execute("train", folder)
    return folder


def check(name, kind, folders, learnt, stride=1):
    """How many faults a command met."""
    whole = folders / "whole"
    commands.prepare(name, whole, learnt)
    commands.execute(name, whole)
    wanted = commands.left_in(whole)
    met = 0

    def work(folder):
        commands.prepare(name, folder, learnt)
        commands.execute(name, folder)

    for folder in each_fault(kind, folders, work, stride):
        met += 1
        commands.execute(name, folder)
        found = commands.left_in(folder)
        assert list(found) == list(wanted), met
        for file, values in wanted.items():
            assert found[file] == values, (met, file)
        shutil.rmtree(folder)
    return met


@pytest.mark.parametrize("name", ["cached", "table"])
def test_a_killed_run_goes_on_to_the_bit(name, tmp_path, learnt):
    assert check(name, "killed", tmp_path, learnt, stride=23) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", commands.COMMANDS)
def test_every_fault_of_every_command(name, kind, tmp_path, learnt):
    assert check(name, kind, tmp_path, learnt, STRIDE) * STRIDE >= 20
