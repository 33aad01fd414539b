"""Processes that are ended at random instants, and go on to what they would have given.

`SURROFE2_KILLS` is how often the long tests kill each command, and interrupt it; default: 20.
"""

import os
import shutil
import signal
import time
from itertools import product

import numpy as np
import pytest

from surrofe2.store.run_folder import read_record
from tests import commands
from tests.folders import assert_same, numbers

KILLS = int(os.environ.get("SURROFE2_KILLS", "20"))


def run(forks, name, folder, seconds=600.0, number=signal.SIGKILL):
    """(exit code, s) of a command in its folder, ended by a signal after so many seconds."""
    begin = time.perf_counter()
    process = forks("tests.commands", [name, folder], folder.with_name("said.txt"))
    process.wait(seconds)
    process.send_signal(number)
    return process.wait(), time.perf_counter() - begin


@pytest.fixture(scope="module")
def wanted(tmp_path_factory, learnt, forks):
    """What a whole command leaves, and how long it took last, by its name."""
    known = {}

    def of(name):
        if name not in known:
            whole = tmp_path_factory.mktemp("whole") / "folder"
            commands.prepare(name, whole, learnt)
            code, lasts = run(forks, name, whole)
            assert code == 0
            known[name] = [numbers(whole), lasts]
        return known[name]

    return of


ENDS = {"killed": (signal.SIGKILL, -signal.SIGKILL), "interrupted": (signal.SIGINT, 130)}
"""Signal and exit code."""
QUICK = ("cached",)
"""Commands that are killed once in the quick tests; the others once in the slow ones."""
CASES = [
    pytest.param(name, "killed", 1, marks=[pytest.mark.slow] * (name not in QUICK))
    for name in commands.COMMANDS
] + [
    pytest.param(*case, KILLS, marks=pytest.mark.nightly)
    for case in product(commands.COMMANDS, ENDS)
]


@pytest.mark.parametrize(("name", "how", "times"), CASES)
def test_an_ended_command_goes_on_to_the_bit(name, how, times, tmp_path, learnt, forks, wanted):
    """Ended once at random in each of as many equal parts of its work as it is ended; once at all:
    in its first third, again sooner where it was done by then."""
    folder, struck, known = tmp_path / "ended", 0, wanted(name)
    number, code_of_ended = ENDS[how]
    random = np.random.default_rng(times)
    shares = (np.arange(times) + random.uniform(size=times)) / times
    for share in shares if times > 1 else (0.3, 0.15, 0.07):
        commands.prepare(name, folder, learnt)
        code, took = run(forks, name, folder, share * known[1], number)
        assert code in (0, code_of_ended)
        struck += code != 0
        if code == 0:  # the first may have been busy with kernels
            known[1] = took
        if how == "interrupted":
            assert not [*folder.rglob("*.lock"), *folder.rglob("*.partial")]
            for path in folder.rglob("run.json"):
                assert read_record(path.parent).status in ("interrupted", "finished")
        commands.execute(name, folder)
        assert_same(folder, known[0])
        shutil.rmtree(folder)
        if times == 1 and struck:
            break
    assert struck
