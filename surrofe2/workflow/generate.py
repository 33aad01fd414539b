"""From a declared range of (F, Ḟ) to a data set of stresses."""

from __future__ import annotations

import builtins
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, training_points
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import StressLaw, StressResponse, describe
from surrofe2.recipe.recipe import Recipe
from surrofe2.rve import RveLaw
from surrofe2.store.samples import DataSetHeader, stored_count, writing_data_set
from surrofe2.workflow import laws
from surrofe2.workflow.progress import Report, no_report
from surrofe2.workflow.workers import in_pieces

Array = NDArray[np.float64]

CHUNK = 512


@dataclass(frozen=True, slots=True)
class Generated:
    """What is in a finished data set.

    Attributes:
        added: number of samples that this call computed; 0: it was already finished.
        failed: reason → number of samples.
        left: number of samples that have a stress, but whose RVE left a bifurcation.
    """

    path: Path
    count: int
    added: int
    failed: dict[str, int]
    left: int = 0


def counts_of(recipe: Recipe) -> tuple[int, ...]:
    """How many samples training takes, in turn."""
    return recipe.samples.counts(recipe.training.bound)


def wanted_count(recipe: Recipe, *, fresh: bool = False) -> int:
    """How many samples the recipe's data set is to have: what training begins with, or, where it
    has asked for more of them before, these.
    """
    counts, path = counts_of(recipe), recipe.data_path()
    if len(counts) == 1 or fresh or not path.exists():
        return counts[0]
    there = stored_count(path).rows
    return next((count for count in counts if count >= there), counts[-1])


def generate_data_set(
    recipe: Recipe,
    law: StressLaw | None = None,
    *,
    count: int = 0,
    fresh: bool = False,
    chunk: int = CHUNK,
    executor: Any = None,
    report: Report = no_report,
) -> Generated:
    """Sample the recipe's range, ask the RVE, and write the recipe's data set.

    Samples are asked without warm start and answered each for itself, so a data set that was
    continued, or made by several processes, equals one made in one go, to the bit.

    Args:
        law: asked instead of the recipe's RVE; an executor must be able to send it.
        count: of samples in the end, or `wanted_count` if that is more.
        executor: does the work, see `surrofe2.workflow.workers`; None: this process.
        report: is told the number of samples done.

    Raises:
        InputError: tangents are wanted of RVEs that have none.
    """
    path, settings, wanted = recipe.data_path(), recipe.samples, recipe.sampling_range()
    if settings.tangents and recipe.rve.solver == "iterated":
        raise InputError('samples.tangents: true; it needs rve.solver = "direct"')
    law, count = law or laws.true_law(recipe), max(count, wanted_count(recipe, fresh=fresh))
    header = DataSetHeader(
        cell=recipe.cell,
        rve=asdict(recipe.rve),
        range=wanted,
        count=count,
        seed=settings.seed,
        chunk=chunk,
        version=version("surrofe2"),
        recipe=recipe.to_dict(),
        reference=law.reference if isinstance(law, RveLaw) else None,
        tangents=settings.tangents,
        is_open=settings.count is None,
    )
    with writing_data_set(path, header, fresh=fresh) as data:
        added = count - data.completed
        failures = sum(n for code, n in data.status_counts().items() if code)
        report(data.completed, f"{failures} failed")
        work = partial(_sampled, law, wanted, settings.seed, settings.tangents)
        items = range(data.completed, count)
        for _, _, (F, F_dot, answer) in in_pieces(work, items, chunk, executor):
            data.append(F, F_dot, answer)
            failures += int((answer.status != 0).sum())
            report(data.completed, f"{failures} failed")
        counts, left = data.status_counts(), data.left_count()
        data.finish()
    failed = {describe(code): n for code, n in counts.items() if code}
    return Generated(path, count, added, failed, left)


def _sampled(
    law: StressLaw, wanted: SamplingRange, seed: int, tangents: bool, first: int, count: int
) -> tuple[Array, Array, StressResponse]:
    """Points `first` to `first + count` of a sequence, F and Ḟ, and the answers there."""
    F, F_dot = training_points(wanted, count, seed, start=first)
    answer = law.respond(F, F_dot, tangents=tangents)
    return F, F_dot, replace(answer, state=None)  # a warm start takes 20 kB a sample


def sample_stress(
    law: RveLaw,
    range: SamplingRange,
    count: int,
    *,
    seed: int = 1,
    tangents: bool = True,
    executor: Any = None,
    report: Report = no_report,
) -> StressSamples:
    """Samples of the stress of an RVE over a range, for `train`; the numbers of `generate`.

    Args:
        tangents: whether ∂P/∂F and ∂P/∂Ḟ are sampled too, from which training learns more.
        executor: does the work, see `surrofe2.workflow.workers`; None: this process.
        report: is told the number of samples done.

    Raises:
        InputError: `count` or `seed` is no such number, or the law has no tangents.
    """
    if count < 1:
        raise InputError(f"count: {count}; it must be at least 1")
    parts: list[tuple[Array, Array, StressResponse]] = []
    work = partial(_sampled, law, range, seed, tangents)
    for first, done, part in in_pieces(work, builtins.range(count), CHUNK, executor):
        parts.append(part)
        report(first + done, "")
    answers = [answer for _, _, answer in parts]
    slopes = [answer.tangents for answer in answers if answer.tangents is not None]
    left = [
        np.zeros(len(answer.status), np.bool_)
        if answer.left_bifurcation is None
        else answer.left_bifurcation
        for answer in answers
    ]
    return StressSamples(
        F=np.concatenate([F for F, _, _ in parts]),
        F_dot=np.concatenate([F_dot for _, F_dot, _ in parts]),
        stress=np.concatenate([answer.stress for answer in answers]),
        status=np.concatenate([answer.status for answer in answers]),
        cell=law.cell,
        initialisation=law.initialisation,
        range=range,
        seed=seed,
        rest_length=law.rest_length,
        P_by_F=np.concatenate([each.P_by_F for each in slopes]) if slopes else None,
        P_by_F_dot=np.concatenate([each.P_by_F_dot for each in slopes]) if slopes else None,
        left_bifurcation=np.concatenate(left),
    )


def data_summary(made: Generated) -> str:
    """How many samples there are and of what use; each is counted once."""
    failed = Counter(made.failed)
    text = f"{made.count} samples" + ("" if made.added else " (already finished)")
    usable = made.count - failed.total() - made.left
    text = f"{text}, {'all' if usable == made.count else usable} usable"
    if failed:
        reasons = "; ".join(f"{n}: {reason}" for reason, n in failed.most_common())
        text = f"{text}, {failed.total()} failed ({reasons})"
    if made.left:
        share = made.left / made.count
        text += (
            f", {made.left} left a bifurcation and are not trained on: in {share:.1%} of the "
            "recipe's range the stress has more than one value; narrow it where that matters"
        )
    return text
