"""Files of more than one call of the system reads, and memory for no more than a file has."""

import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.store import store
from surrofe2.store.hdf5 import Kind, read, write
from surrofe2.store.store import check_replaceable, read_bytes, write_json
from tests.processes import python

ANYTHING = Kind("example", 1)

UNDER_A_LIMIT = """
import resource, sys
from pathlib import Path
from surrofe2.store.hdf5 import Kind, read
from surrofe2.store.store import digest, read_bytes, read_json, read_text
taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
limit = taken + 100_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
json, array, large = map(Path, sys.argv[1:])
print(read_json(json), read_text(json)[:1], len(digest(json)))
print(read(array, Kind("example", 1))[1]["x"].sum())
print(len(digest(large)))
try:
    read_bytes(large)
except Exception as error:
    print(type(error).__name__, error)
"""


def test_reading_takes_the_memory_of_the_file(tmp_path):
    """By a process that may have 100 MB more, of files that might have a GB and half the memory."""
    small, array, large = tmp_path / "a.json", tmp_path / "a.h5", tmp_path / "large"
    write_json(small, {"states": 1})
    write(array, ANYTHING, {}, {"x": np.ones(1000)})
    with large.open("wb") as file:
        file.truncate(200_000_000)
    lines = python("-c", UNDER_A_LIMIT, small, array, large).stdout.splitlines()
    assert lines == [
        "{'states': 1} { 64",
        "1000.0",
        "64",
        f"FileError {large}: cannot be read: 0.2 GB; this process has less memory free",
    ]


def test_a_file_is_limited_by_its_size(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("12345")
    assert read_bytes(path, 5) == b"12345"
    assert read_bytes(path, 5, b"12") == b"12345"
    assert read_bytes(path, 1, b"2") == b"1"
    with pytest.raises(FileError, match=r"5e-09 GB; it must have at most 4e-09"):
        read_bytes(path, 4)


@pytest.mark.parametrize("before", range(4, 9))
def test_what_marks_a_file_may_lie_across_blocks(tmp_path, monkeypatch, before):
    monkeypatch.setattr(store, "_BLOCK", 8)
    path = tmp_path / "a"
    path.write_bytes(before * b"-" + b"first" + b"second")
    check_replaceable(path, "example", "first", "second")
    with pytest.raises(FileError, match="not a example"):
        check_replaceable(path, "example", "first", "third")


@pytest.mark.slow
def test_files_of_more_than_two_gigabytes(tmp_path):
    """One call of the system reads or writes 2,147,479,552 bytes at most."""
    path = tmp_path / "a.h5"
    x = np.zeros(2**28 + 1000)
    x[-1] = 7.0
    write(path, ANYTHING, {"note": "large"}, {"x": x})
    assert path.stat().st_size > 2**31
    content = read_bytes(path, 2**32)
    assert len(content) == path.stat().st_size
    del content
    check_replaceable(path, ANYTHING.title, ANYTHING.schema)
    values = read(path, ANYTHING)[1]["x"]
    assert values.shape == x.shape
    assert values[-1] == 7.0
    del values
    with path.open("r+b") as file:
        file.seek(-8, 2)
        file.write(b"\1")
    with pytest.raises(FileError, match="damaged, or changed"):
        read(path, ANYTHING)
