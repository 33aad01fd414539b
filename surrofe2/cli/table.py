"""`surrofe2 table`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import Fresh, done
from surrofe2.io.tables import read_table
from surrofe2.workflow.run_outputs import merge_tables

table = typer.Typer(
    help="Tables of stresses that runs by --law table leave behind: show and merge them.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@table.command()
def merge(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Tables, two or more.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The table to write.")],
    fresh: Fresh = False,
) -> None:
    """Records of several tables of one plant cell as one table.

    Example: [bold]surrofe2 table merge out/a/table.h5 out/b/table.h5 --out table.h5[/bold]
    """
    count = merge_tables(files, out, fresh=fresh)
    done(out, f"{count} records of {len(files)} tables", records=count)


@table.command()
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A table.")],
) -> None:
    """What a table is of and how much it knows.

    Example: [bold]surrofe2 table show out/table/table.h5[/bold]
    """
    stored = read_table(file)
    share = 100.0 * stored.tolerance / stored.spread
    done(
        file,
        f"{len(stored.records.centre)} records, {stored.initialisation}, cell parameters "
        f"{stored.cell.fingerprint}, tolerance {stored.tolerance:.3g} µN/µm ({share:.3g} % of the "
        f"spread of stress, {stored.spread:.3g} µN/µm)",
        timed=False,
        records=len(stored.records.centre),
        tolerance=stored.tolerance,
        spread=stored.spread,
    )
