"""Clocks that stand while this process compiles kernels or reads them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, process_time

# Seconds of wall and of CPU in which kernels were compiled or read.
_waited = [0.0, 0.0]
# Times, wall and CPU, when compilations began that are not finished: the kernels that one calls are
# compiled within it.
_begun: list[tuple[float, float]] = []


@contextmanager
def waiting() -> Iterator[None]:
    """Let the clocks stand in the block, in which a kernel is compiled or read."""
    _begun.append((perf_counter(), process_time()))
    try:
        yield
    finally:
        wall, cpu = _begun.pop()
        if not _begun:
            _waited[0] += perf_counter() - wall
            _waited[1] += process_time() - cpu


def clock() -> float:
    """Return seconds of a clock that stands while this process compiles kernels or reads them."""
    now = _begun[0][0] if _begun else perf_counter()
    return now - _waited[0]


def seconds_compiling() -> float:
    """Return the seconds of wall in which this process compiled kernels or read them so far."""
    return _waited[0]


class Meter:
    """Seconds from now on, after those of an earlier call; compilation is not counted."""

    def __init__(self, before: float = 0.0) -> None:
        self._begun = clock() - before

    @property
    def seconds(self) -> float:
        """Seconds until now."""
        return clock() - self._begun


def cpu_clock() -> float:
    """Return seconds of CPU, without those in which kernels are compiled or read."""
    now = _begun[0][1] if _begun else process_time()
    return now - _waited[1]
