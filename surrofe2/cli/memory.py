"""`surrofe2 memory`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import CellName, Fresh, print_line
from surrofe2.report.study import NamedCell, keep_study
from surrofe2.studies.memory import MemorySettings, describe
from surrofe2.studies.memory import memory as measure


def memory(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figure and data.")],
    cell: CellName = "printed",
    period: Annotated[
        float, typer.Option(metavar="µs", help="Of the fastest motion expected.")
    ] = 17.0,
    tolerance: Annotated[
        float, typer.Option(help="Part of the stress that may depend on the past.")
    ] = 0.01,
    fresh: Fresh = False,
) -> None:
    """Whether a cache on (F, Ḟ) is sound: two pasts that end in the same (F, Ḟ).

    Both RVEs are integrated in time and go on alike after they meet; the difference of their
    stresses is what (F, Ḟ) does not tell. It must be small, and fade within a tenth of the period.

    Example: [bold]surrofe2 memory --cell water --out out/memory[/bold]
    """
    of = NamedCell.of(cell)
    settings = MemorySettings(period=period, tolerance=tolerance)
    study, paths = keep_study(
        out,
        "memory",
        of,
        asdict(settings),
        lambda: describe(measure(of.cell, settings)),
        fresh=fresh,
    )
    for path in paths:
        print_line(f"{path}: there already" if study is None else str(path))
    if study is not None:
        print_line(study.table.rows[0].verdict)
