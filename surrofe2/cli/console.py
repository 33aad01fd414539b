"""What a user sees while a command works, and when it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from surrofe2.errors import Surrofe2Error

INTERRUPTED = 130

Report = Callable[[float, str], None]


class InterruptedWork(Exception):  # noqa: N818 - Ctrl-C is no error
    """Ctrl-C; the message says what was kept and how to go on."""


class CarefulGroup(TyperGroup):
    """Ends every command with one line instead of a traceback, unless one is asked for."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take --traceback wherever it stands, before or after the command."""
        if "--traceback" in args:
            args = ["--traceback", *(entry for entry in args if entry != "--traceback")]
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command and turn known failures into an exit code."""
        try:
            return super().invoke(ctx)
        except Surrofe2Error as error:
            if ctx.params.get("traceback"):
                raise
            complain(f"error: {error}")
            raise typer.Exit(1) from None
        except InterruptedWork as work:
            complain(f"interrupted: {work}")
            raise typer.Exit(INTERRUPTED) from None
        except KeyboardInterrupt:
            complain("interrupted: nothing was changed")
            raise typer.Exit(INTERRUPTED) from None


def complain(sentence: str) -> None:
    """One red line on stderr, never wrapped, its brackets taken as they are."""
    from rich.console import Console
    from rich.text import Text

    line = " ".join(sentence.split())
    Console(stderr=True).print(Text(line, style="red"), soft_wrap=True)


def say(sentence: str) -> None:
    """One line on stdout."""
    typer.echo(sentence)


def show_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """A table on stdout; the first column names, the others are figures."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def keeping(what: str) -> Iterator[None]:
    """Say what was kept and how to go on where Ctrl-C ends the block.

    Raises:
        InterruptedWork: Ctrl-C.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedWork(what) from None


@contextmanager
def progress(what: str, total: float, unit: str) -> Iterator[Report]:
    """A function (done, note) that shows how far work is, at which rate, and the time left.

    In a terminal a bar on stderr; elsewhere a plain line each tenth of the way.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with _bar(console, what, total, unit) as report:
            yield report
    else:
        yield _lines(what, total)


@contextmanager
def _bar(console: Any, what: str, total: float, unit: str) -> Iterator[Report]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[rate]}"),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task(what, total=total, rate="", note="")
        first: list[float] = []

        def report(done: float, note: str = "") -> None:
            now = time.perf_counter()
            if not first:
                first.extend((now, done))
            elapsed = now - first[0]
            rate = f"{(done - first[1]) / elapsed:.3g} {unit}/s" if elapsed > 0.2 else ""
            shown.update(task, completed=done, rate=rate, note=note)

        yield report


def _lines(what: str, total: float) -> Report:
    told = 0

    def report(done: float, note: str = "") -> None:
        nonlocal told
        tenth = int(10.0 * done / total) if total else 10
        if tenth > told:
            told = tenth
            typer.echo(f"{what}: {10 * tenth} % {note}".rstrip(), err=True)

    return report


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"
