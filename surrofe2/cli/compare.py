"""`surrofe2 compare`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from surrofe2.cli.console import Fresh, print_line, show_table
from surrofe2.report.comparison import Comparison
from surrofe2.workflow.comparison import COMPARISON_FILES, compare_runs


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Run folders, two or more.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the comparison.")],
    fresh: Fresh = False,
) -> None:
    """Compare displacement curves, forces and costs of runs of one load case.

    The reference is the first full tissue, else the first run by true RVEs, else the first one.
    Writes comparison.json and comparison.png: difference relative to the largest displacement,
    speed-up of wall time and of RVE solves.

    Example: [bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
    """
    result = compare_runs(runs, out, fresh=fresh)
    show_comparison(result)
    print_line(f"{out}: {' and '.join(COMPARISON_FILES)}")


def show_comparison(result: Comparison, of: str = "") -> None:
    """The figures of a comparison as a table."""
    title = f"{of}, against {result.reference}" if of else f"Against {result.reference}"
    show_table(title, *result.table.for_people())
    for run in result.runs:
        if run.audit is not None and run.audit["audited"]:
            print_line(f"{run.name}: {audit_line(run.audit)}")
        for name, force in run.forces.items():
            share = f", {force.largest / force.scale:.2g} of its largest" if force.scale else ""
            print_line(f"{run.name}: force {name}: at most {force.largest:.3g} µN apart{share}")


def audit_line(audit: Mapping[str, Any]) -> str:
    """What an audit found, in short."""
    quantiles = ", ".join(
        f"{value:.2g} µN/µm at {100 * float(share):g} %"
        for share, value in audit["quantiles"].items()
    )
    off = "; the cache was switched off" if audit["trust"]["off"] else ""
    return (
        f"{audit['audited']} answers audited, {audit['violations']} above the tolerance of "
        f"{float(audit['tolerance']):.2g} µN/µm; error {quantiles}{off}"
    )
