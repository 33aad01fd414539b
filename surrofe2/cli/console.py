"""What commands share: what they say, what an interruption keeps, and their options."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer

# What commands say, for `console.…` in each of them.
from surrofe2.cli.output import (  # noqa: F401
    done,
    now,
    print_line,
    print_warning,
    show_notes,
    show_table,
    took,
)
from surrofe2.cli.progress import Report, progress, stages  # noqa: F401


class InterruptedWork(Exception):  # noqa: N818 - Ctrl-C is no error
    """Ctrl-C; the message says what was kept.

    Attributes:
        has_begun: whether work is there to go on from; else --fresh is as needed as before.
    """

    def __init__(self, what: str, has_begun: bool) -> None:
        super().__init__(what)
        self.has_begun = has_begun


@contextmanager
def on_interrupt(what: str, begun: Sequence[Path] = ()) -> Iterator[None]:
    """Say what was kept where Ctrl-C ends the block; how to go on is said after it.

    Args:
        begun: files of which the block writes one again as soon as something is kept.

    Raises:
        InterruptedWork: Ctrl-C.
    """
    before = [_stamp(path) for path in begun]
    try:
        yield
    except KeyboardInterrupt:
        after = [_stamp(path) for path in begun]
        changed = any(a is not None and a != b for a, b in zip(after, before, strict=True))
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


AnyInitialisation = Literal["all", "cauchy-born", "elastic", "constrained-runs", "slow-manifold"]
HOW = "cauchy-born, elastic, constrained-runs or slow-manifold: how RVEs are put into their state."

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
    typer.Option(metavar="NAME", help="Only this of the recipe's \\[cells.NAME]; default: all."),
]
Initialisation = Annotated[
    str | None,
    typer.Option(metavar="NAME", help=f"{HOW[:-1]}; default: the recipe's."),
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
