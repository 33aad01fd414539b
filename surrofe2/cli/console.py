"""What a user sees while a command works, and when it fails; the options that commands share."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from surrofe2.errors import InputError, quoted


class PrintHandler(logging.Handler):
    """Prints what the package logs: remarks on stdout, warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        sentence = record.getMessage()
        (print_error if record.levelno >= logging.WARNING else print_line)(sentence)


Report = Callable[[float, str], None]


class InterruptedWork(Exception):  # noqa: N818 - Ctrl-C is no error
    """Ctrl-C; the message says what was kept.

    Attributes:
        has_begun: whether work is there to go on from; else --fresh is as needed as before.
    """

    def __init__(self, what: str, has_begun: bool) -> None:
        super().__init__(what)
        self.has_begun = has_begun


def print_error(sentence: str) -> None:
    """One red line on stderr, never wrapped, its brackets taken as they are."""
    line = " ".join(sentence.split())
    Console(stderr=True).print(Text(line, style="red"), soft_wrap=True)


def print_line(sentence: str) -> None:
    """One line on stdout."""
    typer.echo(sentence)


def show_table(title: str, columns: list[str], rows: list[list[str]], names: int = 1) -> None:
    """A table on stdout; the first columns, so many, name, the others are figures.

    Where it is wider than the terminal, further tables have the figures that are left.
    """
    console = Console()
    heads = [max(map(len, column.split())) for column in columns]
    widths = [1 + max([head, *(len(row[k]) for row in rows)]) for k, head in enumerate(heads)]
    parts: list[list[int]] = [[]]
    for k in range(names, len(columns)):
        if parts[-1] and sum(widths[j] for j in (*range(names), *parts[-1], k)) >= console.width:
            parts.append([])
        parts[-1].append(k)
    for part in parts:
        shown = [*range(names), *part]
        fits = sum(widths[k] for k in shown) < console.width
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0)
        for k in shown:
            how = {"width": widths[k] - 1} if fits else {"min_width": heads[k]}
            table.add_column(columns[k], justify="right" if k else "left", **how)
        for row in rows:
            table.add_row(*(row[k] for k in shown))
        console.print(table)


@contextmanager
def on_interrupt(what: str, begun: Sequence[Path] = ()) -> Iterator[None]:
    """Say what was kept where Ctrl-C ends the block; how to go on is said after it.

    Args:
        begun: files of which the block writes one anew as soon as something is kept.

    Raises:
        InterruptedWork: Ctrl-C.
    """
    before = [_stamp(path) for path in begun]
    try:
        yield
    except KeyboardInterrupt:
        now = [_stamp(path) for path in begun]
        changed = any(a is not None and a != b for a, b in zip(now, before, strict=True))
        raise InterruptedWork(what, changed or not begun) from None


def _stamp(path: Path) -> tuple[int, int] | None:
    """What another file of that name does not have; None where there is no file."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


@contextmanager
def working(
    what: str, total: float, unit: str, kept: str, begun: Sequence[Path] = ()
) -> Iterator[Report]:
    """Show the progress of work, and say what was kept where Ctrl-C ends it; see `on_interrupt`."""
    with on_interrupt(kept, begun), progress(what, total, unit) as report:
        yield report


@contextmanager
def progress(what: str, total: float, unit: str) -> Iterator[Report]:
    """A function (done, note) that shows how far work is, at which rate, and the time left.

    In a terminal a bar on stderr; elsewhere a plain line each tenth of the way.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with _display(console) as shown, _row(shown, what, total, unit) as report:
            yield report
    else:
        yield _lines(what, total)


@contextmanager
def stages() -> Iterator[Callable[[str, float, str], AbstractContextManager[Report]]]:
    """One display for all stages of a command: a `progress` whose rows stay, with their times."""
    console = Console(stderr=True)
    if console.is_terminal:
        with _display(console) as shown:
            yield partial(_row, shown)
    else:
        yield progress


def _display(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[rate]}"),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # what is piped elsewhere goes there
    )


@contextmanager
def _row(shown: Progress, what: str, total: float, unit: str) -> Iterator[Report]:
    task = shown.add_task(what, total=total, rate="", note="")
    first: list[float] = []
    begin = time.perf_counter()

    def report(done: float, note: str = "") -> None:
        now = time.perf_counter()
        if not first and done > 0.0:  # what comes before is not a part of the work
            first.extend((now, done))
        elapsed = now - first[0] if first else 0.0
        rate = f"{(done - first[1]) / elapsed:.3g} {unit}/s" if elapsed > 0.2 else ""
        shown.update(task, completed=done, rate=rate, note=note)

    yield report
    shown.update(task, completed=total, rate=f"{time.perf_counter() - begin:.1f} s", note="")


def _lines(what: str, total: float) -> Report:
    told = 0

    def report(done: float, note: str = "") -> None:
        nonlocal told
        tenth = int(10.0 * done / total) if total else 10
        if tenth > told:
            told = tenth
            typer.echo(f"{what}: {10 * tenth} % {note}".rstrip(), err=True)

    return report


AnyInitialisation = Literal["all", "cauchy-born", "elastic", "constrained-runs", "slow-manifold"]

RecipeFile = Annotated[Path, typer.Argument(metavar="RECIPE", help="The study's TOML file.")]
OutFolder = Annotated[Path, typer.Option(metavar="DIR", help="The folder to write.")]
JsonFile = Annotated[Path | None, typer.Option(metavar="FILE", help="All numbers as JSON.")]
SurrogateFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--surrogate",
        metavar="FILE",
        help="Surrogate file; default: the recipe's. One for each of several cells.",
    ),
]
CellName = Annotated[
    str,
    typer.Option(
        "--cell",
        "--preset",
        metavar="NAME|RECIPE",
        help="printed or water, the paper's with 2.7 or 0.27 ng; apple, potato; or a TOML file.",
    ),
]
OneCell = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Only this of the recipe's [cells.NAME]; default: all."),
]
Initialisation = Annotated[
    str | None, typer.Option(help="How RVEs are initialised; default: the recipe's.")
]
Audit = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        help="Share of the cache's answers that RVEs check, 1: all; default: the recipe's.",
    ),
]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads; default: all cores.")
]
Workers = Annotated[
    int,
    typer.Option(min=0, metavar="N", help="Processes that sample; default: this one alone."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="A Dask scheduler whose workers sample, tcp://HOST:PORT."),
]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Start over; default: keep what is there and go on.")
]
KEPT_RUN = "{} keeps the run up to its last checkpoint"


def integers(option: str, text: str, least: int = 1) -> tuple[int, ...]:
    """Integers between commas, in their order.

    Args:
        option: whose text it is, for the message.

    Raises:
        InputError: not integers, or one of them less than `least`.
    """
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < least:
        raise InputError(
            f"{option}: {quoted(text)}; it must be integers of at least {least} with commas"
        )
    return numbers
