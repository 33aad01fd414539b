"""`surrofe2 memory`: does the stress of a plant cell depend on its past?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import say
from surrofe2.cli.options import Preset, ReplaceFiles


def memory(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figure and data.")],
    preset: Preset = "printed",
    period: Annotated[
        float, typer.Option(metavar="µs", help="Of the fastest motion expected.")
    ] = 17.0,
    tolerance: Annotated[
        float, typer.Option(help="Part of the stress that may depend on the past.")
    ] = 0.01,
    force: ReplaceFiles = False,
) -> None:
    """Whether a cache on (F, Ḟ) is sound: two pasts that end in the same (F, Ḟ).

    Both RVEs are integrated in time and go on alike after they meet; the difference of their
    stresses is what (F, Ḟ) does not tell. It must be small, and fade within a tenth of the period.

    Example: [bold]surrofe2 memory --preset water --out out/memory[/bold]
    """
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.report.study_files import check_free, write_study
    from surrofe2.studies.memory import MemorySettings, describe
    from surrofe2.studies.memory import memory as measure

    name = f"memory-{preset}"
    if not force:
        check_free(out, name)
    cell = CellParameters.preset(preset)
    settings = MemorySettings(period=period, tolerance=tolerance)
    found = measure(cell, settings)
    for path in write_study(out, describe(found, settings, preset, name), cell, preset):
        say(str(path))
    say(found.verdict(settings))
