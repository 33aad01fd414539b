"""`surrofe2 compare`: runs against each other, as a table and on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli import console
from surrofe2.report.comparison import (
    COMPARISON,
    Comparison,
    audit_sentence,
    closing_sentence,
    compare_runs,
)
from surrofe2.store.run_folder import caches_of

REPORT = "report.html"


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Run folders, one or more.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The folder to write; default: comparison beside them."),
    ] = None,
    form: console.PictureFormat = "png",
    fresh: console.Fresh = False,
) -> None:
    """Compare displacement curves, forces and costs of runs of one load case.

    The reference is the first full tissue, else the first run by RVEs, else the first one.
    Writes comparison.json and comparison.png (with --format pdf or svg): difference relative to the
    largest displacement, at any time and of the largest ones; the same of every force on the
    tissue; speed-up of wall time and of RVE solves.

    Also writes report.html, one page that works offline and can be passed on, of one run too: the
    tissue in motion, all curves, where and when the cache fell back, audited errors, the range that
    was met, energies, provenance. The page says what a folder lacks; `run --cell-fields` adds the
    stretch of walls, `zoom` the plant cells at a point.

    Example: surrofe2 compare out/rve out/cached --out out/comparison
    """
    from surrofe2.report.page import write_report  # pictures of plant cells need kernels

    folder = runs[0].parent / "comparison" if out is None else out
    if len(runs) > 1:
        show_comparison(compare_runs(runs, folder, form=form, fresh=fresh))
    page = write_report(runs, folder / REPORT)
    files = [page.name]
    if len(runs) > 1:
        files = [COMPARISON, f"comparison.{form}", page.name]
    console.done(folder, ", ".join(files))


def show_comparison(result: Comparison) -> None:
    """Show the numbers of a comparison as a table."""
    console.show_table(f"Against {result.reference}", result.table)
    if result.force_table.rows:
        console.show_table("Forces on the tissue", result.force_table)
    for run in result.runs:
        if run.balance is not None:
            console.print_line(f"{run.name}: {run.balance.sentence}")
        for name, cache in caches_of(run.cache).items():
            of = run.name if name is None else f"{run.name}, {name}"
            if cache["audit"]["audited"]:
                console.print_line(f"{of}: audit: {audit_sentence(cache)}")
            sentence = closing_sentence(cache)
            if sentence:
                console.print_line(f"{of}: closing audit: {sentence}")
