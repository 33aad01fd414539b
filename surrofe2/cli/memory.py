"""`surrofe2 memory`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import Fresh, Preset, print_line
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import study_is_there, write_study
from surrofe2.studies.memory import MemorySettings, describe
from surrofe2.studies.memory import memory as measure


def memory(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figure and data.")],
    preset: Preset = "printed",
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

    Example: [bold]surrofe2 memory --preset water --out out/memory[/bold]
    """
    name, cell = f"memory-{preset}", CellParameters.preset(preset)
    settings = MemorySettings(period=period, tolerance=tolerance)
    asked = asdict(settings)
    if not fresh and study_is_there(out, name, cell, preset, asked):
        print_line(f"{out / name}.json: there already")
        return
    found = measure(cell, settings)
    for path in write_study(out, describe(found, preset), cell, preset, asked):
        print_line(str(path))
    print_line(found.verdict)
