"""All changes of what is on disk; a test that puts a fault in here tests every file.

A file is written under a name of its own, brought to the disk and only then moved to its place,
whose folder is brought to the disk too: after a fault the file is the former or the new one.
"""

from __future__ import annotations

import errno
import logging
import os
from io import FileIO, IOBase
from pathlib import Path

from surrofe2.base import locks

log = logging.getLogger(__name__)

# Errors of opening or synchronising a folder on CIFS, vboxsf, WSL and some FUSE, or one that may be
# written and not read. The files in it are on the disk all the same.
_NOT_SYNCED = (
    errno.EINVAL, errno.EIO, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES, errno.EPERM,
    errno.EBADF, errno.EISDIR,
)  # fmt: skip


def create(path: Path) -> FileIO:
    """Make a new file, never one that is there or behind a link; locked while it is open."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    file = FileIO(os.open(path, flags, 0o666), "r+b")
    try:
        lock(file, path)
    except OSError:
        file.close()
        path.unlink()
        raise
    return file


def lock(file: IOBase, path: Path) -> bool:
    """Lock an open file; False, with one warning of the process, where there are no locks.

    Raises:
        BlockingIOError: another process holds the lock.
    """
    reason = locks.lock(file)
    if reason:
        _warn_once(_NO_LOCKS, path.parent, reason)
    return not reason


# Warnings that this process has printed, each of the first folder that it concerned.
_warnings = set[str]()
_NO_LOCKS = "%s: its file system keeps no locks (%s); let one process at a time write there"
_NO_SYNC = (
    "%s: its file system cannot bring names of files to the disk (%s), which may be a fault of the "
    "disk: after a power failure the last files may be missing; look at the system's log"
)


def _warn_once(warning: str, folder: Path, reason: str) -> None:
    """Log a warning of a folder and a reason, where this process has not logged it yet."""
    if warning not in _warnings:
        _warnings.add(warning)
        log.warning(warning, folder, reason)


def write(file: FileIO, content: bytes | memoryview) -> None:
    """Make this the whole content of an open file."""
    file.seek(0)
    file.truncate()
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk.

    A folder that cannot be synchronised stays as it is, with one warning where that may be a fault
    of the disk.
    """
    is_folder = path.is_dir()
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if not (is_folder and error.errno in _NOT_SYNCED):
            raise
        if error.errno == errno.EIO:
            _warn_once(_NO_SYNC, path, str(error.strerror))


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
