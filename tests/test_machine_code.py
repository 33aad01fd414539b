"""A kernel's machine code is its own: no other kernel of a process stands in for parts of it."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from surrofe2.machine_code import OwnCode

KERNELS = """
import sys
import numpy as np
from surrofe2.compilation import kernel

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


def test_all_but_the_entries_are_private(module, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(module / "kept"))
    monkeypatch.syspath_prepend(module)
    import kernels

    kernels.outer(np.linspace(0.1, 2.0, 13))
    (made,) = kernels.outer.overloads.values()
    assert isinstance(made.library, OwnCode)
    shared = {"linkonce_odr", "linkonce_any", "weak_odr", "weak_any"}
    functions = list(made.library.get_defined_functions())
    assert not [function.name for function in functions if function.linkage.name in shared]
    assert any("inner" in function.name for function in functions)
    assert [function.name for function in functions if function.linkage.name == "internal"]


def test_a_kept_kernel_serves_those_compiled_later(module):
    """What could be taken from it is read when another kernel takes it."""
    hits = "k.stats.cache_hits.total()"
    first = said(module, A, "print(inner(a.copy()).hex())")
    again = said(
        module,
        A,
        "k = inner; (value := inner(a.copy()))",
        f"print(value.hex(), {hits}, k.overloads[k.signatures[0]].library._shared_module is None)",
        f"k = outer; print(outer(a.copy()).hex(), {hits})",
    )
    assert again[:3] == [*first, "1", "True"]
    assert again[4] == "0"
    assert said(module, A, "print(outer(a.copy()).hex())") == [again[3]]


def test_kernels_of_others_are_left_as_they_are():
    import numba

    @numba.njit
    def another(x):
        return x + 1.0

    assert another(1.0) == 2.0
    (made,) = another.overloads.values()
    assert not isinstance(made.library, OwnCode)
