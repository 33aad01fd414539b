"""`surrofe2 generate`, `train`, `refine` and `export`: a surrogate, from samples to C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from surrofe2.base.errors import InputError
from surrofe2.cli import console
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.store.c_source import write_c
from surrofe2.store.run_folder import of_cell
from surrofe2.store.surrogates import read_surrogate
from surrofe2.workflow.generate import data_summary, generate_data_set, wanted_count
from surrofe2.workflow.laws import open_study, recipe_notes
from surrofe2.workflow.refine import QUANTITIES, SURROGATE, Round, refine_surrogate
from surrofe2.workflow.train import (
    STRESSES,
    large_errors,
    train_surrogate,
    training_summary,
    unfinished_training,
)
from surrofe2.workflow.workers import executor_of


def generate(
    recipe: console.RecipeFile,
    cell: console.OneCell = None,
    fresh: console.Fresh = False,
    workers: console.Workers = 0,
    scheduler: console.Scheduler = None,
    threads: console.Threads = None,
) -> None:
    """Compute plant-cell stresses over a range of (F, Ḟ) into a data set.

    The recipe's [range] says how far F and Ḟ (1/µs) go, [samples] how many samples and which file,
    and with tangents = true stores ∂P/∂F and ∂P/∂Ḟ too. Where it leaves their number out, these are
    the samples that training begins with, or has needed since. Samples whose RVE fails stay in the
    file, with the reason; those whose RVE left an unstable equilibrium for another one are marked
    and not trained on.

    Example: surrofe2 generate data/bending-bar.toml

    Several processes or a cluster (--workers, --scheduler) give the same samples, to the bit where
    their processors are of one kind.

    Next: surrofe2 train data/bending-bar.toml
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    with executor_of(workers, scheduler) as executor:
        for cell_study in study.studies(cell).values():
            what = cell_study.title("generate")
            count = wanted_count(cell_study, fresh=fresh)
            kept = "the samples so far are kept"
            begun = (cell_study.data_path(),)
            with console.working(what, count, "samples", kept, begun) as report:
                data_set = generate_data_set(
                    cell_study, fresh=fresh, executor=executor, report=report
                )
            console.done(data_set.path, data_summary(data_set))


def train(
    recipe: console.RecipeFile,
    add: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Harvest (harvest.h5) of a cached run to train on too; may be repeated.",
        ),
    ] = None,
    cell: console.OneCell = None,
    fresh: console.Fresh = False,
    threads: console.Threads = None,
) -> None:
    """Fit a surrogate of the plant-cell stress to the recipe's data set.

    Shows the errors on held-out samples, for each stress component, relative to that component's
    standard deviation over them. Then calibrates the bound
    of the error at a single point, by RVEs along paths as the recipe's [calibration] has it.

    Where the recipe leaves the number of samples out, training is repeated on twice as many until
    this bound is what [training] wants, or twice as many do not help, on 16384 at most.

    Example: surrofe2 train data/bending-bar.toml

    Next: surrofe2 run data/bending-bar.toml --law cached --out out/cached
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    studies = study.studies(cell)
    if add and len(studies) > 1:
        names = ", ".join(str(name) for name in studies)
        raise InputError(f"--add: a harvest is of one cell; choose --cell, one of {names}")
    for name, cell_study in studies.items():
        begun = (unfinished_training(cell_study), cell_study.training_path())
        with console.on_interrupt("the iterations so far are kept", begun):
            trained = train_surrogate(
                cell_study, fresh=fresh, add=add or (), stage=console.progress
            )
        errors = trained.surrogate.errors
        quantities: list[Quantity[str]] = [
            Quantity("stress", "", "", str),
            Quantity("spread", "µN/µm", ".3g", errors["spread"].get),
            Quantity("RMS", "", percent(2), errors["rms"].get),
            Quantity("worst", "", percent(2), errors["worst"].get),
        ]
        whose = "" if name is None else f" of {name}"
        title = f"Held-out errors{whose}, {errors['points']} samples"
        console.show_table(title, Table(quantities, STRESSES))
        for line in trained.bound.splitlines():
            console.print_line(line)
        console.done(trained.path, training_summary(trained))
        warning = large_errors(cell_study, trained)
        if warning is not None:
            console.print_warning(warning)


def refine(
    recipe: console.RecipeFile,
    out: console.OutFolder = None,
    cell: console.OneCell = None,
    rounds: Annotated[int, typer.Option(min=1, metavar="N", help="Rounds at most.")] = 6,
    fresh: console.Fresh = False,
    threads: console.Threads = None,
) -> None:
    """Active learning: retrain on states that the run could not trust.

    Runs through the cache, in time or at rest as the recipe states, collects the states that the
    surrogate did not know well enough, solves RVEs there and around, trains again, and so on until
    a run has no unknown state and its audit holds. DIR receives refine.json (the table of rounds)
    and surrogate.h5, of several cells surrogate-NAME.h5.

    Example: surrofe2 refine data/bending-bar-triple-load.toml

    Next: surrofe2 run RECIPE --law cached --surrogate DIR/surrogate.h5
    """
    study = open_study(recipe, threads)
    console.show_notes(recipe_notes(study))
    folder = console.folder_of(out, recipe)
    rows = list[Round]()

    def tell(row: Round) -> None:
        """Keep a row, and print what became of its round."""
        rows.append(row)
        console.print_line(row.sentence)

    try:
        with console.on_interrupt(f"{folder} keeps the finished rounds"):
            refine_surrogate(
                study,
                folder,
                cell=cell,
                rounds=rounds,
                fresh=fresh,
                stage=console.progress,
                tell=tell,
            )
    finally:
        if rows:
            console.show_table("Rounds", Table(QUANTITIES, rows))
    files = ", ".join(str(folder / of_cell(SURROGATE, name)) for name in study.studies(cell))
    console.done(files, f"settled after {rows[-1].round + 1} rounds")


def export(
    surrogate: Annotated[
        Path, typer.Argument(metavar="SURROGATE", help="A trained surrogate (.h5).")
    ],
    to: Annotated[Literal["c"], typer.Option(help="The language.")] = "c",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file to write; default: beside SURROGATE, .c."),
    ] = None,
    name: Annotated[
        str, typer.Option(metavar="NAME", help="What the names of its functions begin with.")
    ] = "surrofe2",
    fresh: console.Fresh = False,
) -> None:
    """Write a surrogate as C source and header: stress, tangents, domain and bound of the error.

    The source needs the standard library alone; its head says how to call it, and examples/umat.f90
    calls it as the UMAT of a finite-element program.

    Example: surrofe2 export training/bending-bar.h5 --to c
    """
    law = read_surrogate(surrogate)
    path = out or surrogate.with_suffix(f".{to}")
    text = write_c(law, path, name, fresh=fresh)
    console.done(path, f"{len(text.splitlines())} lines of C, {len(text.encode()) / 1e3:.0f} kB")
