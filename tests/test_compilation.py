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

# A kernel that bakes in a constant of a file without kernels: points an element, 5.
POINTS = """
import numpy as np
from surrofe2.macro.internal_force import deformation
still = np.zeros((4, 2))
F, _, _ = deformation(np.arange(4)[None], np.zeros((1, 9, 4, 2)), still, still)
print(len(F), deformation.stats.cache_hits.total(), deformation.stats.cache_misses.total())
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that nothing else runs."""
    shutil.copytree(PACKAGE, tmp_path / "surrofe2", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "surrofe2"


def points_an_element(copy):
    """What the copy's kernel answers in a new process: points, cache hits, cache misses."""
    folders = {"PYTHONPATH": str(copy.parent), "NUMBA_CACHE_DIR": str(copy.parent / "kernels")}
    done = subprocess.run(
        [sys.executable, "-c", POINTS],
        env={**os.environ, **folders},
        cwd=copy.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return tuple(int(number) for number in done.stdout.split())


def test_an_edited_constant_of_another_file_is_compiled_anew(copy):
    assert points_an_element(copy) == (5, 0, 1)
    assert points_an_element(copy) == (5, 1, 0)
    constants = copy / "macro" / "discretisation.py"
    text = constants.read_text(encoding="utf-8")
    assert "surrofe2.compilation" not in text
    assert text.count("\nN_POINTS = 5\n") == 1
    constants.write_text(text.replace("\nN_POINTS = 5\n", "\nN_POINTS = 7\n"), encoding="utf-8")
    assert points_an_element(copy) == (7, 0, 1)


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
