"""What a command prints: lines, tables and warnings.

Commands call `print_line`, `print_warning`, `show_table` and `done`; only these heed `--quiet`.
"""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as ShownTable
from rich.text import Text

from surrofe2.base.units import time_text

if TYPE_CHECKING:
    from surrofe2.report.tables import Table


@dataclass(slots=True)
class Output:
    """The command that is at work.

    Attributes:
        began: when, by `time.perf_counter`.
    """

    command: str = ""
    quiet: bool = False
    began: float = field(default_factory=time.perf_counter)


_now = [Output()]


def begin(command: str, *, quiet: bool) -> None:
    """A command begins."""
    _now[0] = Output(command, quiet)


def now() -> Output:
    """The command that is at work."""
    return _now[0]


class PrintHandler(logging.Handler):
    """Prints what the package logs: remarks on stdout, warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        sentence = record.getMessage()
        (print_warning if record.levelno >= logging.WARNING else print_line)(sentence)


def print_warning(sentence: str) -> None:
    """A warning or an error: one red line on stderr, never wrapped, its brackets as they are."""
    line = " ".join(sentence.split())
    Console(stderr=True).print(Text(line, style="red"), soft_wrap=True)


def print_line(sentence: str) -> None:
    """One line on stdout."""
    if not now().quiet:
        typer.echo(sentence)


def show_notes(notes: Iterable[tuple[str, bool]]) -> None:
    """Sentences, each with whether it is a warning."""
    for sentence, is_warning in notes:
        (print_warning if is_warning else print_line)(sentence)


def done(where: str | Path | None, what: str, *, timed: bool = True) -> None:
    """The line that sums up: where the outcome is, what it is and how long the command took.

    Args:
        where: None of a command that wrote no file; its name stands there.
        timed: whether to say how long; not where `what` does.
    """
    print_line(f"{where or now().command}: {what}{f', {took()}' if timed else ''}")


def took() -> str:
    """How long the command has taken."""
    return time_text(time.perf_counter() - now().began)


def show_table(title: str, table: Table[Any], names: int = 1) -> None:
    """A table on stdout; the first columns, so many, name, the others are figures.

    Where it is wider than the terminal, further tables have the figures that are left.
    """
    if now().quiet:
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
        console.print(Text(named, style="italic"))
        drawn = ShownTable(box=SIMPLE_HEAD, padding=0)
        for j in shown:
            how = {"width": widths[j] - 1} if fits else {"min_width": heads[j]}
            drawn.add_column(columns[j], justify="right" if j else "left", **how)
        for row in rows:
            drawn.add_row(*(row[j] for j in shown))
        console.print(drawn)


class _Noting(io.FileIO):
    """A descriptor whose first error of writing is kept, and what follows it is lost."""

    error: OSError | None = None

    def write(self, content: bytes) -> int:  # type: ignore[override]
        """Write; how much was taken."""
        try:
            return super().write(content)
        except OSError as error:
            self.error = self.error or error
            return len(content)


_raw: dict[str, _Noting] = {}


def note_errors() -> None:
    """From now on stdout and stderr never fail; what a terminal has no sign for becomes "?"."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if isinstance(stream, io.TextIOWrapper):
            stream.flush()
            _raw[name] = _Noting(stream.fileno(), "w", closefd=False)
            heard = io.TextIOWrapper(
                io.BufferedWriter(_raw[name]),  # type: ignore[type-var]
                encoding=stream.encoding,
                errors="replace",
                line_buffering=stream.line_buffering,
            )
            setattr(sys, name, heard)


def leave(code: int) -> None:
    """End the process without taking its objects apart; 1 instead of 0 if words were lost."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if stream is not None:
            stream.flush()
        error = _raw[name].error if name in _raw else None
        if error is not None:
            code = code or 1
            if error.errno != errno.EPIPE:  # whoever listened has heard enough
                sys.stderr.write(f"error: {name}: {error.strerror}\n")
    os._exit(code)
