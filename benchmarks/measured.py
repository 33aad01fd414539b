"""Measured figures by name, and the one file that README and documentation take them from."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Iterator, Mapping
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


def substitutions(path: Path = MEASURED) -> dict[str, Any]:
    """Texts by the parts of their names: `bar.printed.speed_up` is {{ bar.printed.speed_up }}."""
    tree: dict[str, Any] = {}
    for name, figure in read(path).items():
        *parents, last = name.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = str(figure)
    return tree


README_ROWS = (
    ("error of the surrogate's stress on unseen samples, RMS, of the spread of stress",
     "{}.surrogate_rms", "surrofe2 train"),
    ("largest difference in displacement, cached against full FE²",
     "{}.displacement_error", "surrofe2 compare"),
    ("bar of 4 × 4 elements: cached FE² faster than full FE² by", "{}.speed_up", "surrofe2 study"),
    ("64 × 64 elements, first run with data and training counted", "large.{}.first_run",
     "surrofe2 study data/large-bar.toml"),
    ("full FE² faster than the full particle model by", "tissue.{}.full", "make bench"),
    ("cached FE² faster than the full particle model by", "tissue.{}.cached", "make bench"),
)  # fmt: skip
"""What the table of README says, the name of its figure by preset, and how to see it."""


def readme_table(path: Path = MEASURED) -> Iterator[str]:
    """The lines of README's table of accuracy and speed."""
    figures = read(path)
    yield "| | `printed` | `water` | command |"
    yield "|---|---|---|---|"
    for words, name, command in README_ROWS:
        named = (name.format(preset) for preset in ("printed", "water"))
        values = (str(figures.get(each, "–")) for each in named)
        yield f"| {words} | {' | '.join(values)} | `{command}` |"


TESTS = (
    ("quick", "none", "every behaviour, with few cases"),
    ("slow", "`slow`", "whole studies, installation, the documentation site, more cases"),
    ("nightly", "`nightly` (counts as slow, too)",
     "random kills and faults, fuzzing, 10,000 solves, every benchmark"),
)  # fmt: skip
"""Kinds of tests, their marker and what they are."""


def contributing_table(path: Path = MEASURED) -> Iterator[str]:
    """The lines of CONTRIBUTING's table of tests."""
    figures = read(path)
    yield "| tests | marker | time on two cores | what they are |"
    yield "|---|---|---|---|"
    for name, marker, words in TESTS:
        yield f"| {name} | {marker} | {figures.get(f'tests.{name}', 'not measured')} | {words} |"


TABLES = {"README.md": readme_table, "CONTRIBUTING.md": contributing_table}
"""Tables of figures on pages that Sphinx's substitutions do not reach, between two comments."""


def _parts(page: str) -> tuple[str, str, str]:
    """Text of a page before its table, the table, and the text behind it."""
    text = (ROOT / page).read_text(encoding="utf-8")
    before, mark, rest = text.partition("<!-- measured: python -m benchmarks tables -->\n")
    table, end, after = rest.partition("\n<!-- end -->")
    return before + mark, table, end + after


def table_of(page: str) -> str:
    """The table that a page has."""
    return _parts(page)[1]


def write_tables() -> None:
    """Write the tables of `TABLES` into their pages."""
    for page, table in TABLES.items():
        before, _, after = _parts(page)
        (ROOT / page).write_text(before + "\n".join(table()) + after, encoding="utf-8")
