"""`surrofe2 moduli`."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated

import typer

from surrofe2.cli.console import print_error, print_line, show_table
from surrofe2.cli.options import AnyInitialisation, Fresh, JsonFile, Preset
from surrofe2.io.files import is_there, write_json
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import INITIALISATIONS
from surrofe2.studies.moduli import cell_moduli, to_numbers, with_turgor
from surrofe2.studies.moduli import turgor as turgor_of
from surrofe2.studies.moduli_tables import TABLES, ModuliRow
from surrofe2.studies.moduli_tables import to_numbers as row_numbers

NAMES = ("C11", "C12", "C66", "bulk", "shear", "shear_45", "young", "poisson")


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
    _show({name: to_numbers(cell, value) for name, value in found.items()})
    record: dict[str, object] = {
        **asked,
        "preset": preset,
        "fingerprint": cell.fingerprint,
        "turgor_mean_MPa": pressure.mean,
        "turgor_virial_MPa": pressure.virial,
        "moduli": {name: to_numbers(cell, value) for name, value in found.items()},
    }
    if tables:
        method = "slow-manifold" if initialisation == "all" else initialisation
        changes = {}
        for name, (heading, make) in TABLES.items():
            rows = make(cell, method)
            changes[name] = [row_numbers(row) for row in rows]
            _show_changes(f"Over {name}, {method}", heading, rows, cell)
        record["tables"] = {"initialisation": method, "units": "N/m, N/m µs", **changes}
    if out is not None:
        write_json(out, record)
        print_line(str(out))


def _show(found: dict[str, dict[str, dict[str, dict[str, float]]]]) -> None:
    for kind in ("elastic", "viscous"):
        units = next(iter(found.values()))[kind]
        for unit in units:
            rows = [
                [method, *(f"{kinds[kind][unit][name]:.4g}" for name in NAMES)]
                for method, kinds in found.items()
            ]
            title = f"{kind.capitalize()} moduli, {unit} (Poisson: 1)"
            show_table(title, ["initialisation", *NAMES], rows)


def _show_changes(title: str, heading: str, rows: list[ModuliRow], cell: CellParameters) -> None:
    t = cell.tissue_thickness
    columns = [heading, "turgor", "l₀/spring", "bulk", "shear", "shear 45°", "young", "visc. shear"]
    shown = []
    for row in rows:
        if row.moduli is None or row.turgor is None:
            shown.append([f"{row.value:.4g}", *["–"] * (len(columns) - 1)])
            continue
        e, v = row.moduli.elastic, row.moduli.viscous
        solid = (value / t for value in (e.bulk, e.shear, e.shear_45, e.young, v.shear))
        figures = (row.turgor.mean, row.relative_rest_length or 0.0, *solid)
        shown.append([f"{row.value:.4g}", *(f"{value:.4g}" for value in figures)])
    show_table(f"{title}: MPa, MPa µs", columns, shown)
    for row in rows:
        if row.trouble:
            print_error(f"{heading} {row.value:.4g}: {row.trouble}")
