"""Printing, progress, interruption and options that commands share."""

from __future__ import annotations

import errno
import io
import logging
import os
import re
import shlex
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table as ShownTable
from rich.text import Text

from surrofe2.base.errors import printable
from surrofe2.base.interruption import fill_standard_streams, interruptible
from surrofe2.base.units import time_text
from surrofe2.run.loop import Report, Stage

if TYPE_CHECKING:
    from surrofe2.report.tables import Table

# Options

INITIALISATIONS = "cauchy-born, elastic, constrained-runs or slow-manifold"

RecipeFile = Annotated[Path, typer.Argument(metavar="RECIPE", help="The study's TOML file.")]
RunFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to write.")]
OutFolder = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="The folder to write; default: out/COMMAND-RECIPE."),
]
JsonFile = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="All numbers as JSON.")
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
    typer.Option("--cell", metavar="NAME", help="Only this one of [cells.NAME]; default: all."),
]
Initialisation = Annotated[
    str | None,
    typer.Option(metavar="NAME", help=f"How RVEs begin: {INITIALISATIONS}; default: the recipe's."),
]
AnyInitialisation = Annotated[
    Literal["all", "cauchy-born", "elastic", "constrained-runs", "slow-manifold"],
    typer.Option("--initialisation", metavar="NAME", help=f"How RVEs begin: {INITIALISATIONS}."),
]
PictureFormat = Annotated[
    Literal["png", "pdf", "svg"],
    typer.Option("--format", metavar="png|pdf|svg", help="Format of pictures."),
]
LawName = Literal["rve", "surrogate", "cached", "table"]
_LAW: Any = typer.Option(
    metavar="LAW",
    help="rve: RVEs; surrogate: network only; cached: network with RVE fallback; "
    "table: adaptive tabulation of RVEs, no training.",
)
Law = Annotated[LawName, _LAW]
LawOrNone = Annotated[LawName | None, _LAW]
SurrogateFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--surrogate",
        metavar="FILE",
        help="Surrogate file; default: the recipe's. One for each of several cells.",
    ),
]
TableFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--table",
        metavar="FILE",
        help="Table (.h5) to start from, e.g. table.h5 of an earlier run; several tables of "
        "the same cell are merged. Default: an empty one.",
    ),
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="Cached: allowed error of a stress relative to the spread of stress; default: "
        "the recipe's.",
    ),
]
Audit = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="Fraction of the cache's answers that RVEs check, 1: all; default: the recipe's.",
    ),
]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads; default: all cores.")
]
Workers = Annotated[
    int, typer.Option(min=0, metavar="N", help="Processes that work; default: this one alone.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="A Dask scheduler whose workers work, tcp://HOST:PORT."),
]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Start over; default: keep what is there and resume.")
]


def folder_of(out: Path | None, recipe: Path) -> Path:
    """Return where a command writes: `out`, or the folder of the command and the recipe."""
    return out or Path("out") / f"{_now['command']}-{recipe.stem}"


# Output. Names and texts of files may hold anything: `printable` escapes what a terminal would
# obey, and rich gets them as Text, in which brackets and colons are no markup.


# The command that is at work, whether it prints only warnings and errors, and when it began.
_now: dict[str, Any] = {"command": "", "quiet": False, "began": time.perf_counter()}


def begin(command: str, *, quiet: bool) -> None:
    """Note that a command begins."""
    _now.update(command=command, quiet=quiet, began=time.perf_counter())


class PrintHandler(logging.Handler):
    """Prints what the package logs: remarks on stdout, warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        message = record.getMessage()
        (print_warning if record.levelno >= logging.WARNING else print_line)(message)


def print_warning(message: str) -> None:
    """Print a warning or an error: one red line on stderr, never wrapped, brackets as they are."""
    line = re.sub(r"\s*[\r\n]\s*", " ", message.strip())  # messages of libraries have several
    _console("stderr").print(Text(printable(line), style="red"), soft_wrap=True)


def print_line(message: str) -> None:
    """Print one line on stdout."""
    if not _now["quiet"]:
        typer.echo(printable(message))


def command_line(words: Iterable[str]) -> str:
    """Return a call of surrofe2 as a shell takes it; signs that no terminal shows are escaped."""
    return " ".join(["surrofe2", *map(_shell_word, words)])


def _shell_word(word: str) -> str:
    """Quote a word for a shell; signs that no terminal shows become escapes."""
    if word.isprintable():
        return shlex.quote(word)
    signs = []
    for sign in word:
        if sign in "\\'":
            signs.append(f"\\{sign}")
        elif sign.isprintable():
            signs.append(sign)
        else:
            signs += [f"\\x{byte:02x}" for byte in os.fsencode(sign)]
    return f"$'{''.join(signs)}'"


def _console(name: Literal["stdout", "stderr"]) -> Console:
    """Make a console of rich, whose own colours and movements of the cursor reach the terminal."""
    stream = getattr(sys, name)
    return Console(file=getattr(stream, "rich_proxied_file", stream), stderr=name == "stderr")


def show_notes(notes: Iterable[tuple[str, bool]]) -> None:
    """Print messages, each with whether it is a warning."""
    for message, is_warning in notes:
        (print_warning if is_warning else print_line)(message)


def done(where: str | Path | None, what: str, *, timed: bool = True) -> None:
    """Print the line that sums up: where the outcome is, what it is and how long the command took.

    Args:
        where: file or folder of the outcome; None: there is none, and the command's name stands.
        what: words for the outcome.
        timed: whether to say how long; not where `what` does.
    """
    seconds = f", {time_text(time.perf_counter() - _now['began'])}" if timed else ""
    print_line(f"{where or _now['command']}: {what}{seconds}")


def show_table(title: str, table: Table[Any]) -> None:
    """Print a table on stdout; if wider than the terminal, in parts with the same names."""
    if _now["quiet"]:
        return
    console = _console("stdout")
    names = [*range(table.names)]
    headings, texts = table.for_people()
    columns = [printable(heading) for heading in headings]
    rows = [[printable(text) for text in row] for row in texts]
    # a heading may be wrapped between words, a value is never
    heads = [max(map(cell_len, column.split())) for column in columns]
    widths = []
    for k, head in enumerate(heads):
        widths.append(1 + max([head, *(cell_len(row[k]) for row in rows)]))
    parts: list[list[int]] = [names]
    for k in range(table.names, len(columns)):
        if parts[-1] != names and sum(widths[j] for j in (*parts[-1], k)) >= console.width:
            parts.append(names)
        parts[-1] = [*parts[-1], k]
    for part in parts:
        fits = sum(widths[k] for k in part) < console.width
        more = "" if part is parts[0] else ", continued"
        console.print(Text(f"{printable(title)}{more}", style="italic"))
        drawn = ShownTable(box=SIMPLE_HEAD, padding=0)
        for k in part:
            drawn.add_column(
                Text(columns[k]),
                justify="right" if k else "left",
                width=widths[k] - 1 if fits else None,
                min_width=heads[k],
            )
        for row in rows:
            drawn.add_row(*(Text(row[k]) for k in part))
        console.print(drawn)


_CLOSED = OSError(errno.EBADF, "closed before the command began")


class _Noting(io.FileIO):
    """A descriptor that keeps its first error of writing, and raises none."""

    error: OSError | None = None
    is_closed = False

    def write(self, content: bytes) -> int:  # type: ignore[override]
        """Write, and return the number of bytes as if all had been written."""
        if self.is_closed:
            self.error = _CLOSED
            return len(content)
        try:
            return super().write(content)
        except OSError as error:
            self.error = self.error or error
            return len(content)


class _Escaping(io.TextIOWrapper):
    """A stream that escapes what `printable` does, except line breaks and tabs.

    So tracebacks and messages of other libraries quote names safely, too.
    """

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped."""
        super().write("".join(map(self._escaped, re.split(r"([\n\t])", text))))
        return len(text)

    @staticmethod
    def _escaped(part: str) -> str:
        """Escape a part between line breaks and tabs."""
        return part if part in ("\n", "\t") else printable(part)

    @property
    def rich_proxied_file(self) -> _Styled:
        """The stream for consoles of rich, which look by this name for what is behind a stream."""
        return _Styled(self)


class _Styled:
    """The same stream for texts that rich has styled by escape sequences."""

    def __init__(self, stream: _Escaping) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text as it is."""
        return io.TextIOWrapper.write(self._stream, text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


# Descriptors of stdout and stderr by name, with the errors that they have kept.
_raw: dict[str, _Noting] = {}


def note_errors() -> None:
    """Replace stdout and stderr by streams that never fail, and that no name in a text can control.

    A sign that a terminal does not have becomes "?". A stream that was closed before the command
    began loses what is written to it, and no file gets its number.
    """
    fill_standard_streams()
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        is_closed = stream is None
        if is_closed:
            stream = os.fdopen(number, "w", encoding="utf-8", closefd=False)
        if isinstance(stream, io.TextIOWrapper):
            stream.flush()
            _raw[name] = _Noting(stream.fileno(), "w", closefd=False)
            _raw[name].is_closed = is_closed
            noted = _Escaping(
                io.BufferedWriter(_raw[name]),  # type: ignore[type-var]
                encoding=stream.encoding,
                errors="replace",
                line_buffering=stream.line_buffering,
            )
            setattr(sys, name, noted)


def leave(code: int) -> None:
    """End the process without taking its objects apart; with 1 instead of 0 if output was lost."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if stream is not None:
            stream.flush()
        error = _raw[name].error if name in _raw else None
        if error is not None:
            code = code or 1
            if error.errno != errno.EPIPE:  # the reader of a pipe has ended, as `head` does
                sys.stderr.write(f"error: {name}: {error.strerror}\n")
    os._exit(code)


# Progress

# Seconds between lines where there is no terminal; work that is done sooner prints nothing.
SELDOM = 10.0
# Seconds before a rate is reported.
_SETTLED = 0.5


@contextmanager
def progress(what: str, total: float, unit: str) -> Iterator[Report]:
    """Yield a function (done, note) that shows progress, its rate, and the time left."""
    with stages() as stage, stage(what, total, unit) as report:
        yield report


@contextmanager
def stages() -> Iterator[Stage]:
    """Open one display for all stages of a command, each a `progress`.

    In a terminal it has bars on stderr, with their times; elsewhere a plain line now and then, see
    `SELDOM`.
    """
    console = _console("stderr")
    bar_width = 20 if console.width >= 100 else 10
    display = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=bar_width),
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TextColumn("{task.fields[status]}", markup=False),
        console=console,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # what is piped elsewhere goes there
        disable=_now["quiet"] or not console.is_terminal or console.is_dumb_terminal,
    )
    with display:
        yield partial(_stage, display, bar_width + len("   100 %  "))


@contextmanager
def _stage(display: Progress, taken: int, what: str, total: float, unit: str) -> Iterator[Report]:
    """Show a stage: a bar of a display, or lines where the display is disabled.

    Args:
        taken: characters of the line that the bar takes.
        total: amount of work; 1 is reported in percent.
    """
    what = printable(what)
    began = time.perf_counter()
    last = began  # time of the last line
    # time and amount at the first report: what was done before counts for no rate
    first: tuple[float, float] | None = None
    task = display.add_task(what, total=total, status="")

    def report(done: float, note: str = "") -> None:
        """Show how much is done, and a remark."""
        nonlocal first, last
        moment = time.perf_counter()
        is_counted = total != 1.0
        if first is None and done > 0.0:
            first = (moment, done)
        elapsed = 0.0
        more = 0.0
        if first is not None:
            elapsed = moment - first[0]
            more = done - first[1]
        parts = list[str]()
        if elapsed >= _SETTLED and more > 0.0:
            parts.append(f"{time_text(max((total - done) * elapsed / more, 0.0))} left")
            if is_counted:
                parts.append(f"{_short(more / elapsed)} {unit}/s")
        if note:
            parts.append(printable(note))
        if not display.disable:
            if is_counted:
                parts.insert(0, f"{_short(done)} of {_short(total)} {unit}")
            # the last parts are left out where the line would be too long
            while len(", ".join(parts)) > display.console.width - taken - cell_len(what) and parts:
                parts.pop()
            display.update(task, completed=done, status=", ".join(parts))
        elif not _now["quiet"] and moment - last >= SELDOM:
            last = moment
            if total:
                parts.insert(0, f"{100.0 * done / total:.0f} %")
            typer.echo(f"{what}: {', '.join(parts)}", err=True)

    yield report
    display.update(task, completed=total, status=time_text(time.perf_counter() - began))


def _short(number: float) -> str:
    """Write a number in few characters, counts of thousands with their commas."""
    return f"{number:,.0f}" if abs(number) >= 1000.0 else f"{number:.3g}"


# Interruption


class InterruptedWork(KeyboardInterrupt):
    """Ctrl-C during work.

    Its arguments are words for what was kept, and whether there is work to resume from; else
    --fresh stays in the command that resumes.
    """


@contextmanager
def on_interrupt(what: str, begun: Sequence[Path] = ()) -> Iterator[None]:
    """Print what was kept where Ctrl-C ends the block; how to resume is printed after it.

    Args:
        begun: files of which the block writes one again as soon as something is kept.

    Raises:
        InterruptedWork: Ctrl-C.
    """
    before = [_stamp(path) for path in begun]
    try:
        with interruptible():
            yield
    except KeyboardInterrupt:
        after = [_stamp(path) for path in begun]
        changed = any(a is not None and a != b for a, b in zip(after, before, strict=True))
        raise InterruptedWork(what, changed or not begun) from None


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return what another file of that name does not have; None where there is no file."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


@contextmanager
def working(
    what: str, total: float, unit: str, kept: str, begun: Sequence[Path] = ()
) -> Iterator[Report]:
    """Show the progress of work, and print what was kept where Ctrl-C ends it; `on_interrupt`."""
    with on_interrupt(kept, begun), progress(what, total, unit) as report:
        yield report


def running(
    what: str, total: float, unit: str, folder: Path, kept: str = "run up to its last checkpoint"
) -> AbstractContextManager[Report]:
    """Show the progress of a run that is written into a folder; see `working`."""
    return working(what, total, unit, f"{folder} keeps the {kept}", (folder / "run.json",))
