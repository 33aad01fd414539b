"""Locks of open files by `flock`, which some file systems do not keep.

Lustre mounted without flock, DVS and some NFS and FUSE refuse every lock. Work there continues
without locks; callers say so, or do what needs none.
"""

from __future__ import annotations

import errno
import fcntl
import io

# The number that the kernel's NFS lets through; Python has no name for it.
_ENOTSUPP = 524
_KEEPS_NONE = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, _ENOTSUPP)


def lock(file: io.IOBase, *, wait: bool = False) -> str:
    """Lock a file, open for writing, until it is closed.

    Args:
        wait: until another process has unlocked it.

    Returns:
        Why the file system keeps no locks; empty where the file is locked.

    Raises:
        BlockingIOError: another process, or another open file of this one, holds the lock.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno not in _KEEPS_NONE:
            raise
        return error.strerror or str(error)
    return ""
