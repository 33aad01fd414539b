"""`surrofe2 report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.workflow.report import write_report


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Run folders, one or more.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file; default: report.html beside the first DIR."),
    ] = None,
) -> None:
    """Show runs on one page: one HTML file that works offline and can be passed on.

    The tissue in motion, displacements of all runs and their difference, speed-up with all costs
    counted, where and when the cache fell back, audited errors, the range that was met,
    energies, provenance, and how to run it all again. What a folder lacks is left out with a
    sentence; `run --cell-fields` adds the stretch of walls, `zoom` the plant cells at a point.

    Example: [bold]surrofe2 report out/rve out/cached[/bold]
    """
    path = write_report(runs, runs[0].parent / "report.html" if out is None else out)
    console.done(path, f"{path.stat().st_size / 1e6:.2g} MB")
