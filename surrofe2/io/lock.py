"""One process at a time writes an output: a lock file beside or in it says which one that is.

The file is there only while a process works. One that was killed leaves it behind: the process it
names is gone, and the next one takes its place. Of a process on another machine nobody can tell.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from surrofe2.errors import FileError
from surrofe2.interruption import held
from surrofe2.io import disk
from surrofe2.io.files import reported

log = logging.getLogger(__name__)

_PATIENCE = 1.0
"""s until a lock that says nothing, for its process has just made it, is one that was left."""
_held: set[Path] = set()
"""Locks of this process."""


def folder_lock(folder: Path) -> Path:
    """The lock of what a folder holds."""
    return folder / ".lock"


def file_lock(path: Path) -> Path:
    """The lock of a file."""
    return path.with_name(f".{path.name}.lock")


def locked_folder(folder: Path) -> AbstractContextManager[None]:
    """Nobody else writes into a folder; it is made where it is not there.

    Raises:
        FileError: another process does, and the sentence names it, or the folder is not writable.
    """
    return _locked(folder_lock(folder), folder)


def locked_file(path: Path) -> AbstractContextManager[None]:
    """Nobody else writes a file; its folder is made where it is not there.

    Raises:
        FileError: another process does, and the sentence names it, or the folder is not writable.
    """
    return _locked(file_lock(path), path)


@contextmanager
def _locked(lock: Path, output: Path) -> Iterator[None]:
    lock = lock.resolve()
    mine = json.dumps(_myself(), ensure_ascii=False).encode()
    _take(lock, output, mine)
    try:
        yield
    finally:
        _held.discard(lock)
        with suppress(OSError):  # where it cannot be removed, the next process takes it over
            if lock.read_bytes() == mine:
                _let_go(lock)


def _let_go(lock: Path) -> None:
    """Remove a lock; once more if the disk fails, for nobody may come back to its folder."""
    try:
        disk.remove(lock)
    except OSError:
        disk.remove(lock)


def _take(lock: Path, output: Path, mine: bytes) -> None:
    """Make the lock, in the place of one whose process is gone."""
    if lock in _held:
        raise FileError(f"{output}: in use by another call of this process")
    with reported(output, "written"):
        disk.make_folder(lock.parent)
        while True:
            try:
                _create(lock, mine)
            except FileExistsError:
                _remove_stale(lock, output)
            else:
                return


def _create(lock: Path, mine: bytes) -> None:
    try:
        with held():  # cut in between, it would say nothing
            disk.create(lock, mine)
            _held.add(lock)
    except FileExistsError:  # of another
        raise
    except OSError:  # a lock that says nothing helps nobody
        with suppress(OSError):
            disk.remove(lock)
        raise


def _remove_stale(lock: Path, output: Path) -> None:
    """Remove a lock that was left; others that see it too find it removed, or wait.

    Raises:
        FileError: its process is at work, or on another machine.
    """
    try:
        file = lock.open("rb")
    except FileNotFoundError:
        return
    with file:
        holder = _read(file)
        if _is_at_work(holder, output, lock):
            raise FileError(f"{output}: in use by {_described(holder)}; wait for it or end it")
        fcntl.flock(file, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), lock.stat()):
                log.warning("%s: %s is gone; its lock is taken over", output, _described(holder))
                disk.remove(lock)


def _read(file: Any) -> dict[str, Any]:
    """What a lock says, {} where its process was killed as it made it."""
    until = time.monotonic() + _PATIENCE
    while True:
        file.seek(0)
        try:
            said = json.loads(file.read())
            return {name: said[name] for name in ("process", "host", "since", "command", "start")}
        except (ValueError, RecursionError, KeyError, TypeError):
            if time.monotonic() > until:
                return {}
            time.sleep(0.05)


def _is_at_work(holder: dict[str, Any], output: Path, lock: Path) -> bool:
    if not holder:
        return False
    if holder["host"] != platform.node():
        raise FileError(
            f"{output}: in use by {_described(holder)} on {str(holder['host'])[:40]}; if it is not "
            f"running any more, remove {lock.name} there"
        )
    mine, number = _myself(), holder["process"]
    if number == mine["process"]:
        return holder["start"] == mine["start"] and lock in _held
    is_hidden = False
    try:
        os.kill(number, 0)
    except PermissionError:
        is_hidden = True  # it is another user's, of whom a system may tell nothing more
    except (OSError, OverflowError, TypeError, ValueError):
        return False
    start = _start_of(number)
    if start is None and is_hidden:
        return True
    return holder["start"] in (None, start)  # else the number is another's now


def _described(holder: dict[str, Any]) -> str:
    if not holder:
        return "a process that was killed as it began"
    said = f"process {holder['process']} since {holder['since']} ({holder['command']})"
    return " ".join(said.split())[:150]


def _myself() -> dict[str, Any]:
    return {
        "process": os.getpid(),
        "host": platform.node(),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100],
        "start": _start_of(os.getpid()),
    }


def _start_of(process: int) -> int | None:
    """When a process began, in ticks since the machine did; None where that cannot be told, 0 of
    one that was killed and nobody has waited for."""
    try:
        line = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    state, *figures = line.rpartition(")")[2].split()
    return 0 if state in "ZX" else int(figures[18])
