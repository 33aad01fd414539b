"""`surrofe2 moduli`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from surrofe2.cli.console import (
    HOW,
    AnyInitialisation,
    CellName,
    Fresh,
    JsonFile,
    Report,
    done,
    on_interrupt,
    print_line,
    progress,
    show_table,
    stages,
)
from surrofe2.questions import memory as memory_of
from surrofe2.questions import stability as stability_of
from surrofe2.questions.memory import MemorySettings
from surrofe2.questions.moduli import (
    CHANGES,
    cell_moduli,
    changed_cells,
    moduli_tables,
    with_turgor,
)
from surrofe2.questions.moduli import (
    turgor as turgor_of,
)
from surrofe2.report.study import NamedCell, Study, keep_study
from surrofe2.rve import INITIALISATIONS
from surrofe2.store.store import keep


def moduli(
    cell: CellName = "printed",
    initialisation: Annotated[AnyInitialisation, typer.Option(metavar="NAME", help=HOW)] = "all",
    turgor: Annotated[
        float | None,
        typer.Option(metavar="MPa", help="Wanted turgor instead of the fluid's mass."),
    ] = None,
    tables: Annotated[
        bool, typer.Option("--tables", help="Also how they change with turgor, walls, particles.")
    ] = False,
    memory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also whether a cache on (F, Ḟ) is sound, by two pasts that end in the same "
            "(F, Ḟ); figure, CSV and numbers in DIR.",
        ),
    ] = None,
    period: Annotated[
        float,
        typer.Option(metavar="µs", help="--memory: period of the fastest motion expected."),
    ] = MemorySettings().period,
    stability: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also where the cell has a stable equilibrium; map, CSV and numbers in DIR.",
        ),
    ] = None,
    out: JsonFile = None,
    fresh: Fresh = False,
) -> None:
    """Elastic and viscous moduli of a plant cell at rest, in N/m and MPa.

    From the exact tangents of the stress at F = I. The turgor is the mean of c_s² ρ over the fluid
    particles, over the tissue's thickness; it is set by the fluid's mass.

    Example: [bold]surrofe2 moduli --cell water --tables[/bold]
    """
    of = NamedCell.of(cell)
    if turgor is not None:
        of = NamedCell(with_turgor(of.cell, turgor), of.name, of.source)
    asked = of.identity({"initialisation": initialisation, "tables": tables})

    def make() -> dict[str, Any]:
        return _moduli(of, initialisation, tables)

    was_there = False
    if out is None:
        make()
    else:
        _, was_there = keep(out, asked, make, fresh=fresh)
    if was_there:
        print_line(f"{out}: there already")
    else:
        done(out, f"elastic and viscous, of {of}")
    if memory is not None:
        wanted = MemorySettings(period=period)
        _study(
            "memory", of, memory, asdict(wanted), fresh,
            lambda report: memory_of.describe(
                memory_of.memory(of.cell, wanted, progress=_counted(report))
            ),
        )  # fmt: skip
    if stability is not None:
        _study(
            "stability", of, stability, {}, fresh,
            lambda report: stability_of.stability(of.cell, progress=_counted(report)),
        )  # fmt: skip


def _study(
    name: str,
    of: NamedCell,
    folder: Path,
    asked: Mapping[str, Any],
    fresh: bool,
    make: Callable[[Report], Study],
) -> None:
    """Make a study of the cell unless it is in the folder, and show it."""

    def compute() -> Study:
        with progress(name, 1.0, "parts") as report:
            return make(report)

    with on_interrupt("nothing was changed"):
        study, paths = keep_study(folder, name, of, asked, compute, fresh=fresh)
    files = ", ".join(path.name for path in paths)
    if study is None:
        print_line(f"{folder}: {files}, there already")
        return
    show_table(f"{' '.join(study.title.split())}, {of}", study.table)
    for row in study.table.to_records():
        if "verdict" in row:
            print_line(row["verdict"])
    print_line(f"{folder}: {files}")


def _moduli(of: NamedCell, initialisation: str, tables: bool) -> dict[str, Any]:
    """Compute and show them; what a file says of them."""
    chosen = INITIALISATIONS if initialisation == "all" else (initialisation,)
    with on_interrupt("nothing was changed"), stages() as stage:
        moduli_by_name = {}
        with stage("moduli", len(chosen), "initialisations") as report:
            pressure = turgor_of(of.cell)
            for name in chosen:
                moduli_by_name[name] = cell_moduli(of.cell, name)
                report(len(moduli_by_name), "")
        method = "slow-manifold" if initialisation == "all" else initialisation
        over = {}
        for name, change in CHANGES.items() if tables else ():
            values = change[1](of.cell)
            with stage(f"over {name}", len(values), "plant cells") as report:
                over[name] = changed_cells(of.cell, method, change, values, _counted(report))
    print_line(
        f"{of}, fluid particles of {of.cell.fluid_particle_mass:.5g} ng: turgor "
        f"{pressure.mean:.4g} MPa (mean of c_s² ρ), {pressure.virial:.4g} MPa (virial of the "
        f"fluid), {pressure.walls:.4g} MPa (carried by the walls)"
    )
    shown = moduli_tables(of.cell, moduli_by_name)
    for title, table in shown.items():
        show_table(title, table)
    for name, table in over.items():
        title = f"Over {name}, {method}: MPa, MPa µs"
        show_table(title, table)
        for row in table.rows:
            if "trouble" in row:
                print_line(f"{name} {row[CHANGES[name][0]]:.4g}: {row['trouble']}")
        shown[title] = table
    turgors = {"turgor_mean_MPa": pressure.mean, "turgor_virial_MPa": pressure.virial}
    turgors["turgor_walls_MPa"] = pressure.walls
    records = {title: table.to_records() for title, table in shown.items()}
    return {"fingerprint": of.cell.fingerprint, **turgors, "tables": records}


def _counted(report: Report) -> Callable[[float], None]:
    """A report of numbers alone."""
    return lambda done: report(done, "")
