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
from surrofe2.cache.table.records import set_bound
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


def start(copy, setting="", **environment):
    """A process of the copy's kernel, and what it says."""
    given = {"PYTHONPATH": str(copy.parent), "NUMBA_CACHE_DIR": str(copy.parent / "kernels")}
    return subprocess.Popen(
        [sys.executable, "-c", setting + INPUTS],
        env={**os.environ, **given, **environment},
        cwd=copy.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def inputs_of_a_law(process):
    """What the copy's kernel answers: inputs, cache hits, cache misses."""
    out, told = process.communicate()
    assert (process.returncode, told) == (0, "")
    return tuple(int(number) for number in out.split())


def test_two_first_starts_at_once_and_an_edited_constant_of_another_file(copy):
    """The second start reads what the first kept; a change of any source file compiles anew."""
    assert [inputs_of_a_law(process)[0] for process in [start(copy), start(copy)]] == [7, 7]
    assert inputs_of_a_law(start(copy)) == (7, 1, 0)
    constants = copy / "base" / "tensors.py"
    text = constants.read_text(encoding="utf-8")
    assert "surrofe2.base.compilation" not in text
    assert text.count("\nINPUTS = 7\n") == 1
    constants.write_text(text.replace("\nINPUTS = 7\n", "\nINPUTS = 5\n"), encoding="utf-8")
    assert inputs_of_a_law(start(copy)) == (5, 0, 1)


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
    ("setting", "why"), [(NO_HOME, "Not a directory"), (FULL, "File too large")]
)
def test_without_a_place_to_keep_them_kernels_are_compiled_in_memory(copy, setting, why):
    process = start(copy, setting)
    out, told = process.communicate()
    assert process.returncode == 0, told
    assert out.split()[:2] == ["7", "0"]
    (line,) = told.splitlines()
    assert "kernels are compiled in memory and not kept, which takes a minute: " in line
    assert why in line
    assert not [*copy.parent.rglob("*.nbc")]


DAMAGES = {
    "a flipped bit in machine code": ("*.nbc", lambda content: flipped(content, 0.5)),
    "truncated code": ("*.nbc", lambda content: content[: len(content) // 2]),
    "empty code": ("*.nbc", lambda content: b""),
    "a flipped bit in an index": ("*.nbi", lambda content: flipped(content, 0.3)),
    "an empty index": ("*.nbi", lambda content: b""),
}


def flipped(content, place):
    k = int(place * len(content))
    return content[:k] + bytes([content[k] ^ 16]) + content[k + 1 :]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_kernel_is_compiled_again_with_one_note(copy, damage):
    pattern, change = DAMAGES[damage]
    assert inputs_of_a_law(start(copy))[0] == 7
    files = [*(copy.parent / "kernels").rglob(pattern)]
    assert files
    for path in files:
        path.write_bytes(change(path.read_bytes()))
    process = start(copy)
    out, said = process.communicate()
    assert process.returncode == 0, said
    assert out.split()[0] == "7"
    (line,) = said.splitlines()
    assert "damaged files of compiled kernels; they are compiled again" in line
    assert inputs_of_a_law(start(copy)) == (7, 1, 0)


TUPLE = """
from typing import NamedTuple
import numpy as np
class Pair(NamedTuple):
    {first}: float
    {second}: float
"""
CALL = """
from surrofe2.base.compilation import kernel
@kernel
def first(pair):
    return pair.first
"""
SHOWN = """
from tuples import Pair
from taking import first
print(int(first(Pair(first=3.0, second=5.0))), first.stats.cache_hits.total())
"""


def test_a_named_tuple_whose_fields_have_changed_places(tmp_path):
    """Neither the kernel's file nor the signature has changed."""
    (tmp_path / "taking.py").write_text(CALL, encoding="utf-8")
    shown = []
    for first, second in (("first", "second"), ("first", "second"), ("second", "first")):
        text = TUPLE.format(first=first, second=second)
        (tmp_path / "tuples.py").write_text(text, encoding="utf-8")
        run = subprocess.run(
            [sys.executable, "-B", "-c", SHOWN],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
            cwd=tmp_path, capture_output=True, text=True, check=True,
        )  # fmt: skip
        shown.append(run.stdout.split())
    assert shown == [["3", "0"], ["3", "1"], ["3", "0"]]
    (tmp_path / "tuples.py").rename(tmp_path / "renamed.py")
    other = SHOWN.replace("tuples", "renamed")
    run = subprocess.run(
        [sys.executable, "-B", "-c", other],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (run.returncode, run.stdout.split()[:1]) == (0, ["3"]), run.stderr
