"""How many threads are worth their waiting for each other.

The threads of a leap meet twice a step, every 0.1 ms or so. Where another process takes one of
the cores, all wait for the one that lacks it, and fewer threads are faster. Results do not depend
on the number of threads, so it is chosen by the clock, time and again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import numba

TILES_PER_THREAD = 4
"""Tiles below which another thread is not even tried."""
TRIAL_INTERVAL = 40
"""Every so many pieces of work another number of threads is tried again."""
SHORTEST = 10
"""Steps below which a piece of work tells nothing about speed."""


class ThreadChoice:
    """Sets the number of threads for pieces of work in `tiles` tiles, and learns from each."""

    def __init__(self, tiles: int) -> None:
        self._most = max(1, tiles // TILES_PER_THREAD)
        self._seconds: dict[int, float] = {}
        self._pieces = 0

    @contextmanager
    def set_for(self, steps: int) -> Iterator[None]:
        """The best number of threads known, within the block, for work of so many steps."""
        allowed = numba.get_num_threads()
        threads = self._next(min(allowed, self._most), steps)
        numba.set_num_threads(threads)
        begin = perf_counter()
        try:
            yield
        finally:
            numba.set_num_threads(allowed)
            if steps >= SHORTEST:
                self._learn(threads, (perf_counter() - begin) / steps)

    def _learn(self, threads: int, seconds: float) -> None:
        """A trial counts as it is; one slow piece of the best does not yet make it another's."""
        known = self._seconds
        if known and threads == min(known, key=known.__getitem__):
            seconds = 0.5 * (seconds + known[threads])
        known[threads] = seconds

    def _next(self, most: int, steps: int) -> int:
        choices = sorted({1, max(1, most // 2), most}, reverse=True)
        known = {n: self._seconds[n] for n in choices if n in self._seconds}
        if steps < SHORTEST:
            return min(known, key=known.__getitem__, default=most)
        self._pieces += 1
        untried = [n for n in choices if n not in known]
        if untried:
            return untried[0]
        if self._pieces % TRIAL_INTERVAL == 0:
            return choices[self._pieces // TRIAL_INTERVAL % len(choices)]
        return min(known, key=known.__getitem__)
