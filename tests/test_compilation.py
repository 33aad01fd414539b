"""Machine code belongs to the sources it is run with."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import surrofe2

PACKAGE = Path(surrofe2.__file__).parent

# A kernel that bakes in a constant of a file without kernels: 7 inputs of a law. It changes as
# many entries of `extent`.
INPUTS = """
import numpy as np
from surrofe2.cache.table.ellipsoids import set_bound
extent = np.zeros(9)
set_bound(np.ones(9), 20.0, np.eye(9), extent)
print((extent != 0.0).sum(), set_bound.stats.cache_hits.total(),
      set_bound.stats.cache_misses.total())
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that nothing else runs."""
    shutil.copytree(PACKAGE, tmp_path / "surrofe2", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "surrofe2"


def inputs_of_a_law(copy):
    """What the copy's kernel answers in a new process: inputs, cache hits, cache misses."""
    folders = {"PYTHONPATH": str(copy.parent), "NUMBA_CACHE_DIR": str(copy.parent / "kernels")}
    done = subprocess.run(
        [sys.executable, "-c", INPUTS],
        env={**os.environ, **folders},
        cwd=copy.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return tuple(int(number) for number in done.stdout.split())


def test_an_edited_constant_of_another_file_is_compiled_anew(copy):
    assert inputs_of_a_law(copy) == (7, 0, 1)
    assert inputs_of_a_law(copy) == (7, 1, 0)
    constants = copy / "tensors.py"
    text = constants.read_text(encoding="utf-8")
    assert "surrofe2.compilation" not in text
    assert text.count("\nINPUTS = 7\n") == 1
    constants.write_text(text.replace("\nINPUTS = 7\n", "\nINPUTS = 5\n"), encoding="utf-8")
    assert inputs_of_a_law(copy) == (5, 0, 1)


def test_the_digest_covers_every_source_file(copy):
    def digest():
        code = "from surrofe2.compilation import source_digest; print(source_digest())"
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONPATH": str(copy.parent)},
            cwd=copy.parent,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    seen = [digest()]
    for name in ("units.py", "cli/console.py", "surrogate/__init__.py"):
        source = copy / name
        source.write_text(source.read_text(encoding="utf-8") + "# another\n", encoding="utf-8")
        seen.append(digest())
    assert len(set(seen)) == 4
