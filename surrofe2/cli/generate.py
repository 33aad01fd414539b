"""`surrofe2 generate`: from a declared range of (F, Ḟ) to a data set of stresses."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from surrofe2.cli.console import duration, keeping, progress, say
from surrofe2.cli.options import RecipeFile, Threads

if TYPE_CHECKING:
    from surrofe2.recipe import Recipe
    from surrofe2.stress_law import StressLaw

CHUNK = 512


@dataclass(frozen=True, slots=True)
class Generated:
    """What is in a finished data set.

    Attributes:
        failed: reason → number of samples.
        left: number of samples whose RVE left a bifurcation.
    """

    path: Path
    count: int
    added: int
    failed: dict[str, int]
    left: int = 0


def generate_data_set(
    recipe: Recipe,
    law: StressLaw | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    chunk: int = CHUNK,
    report: Callable[[int, str], None] = lambda done, note: None,
) -> Generated:
    """Sample the recipe's range, ask the RVE, and write the recipe's data set.

    Samples are asked in chunks of fixed bounds and without warm start, so a continued data set
    equals one made in one go, to the bit.

    Args:
        law: asked instead of the recipe's RVE.
        report: called with the number of samples done and a remark.

    Raises:
        InputError: tangents are wanted of RVEs that have none.
    """
    from importlib.metadata import version

    from surrofe2.errors import InputError
    from surrofe2.io.data_sets import DataSetHeader, finish_data_set, writing_data_set
    from surrofe2.rve import RveLaw
    from surrofe2.sampling import sample
    from surrofe2.stress_law import describe

    path, settings = recipe.data_path(), recipe.samples
    if settings.tangents and recipe.rve.solver == "iterated":
        raise InputError('samples.tangents: true; it needs rve.solver = "direct"')
    wish: dict[str, Any] = {"tangents": True} if settings.tangents else {}
    law = law or RveLaw(recipe.cell, recipe.rve)
    header = DataSetHeader(
        cell=recipe.cell,
        rve=asdict(recipe.rve),
        range=recipe.range,
        count=settings.count,
        seed=settings.seed,
        chunk=chunk,
        version=version("surrofe2"),
        recipe=recipe.to_dict(),
        rest_length=getattr(law, "rest_length", None),
        tangents=settings.tangents,
    )
    with writing_data_set(path, header, resume=resume, force=force) as data:
        added = settings.count - data.completed
        failures = sum(n for code, n in data.status_counts().items() if code)
        report(data.completed, f"{failures} failed")
        while data.completed < settings.count:
            start = data.completed
            F, F_dot = sample(
                recipe.range, min(chunk, settings.count - start), settings.seed, start=start
            )
            answer = law.respond(F, F_dot, **wish)
            data.append(
                F, F_dot, answer.stress, answer.status, answer.tangents, answer.left_bifurcation
            )
            failures += int((answer.status != 0).sum())
            report(data.completed, f"{failures} failed")
        counts, left = data.status_counts(), data.left_count()
    finish_data_set(path)
    failed = {describe(code): n for code, n in counts.items() if code}
    return Generated(path, settings.count, added, failed, left)


def generate(
    recipe: RecipeFile,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an unfinished data set.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing data set.")] = False,
    threads: Threads = None,
) -> None:
    """Compute plant-cell stresses over a range of (F, Ḟ) into a data set.

    The recipe's [bold]\\[range][/bold] says how far F and Ḟ (1/µs) go, [bold]\\[samples][/bold]
    how many samples and which file, and with [bold]tangents = true[/bold] stores ∂P/∂F and ∂P/∂Ḟ
    too. Samples whose RVE fails stay in the file, with the reason; those whose RVE left an
    unstable equilibrium for another one are marked and not trained on.

    Example: [bold]surrofe2 generate data/bending-bar.toml[/bold]

    Next: [bold]surrofe2 train data/bending-bar.toml[/bold]
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.recipe import load_recipe

    study = load_recipe(recipe)
    use_threads(threads)
    begin = time.perf_counter()
    kept = f"the samples so far are kept; continue with: surrofe2 generate {recipe} --resume"
    with keeping(kept), progress("generate", study.samples.count, "samples") as report:
        made = generate_data_set(study, resume=resume, force=force, report=report)
    say(f"{made.path}: {summary(made)}, {duration(time.perf_counter() - begin)}")


def summary(made: Generated) -> str:
    """How many samples there are, how many were added, how many failed and why."""
    failed = Counter(made.failed)
    text = f"{made.count} samples" + ("" if made.added else " (already finished)")
    if not failed:
        text = f"{text}, none failed"
    else:
        reasons = "; ".join(f"{n}: {reason}" for reason, n in failed.most_common())
        text = f"{text}, {failed.total()} failed ({reasons})"
    if made.left:
        share = made.left / made.count
        text += (
            f", {made.left} left a bifurcation and are not trained on: in {share:.1%} of the "
            "recipe's range the stress has more than one value; narrow it where that matters"
        )
    return text
