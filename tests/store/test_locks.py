"""One process at a time writes an output; a lock that was left is told from one that is held."""

import errno
import fcntl
import os
import platform
import signal
import stat
import subprocess
import sys
import time

import pytest

from surrofe2.base.errors import FileError
from surrofe2.store import disk
from surrofe2.store.store import file_lock, folder_lock, locked_file, locked_folder, write_text

HOLDER = """
import signal, sys, time
from pathlib import Path
from surrofe2.store.store import locked_folder
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


def leave_lock(lock):
    """The lock of a process that was killed."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    since = "2026-01-01T00:00:00+00:00"
    lock.write_text(f"process 4194305 on elsewhere since {since} (surrofe2 run a.toml)")


def test_a_second_process_is_told_who_is_at_work(tmp_path, holder):
    out = tmp_path / "out"
    text = folder_lock(out).read_text(encoding="utf-8")
    assert text.startswith(f"process {holder.pid} on {platform.node()} since 20")
    assert text.endswith(f" (-c {out})")
    with pytest.raises(FileError) as caught, locked_folder(out):
        pass
    assert str(caught.value) == f"{out}: in use by {text}; wait for it or end it"
    assert folder_lock(out).read_text(encoding="utf-8") == text


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
        assert folder_lock(out).read_text(encoding="utf-8").startswith(f"process {os.getpid()} ")
    assert not folder_lock(out).exists()
    assert [f"process {holder.pid} " in each.getMessage() for each in caplog.records] == [True]
    with locked_folder(out):
        pass
    assert len(caplog.records) == 1


def test_a_process_that_stalls_as_it_signs_keeps_its_lock(tmp_path, holder):
    out = tmp_path / "out"
    folder_lock(out).write_bytes(b"")
    with pytest.raises(FileError, match="in use by a process that did not say"), locked_folder(out):
        pass


@pytest.mark.parametrize("content", [b"", b"process 1 \x1b[2J", b"[" * 100_000, b"0"])
def test_a_lock_that_nobody_holds_is_taken_over_whatever_it_says(tmp_path, content, caplog):
    name = "a process that did not say its name"
    path = tmp_path / "cells.h5"
    file_lock(path).write_bytes(content)
    with locked_file(path):
        assert file_lock(path).read_bytes() != content
    assert not file_lock(path).exists()
    assert all(name in each.getMessage() for each in caplog.records)


def test_two_calls_of_one_process_are_kept_apart_too(tmp_path):
    with (
        locked_folder(tmp_path),
        pytest.raises(FileError, match="another call of this process"),
        locked_folder(tmp_path),
    ):
        pass
    assert not folder_lock(tmp_path).exists()  # errors leave none


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
        text = folder_lock(out).read_text(encoding="utf-8")
        assert text.startswith(f"process {holding[0].pid} ")
    finally:
        for each in several:
            each.kill()
            each.communicate()


def test_a_stopped_process_keeps_its_lock(tmp_path, holder):
    holder.send_signal(signal.SIGSTOP)
    with pytest.raises(FileError, match=f"in use by process {holder.pid} "):
        locked_folder(tmp_path / "out").__enter__()
    holder.send_signal(signal.SIGCONT)


@pytest.fixture
def unlockable(monkeypatch):
    """unlockable(number): every lock is refused by this error from now on."""
    monkeypatch.setattr(disk, "_warnings", set())

    def refuse(number):
        def flock(*_):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(fcntl, "flock", flock)

    return refuse


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, 524])
def test_a_file_system_without_locks_takes_all_with_one_warning(
    tmp_path, unlockable, caplog, number
):
    out, path = tmp_path / "out", tmp_path / "out" / "a.txt"
    unlockable(number)
    with locked_folder(out):
        write_text(path, "former")
        write_text(path, "new")
    assert path.read_text() == "new"
    assert [*out.iterdir()] == [path]
    (record,) = caplog.records
    assert record.getMessage() == (
        f"{out}: its file system keeps no locks ({os.strerror(number)}); "
        "let one process at a time write there"
    )


def test_without_locks_nothing_of_another_process_is_removed(tmp_path, unlockable, caplog):
    """What looks as if a killed process had left it may be of one that is at work."""
    out = tmp_path / "out"
    leave_lock(folder_lock(out))
    partial = out / ".a.txt.01234567.partial"
    partial.touch()
    unlockable(errno.ENOLCK)
    with locked_folder(out):
        write_text(out / "a.txt", "text")
    assert partial.exists()
    assert "was killed or is still at work; this process resumes" in caplog.text


@pytest.mark.parametrize(
    ("number", "warnings"), [(errno.EIO, 1), (errno.EINVAL, 0)], ids=["EIO", "EINVAL"]
)
def test_a_folder_that_cannot_be_synchronised_takes_files(
    tmp_path, monkeypatch, caplog, number, warnings
):
    """A disk that fails may do so: one warning. Some file systems never synchronise folders."""
    monkeypatch.setattr(disk, "_warnings", set())
    synchronise = os.fsync

    def fsync(descriptor):
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        synchronise(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    for name in ("a.txt", "b.txt"):
        write_text(tmp_path / name, "text")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b.txt"]
    begin = f"{tmp_path}: its file system cannot bring names of files to the disk (Input/output"
    assert [each.getMessage().startswith(begin) for each in caplog.records] == [True] * warnings


def test_a_lock_that_fails_otherwise_leaves_no_partial_file(tmp_path, unlockable):
    unlockable(errno.EIO)
    with pytest.raises(FileError, match="cannot be written: Input/output error"):
        write_text(tmp_path / "a.txt", "text")
    assert not [*tmp_path.iterdir()]
