"""The only place that changes what is on disk; a fault put in here is one of all files.

A file is written under a name of its own, brought to the disk and only then given its place, whose
folder is brought to the disk too: after a fault or a power failure the file is the former or the
new one, whole.
"""

from __future__ import annotations

import os
from io import FileIO
from pathlib import Path


def write(path: Path, content: bytes | memoryview) -> None:
    """Write a new file; never through a link, which others may have put there."""
    with FileIO(path, "wb", opener=lambda at, how: os.open(at, how | os.O_NOFOLLOW, 0o666)) as file:
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
