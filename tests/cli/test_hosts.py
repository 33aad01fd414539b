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


LIMITED = """
import resource, sys
limit = 1_000_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
sys.argv = ["surrofe2", *sys.argv[1:]]
from surrofe2.__main__ import main
main()
"""


def test_a_recipe_is_checked_where_the_address_space_is_limited(recipe_path):
    """As `ulimit -v` and queues of batch systems limit it, here to 1 GB."""
    one = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = python("-c", LIMITED, "check", recipe_path, "--only", env=one)
    assert "no problem found" in done.stdout
