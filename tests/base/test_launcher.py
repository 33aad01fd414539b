"""What a rank that fails has printed is heard, whatever its launcher does with the ranks then."""

import os
import select
import signal
import socket
import subprocess
import sys
import time

import pytest

from surrofe2.base.launcher import ENOUGH
from tests.conftest import ROOT

FAILING = """
import sys
from surrofe2.base.launcher import end_job
sys.stderr.write("no such thing" + 20000 * " " + "at the end")
end_job()
"""


def test_the_last_lines_of_a_rank_are_read_before_its_launcher_is_asked_to_end_all():
    """A launcher that looks now and then, to the requests of its ranks first, as MPICH's may."""
    launcher, of_rank = socket.socketpair()
    process = subprocess.Popen(
        [sys.executable, "-c", FAILING],
        env=os.environ | {"PMI_FD": str(of_rank.fileno()), "PYTHONPATH": str(ROOT)},
        pass_fds=[of_rank.fileno()],
        stderr=subprocess.PIPE,
    )
    printed = b""
    while True:
        select.select([launcher, process.stderr], [], [])
        time.sleep(0.05)
        ready = select.select([launcher, process.stderr], [], [])[0]
        if launcher in ready:
            break
        printed += os.read(process.stderr.fileno(), 65536)
    process.kill()
    process.communicate()
    request = launcher.recv(100)
    for end in (launcher, of_rank):
        end.close()
    assert request == b"cmd=abort exitcode=1\n"
    assert printed.startswith(b"no such thing")
    assert printed.endswith(b"at the end")


def test_a_rank_without_such_a_launcher_ends_by_a_signal():
    words = [sys.executable, "-c", FAILING]
    alone = {name: value for name, value in os.environ.items() if name != "PMI_FD"}
    done = subprocess.run(words, env=alone, cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == -signal.SIGTERM
    assert done.stderr.endswith(b"at the end")


SLOW = """
import os, time
if os.environ["PMI_RANK"] == "0":
    time.sleep(0.6)
"""


def by_strict_launcher(ranks, *words, **settings):
    """What ranks print whose launcher kills all as soon as one ends with an exit code above 0."""
    processes = [
        subprocess.Popen(
            words,
            env=os.environ | settings | {"PMI_SIZE": str(ranks), "PMI_RANK": str(number)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for number in range(ranks)
    ]
    until = time.monotonic() + 60.0
    while time.monotonic() < until and not any(each.poll() for each in processes):
        time.sleep(0.01)
    for each in processes:
        each.kill()
    return [each.communicate()[0] for each in processes]


def test_a_command_not_for_ranks_is_refused_before_any_rank_has_failed(tmp_path):
    """Rank 0, which says so, starts later than the others."""
    (tmp_path / "sitecustomize.py").write_text(SLOW, encoding="utf-8")
    path = f"{tmp_path}:{ROOT}"
    command = (sys.executable, "-m", "surrofe2", "check", "none.toml")
    first, *others = by_strict_launcher(3, *command, PYTHONPATH=path)
    assert first.startswith("error: check: 3 ranks were started, and only run shares")
    assert others == ["", ""]
    assert ENOUGH > 3 * 0.6  # so that this holds on a loaded machine


class Request:
    """A barrier that others come to after two looks."""

    def __init__(self, events):
        self.events = events
        self.looks = 0

    def Test(self):
        self.looks += 1
        self.events.append(f"look {self.looks}")
        return self.looks == 3


@pytest.mark.parametrize(
    ("rank", "code", "wait"), [(0, 1, []), (1, 0, []), (1, 1, ["wait"])], ids=str
)
def test_a_rank_leaves_when_all_do_and_one_that_fails_last(monkeypatch, rank, code, wait):
    mpi4py = pytest.importorskip("mpi4py")
    from surrofe2.ranks import driver

    events = []

    class World:
        def Ibarrier(self):
            return Request(events)

    class MPI:
        COMM_WORLD = World()

        @staticmethod
        def Finalize():
            events.append("left")

    World.rank = rank
    monkeypatch.setattr(mpi4py, "MPI", MPI, raising=False)
    sleeps = {driver.HEARD: lambda: events.append("wait")}
    monkeypatch.setattr(driver.time, "sleep", lambda s: sleeps.get(s, lambda: None)())
    driver.leave(code)
    assert events == ["look 1", "look 2", "look 3", *wait, "left"]
