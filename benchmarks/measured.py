"""Measured figures by name, and the one file that holds them; `pages` writes them into pages."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from typing import Any

import numba

ROOT = Path(__file__).parents[1]
MEASURED = ROOT / "docs" / "measured.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One measured figure and how to measure it again.

    Attributes:
        value: in `unit`; the median where it was repeated.
        about: what was measured, in words.
        spread: interquartile range of the repeats, in `unit`; None: measured once.
        at_least, at_most: what must hold; None: nothing.
        date, version, machine, command: when, of what, where and how it was measured.
    """

    value: float
    unit: str
    about: str
    spread: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    date: str
    version: str
    machine: str
    command: str

    @property
    def holds(self) -> bool | None:
        """Whether the limit is kept; None where there is none."""
        if self.at_least is None and self.at_most is None:
            return None
        low = -float("inf") if self.at_least is None else self.at_least
        high = float("inf") if self.at_most is None else self.at_most
        return isfinite(self.value) and low <= self.value <= high

    def __str__(self) -> str:
        if not self.unit and self.value.is_integer():  # a count
            return f"{self.value:,.0f}"
        return f"{number(self.value)} {self.unit}".rstrip()


def number(value: float) -> str:
    """Two or three significant digits, without an exponent; whole numbers by thousands."""
    if value == 0.0 or abs(value) >= 100.0:
        return f"{value:,.0f}"
    if abs(value) >= 10.0:
        return f"{value:.1f}".removesuffix(".0")
    digits = 2
    while abs(value) < 10.0 ** (1 - digits) and digits < 12:
        digits += 1
    return f"{value:.{digits}f}"


@dataclass(slots=True)
class Bench:
    """A run of the benchmarks: collects figures.

    Attributes:
        quick: less of everything, to try the benchmarks themselves; limits are not judged.
        out: folder of the runs.
        command: what measures the figures that come, which each of them states.
    """

    quick: bool
    out: Path
    command: str = "python -m benchmarks"
    figures: dict[str, Figure] = field(default_factory=dict)

    def pick(self, full: Any, quick: Any) -> Any:
        """The value for this mode."""
        return quick if self.quick else full

    def add(self, name: str, value: float, unit: str, about: str, **more: float | None) -> None:
        """Record a figure, `more` as in `Figure`, and print it."""
        limits: dict[str, Any] = {
            k: v for k, v in more.items() if not (self.quick and k.startswith("at_"))
        }
        figure = Figure(
            value=float(value),
            unit=unit,
            about=about,
            date=datetime.now(UTC).date().isoformat(),
            version=version("surrofe2"),
            machine=machine(),
            command=self.command,
            **limits,
        )
        self.figures[name] = figure
        verdict = {None: "", True: "  (kept)", False: "  (LIMIT MISSED)"}[figure.holds]
        print(f"  {figure!s:>14}  {name}: {about}{verdict}", flush=True)

    def add_group(self, group: str, rows: Iterable[tuple]) -> None:
        """Record figures of a group, each (name, value, unit, about) and perhaps its limits."""
        for name, value, unit, about, *limits in rows:
            self.add(f"{group}.{name}", value, unit, about, **dict(*limits))


def machine() -> str:
    """Processor and threads, as far as the system tells."""
    name = platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    except OSError:
        pass  # not Linux: the architecture has to do
    return f"{name}, {numba.config.NUMBA_NUM_THREADS} threads"


def read(path: Path = MEASURED) -> dict[str, Figure]:
    """The figures of a file by name; none where there is no file."""
    if not path.exists():
        return {}
    stored = json.loads(path.read_text(encoding="utf-8"))
    return {name: Figure(**each) for name, each in stored.items()}


def merge(path: Path, figures: Mapping[str, Figure]) -> None:
    """Write figures into a file; others that it has stay."""
    every = read(path) | dict(figures)
    text = {
        name: {k: v for k, v in asdict(every[name]).items() if v is not None}
        for name in sorted(every)
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(text, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
