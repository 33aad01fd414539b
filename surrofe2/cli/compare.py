"""`surrofe2 compare` and `surrofe2 report`: runs against each other, and on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.report.comparison import Comparison, audit_sentence
from surrofe2.store.run_folder import caches_of
from surrofe2.workflow.comparison import (
    COMPARISON_FILES,
    compare_runs,
    missing_notes,
)


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Run folders, two or more.")],
    out: console.OutFolder,
    fresh: console.Fresh = False,
) -> None:
    """Compare displacement curves, forces and costs of runs of one load case.

    The reference is the first full tissue, else the first run by RVEs, else the first one.
    Writes comparison.json and comparison.png: difference relative to the largest displacement, at
    any time and of the largest ones; the same of every force on the tissue; speed-up of wall time
    and of RVE solves.

    Example: [bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
    """
    result = compare_runs(runs, out, fresh=fresh)
    show_comparison(result)
    for sentence in missing_notes(runs):
        console.print_line(sentence)
    console.done(out, " and ".join(COMPARISON_FILES))


def show_comparison(result: Comparison) -> None:
    """The figures of a comparison as a table."""
    console.show_table(f"Against {result.reference}", result.table)
    if result.force_table.rows:
        console.show_table("Forces on the tissue", result.force_table)
    for run in result.runs:
        if run.balance is not None:
            console.print_line(f"{run.name}: {run.balance.sentence}")
        for name, cache in caches_of(run.cache).items():
            if cache["audit"]["audited"]:
                of = f"{run.name}, {name}" if name else run.name
                console.print_line(f"{of}: audit: {audit_sentence(cache)}")


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
    energies, provenance, and how to run it all again. The page says what a folder
    lacks; `run --cell-fields` adds the stretch of walls, `zoom` the plant cells at a point.

    Example: [bold]surrofe2 report out/rve out/cached[/bold]
    """
    from surrofe2.workflow.report import write_report

    path = write_report(runs, runs[0].parent / "report.html" if out is None else out)
    console.done(path, f"{path.stat().st_size / 1e6:.2g} MB")
