"""How far long work is: one display for all of it, a bar in a terminal and few lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from surrofe2.base.units import time_text
from surrofe2.cli.output import now

Report = Callable[[float, str], None]
SELDOM = 10.0
"""Seconds between lines where there is no terminal; work that is done sooner says nothing."""
_SETTLED = 0.5
"""Seconds before a rate is reported."""


class Clock:
    """The rate of work and the time that is left; what was done before counts for neither.

    Work whose total is 1 is reported in shares alone.
    """

    def __init__(self, total: float, unit: str) -> None:
        self._total, self._unit = total, unit
        self._first: tuple[float, float] | None = None

    def far(self, done: float) -> str:
        """How far the work is in its unit."""
        return "" if self._total == 1.0 else f"{_short(done)} of {_short(self._total)} {self._unit}"

    def rate_and_time_left(self, done: float) -> tuple[str, str]:
        """(time left, rate) as people say them, empty where not known yet."""
        moment = time.perf_counter()
        if self._first is None and done > 0.0:
            self._first = moment, done
        if self._first is None:
            return "", ""
        elapsed, more = moment - self._first[0], done - self._first[1]
        if elapsed < _SETTLED or more <= 0.0:
            return "", ""
        left = (self._total - done) * elapsed / more
        rate = "" if self._total == 1.0 else f"{_short(more / elapsed)} {self._unit}/s"
        return f"{time_text(max(left, 0.0))} left", rate


@contextmanager
def progress(what: str, total: float, unit: str) -> Iterator[Report]:
    """A function (done, note) that shows how far work is, at which rate, and the time left."""
    with stages() as stage, stage(what, total, unit) as report:
        yield report


@contextmanager
def stages() -> Iterator[Callable[[str, float, str], AbstractContextManager[Report]]]:
    """One display for all stages of a command, each a `progress`.

    In a terminal bars on stderr that stay, with their times; elsewhere a plain line now and then,
    see `SELDOM`.
    """
    console = Console(stderr=True)
    if now().quiet or not console.is_terminal or console.is_dumb_terminal:
        yield _lines
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=_bar_width(console)),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[status]}"),
    )
    # what is piped elsewhere goes there
    redirected = sys.stdout.isatty()
    with Progress(*columns, console=console, transient=True, redirect_stdout=redirected) as shown:
        yield partial(_row, shown)


@contextmanager
def _row(shown: Progress, what: str, total: float, unit: str) -> Iterator[Report]:
    clock, began = Clock(total, unit), time.perf_counter()
    task = shown.add_task(what, total=total, status="")

    def report(done: float, note: str = "") -> None:
        parts = [each for each in (clock.far(done), *clock.rate_and_time_left(done), note) if each]
        space = shown.console.width - len(what) - _bar_width(shown.console) - len("   100 %  ")
        while len(", ".join(parts)) > space and parts:
            parts.pop()
        shown.update(task, completed=done, status=", ".join(parts))

    yield report
    shown.update(task, completed=total, status=time_text(time.perf_counter() - began))


@contextmanager
def _lines(what: str, total: float, unit: str) -> Iterator[Report]:
    clock, last = Clock(total, unit), time.perf_counter()

    def report(done: float, note: str = "") -> None:
        nonlocal last
        left_and_rate = clock.rate_and_time_left(done)
        if now().quiet or time.perf_counter() - last < SELDOM:
            return
        last = time.perf_counter()
        share = f"{100.0 * done / total:.0f} %" if total else ""
        status = ", ".join(each for each in (share, *left_and_rate, note) if each)
        typer.echo(f"{what}: {status}", err=True)

    yield report


def _bar_width(console: Console) -> int:
    return 20 if console.width >= 100 else 10


def _short(number: float) -> str:
    """A number in few characters, counts of thousands with their commas."""
    return f"{number:,.0f}" if abs(number) >= 1000.0 else f"{number:.3g}"
