"""Parts of a round of `surrofe2 refine`: what a run did not know, what is sampled for it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from surrofe2.cache.protocols import Surrogate
    from surrofe2.io.harvest import Harvest
    from surrofe2.recipe import Recipe
    from surrofe2.sampling import SamplingRange
    from surrofe2.stress_law import StressLaw

Array = NDArray[np.float64]

FALLBACK, AUDIT, NEIGHBOUR, WIDENED = 0, 1, 2, 3
AUDIT_QUANTILE = 0.99
MOST_NEIGHBOURS = 20_000
"""Largest number of neighbours sampled in a round; as many as unknown states below it."""
CHUNK = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """A row of the table of rounds.

    Attributes:
        hits: share of the run's answers that came from the surrogate.
        unknown: states at accepted steps that the surrogate could not answer, and audited ones
            over the tolerance.
        samples: valid ones that the surrogate was trained on.
        held_out: largest held-out RMS error of a stress component, relative to its spread.
        audit: 99 % quantile of the audited errors as a share of the spread of stress; None where
            nothing was audited.
        range: of the surrogate.
        added: samples taken in after the run.
        seconds: of the run, sampling and training.
    """

    round: int
    hits: float
    unknown: int
    samples: int
    held_out: float
    audit: float | None
    tolerance: float
    range: dict[str, Any]
    added: int
    seconds: float

    @property
    def settled(self) -> bool:
        """Whether no state was unknown and the audit holds."""
        return self.unknown == 0 and (self.audit is None or self.audit <= self.tolerance)


def harvest_of(run: Path) -> Harvest | None:
    """What a run harvested; None where its surrogate answered everything unseen."""
    from surrofe2.cli.reaping import HARVEST
    from surrofe2.io.harvest import read_harvest

    path = run / HARVEST
    return read_harvest(path) if path.exists() else None


def unknown_states(
    harvest: Harvest | None, surrogate: Surrogate, allowed: float
) -> tuple[NDArray[np.intp], float | None]:
    """(rows of the harvest that were not known well enough, 99 % quantile of audited errors).

    A point also falls back where the surrogate knows its state but not what the step may come to;
    such states are not unknown.

    Args:
        allowed: error of a stress, µN/µm.
    """
    from surrofe2.tensors import stress_error

    if harvest is None:
        return np.empty(0, dtype=np.intp), None
    audited = np.flatnonzero((harvest.why == AUDIT) & (harvest.status == 0))
    fell_back = np.flatnonzero((harvest.why == FALLBACK) & (harvest.status == 0))
    unknown = np.zeros(len(harvest.why), dtype=bool)
    _, status, _ = surrogate.lookup(harvest.F[fell_back], harvest.F_dot[fell_back], allowed)
    unknown[fell_back] = status != 0
    quantile = None
    if len(audited):
        answer, status, _ = surrogate.lookup(harvest.F[audited], harvest.F_dot[audited])
        error = stress_error(answer, harvest.stress[audited])
        error = np.where(status == 0, error, np.inf)
        unknown[audited[error > allowed]] = True
        quantile = float(np.quantile(error, AUDIT_QUANTILE))
    return np.flatnonzero(unknown), quantile


def new_samples(
    recipe: Recipe,
    law: StressLaw,
    harvest: Harvest,
    unknown: NDArray[np.intp],
    known: SamplingRange,
    seed: int,
    report: Any,
) -> tuple[SamplingRange, tuple[Array, Array, Array, NDArray[np.int8], NDArray[np.int8]]]:
    """(range that holds the unknown states, (F, F_dot, stress, status, why) to train on).

    The true answers of the harvest, as many neighbours of the unknown states, and, where the
    range had to be widened, as many samples of it as the recipe has of its own.

    Args:
        known: range of the surrogate.
        report: called with (samples done, remark).
    """
    from surrofe2.sampling import neighbours, range_holding, sample

    states = harvest.F[unknown], harvest.F_dot[unknown]
    wider = range_holding(known, *states)
    asked = [(*neighbours(wider, *states, min(len(unknown), MOST_NEIGHBOURS), seed), NEIGHBOUR)]
    if wider != known:
        asked.append((*sample(wider, recipe.samples.count, seed), WIDENED))
    parts = [(harvest.F, harvest.F_dot, harvest.stress, harvest.status, harvest.why)]
    total, done = sum(len(F) for F, _, _ in asked), 0
    for F, F_dot, why in asked:
        for first in range(0, len(F), CHUNK):
            rows = slice(first, first + CHUNK)
            answer = law.respond(F[rows], F_dot[rows])
            reasons = np.full(len(answer.status), why, dtype=np.int8)
            parts.append((F[rows], F_dot[rows], answer.stress, answer.status, reasons))
            done += len(answer.status)
            report(done / total, f"{done} of {total} new samples")
    F, F_dot, stress, status, reason = (np.concatenate(part) for part in zip(*parts, strict=True))
    return wider, (F, F_dot, stress, status, reason)


def write_new_samples(path: Path, recipe: Recipe, arrays: tuple[Any, ...]) -> None:
    """Write samples as a harvest, whole or not at all."""
    from importlib.metadata import version

    from surrofe2.io.files import replacing
    from surrofe2.io.harvest import HarvestHeader, HarvestWriter

    header = HarvestHeader(
        cell=recipe.cell,
        rve=asdict(recipe.rve),
        version=version("surrofe2"),
        recipe=recipe.to_dict(),
    )
    with replacing(path) as partial:
        partial.unlink(missing_ok=True)
        writer = HarvestWriter(partial, header)
        writer(*arrays)
        writer.flush()
