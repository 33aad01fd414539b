"""One process at a time writes an output, by a lock file beside or in it.

The process holds the file by `flock`, which the kernel drops when the process ends, however it
ends. What stands in the file is for people: who holds it. A process that ends well removes the
file, so one that is there without a holder says that the last process was killed.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO

from surrofe2.errors import FileError
from surrofe2.interruption import held
from surrofe2.io import disk
from surrofe2.io.files import reported

log = logging.getLogger(__name__)


def folder_lock(folder: Path) -> Path:
    """The lock of what a folder holds."""
    return folder / ".lock"


def file_lock(path: Path) -> Path:
    """The lock of a file."""
    return path.with_name(f".{path.name}.lock")


def locked_folder(folder: Path) -> AbstractContextManager[None]:
    """Only this call writes into a folder, which is made where it is missing.

    Raises:
        FileError: another call does, which the message names, or the folder is not writable.
    """
    return _locked(folder_lock(folder), folder)


def locked_file(path: Path) -> AbstractContextManager[None]:
    """Only this call writes a file, whose folder is made where it is missing.

    Raises:
        FileError: another call does, which the message names, or the folder is not writable.
    """
    return _locked(file_lock(path), path)


@contextmanager
def _locked(lock: Path, output: Path) -> Iterator[None]:
    with reported(output, "written"), held():
        file = _take(lock, output)
    try:
        yield
    finally:
        with file, suppress(OSError):  # where it cannot be removed, the next process takes it over
            _remove(lock)


def _take(lock: Path, output: Path) -> IO[bytes]:
    """The open lock file, held."""
    disk.make_folder(lock.parent)
    while True:
        file = lock.open("a+b")
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise FileError(f"{output}: in use by {_holder(file)}") from None
            if _is_at(file, lock):
                file.seek(0)
                if os.fstat(file.fileno()).st_size:
                    log.warning("%s: %s was killed; this process goes on", output, _said_by(file))
                _sign(lock)
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # its holder removed it between our two calls


def _is_at(file: IO[bytes], lock: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), lock.stat())
    except FileNotFoundError:
        return False


def _sign(lock: Path) -> None:
    """Write who holds a lock into it."""
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:100]
    me = {
        "process": os.getpid(),
        "host": platform.node(),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": command,
    }
    try:
        disk.write(lock, json.dumps(me).encode())
    except OSError:
        with suppress(OSError):
            disk.remove(lock)
        raise


def _remove(lock: Path) -> None:
    """Remove a lock; try again if the disk fails once."""
    try:
        disk.remove(lock)
    except OSError:
        disk.remove(lock)


def _holder(file: IO[bytes]) -> str:
    """Who holds a lock, and what to do."""
    said = _said_by(file)
    if said.startswith(f"process {os.getpid()} on {platform.node()} "):
        return "another call of this process"
    return f"{said}; wait for it or end it"


def _said_by(file: IO[bytes]) -> str:
    """What a lock says of the process that signed it; its file is damaged or empty at times."""
    try:
        file.seek(0)
        said = json.loads(file.read(10_000))
        who = f"process {said['process']} on {said['host']} since {said['since']}"
        return " ".join(f"{who} ({said['command']})".split())[:200]
    except (ValueError, RecursionError, KeyError, TypeError):
        return "a process that did not say its name"
