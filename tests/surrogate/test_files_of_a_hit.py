"""How many files of the package a warm hit of the cache passes through."""

import sys

import numpy as np
from numba.core.dispatcher import Dispatcher

import surrofe2
from surrofe2.cache import CachedLaw, CacheSettings
from tests.laws import TrueLattice

MOST = 10


def kernels_of(function, scope, seen):
    """Files of the kernels that a function names, and of those that these name."""
    for name in function.__code__.co_names:
        kernel = scope.get(name)
        if isinstance(kernel, Dispatcher) and kernel not in seen:
            seen.add(kernel)
            plain = kernel.py_func
            kernels_of(plain, plain.__globals__, seen)
    return {kernel.py_func.__code__.co_filename for kernel in seen}


def test_a_hit_touches_few_files(law):
    cached = CachedLaw(law, TrueLattice(), CacheSettings(tolerance=np.inf))
    F, F_dot = np.tile(np.eye(2), (4, 1, 1)), np.zeros((4, 2, 2))
    state = cached.accept(F, F_dot, cached.respond(F, F_dot)).state
    cached.respond(F, F_dot, state)
    frames = []

    def watch(frame, event, argument):
        if event == "call":
            frames.append((frame.f_code, frame.f_globals))

    sys.setprofile(watch)
    try:
        answer = cached.respond(F, F_dot, state)
    finally:
        sys.setprofile(None)
    assert answer.effort["hits"] == 4
    package, files = surrofe2.__path__[0], set()
    for code, scope in frames:
        if code.co_filename.startswith(package):
            files.add(code.co_filename)
            asked = type("Asked", (), {"__code__": code})
            files |= kernels_of(asked, scope, set())
    files = {name.removeprefix(package) for name in files if name.startswith(package)}
    assert "/cache/cached_law.py" in files
    assert len(files) <= MOST, sorted(files)
