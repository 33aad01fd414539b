"""`surrofe2 table`: tables of RVE answers in files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import say

table = typer.Typer(
    help="Tables of stresses that runs by --law table leave behind: show and merge them.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


def merge_tables(files: list[Path], out: Path, *, force: bool = False) -> int:
    """Write the records of all files into one; how many there are.

    Ellipsoids are tested for the smallest tolerance of the files.

    Raises:
        MismatchError: they are not of the same cell parameters and initialisation.
    """
    from dataclasses import replace

    from surrofe2.cache.table_merge import merged
    from surrofe2.io.files import refuse_existing
    from surrofe2.io.tables import check_table, read_table, write_table

    if not force:
        refuse_existing(out)
    tables = [read_table(path) for path in files]
    first = tables[0]
    tolerance = min(stored.tolerance for stored in tables)
    images = 4 if getattr(first.cell, "symmetry", "D4") == "D4" else 1
    records = first.records
    for path, stored in zip(files[1:], tables[1:], strict=True):
        check_table(path, stored, first.cell, first.initialisation)
        records = merged(records, stored.records, tolerance, images)
    sources = {"merged": [stored.recipe for stored in tables]}
    write_table(out, replace(first, records=records, tolerance=tolerance, recipe=sources))
    return len(records.centre)


@table.command()
def merge(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Tables, two or more.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The table to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing table.")] = False,
) -> None:
    """Records of several tables of one plant cell as one table.

    Example: [bold]surrofe2 table merge out/a/table.h5 out/b/table.h5 --out table.h5[/bold]
    """
    count = merge_tables(files, out, force=force)
    say(f"{out}: {count} records of {len(files)} tables")


@table.command()
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A table.")],
) -> None:
    """What a table is of and how much it knows.

    Example: [bold]surrofe2 table show out/table/table.h5[/bold]
    """
    from surrofe2.io.tables import read_table

    stored = read_table(file)
    share = 100.0 * stored.tolerance / stored.spread
    say(
        f"{file}: {len(stored.records.centre)} records, {stored.initialisation}, cell parameters "
        f"{stored.cell.fingerprint}, tolerance {stored.tolerance:.3g} µN/µm ({share:.3g} % of the "
        f"spread of stress, {stored.spread:.3g} µN/µm)"
    )
