"""Processes that are killed at random instants, and go on to what they would have given.

`SURROFE2_KILLS` is how many kills of each command the long tests make; default: 5.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests import commands

KILLS = int(os.environ.get("SURROFE2_KILLS", "5"))
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A folder with a data set and a surrogate."""
    folder = tmp_path_factory.mktemp("learnt") / "train"
    commands.prepare("train", folder, None)
    commands.execute("train", folder)
    return folder


def start(name, folder):
    """A process whose work begins now."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.commands", name, folder],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "at work\n", process.stderr.read()
    return process


def check(name, kills, folders, learnt):
    """Kill a command at instants from the beginning to the end of its work."""
    whole = folders / "whole"
    commands.prepare(name, whole, learnt)
    process = start(name, whole)
    begin = time.perf_counter()
    _, said = process.communicate()
    assert process.returncode == 0, said
    lasts = time.perf_counter() - begin
    wanted = commands.left_in(whole)
    struck = 0
    # One instant at random in each of as many equal parts of the work as there are kills.
    shares = (np.arange(kills) + np.random.default_rng(kills).uniform(size=kills)) / kills
    for share in shares:
        folder = folders / "killed"
        commands.prepare(name, folder, learnt)
        process = start(name, folder)
        time.sleep(share * lasts)
        process.kill()
        _, said = process.communicate()
        assert process.returncode in (0, -signal.SIGKILL), said
        struck += process.returncode != 0
        commands.execute(name, folder)
        commands.assert_same(folder, wanted)
        shutil.rmtree(folder)
    assert struck


def test_a_killed_run_goes_on_to_the_bit(tmp_path, learnt):
    check("cached", 2, tmp_path, learnt)


@pytest.mark.slow
@pytest.mark.parametrize("name", commands.COMMANDS)
def test_every_command_goes_on_to_the_bit(name, tmp_path, learnt):
    check(name, KILLS, tmp_path, learnt)
