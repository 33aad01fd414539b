"""Wall times: after warm-up, repeated, and side by side where two are compared."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numba
import numpy as np
from threadpoolctl import threadpool_limits

Call = Callable[[], Any]

LEAST = 5e-3
"""Seconds that one sample lasts at least; shorter calls are repeated within it."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds a call, one entry a sample."""

    samples: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median, s."""
        return float(np.median(self.samples))

    @property
    def spread(self) -> float:
        """Interquartile range, s."""
        low, high = np.percentile(self.samples, (25, 75))
        return float(high - low)


def time_calls(call: Call, repeats: int) -> Timing:
    """Seconds a call of `call`, after one call that is not counted."""
    return side_by_side([call], repeats)[0]


def side_by_side(calls: Sequence[Call], repeats: int) -> list[Timing]:
    """Seconds a call of each, sampled in turns after one call each that is not counted."""
    numbers = [_number(call) for call in calls]
    samples: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for call, number, taken in zip(calls, numbers, samples, strict=True):
            begin = perf_counter()
            for _ in range(number):
                call()
            taken.append((perf_counter() - begin) / number)
    return [Timing(tuple(taken)) for taken in samples]


def ratio(slow: Timing, fast: Timing) -> float:
    """Median over neighbouring samples of slow / fast."""
    return float(np.median(np.divide(slow.samples, fast.samples)))


def _number(call: Call) -> int:
    call()
    begin = perf_counter()
    call()
    return max(1, int(np.ceil(LEAST / max(perf_counter() - begin, 1e-9))))


@contextmanager
def threads(count: int) -> Iterator[None]:
    """At most so many threads for numba, BLAS and, if it is loaded, torch."""
    torch = sys.modules.get("torch")
    before = numba.get_num_threads()
    torch_before = torch.get_num_threads() if torch else 0
    numba.set_num_threads(count)
    if torch:
        torch.set_num_threads(count)
    try:
        with threadpool_limits(count):
            yield
    finally:
        numba.set_num_threads(before)
        if torch:
            torch.set_num_threads(torch_before)


def all_cores() -> int:
    """Threads that numba may use on this machine."""
    return int(numba.config.NUMBA_NUM_THREADS)
