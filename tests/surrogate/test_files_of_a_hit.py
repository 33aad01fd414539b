"""How many files of the package a warm hit of the cache passes through."""

import sys

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

import surrofe2
from surrofe2.cache import CachedLaw, CacheSettings
from tests.laws import TrueLattice

MOST = 10
INTRINSIC = type(intrinsic(lambda typing: None))


def kernel_files(code, scope, seen):
    """Files of the kernels and instructions that a function names, and of those these name."""
    files = set()
    for name in code.co_names:
        named = scope.get(name)
        if isinstance(named, INTRINSIC):
            files.add(named._defn.__code__.co_filename)
        elif isinstance(named, Dispatcher) and named not in seen:
            seen.add(named)
            plain = named.py_func
            files |= {plain.__code__.co_filename}
            files |= kernel_files(plain.__code__, plain.__globals__, seen)
    return files


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
    package, files, seen = surrofe2.__path__[0], set(), set()
    for code, scope in frames:
        if code.co_filename.startswith(package):
            files |= {code.co_filename, *kernel_files(code, scope, seen)}
    files = {name.removeprefix(package) for name in files if name.startswith(package)}
    assert {"/cache/cached_law.py", "/cache/cost.py", "/simd.py"} <= files
    assert len(files) <= MOST, " ".join(sorted(files))
