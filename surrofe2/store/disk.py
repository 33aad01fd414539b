"""The only place that changes what is on disk; a fault put in here is one of all files.

A file is written under a name of its own, brought to the disk and only then moved to its place,
whose folder is brought to the disk too: after a fault the file is the former or the new one.
"""

from __future__ import annotations

import fcntl
import os
from io import FileIO
from pathlib import Path


def create(path: Path) -> FileIO:
    """Make a new file, never one that is there or behind a link; locked while it is open."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    file = FileIO(os.open(path, flags, 0o666), "r+b")
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


def write(file: FileIO, content: bytes | memoryview) -> None:
    """Make this the whole content of an open file."""
    file.seek(0)
    file.truncate()
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def move(source: Path, target: Path) -> None:
    """Give a file the place of another."""
    os.replace(source, target)


def remove(path: Path) -> None:
    """Remove a file where it is there."""
    path.unlink(missing_ok=True)


def remove_folder(path: Path) -> None:
    """Remove an empty folder."""
    path.rmdir()


def make_folder(path: Path) -> None:
    """Make a folder, and those that it is in, where they are not there."""
    path.mkdir(parents=True, exist_ok=True)
