"""What work costs in seconds, added up over all calls that did it, and from when it pays."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba

from surrofe2.compilation import clock, cpu_clock
from surrofe2.settings import check_value


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """Seconds of wall and of CPU, of all threads and processes; most threads; the machines."""

    wall: float = 0.0
    cpu: float = 0.0
    threads: int = 0
    machine: str = ""

    def __add__(self, other: Cost) -> Cost:
        machines = dict.fromkeys(each for each in (self.machine, other.machine) if each)
        return Cost(
            wall=self.wall + other.wall,
            cpu=self.cpu + other.cpu,
            threads=max(self.threads, other.threads),
            machine=" + ".join(machines),
        )

    @classmethod
    def of(cls, entries: Mapping[str, Any]) -> Cost:
        """From the entries of `to_dict`.

        Raises:
            InputError: one of them is not what it must be.
        """
        kinds = {"wall": float, "cpu": float, "threads": int, "machine": str}
        return cls(
            **{name: check_value(f"cost.{name}", entries[name], kinds[name], {}) for name in kinds}
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    def to_json(self) -> str:
        """As files have it."""
        return json.dumps(self.to_dict(), ensure_ascii=False)


NOTHING = Cost()


class Meter:
    """Measures from now on, after what an earlier call has spent; compilation is not counted."""

    def __init__(self, before: Cost = NOTHING) -> None:
        self._before = before
        self._wall, self._cpu = clock(), cpu_clock()

    def add_cpu(self, seconds: float) -> None:
        """Take in what another process has spent."""
        self._cpu -= seconds

    @property
    def cost(self) -> Cost:
        """All until now."""
        return self._before + Cost(
            wall=clock() - self._wall,
            cpu=cpu_clock() - self._cpu,
            threads=numba.get_num_threads(),
            machine=machine(),
        )


@cache
def machine() -> str:
    """Processor and number of cores; nothing that identifies the machine."""
    return f"{processor()}, {os.cpu_count()} cores"


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
    """A run through a cache against the true one, with what the cache cost to make; wall, s.

    Attributes:
        made: of data set, training and calibration; None where that is not known.
        run, true: of the two runs.
    """

    made: float | None
    run: float
    true: float

    @property
    def gain(self) -> float | None:
        """How many times faster than the true run with everything counted."""
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
            return "what its surrogate cost is not known; train it anew to have it counted"
        text = (
            f"{self.made:.3g} s to make and {self.run:.3g} s to run against {self.true:.3g} s: "
            f"{self.gain:.2g} times as fast with everything counted"
        )
        if self.pays_from is None:
            return f"{text}; it never pays, since the true run is faster"
        if self.pays_from == 1:
            return f"{text}; it pays from the first run"
        times = self.made / (self.true - self.run)
        return (
            f"{text}; it pays from {self.pays_from} such runs, or from {times:.2g} times the "
            "elements at as many steps"
        )
