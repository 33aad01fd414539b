"""`surrofe2 train` and `surrofe2 refine`: a surrogate from a data set, and from its own runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.cli import console
from surrofe2.recipe.recipe import Recipe
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.workflow.laws import open_study
from surrofe2.workflow.refine import QUANTITIES, SURROGATE, Round, refine_surrogate
from surrofe2.workflow.run import of_cell
from surrofe2.workflow.train import (
    STRESSES,
    large_errors,
    train_surrogate,
    training_summary,
    unfinished_training,
)


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

    Shows the errors on samples that training never saw and that decided nothing, for each stress
    component, relative to that component's standard deviation over them. Then calibrates the bound
    of the error at a single point, by RVEs along paths as the recipe's
    [bold]\\[calibration][/bold] has it.

    Where the recipe leaves the number of samples out, the data set grows until this bound is what
    [bold]\\[training][/bold] wants, or twice as many samples do not help, to 16384 at most.

    Example: [bold]surrofe2 train data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]
    """
    study = open_study(recipe, threads)
    parts = study.parts(cell)
    if add and len(parts) > 1:
        raise InputError(
            f"--add: a harvest is of one cell; say --cell and one of {', '.join(parts)}"
        )
    for part in parts.values():
        _train(part, add or (), fresh)


def _train(study: Recipe, add: Sequence[Path], fresh: bool) -> None:
    begun = (unfinished_training(study), study.training_path())
    with console.on_interrupt("the iterations so far are kept", begun):
        trained = train_surrogate(study, fresh=fresh, add=add, stage=console.progress)
    errors = trained.surrogate.errors
    quantities: list[Quantity[str]] = [
        Quantity("stress", "", "", lambda name: name),
        Quantity("spread", "µN/µm", ".3g", lambda name: errors["spread"][name]),
        Quantity("RMS", "", percent(2), lambda name: errors["rms"][name]),
        Quantity("worst", "", percent(2), lambda name: errors["worst"][name]),
    ]
    of = study.cell_name and f" of {study.cell_name}"
    title = f"Held-out errors{of}, {errors['points']} samples"
    console.show_table(title, Table(quantities, STRESSES))
    for line in trained.bound.splitlines():
        console.print_line(line)
    summary = training_summary(trained)
    console.done(trained.path, summary)
    warning = large_errors(study, trained)
    if warning is not None:
        console.print_warning(warning)


def refine(
    recipe: console.RecipeFile,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the rounds; default: out/refine-RECIPE."),
    ] = None,
    cell: console.OneCell = None,
    rounds: Annotated[int, typer.Option(min=1, metavar="N", help="Rounds at most.")] = 6,
    fresh: console.Fresh = False,
    threads: console.Threads = None,
) -> None:
    """Active learning: retrain on states that the run could not trust.

    Runs through the cache, collects the states that the surrogate did not know well enough, solves
    RVEs there and around, trains again, and so on until a run has no unknown state and its audit
    holds. DIR receives refine.json (the table of rounds) and surrogate.h5, of several
    cells surrogate-NAME.h5.

    Example: [bold]surrofe2 refine data/bending-bar-triple-load.toml[/bold]

    Next: [bold]surrofe2 run RECIPE --law cached --surrogate DIR/surrogate.h5[/bold]
    """
    study = open_study(recipe, threads)
    folder = out or Path("out") / f"refine-{recipe.stem}"
    rounds_done: list[Round] = []

    def tell(row: Round) -> None:
        rounds_done.append(row)
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
    except SimulationError:
        show_rounds(rounds_done)
        raise
    show_rounds(rounds_done)
    files = ", ".join(str(folder / of_cell(SURROGATE, name)) for name in study.parts(cell))
    console.done(files, f"settled after {rounds_done[-1].round + 1} rounds")


def show_rounds(rounds_done: list[Round]) -> None:
    """The table of rounds."""
    console.show_table("Rounds", Table(QUANTITIES, rounds_done))
