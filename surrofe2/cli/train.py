"""`surrofe2 train`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from surrofe2.cli.console import (
    Fresh,
    RecipeFile,
    Threads,
    on_interrupt,
    print_line,
    progress,
    show_table,
)
from surrofe2.recipe import load_recipe
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.run_lifecycle import time_text
from surrofe2.workflow.train import STRESSES, train_surrogate, training_summary


def train(
    recipe: RecipeFile,
    add: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Harvest (harvest.h5) of a cached run to train on too; may be repeated.",
        ),
    ] = None,
    fresh: Fresh = False,
    threads: Threads = None,
) -> None:
    """Fit a surrogate of the plant-cell stress to the recipe's data set.

    Shows the errors on samples that training never saw, for each stress component, relative to
    that component's standard deviation over them. Then calibrates the bound of the error that
    holds at a single point, by true RVEs along paths as the recipe's
    [bold]\\[calibration][/bold] has it.

    Example: [bold]surrofe2 train data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]
    """
    study = load_recipe(recipe)
    use_threads(threads)
    begin = time.perf_counter()
    with on_interrupt("the iterations so far are kept"):
        trained = train_surrogate(study, fresh=fresh, add=add or (), stage=progress)
    errors = trained.surrogate.errors
    rows = []
    for name in STRESSES:
        shares = [f"{100 * errors[figure][name]:.2g} %" for figure in ("rms", "worst")]
        rows.append([name, f"{errors['spread'][name]:.3g}", *shares])
    columns = ["stress", "spread (µN/µm)", "RMS", "worst"]
    show_table(f"Held-out errors, {errors['points']} samples", columns, rows)
    print_line(trained.bound)
    taken = time_text(time.perf_counter() - begin)
    print_line(f"{trained.path}: {training_summary(trained)}, {taken}")
