"""One process at a time writes an output; a lock that was left is told from one that is held."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time

import pytest

from surrofe2.errors import FileError
from surrofe2.io import lock
from surrofe2.io.lock import file_lock, folder_lock, locked_file, locked_folder

HOLDER = """
import signal, sys, time
from pathlib import Path
from surrofe2.io.lock import locked_folder
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have it ignored
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        pass
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the folder `out`."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, tmp_path / "out"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def leave_lock(lock, **entries):
    """A lock of a process that is gone, or of what the entries say."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    said = {
        "process": 2**22 + 1,  # above the largest that Linux gives
        "host": platform.node(),
        "since": "2026-01-01T00:00:00+00:00",
        "command": "surrofe2 run a.toml",
        "start": 1,
    }
    lock.write_text(json.dumps(said | entries), encoding="utf-8")


def test_a_second_process_is_told_who_is_at_work(tmp_path, holder):
    out = tmp_path / "out"
    said = json.loads(folder_lock(out).read_text(encoding="utf-8"))
    assert said["process"] == holder.pid
    with pytest.raises(FileError) as caught, locked_folder(out):
        pass
    assert str(caught.value) == (
        f"{out}: in use by process {holder.pid} since {said['since']} ({said['command']}); "
        "wait for it or end it"
    )
    assert json.loads(folder_lock(out).read_text(encoding="utf-8")) == said


def test_an_interrupted_process_leaves_no_lock(tmp_path, holder):
    holder.send_signal(signal.SIGINT)
    holder.wait(timeout=20)
    assert not folder_lock(tmp_path / "out").exists()


def test_the_lock_of_a_killed_process_is_taken_over_with_a_remark(tmp_path, holder, caplog):
    holder.kill()
    holder.wait()
    out = tmp_path / "out"
    assert folder_lock(out).exists()
    with locked_folder(out):
        said = json.loads(folder_lock(out).read_text(encoding="utf-8"))
        assert said["process"] == os.getpid()
    assert not folder_lock(out).exists()
    assert [f"process {holder.pid} " in each.getMessage() for each in caplog.records] == [True]
    with locked_folder(out):
        pass
    assert len(caplog.records) == 1


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="needs /proc")
def test_a_killed_process_that_nobody_has_waited_for_holds_nothing(tmp_path, holder):
    holder.kill()
    os.waitid(os.P_PID, holder.pid, os.WEXITED | os.WNOWAIT)
    with locked_folder(tmp_path / "out"):
        pass


def test_a_process_of_another_user_holds_even_where_its_beginning_is_hidden(
    tmp_path, holder, monkeypatch
):
    def forbidden(process, number):
        raise PermissionError

    start_of = lock._start_of
    mine = os.getpid()
    monkeypatch.setattr(os, "kill", forbidden)
    monkeypatch.setattr(lock, "_start_of", lambda at: start_of(at) if at == mine else None)
    with (
        pytest.raises(FileError, match=f"in use by process {holder.pid} "),
        locked_folder(tmp_path / "out"),
    ):
        pass
    monkeypatch.undo()


def test_a_number_that_is_another_process_now_holds_nothing(tmp_path):
    path = tmp_path / "cells.h5"
    leave_lock(file_lock(path), process=os.getppid(), start=1)
    if not os.path.exists("/proc/self/stat"):
        pytest.skip("needs /proc")
    with locked_file(path):
        assert "a.toml" not in file_lock(path).read_text(encoding="utf-8")


def test_a_lock_of_another_machine_is_never_taken_over(tmp_path):
    path = tmp_path / "cells.h5"
    leave_lock(file_lock(path), host="elsewhere")
    before = file_lock(path).read_bytes()
    with pytest.raises(FileError) as caught, locked_file(path):
        pass
    assert str(caught.value) == (
        f"{path}: in use by process 4194305 since 2026-01-01T00:00:00+00:00 (surrofe2 run a.toml) "
        "on elsewhere; if it is not running any more, remove .cells.h5.lock there"
    )
    assert file_lock(path).read_bytes() == before


@pytest.mark.parametrize("content", [b"", b'{"process": 1', b"[" * 100_000, b'{"host": {}}', b"0"])
def test_a_lock_that_says_nothing_was_left(tmp_path, content, monkeypatch):
    monkeypatch.setattr("surrofe2.io.lock._PATIENCE", 0.1)
    path = tmp_path / "cells.h5"
    file_lock(path).write_bytes(content)
    with locked_file(path):
        assert file_lock(path).read_bytes() != content
    assert not file_lock(path).exists()


@pytest.mark.parametrize("process", ["7", None, -1, 10**30, 1.5, True])
def test_a_lock_of_what_is_no_process_was_left(tmp_path, process):
    path = tmp_path / "cells.h5"
    leave_lock(file_lock(path), process=process)
    with locked_file(path):
        pass


def test_two_calls_of_one_process_are_kept_apart_too(tmp_path):
    with (
        locked_folder(tmp_path),
        pytest.raises(FileError, match="another call of this process"),
        locked_folder(tmp_path),
    ):
        pass
    assert not folder_lock(tmp_path).exists()


def test_errors_leave_no_lock(tmp_path):
    with pytest.raises(ZeroDivisionError), locked_folder(tmp_path):
        raise ZeroDivisionError
    assert not folder_lock(tmp_path).exists()


def test_of_many_processes_one_takes_over(tmp_path):
    out = tmp_path / "out"
    leave_lock(folder_lock(out))
    start = [sys.executable, "-c", HOLDER, out]
    several = [
        subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    until = time.monotonic() + 30
    while sum(each.poll() is None for each in several) > 1 and time.monotonic() < until:
        time.sleep(0.05)
    holding = [each for each in several if each.poll() is None]
    try:
        assert len(holding) == 1
        said = json.loads(folder_lock(out).read_text(encoding="utf-8"))
        assert said["process"] == holding[0].pid
    finally:
        for each in several:
            each.kill()
            each.communicate()
