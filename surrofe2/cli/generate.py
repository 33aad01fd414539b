"""`surrofe2 generate`."""

from __future__ import annotations

from surrofe2.cli import console
from surrofe2.workflow.generate import data_summary, generate_data_set, wanted_count
from surrofe2.workflow.laws import open_study
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

    The recipe's [bold]\\[range][/bold] says how far F and Ḟ (1/µs) go, [bold]\\[samples][/bold]
    how many samples and which file, and with [bold]tangents = true[/bold] stores ∂P/∂F and ∂P/∂Ḟ
    too. Where it leaves their number out, these are the samples that training begins with, or has
    asked for since. Samples whose RVE fails stay in the file, with the reason; those whose RVE left
    an unstable equilibrium for another one are marked and not trained on.

    Example: [bold]surrofe2 generate data/bending-bar.toml[/bold]

    Several processes or a cluster ([bold]--workers[/bold], [bold]--scheduler[/bold]) give the same
    samples, to the bit where their processors are of one kind.

    Next: [bold]surrofe2 train data/bending-bar.toml[/bold]
    """
    study = open_study(recipe, threads)
    with executor_of(workers, scheduler) as executor:
        for name, part in study.parts(cell).items():
            kept = "the samples so far are kept"
            what, count = f"generate {name}".rstrip(), wanted_count(part, fresh=fresh)
            begun = (part.data_path(),)
            with console.working(what, count, "samples", kept, begun) as report:
                data_set = generate_data_set(part, fresh=fresh, executor=executor, report=report)
            console.done(data_set.path, data_summary(data_set))
