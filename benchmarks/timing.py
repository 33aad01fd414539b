"""Wall times: after warm-up, repeated, and side by side where two are compared."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numba
import numpy as np
from threadpoolctl import threadpool_limits

Call = Callable[[], Any]

LEAST = 5e-3
"""Seconds that one sample lasts at least; shorter calls are repeated within it."""


def side_by_side(calls: Sequence[Call], repeats: int) -> list[float]:
    """Median seconds of each call, sampled in turns after one call each that is not counted."""
    numbers = [_number(call) for call in calls]
    samples = np.empty((repeats, len(calls)))
    for turn in samples:
        for k, (call, number) in enumerate(zip(calls, numbers, strict=True)):
            begin = perf_counter()
            for _ in range(number):
                call()
            turn[k] = (perf_counter() - begin) / number
    return [float(median) for median in np.median(samples, axis=0)]


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
