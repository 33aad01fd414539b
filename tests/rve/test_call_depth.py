"""How many files a reader has to open who follows one warm call of the true law."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numba.core.registry import CPUDispatcher

import surrofe2
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.newton import chord, newton

PACKAGE = Path(surrofe2.__file__).parent
MOST_FILES = 16


def python_files(call):
    """Files of the package whose functions run during the call."""
    found = set()

    def note(frame, event, _):
        if event == "call":
            found.add(Path(frame.f_code.co_filename))

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return {path for path in found if PACKAGE in path.parents}


def kernel_files(kernel, seen):
    """Files of the kernels that a kernel may call, itself included, and of the lanes they use."""
    if kernel in seen:
        return set()
    seen.add(kernel)
    function = kernel.py_func
    files = {Path(function.__code__.co_filename)}
    for name in function.__code__.co_names:
        other = function.__globals__.get(name)
        if isinstance(other, CPUDispatcher):
            files |= kernel_files(other, seen)
        elif name in ("load", "store"):
            files.add(PACKAGE / "simd.py")
    return files


def test_a_warm_call_and_its_acceptance_stay_within_sixteen_files():
    law = RveLaw(CellParameters.preset("printed"))
    F, F_dot = np.eye(2)[None] + np.full((1, 2, 2), 0.01), np.full((1, 2, 2), 0.001)
    state = law.respond(F, F_dot).state
    answers = []

    def step():
        answers.append(law.respond(F + 1e-4, F_dot, state))
        law.accept(F + 1e-4, F_dot, answers[0])

    files = python_files(step)
    assert answers[0].effort["newton_solves"] == 0
    seen = set()
    files |= kernel_files(chord, seen) | kernel_files(newton, seen)
    names = sorted(path.relative_to(PACKAGE).as_posix() for path in files)
    assert {"rve/rve_law.py", "plant_cell/contact.py", "simd.py"} <= set(names)
    assert len(names) <= MOST_FILES, names
