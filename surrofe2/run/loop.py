"""The loop of every run: steps with progress, checkpoints and interrupts; and how work reports."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from time import monotonic
from typing import Any, Protocol, TypeVar

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.interruption import interruptible

Run = TypeVar("Run")
# A function that is called with how much is done, and a remark.
Report = Callable[[float, str], None]
# A function that begins to display a stage: what is done, how much of it, in which unit.
Stage = Callable[[str, float, str], AbstractContextManager[Report]]

# Largest fraction of the time of a run that its checkpoints may take.
SHARE = 0.05


# A function that is called with (t, duration) after every step; True: a line of the standard error
# shows it.
Progress = Callable[[float, float], None] | bool | None
# Seconds between two lines of progress.
_EVERY = 0.5


class ShownProgress:
    """Shows how much of a run is done on a line of the standard error, for scripts and notebooks.

    The line is written over again until `close` ends it.
    """

    def __init__(self) -> None:
        self._began = monotonic()
        self._due = self._began

    def __call__(self, t: float, duration: float) -> None:
        """Write the line again, where that is due or the run has ended."""
        now = monotonic()
        if now < self._due and t != duration:
            return
        self._due = now + _EVERY
        share = t / duration if duration else 1.0
        seconds = now - self._began
        text = f"{100.0 * share:5.1f} % of {duration:g} in {seconds:.0f} s"
        if 0.0 < share < 1.0:
            text += f", about {seconds * (1.0 - share) / share:.0f} s left"
        sys.stderr.write(f"\r{text:<60}")
        sys.stderr.flush()

    def close(self) -> None:
        """End the line, however the run ended; what is printed next begins one of its own."""
        sys.stderr.write("\n")
        sys.stderr.flush()


class CheckpointClock:
    """Decides after a step whether a checkpoint is due; results do not depend on it.

    A checkpoint is due `interval` seconds after the last one, or later where that took long.
    """

    def __init__(self, interval: float) -> None:
        if not interval >= 0.0:
            raise InputError(f"checkpoint_interval: {interval}; it must be a number of at least 0")
        self._interval = interval
        self._due = monotonic() + interval

    def is_due(self) -> bool:
        """Return whether a checkpoint is due."""
        return monotonic() >= self._due

    def write(self, checkpoint: Callable[[], None]) -> None:
        """Let a call write a checkpoint; the time that it takes decides when the next is due."""
        began = monotonic()
        checkpoint()
        now = monotonic()
        if self._interval > 0.0:
            self._due = now + max(self._interval, (1.0 / SHARE - 1.0) * (now - began))


class Recorder(Protocol):
    """A run as far as it is recorded."""

    @property
    def may_be_kept(self) -> bool:
        """True if a checkpoint may be taken upon an interrupt now."""

    def checkpoint(self) -> Any:
        """Return a state that carries the run on, in memory of its own."""


def carry_out(
    steps: Iterable[float],
    recorder: Recorder,
    results: Callable[[bool], Run],
    duration: float,
    *,
    progress: Progress,
    checkpoint: Callable[[Any], None] | None,
    interval: float,
) -> Run:
    """Take all `steps` of a run, and return its results.

    Args:
        steps: each of them records itself and yields the time reached, µs.
        recorder: has the state of the run.
        results: makes the results so far, called with whether the run is finished.
        duration: of the run, for the progress.
        progress: called with (t, duration) in µs after every step; True: a line of the standard
            error shows it.
        checkpoint: called with `recorder.checkpoint()` every `interval` seconds, as of
            `CheckpointClock`, and upon an interrupt, which then continues.

    Raises:
        SimulationError: of a step; `partial` is the run up to there.
    """
    import numpy as np  # late: help needs none of it

    due = CheckpointClock(interval)
    shown = ShownProgress() if progress is True else None
    show = shown if isinstance(progress, bool) else progress
    try:
        # A number that vanishes beside others may underflow, whatever the caller has set numpy to
        # do.
        with interruptible(), np.errstate(under="ignore"):
            for t in steps:
                if show is not None:
                    show(t, duration)
                if checkpoint is not None and due.is_due():
                    # The copy of the state takes time as well, so it is made within.
                    due.write(lambda: checkpoint(recorder.checkpoint()))
    except SimulationError as error:
        raise SimulationError(str(error), partial=results(False)) from error
    except KeyboardInterrupt:
        if checkpoint is not None and recorder.may_be_kept:
            checkpoint(recorder.checkpoint())
        raise
    finally:
        if shown is not None:
            shown.close()
    return results(True)


def no_report(done: float, note: str = "") -> None:
    """Display nothing of the work."""


def no_stage(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
    """Display nothing of a stage."""
    return nullcontext(no_report)
