"""`surrofe2 moduli`."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated

import typer

from surrofe2.cli.console import AnyInitialisation, Fresh, JsonFile, Preset, print_line, show_table
from surrofe2.io.files import is_there, write_json
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import INITIALISATIONS
from surrofe2.studies.moduli import (
    CHANGES,
    cell_moduli,
    changed_cells,
    moduli_tables,
    with_turgor,
)
from surrofe2.studies.moduli import turgor as turgor_of


def moduli(
    preset: Preset = "printed",
    initialisation: Annotated[
        AnyInitialisation, typer.Option(help="One initialisation, or all.")
    ] = "all",
    turgor: Annotated[
        float | None,
        typer.Option(metavar="MPa", help="Wanted turgor instead of the fluid's mass."),
    ] = None,
    tables: Annotated[
        bool, typer.Option("--tables", help="Also how they change with turgor, walls, particles.")
    ] = False,
    out: JsonFile = None,
    fresh: Fresh = False,
) -> None:
    """Elastic and viscous moduli of a plant cell at rest, in N/m and MPa.

    From the exact tangents of the stress at F = I. The turgor is the mean of c_s² ρ over the fluid
    particles, over the tissue's thickness; it is set by the fluid's mass.

    Example: [bold]surrofe2 moduli --preset water --tables[/bold]
    """
    cell = CellParameters.preset(preset)
    if turgor is not None:
        cell = with_turgor(cell, turgor)
    asked = {
        "version": version("surrofe2"),
        "cell": cell.to_dict(),
        "asked": {"initialisation": initialisation, "tables": tables},
    }
    if out is not None and not fresh and is_there(out, asked):
        print_line(f"{out}: there already")
        return
    pressure = turgor_of(cell)
    print_line(
        f"preset {preset}, fluid particles of {cell.fluid_particle_mass:.5g} ng: turgor "
        f"{pressure.mean:.4g} MPa (mean of c_s² ρ), {pressure.virial:.4g} MPa (virial of the fluid)"
    )
    chosen = INITIALISATIONS if initialisation == "all" else (initialisation,)
    found = {name: cell_moduli(cell, name) for name in chosen}
    shown = moduli_tables(cell, found)
    if tables:
        method = "slow-manifold" if initialisation == "all" else initialisation
        for name, change in CHANGES.items():
            title = f"Over {name}, {method}: MPa, MPa µs"
            shown[title] = changed_cells(cell, method, change)
    for title, each in shown.items():
        show_table(title, *each.for_people())
    if out is not None:
        turgors = {"turgor_mean_MPa": pressure.mean, "turgor_virial_MPa": pressure.virial}
        records = {title: each.to_records() for title, each in shown.items()}
        about = {"preset": preset, "fingerprint": cell.fingerprint}
        write_json(out, {**asked, **about, **turgors, "tables": records})
        print_line(str(out))
