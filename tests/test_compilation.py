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


TOLD = "kernels are compiled in memory and not kept, which takes a minute: "


def start(copy, setting="", **environment):
    """A process of the copy's kernel, and what it says."""
    command = [sys.executable, "-c", setting + INPUTS]
    given = {"PYTHONPATH": str(copy.parent), "NUMBA_CACHE_DIR": str(copy.parent / "kernels")}
    return subprocess.Popen(
        command,
        env={**os.environ, **given, **environment},
        cwd=copy.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


NO_HOME = """
import os, pwd
def nobody(*_):
    raise KeyError
pwd.getpwuid = nobody
for name in ("HOME", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
    os.environ.pop(name, None)
"""
FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
"""


@pytest.mark.parametrize(
    ("setting", "environment", "why"),
    [
        ("", {"NUMBA_CACHE_DIR": "/dev/null/kernels"}, "Not a directory"),
        (NO_HOME, {}, "Not a directory"),
        (FULL, {}, "File too large"),
    ],
    ids=["unwritable", "no-home", "full-disk"],
)
def test_without_a_place_to_keep_them_kernels_are_compiled_in_memory(
    copy, setting, environment, why
):
    before = sorted(path for path in copy.rglob("*") if path.suffix != ".pyc")
    process = start(copy, setting, **environment)
    out, told = process.communicate()
    assert process.returncode == 0, told
    assert out.split()[:2] == ["7", "0"]
    assert told.count(TOLD) == 1
    assert len(told.splitlines()) == 1
    assert why in told
    assert [p for p in sorted(copy.rglob("*")) if p.suffix != ".pyc" and p.is_file()] == [
        p for p in before if p.is_file()
    ]


def test_two_first_starts_at_once(copy):
    both = [start(copy), start(copy)]
    for process in both:
        out, told = process.communicate()
        assert (out.split()[0], told) == ("7", "")
    assert inputs_of_a_law(copy) == (7, 1, 0)
