"""When a checkpoint is due: so often that a kill costs little, and so seldom that they do."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

SHARE = 0.05
"""Of the time of a run, what its checkpoints may take."""


class CheckpointClock:
    """Asked after every step; results do not depend on what it says.

    Args:
        interval: s between checkpoints at least; 0: one is due whenever it is asked.
    """

    def __init__(self, interval: float) -> None:
        self._interval = interval
        self._due = monotonic() + interval

    def is_due(self) -> bool:
        """Whether the interval has passed, and such a time that the last one was cheap."""
        return monotonic() >= self._due

    def write(self, checkpoint: Callable[[], None]) -> None:
        """Let a checkpoint be written; how long that takes decides when the next one is due."""
        began = monotonic()
        checkpoint()
        now = monotonic()
        if self._interval > 0.0:
            self._due = now + max(self._interval, (1.0 / SHARE - 1.0) * (now - began))
