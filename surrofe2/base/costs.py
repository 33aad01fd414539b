"""On which processor work was done, and from when a cache pays."""

from __future__ import annotations

import math
import platform
from dataclasses import dataclass
from pathlib import Path

from surrofe2.base.units import number


def processor() -> str:
    """The name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """A run through a cache against one by RVEs, with what the cache took to make; s.

    Attributes:
        made: of data set, training and calibration; None where that is not known.
        run, true: of the two runs.
    """

    made: float | None
    run: float
    true: float

    @property
    def gain(self) -> float | None:
        """How many times faster than the full run with everything counted."""
        return None if self.made is None else self.true / (self.made + self.run)

    @property
    def pays_from(self) -> int | None:
        """The number of such runs from which on it pays; None: never, or not known."""
        if self.made is None or self.true <= self.run:
            return None
        return max(1, math.ceil(self.made / (self.true - self.run)))

    @property
    def sentence(self) -> str:
        """What it comes to."""
        if self.made is None:
            return "the time to make its surrogate is not known; train again to have it counted"
        gain = self.true / (self.made + self.run)
        text = f"including data and training ({number(self.made)} s), " + (
            f"{number(gain, 2)} times faster than full FE²"
            if gain >= 1.0
            else f"{number(1.0 / gain, 2)} times slower than full FE²"
        )
        if self.pays_from is None:
            return f"{text}; it never pays off, since full FE² is faster"
        if self.pays_from == 1:
            return f"{text}; it pays off in the first run"
        times = self.made / (self.true - self.run)
        runs = f"it pays off after {self.pays_from:,} such runs"
        return f"{text}; {runs}, or on {number(times, 2)} times as many elements"
