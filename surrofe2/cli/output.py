"""What a command says: lines, tables and warnings for people, or all of it as one JSON object.

Commands call `print_line`, `print_error`, `show_table` and `done`; whether that is heard, and how,
stands here alone (`--quiet`, `--json`).
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as ShownTable
from rich.text import Text

from surrofe2.units import time_text

if TYPE_CHECKING:
    from surrofe2.report.tables import Table


@dataclass(slots=True)
class Output:
    """What the command has said so far, for `--json`.

    Attributes:
        result: the numbers of the command, by name.
        began: when, by `time.perf_counter`.
    """

    command: str = ""
    quiet: bool = False
    as_json: bool = False
    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    tables: list[dict[str, Any]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)
    began: float = field(default_factory=time.perf_counter)

    @property
    def is_silent(self) -> bool:
        """Whether people are told nothing on stdout."""
        return self.quiet or self.as_json


_now = [Output()]


def begin(command: str, *, quiet: bool, as_json: bool) -> None:
    """A command begins, of which nothing was said."""
    _now[0] = Output(command, quiet, as_json)


def now() -> Output:
    """What the present command has said."""
    return _now[0]


def end(status: str, error: str | None = None) -> None:
    """Say all as one JSON object where that is wanted."""
    said = now()
    if not said.as_json:
        return
    found = {
        "command": said.command,
        "status": status,
        "error": error,
        "seconds": round(time.perf_counter() - said.began, 3),
        "result": said.result,
        "tables": said.tables,
        "lines": said.lines,
        "warnings": said.warnings,
    }
    typer.echo(json.dumps(_plain(found), ensure_ascii=False, allow_nan=False, indent=1))


def _plain(value: Any) -> Any:
    """A value as JSON has it; null where a number is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    try:
        return _plain(value.tolist())  # of numpy
    except AttributeError:
        return str(value)


class PrintHandler(logging.Handler):
    """Prints what the package logs: remarks on stdout, warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        sentence = record.getMessage()
        (print_warning if record.levelno >= logging.WARNING else print_line)(sentence)


def print_error(sentence: str) -> None:
    """One red line on stderr, never wrapped, its brackets taken as they are."""
    line = " ".join(sentence.split())
    Console(stderr=True).print(Text(line, style="red"), soft_wrap=True)


def print_warning(sentence: str) -> None:
    """The same, of a command that goes on; among the warnings of `--json`."""
    now().warnings.append(" ".join(sentence.split()))
    print_error(sentence)


def print_line(sentence: str) -> None:
    """One line on stdout."""
    now().lines.append(sentence)
    if not now().is_silent:
        typer.echo(sentence)


def done(where: str | Path | None, what: str, *, timed: bool = True, **result: Any) -> None:
    """The line that sums up: where the outcome is, what it is and how long the command took.

    Args:
        where: None of a command that wrote no file; its name stands there.
        timed: whether to say how long; not where `what` does.
        result: numbers for `--json`.
    """
    now().result |= {"output": None if where is None else str(where), **result}
    print_line(f"{where or now().command}: {what}{f', {took()}' if timed else ''}")


def took() -> str:
    """How long the command has taken."""
    return time_text(time.perf_counter() - now().began)


def show_table(title: str, table: Table[Any], names: int = 1) -> None:
    """A table on stdout; the first columns, so many, name, the others are figures.

    Where it is wider than the terminal, further tables have the figures that are left.
    """
    now().tables.append({"title": title, "units": table.units, "rows": table.to_records()})
    if now().is_silent:
        return
    columns, rows = table.for_people()
    console = Console()
    heads = [max(map(len, column.split())) for column in columns]
    widths = [1 + max([head, *(len(row[k]) for row in rows)]) for k, head in enumerate(heads)]
    parts: list[list[int]] = [[]]
    for k in range(names, len(columns)):
        if parts[-1] and sum(widths[j] for j in (*range(names), *parts[-1], k)) >= console.width:
            parts.append([])
        parts[-1].append(k)
    for k, part in enumerate(parts):
        named = f"{title}, continued" if k else title
        shown = [*range(names), *part]
        fits = sum(widths[k] for k in shown) < console.width
        drawn = ShownTable(title=named, title_justify="left", box=SIMPLE_HEAD, padding=0)
        for j in shown:
            how = {"width": widths[j] - 1} if fits else {"min_width": heads[j]}
            drawn.add_column(columns[j], justify="right" if j else "left", **how)
        for row in rows:
            drawn.add_row(*(row[j] for j in shown))
        console.print(drawn)
