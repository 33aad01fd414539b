"""Machine code belongs to the sources it is run with, and has the same bits in every process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import surrofe2

PACKAGE = Path(surrofe2.__file__).parent

# A kernel that bakes in a constant of a file without kernels: 7 inputs of a law.
PROBE = """
from surrofe2.base.compilation import kernel
from surrofe2.base.tensors import INPUTS

@kernel
def inputs(number):
    return number * INPUTS
"""
INPUTS = """
from surrofe2.probe import inputs
print(inputs(1), inputs.stats.cache_hits.total(), inputs.stats.cache_misses.total())
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that nothing else runs."""
    shutil.copytree(PACKAGE, tmp_path / "surrofe2", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "surrofe2" / "probe.py").write_text(PROBE, encoding="utf-8")
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


KERNELS = """
import sys
import numpy as np
from surrofe2.base.compilation import kernel

@kernel
def inner(a):
    if a.size > 8:  # calls itself, so that it is not written out where it is called
        return inner(a[:8]) - inner(a[8:])
    total = 0.0
    for k in range(a.size):
        total += np.sin(a[k]) / (1.0 + a[k])
    for k in range(a.size):
        a[k] = np.exp(-total * a[k])
    return total + np.arctan(total)

@kernel
def outer(a):
    return inner(a[:5]) * inner(a[5:]) + inner(a)

@kernel
def total(pair):
    return pair.x + pair.y

@kernel
def some_arrays(n):
    return [np.empty((k, 3)) for k in range(1, n)]

"""


@pytest.fixture
def module(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS, encoding="utf-8")
    return tmp_path


def said(module, *lines):
    """What a new process says that has these kernels."""
    folders = {"PYTHONPATH": os.pathsep.join([str(module), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(["from kernels import *", *lines])],
        env={**os.environ, "NUMBA_CACHE_DIR": str(module / "kept"), **folders},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


A = "a = np.linspace(0.1, 2.0, 13)"


def test_a_kernel_has_the_same_bits_whichever_was_compiled_or_read_before(module):
    """It is compiled alone; read after another; compiled into one that was read."""
    first = said(module, A, "print(inner(a.copy()).hex())")
    again = said(
        module,
        A,
        "print(inner(a.copy()).hex(), inner.stats.cache_hits.total())",
        "print(outer(a.copy()).hex(), outer.stats.cache_hits.total())",
        "print(inner(a.copy()).hex())",
    )
    assert again[:2] == [*first, "1"]
    assert again[3:] == ["0", *first]
    assert said(module, A, "print(outer(a.copy()).hex(), inner(a.copy()).hex())") == [
        again[2], *first,
    ]  # fmt: skip


def test_arrays_of_kernels_begin_at_a_line_of_the_cache(module):
    places = said(module, "print(*[a.ctypes.data % 64 for a in some_arrays(40)])")
    assert set(places) == {"0"}


def test_a_class_of_an_argument_may_move(module):
    """Files of the kernel name its old module, which is no source that the kernel depends on."""
    text = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    x: float\n    y: float\n"
    for name in ("pairs", "couples"):
        (module / f"{name}.py").write_text(text, encoding="utf-8")
        assert said(module, f"from {name} import Pair", "print(total(Pair(1.0, 2.0)))") == ["3.0"]
        (module / f"{name}.py").unlink()
