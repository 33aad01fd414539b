"""Processes that are killed at random instants, and go on to what they would have given.

`SURROFE2_KILLS` is how many kills of each command the long tests make; default: 50.
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

KILLS = int(os.environ.get("SURROFE2_KILLS", "50"))
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A folder with a data set and a surrogate."""
    folder = tmp_path_factory.mktemp("learnt") / "train"
    commands.prepare("train", folder, None)
    commands.execute("train", folder)
    return folder


@pytest.fixture(scope="module")
def server():
    """Starts processes to kill, without importing anything again."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.commands"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    yield process
    process.stdin.close()
    process.wait()
    process.stdout.close()


def run(server, name, folder, seconds=600.0):
    """(exit code, s) of a command in its folder, killed after so many seconds."""
    begin = time.perf_counter()
    server.stdin.write(f"{name}\t{folder}\t{seconds}\n")
    server.stdin.flush()
    code = int(server.stdout.readline())
    return code, time.perf_counter() - begin


@pytest.mark.parametrize("kills", [5, pytest.param(KILLS, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", commands.COMMANDS)
def test_a_killed_command_goes_on_to_the_bit(name, kills, tmp_path, learnt, server):
    """Killed once at random in each of as many equal parts of its work as there are kills."""
    whole, folder = tmp_path / "whole", tmp_path / "killed"
    commands.prepare(name, whole, learnt)
    code, lasts = run(server, name, whole)
    assert code == 0
    wanted = commands.left_in(whole)
    struck = 0
    shares = (np.arange(kills) + np.random.default_rng(kills).uniform(size=kills)) / kills
    for share in shares:
        commands.prepare(name, folder, learnt)
        code, took = run(server, name, folder, share * lasts)
        assert code in (0, -signal.SIGKILL)
        struck += code != 0
        lasts = took if code == 0 else lasts  # the first may have been busy with kernels
        commands.execute(name, folder)
        commands.assert_same(folder, wanted)
        shutil.rmtree(folder)
    assert struck
