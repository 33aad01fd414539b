"""Commands on machines that lack what others have."""

import os

import numpy as np
import pytest

from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.run_folder import read_run
from surrofe2.workflow.run import run_study
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


@pytest.mark.slow
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
limit = int(float(sys.argv[1]) * 1e9)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
sys.argv = ["surrofe2", *sys.argv[2:]]
from surrofe2.__main__ import main
main()
"""


def test_a_recipe_is_checked_where_the_address_space_is_limited(recipe_path):
    """As `ulimit -v` and queues of batch systems limit it, here to 1 GB."""
    one = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = python("-c", LIMITED, 1.0, "check", recipe_path, "--only", env=one)
    assert "no problem found" in done.stdout


def test_a_run_needs_no_more_than_that_much_address_space(changed_recipe, tmp_path):
    """1.2 GB, with kernels compiled: the compiler may take more."""
    path = changed_recipe("duration = 4.0", "duration = 1.0")
    run_study(load_recipe(path), "rve", tmp_path / "whole")
    one = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    words = ("run", path, "--law", "rve", "--threads", 1, "--out", tmp_path / "limited")
    python("-c", LIMITED, 1.2, *words, env=one)
    limited, whole = (read_run(tmp_path / name).curve for name in ("limited", "whole"))
    far = abs(whole.displacement).max()
    np.testing.assert_allclose(limited.displacement, whole.displacement, rtol=0.0, atol=1e-9 * far)
