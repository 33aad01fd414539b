"""The number of threads follows the clock."""

from __future__ import annotations

import numba
import pytest

from surrofe2.tissue import threads
from surrofe2.tissue.threads import SHORTEST, TRIAL_INTERVAL, ThreadChoice


class Clock:
    """Work takes seconds[number of threads] a step."""

    def __init__(self, seconds):
        self.now, self.set, self.seconds = 0.0, 4, seconds

    def perf_counter(self):
        return self.now

    def set_num_threads(self, n):
        self.set = n


@pytest.fixture
def clock(monkeypatch):
    clock = Clock({1: 3.0, 2: 2.0, 4: 1.0})
    monkeypatch.setattr(threads, "perf_counter", clock.perf_counter)
    monkeypatch.setattr(numba, "set_num_threads", clock.set_num_threads)
    monkeypatch.setattr(numba, "get_num_threads", lambda: 4)
    return clock


def used(choice, clock, pieces, steps=50):
    """Threads of each of so many pieces of work."""
    numbers = []
    for _ in range(pieces):
        with choice.set_for(steps):
            numbers.append(clock.set)
            clock.now += steps * clock.seconds[clock.set]
        assert clock.set == 4
    return numbers


def test_fastest_number_is_found_and_found_again(clock):
    choice = ThreadChoice(tiles=37)
    assert used(choice, clock, 3) == [4, 2, 1]
    assert used(choice, clock, 5) == [4] * 5
    clock.seconds = {1: 3.0, 2: 8.0, 4: 9.0}  # another process came
    assert used(choice, clock, 4 * TRIAL_INTERVAL)[-2] == 1
    clock.seconds = {1: 3.0, 2: 2.0, 4: 1.0}
    assert used(choice, clock, 4 * TRIAL_INTERVAL)[-2] == 4


def test_small_tissue_has_one_thread(clock):
    assert used(ThreadChoice(tiles=7), clock, 5) == [1] * 5


def test_short_work_tells_nothing(clock):
    choice = ThreadChoice(tiles=37)
    assert used(choice, clock, 3, steps=SHORTEST - 1) == [4, 4, 4]
