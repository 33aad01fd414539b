"""The journal of a run: rows behind rows, marks to go back to, states as arrays."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.run.journal import Journal, RunState
from surrofe2.run.loop import SHARE, CheckpointClock, carry_out


@dataclass(frozen=True, slots=True)
class State(RunState):
    SERIES: ClassVar[tuple[str, ...]] = ("rows", "frames.t")
    t: float
    journal: Journal
    counts: dict[str, int]
    mark: "State | None" = None


def grown(rows, times):
    journal = Journal.of({"rows": np.empty((0, 2)), "frames.t": np.empty(0)})
    for row, t in zip(rows, times, strict=True):
        journal = journal.written({"rows": row[None], "frames.t": [t] if t % 2 else []})
    return journal


def test_a_longer_journal_leaves_the_shorter_ones_as_they_were(rng):
    rows = rng.uniform(size=(9, 2))
    journals = [Journal.of({"rows": rows[:1]})]
    for row in rows[1:]:
        journals.append(journals[-1].written({"rows": row[None]}))
    for k, journal in enumerate(journals):
        np.testing.assert_array_equal(journal["rows"], rows[: k + 1])
    # rows are not copied at every step
    assert journals[8].room["rows"] is journals[7].room["rows"]


def test_a_mark_is_gone_back_to_and_a_copy_keeps_what_is_written_over(rng):
    rows = rng.uniform(size=(6, 2))
    mark = grown(rows[:4], range(4))
    taken_back = mark.written({"rows": rows[4:5]})
    kept = taken_back.copy()
    again = mark.written({"rows": rows[5:6]})
    np.testing.assert_array_equal(again["rows"], rows[[0, 1, 2, 3, 5]])
    np.testing.assert_array_equal(kept["rows"], rows[:5])
    np.testing.assert_array_equal(mark.part("frames")["t"], [1.0, 3.0])


def test_state_comes_back_from_its_arrays_with_its_mark(rng):
    rows = rng.uniform(size=(3, 2))
    mark = State(1.0, grown(rows[:2], range(2)), {"steps": 2})
    state = State(2.5, grown(rows, range(3)), {"steps": 3}, mark)
    arrays = state.to_arrays()
    back = State.from_arrays(arrays)
    found = [(each.t, each.counts) for each in (back, back.mark)]
    assert found == [(2.5, {"steps": 3}), (1.0, {"steps": 2})]
    np.testing.assert_array_equal(back.journal["rows"], rows)
    np.testing.assert_array_equal(back.mark.journal["rows"], rows[:2])
    for name in ("t", "rows", "frames.t"):
        with pytest.raises(InputError, match=f"no '{name}'; the checkpoint is incomplete"):
            State.from_arrays({k: v for k, v in arrays.items() if k != name})


class Recorded:
    may_be_kept = True

    def __init__(self):
        self.steps, self.told, self.states = [], [], []

    def checkpoint(self):
        return tuple(self.steps)

    def run(self, finished):
        return finished, tuple(self.steps)

    def to(self, end, fault=None):
        for t in range(1, end + 1):
            if fault is not None and t == 3:
                raise fault
            self.steps.append(t)
            yield float(t)


def carried_out(recorded, fault=None, interval=0.0):
    return carry_out(
        recorded.to(4, fault), recorded, recorded.run, 4.0, interval=interval,
        progress=lambda *told: recorded.told.append(told), checkpoint=recorded.states.append,
    )  # fmt: skip


def test_loop_reports_and_checkpoints_every_step():
    recorded = Recorded()
    assert carried_out(recorded) == (True, (1, 2, 3, 4))
    assert recorded.told == [(float(t), 4.0) for t in range(1, 5)]
    assert recorded.states == [(1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)]


def test_failure_gives_the_run_up_to_there():
    with pytest.raises(SimulationError, match="collapsed") as caught:
        carried_out(Recorded(), SimulationError("collapsed"))
    assert caught.value.partial == (False, (1, 2))


@pytest.mark.parametrize("may_be_kept", [True, False])
def test_interrupt_leaves_a_checkpoint_where_it_may_be_kept(may_be_kept):
    recorded = Recorded()
    recorded.may_be_kept = may_be_kept
    with pytest.raises(KeyboardInterrupt):
        carried_out(recorded, KeyboardInterrupt(), 60.0)
    assert recorded.states == ([(1, 2)] if may_be_kept else [])


@pytest.mark.parametrize("interval", [-1.0, float("nan")])
def test_interval_must_be_a_number_of_at_least_zero(interval):
    with pytest.raises(InputError, match=r"checkpoint_interval: .* at least 0"):
        CheckpointClock(interval)


def test_the_time_to_copy_a_state_counts_among_that_of_its_checkpoint(monkeypatch):
    """A copy takes 1 s and a step 1 s: checkpoints are 5 % of the run only if the copy counts."""
    now = [0.0]
    monkeypatch.setattr("surrofe2.run.loop.monotonic", lambda: now[0])

    class Slow(Recorded):
        def checkpoint(self):
            now[0] += 1.0
            return super().checkpoint()

    recorded = Slow()

    def steps():
        for t in range(1, 201):
            now[0] += 1.0
            recorded.steps.append(t)
            yield float(t)

    carry_out(steps(), recorded, recorded.run, 200.0, interval=0.5, progress=None,
              checkpoint=recorded.states.append)  # fmt: skip
    assert 200 * SHARE / (1.0 - SHARE) - 1.0 <= len(recorded.states) <= 1 + 200 * SHARE
