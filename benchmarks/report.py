"""Results as JSON and as tables in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.row import Row
from surrofe2.store.run_folder import describe_platform
from surrofe2.store.store import write_json, write_text

SCHEMA, SCHEMA_VERSION = "surrofe2-benchmarks", 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one benchmark found; `failure`: why it found nothing."""

    name: str
    title: str
    rows: Sequence[Row] = ()
    failure: str | None = None
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "name": self.name,
            "title": self.title,
            "failure": self.failure,
            "seconds": round(self.seconds, 1),
            "rows": [row.to_dict() for row in self.rows],
        }


def make_report(outcomes: Sequence[Outcome], *, quick: bool, load: float) -> dict[str, Any]:
    """Everything of a run of the benchmarks, as JSON can hold it.

    load: processes that kept the machine busy when the run began.
    """
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "version": version("surrofe2"),
        "mode": "quick" if quick else "full",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "platform": describe_platform(),
        "load_before": round(load, 2),
        "benchmarks": [outcome.to_dict() for outcome in outcomes],
    }


def write_report(folder: Path, report: Mapping[str, Any], outcomes: Sequence[Outcome]) -> None:
    """benchmarks.json and benchmarks.md in a folder."""
    write_json(folder / "benchmarks.json", report)
    write_text(folder / "benchmarks.md", to_markdown(report, outcomes))


def to_markdown(report: Mapping[str, Any], outcomes: Sequence[Outcome]) -> str:
    """A page with a table for each benchmark."""
    machine = report["platform"]
    libraries = ", ".join(f"{name} {machine[name]}" for name in ("numpy", "numba", "torch"))
    head = f"""\
# Benchmarks

Written by `make bench`; do not edit. surrofe2 {report["version"]}, {report["mode"]} mode,
{report["date"][:10]}, {machine["processor"]}, {machine["cores"]} cores, {machine["system"]},
Python {machine["python"]}, {libraries}; load average before: {report["load_before"]:g}.

Medians of repeats after warm-up and compilation, ± half their interquartile range. What is
compared was timed in turns in one process; × is how many times the other took as long. Double
precision and one thread unless said. A limit that is not kept reads **missed**.
"""
    return head + _limits(outcomes) + "".join(_section(outcome) for outcome in outcomes)


def _limits(outcomes: Sequence[Outcome]) -> str:
    """The figures that have a limit, in short."""
    lines = [["", "measured", "limit", "", "threads"], ["---"] * 5]
    for outcome in outcomes:
        if outcome.failure is not None:
            lines.append([outcome.title, "", "", "**failed**", ""])
        for row in outcome.rows:
            if row.limit is not None:
                lines.append([row.name, _value(row), _limit(row), _verdict(row), str(row.threads)])
    return f"\n## What must hold\n\n{_table(lines)}"


def _section(outcome: Outcome) -> str:
    title = f"\n## {outcome.title}\n\n"
    if outcome.failure is not None:
        return f"{title}**Failed**: {outcome.failure}\n"
    head = ["", "measured", "limit", "", "compared with", "×", "threads"]
    table = _table([head, ["---"] * len(head), *(_cells(row) for row in outcome.rows)])
    errors = [row.error_of for row in outcome.rows if row.error_of]
    notes = "".join(f"\nErrors: {text}.\n" for text in dict.fromkeys(errors))
    return f"{title}{table}{notes}"


def _cells(row: Row) -> list[str]:
    error = f", error {row.error:.1g}" if row.error is not None else ""
    other = row.baseline or ""
    if row.baseline_value is not None:
        other += f": {figure(row.baseline_value)}{_unit(row)}"
    if row.baseline_error is not None:
        other += f", error {row.baseline_error:.1g}"
    return [
        row.name + (f" ({row.note})" if row.note and row.value is not None else ""),
        f"{_value(row)}{error}",
        _limit(row),
        _verdict(row),
        other,
        figure(row.ratio) if row.ratio is not None else "",
        str(row.threads),
    ]


def _table(lines: Sequence[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _value(row: Row) -> str:
    if row.value is None:
        return row.note
    spread = f" ± {figure(0.5 * row.spread)}" if row.spread is not None else ""
    return f"{figure(row.value)}{spread}{_unit(row)}"


def _limit(row: Row) -> str:
    if row.limit is None:
        return ""
    return f"{'≥' if row.at_least else '≤'} {figure(row.limit)}{_unit(row)}"


def _verdict(row: Row) -> str:
    return {None: "", True: "kept", False: "**missed**"}[row.met]


def _unit(row: Row) -> str:
    return f" {row.unit}" if row.unit else ""


def figure(value: float) -> str:
    """Three digits, without an exponent where that is readable."""
    if value and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2g}"
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
