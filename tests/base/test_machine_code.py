"""A kernel has the same bits whichever were compiled or read before; its arrays are aligned."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

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
