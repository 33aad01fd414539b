"""Faults of the disk: each operation of `surrofe2.store.disk` in turn fails, or is the last one."""

import errno
import os
from contextlib import contextmanager
from itertools import count
from unittest import mock

from surrofe2.base.errors import FileError
from surrofe2.store import disk

OPERATIONS = ("create", "write", "sync", "move", "remove", "remove_folder", "make_folder")
KINDS = {"no space": errno.ENOSPC, "input/output error": errno.EIO, "killed": None}


class Killed(BaseException):
    """The process ended here: nothing that it still tries reaches the disk."""


class Fault:
    """Lets the operation number `at` fail, and all that follow it where the process is killed."""

    def __init__(self, kind, at):
        self.code, self.at = KINDS[kind], at
        self.done = 0

    @property
    def happened(self):
        return self.done >= self.at

    def wrap(self, name, operation):
        def faulty(*arguments):
            self.done += 1
            if self.done < self.at or (self.done > self.at and self.code is not None):
                return operation(*arguments)
            if name == "write" and self.done == self.at:
                file, content = arguments
                operation(file, bytes(content)[: len(content) // 2])
            if self.code is None:
                raise Killed
            raise OSError(self.code, os.strerror(self.code))

        return faulty


@contextmanager
def fault_at(kind, at):
    """The operations with a fault in them."""
    fault = Fault(kind, at)
    faulty = {name: fault.wrap(name, getattr(disk, name)) for name in OPERATIONS}
    with mock.patch.multiple(disk, **faulty):
        yield fault


def each_fault(kind, folders, work, stride=1, most=None):
    """The folders in which `work(folder)` met a fault, at its first operation, its second, …

    stride: only every so many operations; most: none beyond this one.

    It must fail by a FileError, which names a file in the folder, or go on without harm.
    """
    for at in count(1, stride) if most is None else range(1, most + 1, stride):
        folder = folders / f"{kind}-{at}".replace(" ", "-").replace("/", "-")
        told = f"{folder}"
        with fault_at(kind, at) as fault:
            try:
                work(folder)
            except Killed:
                pass
            except FileError as error:
                told = str(error)
        assert str(folder) in told
        assert len(told) < 300
        if not fault.happened:
            assert at > 1
            return
        yield folder
