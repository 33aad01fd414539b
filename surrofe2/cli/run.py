"""`surrofe2 run`: by one process, or by ranks that mpiexec started."""

from __future__ import annotations

import atexit
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.base.errors import InputError, printable
from surrofe2.base.interruption import end_work, held
from surrofe2.base.launcher import rank, world_size
from surrofe2.base.units import time_text
from surrofe2.cli import console
from surrofe2.ranks.driver import (
    Driver,
    leave,
    own_threads,
    serve,
    watched,
    world,
)
from surrofe2.recipe.recipe import changed
from surrofe2.workflow.laws import open_study, recipe_notes, surrogates_by_cell, use_threads
from surrofe2.workflow.rest import (
    extent_of,
    notes_of,
    response_lines,
    study_by_method,
    summary_of,
)
from surrofe2.workflow.scale import sap_notes
from surrofe2.workflow.zoom import add_cell_fields


def run(
    recipe: Annotated[
        Path,
        typer.Argument(
            metavar="RECIPE", help="The study's TOML file, or a run folder to be repeated."
        ),
    ],
    out: console.RunFolder,
    law: console.LawOrNone = None,
    surrogate: console.SurrogateFiles = None,
    table: console.TableFiles = None,
    cell_fields: Annotated[
        bool,
        typer.Option(
            "--cell-fields",
            help="Write wall stretch, pressures of fluid and contacts, and area too, by an RVE for "
            "each element and frame.",
        ),
    ] = False,
    initialisation: console.Initialisation = None,
    integrator: Annotated[
        Literal["explicit", "implicit"] | None,
        typer.Option(
            metavar="NAME",
            help="explicit, or implicit; default: the recipe's.",
        ),
    ] = None,
    tolerance: console.Tolerance = None,
    audit: console.Audit = None,
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Run the recipe's problem: a tissue on its mesh, and all that holds, moves or touches it.

    A recipe with a section [rest] is run by load steps to rest, as `surrofe2 rest` does; others,
    and all with --integrator, in time.

    A run folder instead of RECIPE is repeated in DIR by its own law, from the recipe, mesh and
    surrogates that it keeps, and the largest difference from its results is printed.

    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of the watched
    points in µm), history.csv (forces, motion of boundaries), energies.csv (pJ) and fields.xdmf for
    ParaView; with --law table the table, with --law cached or table the harvest of RVE stresses.

    With mpiexec -n N before the command, N ranks share the RVEs (needs surrofe2[mpi]).

    Example: surrofe2 run data/bending-bar.toml --law cached --out out/cached

    Next: surrofe2 compare out/rve out/cached --out out/comparison
    """
    with all_ranks(threads, f"{out} keeps the run up to its last checkpoint") as threads:
        if recipe.is_dir():
            stated = {
                "--law": law,
                "--surrogate": surrogate,
                "--table": table,
                "--initialisation": initialisation,
                "--integrator": integrator,
                "--tolerance": tolerance,
                "--audit": audit,
            }
            _repeat(recipe, out, stated, threads, cell_fields=cell_fields, fresh=fresh)
            return
        study = open_study(recipe, threads)
        if law is None:
            raise InputError("--law: missing; it must be one of rve, surrogate, cached, table")
        console.show_notes(recipe_notes(study))
        study = replace(
            study,
            rve=changed(study.rve, initialisation=initialisation),
            cache=changed(study.cache, tolerance=tolerance, audit=audit),
            macro=changed(study.macro, integrator=integrator),
        )
        if integrator is not None and study.rest is not None:
            console.print_line(f"in time by {integrator} steps, though the recipe states a [rest]")
            study = replace(study, rest=None)
        console.show_notes(sap_notes(study))
        what = "run" if study.rest is None else "rest"
        with console.running(f"{what} by {law}", *extent_of(study), out) as report:
            record = study_by_method(
                study,
                law,
                out,
                surrogates=surrogates_by_cell(study, surrogate or ()),
                tables=table or (),
                fresh=fresh,
                report=report,
            )
    for line in response_lines(out, record):
        console.print_line(line)
    console.done(out, summary_of(record), timed=False)
    if cell_fields:
        _add_cell_fields(out)
    console.show_notes(notes_of(record, study))
    if study.rest is None:
        console.show_notes(sap_notes(study, record.duration / record.counts["steps"]))


def _add_cell_fields(out: Path) -> None:
    """Write the cell fields of a run into its folder, and say how long that took."""
    begin = time.perf_counter()
    count = add_cell_fields(out)
    seconds = time.perf_counter() - begin
    console.print_line(f"{out}: cell fields of {count} RVEs in {time_text(seconds)}")


def _repeat(
    folder: Path,
    out: Path,
    stated: Mapping[str, object],
    threads: int | None,
    *,
    cell_fields: bool,
    fresh: bool,
) -> None:
    """Repeat the run of a folder, and print by how much the results differ.

    Args:
        stated: values of options that a repeated run has already, by name.

    Raises:
        InputError: one of these options is stated, or cell fields are wanted of a full tissue.
    """
    # late: it loads the full tissue, which other runs do not need
    from surrofe2.workflow.repeat import repeat_run, repetition, stored_run
    from surrofe2.workflow.tissue import tissue_summary

    for name, value in stated.items():
        if value is not None:
            raise InputError(f"{name}: not with a run folder, which states it; leave it out")
    stored = stored_run(folder)
    use_threads(threads)
    record = stored.record
    if cell_fields and record.law == "tissue":
        raise InputError("--cell-fields: not of the full tissue, which has all its particles")
    extent, unit = extent_of(stored.recipe)
    with console.running(f"{folder.name} again by {record.law}", extent, unit, out) as report:
        again = repeat_run(stored, out, fresh=fresh, report=report)
    summary = tissue_summary(again) if record.law == "tissue" else summary_of(again)
    console.done(out, summary, timed=False)
    console.print_line(repetition(stored, out).sentence)
    if cell_fields:
        _add_cell_fields(out)


@contextmanager
def all_ranks(threads: int | None, what: str) -> Iterator[int | None]:
    """Yield the threads of each rank, in a block that rank 0 alone enters; without ranks `threads`.

    Args:
        what: words for what is kept, for the message where a rank dies.

    Raises:
        Exit: here and on every other rank, when rank 0 is done.
    """
    if world_size() < 2:
        yield threads
        return
    threads = threads or own_threads()
    use_threads(threads)
    again = console.command_line(word for word in sys.argv[1:] if word != "--fresh")
    message = f"error: a rank died; {what}; any number of ranks resumes with: {again}"
    with watched(printable(message)) if rank() == 0 else nullcontext():
        comm = world()
        if comm.rank:
            with held():
                code = serve(comm, sys.argv[1:])
                end_work()  # rank 0 prints how the run ended
            atexit.register(leave, code)
            raise typer.Exit(code)
        atexit.register(leave)  # the last act: a launcher may not pass on lines any longer
        with Driver(comm, sys.argv[1:]):
            yield threads
