"""`surrofe2 generate`."""

from __future__ import annotations

import time

from surrofe2.cli.console import Fresh, RecipeFile, Threads, on_interrupt, print_line, progress
from surrofe2.recipe import load_recipe
from surrofe2.workflow.generate import data_summary, generate_data_set
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.run_lifecycle import time_text


def generate(recipe: RecipeFile, fresh: Fresh = False, threads: Threads = None) -> None:
    """Compute plant-cell stresses over a range of (F, Ḟ) into a data set.

    The recipe's [bold]\\[range][/bold] says how far F and Ḟ (1/µs) go, [bold]\\[samples][/bold]
    how many samples and which file, and with [bold]tangents = true[/bold] stores ∂P/∂F and ∂P/∂Ḟ
    too. Samples whose RVE fails stay in the file, with the reason; those whose RVE left an
    unstable equilibrium for another one are marked and not trained on.

    Example: [bold]surrofe2 generate data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 train data/bending-bar.toml[/bold]
    """
    study = load_recipe(recipe)
    use_threads(threads)
    begin = time.perf_counter()
    with (
        on_interrupt("the samples so far are kept"),
        progress("generate", study.samples.count, "samples") as report,
    ):
        made = generate_data_set(study, fresh=fresh, report=report)
    print_line(f"{made.path}: {data_summary(made)}, {time_text(time.perf_counter() - begin)}")
