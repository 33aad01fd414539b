"""Commands on machines that lack what others have."""

import os

import pytest

from tests.processes import python

NO_LOCKS = """
import errno, fcntl, os
def flock(file, operation):
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
fcntl.flock = flock
"""
NO_FOLDERS = """
import errno, os, stat
_fsync = os.fsync
def fsync(descriptor):
    if stat.S_ISDIR(os.fstat(descriptor).st_mode):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
    return _fsync(descriptor)
os.fsync = fsync
"""
KEEPS_NONE = "its file system keeps no locks (Function not implemented)"


@pytest.mark.parametrize(
    ("host", "warnings"), [(NO_LOCKS, 1), (NO_FOLDERS, 0)], ids=["no locks", "no folders"]
)
def test_a_disk_with_less_takes_files(tmp_path, host, warnings):
    (tmp_path / "sitecustomize.py").write_text(host)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = python("-m", "surrofe2", "new", tmp_path / "a.toml", env=environment)
    assert done.stderr.count(KEEPS_NONE) == len(done.stderr.splitlines()) == warnings
    files = sorted(path.name for path in tmp_path.iterdir() if path.is_file())
    assert files == ["a.toml", "recipe.schema.json", "sitecustomize.py"]
