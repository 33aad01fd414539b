"""Active learning: a surrogate is trained on what its own runs met and it did not know.

A round is a cached run or rest, RVEs at further states like those that were unknown, and a
training on all of them. Rounds go on until a run meets nothing unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.clock import Meter
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.sampling import SamplingRange, neighbours, range_holding, sample
from surrofe2.base.tensors import stress_error
from surrofe2.base.units import time_text
from surrofe2.cache.protocols import Surrogate
from surrofe2.recipe.recipe import CellName, CellStudy, Recipe
from surrofe2.report.tables import NONE, Quantity, percent
from surrofe2.run.loop import Stage, no_stage
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.run_folder import HARVEST, caches_of, of_cell
from surrofe2.store.samples import Harvest, HarvestWriter, read_harvest, stored_count
from surrofe2.store.store import (
    check_same,
    locked_folder,
    read_bytes,
    read_json,
    remove,
    remove_tree,
    write_bytes,
    write_json,
)
from surrofe2.workflow import laws
from surrofe2.workflow.generate import CHUNK
from surrofe2.workflow.rest import extent_of, study_by_method
from surrofe2.workflow.run import origin_of
from surrofe2.workflow.train import STRESSES, Trained, learn, train_surrogate

# Files: the table of rounds, the surrogate of a round, and its new samples.
ROUNDS = "refine.json"
SURROGATE = "surrogate.h5"
_NEW = "new.h5"
# Codes why a stress is in a harvest: the first two from runs, see `cache.protocols.OnTrueAnswer`;
# the others are samples near an unknown state, and in a range that has become wider.
FALLBACK = 0
AUDIT = 1
NEIGHBOUR = 2
WIDENED = 3
AUDIT_QUANTILE = 0.99
# As many neighbours are sampled in a round as states were unknown, but at most so many.
MOST_NEIGHBOURS = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """A row of the table of rounds, of one cell.

    Attributes:
        round: number of the round, from 0.
        cell: name of the cell.
        hits: fraction of the answers at accepted steps that came from the surrogate.
        unknown: number of states that the surrogate could not answer, and of audited ones over the
            tolerance.
        samples: number of valid samples that it was trained on.
        held_out: largest held-out RMS error of a stress component, relative to its spread.
        audit: 99 % quantile of the audited errors over the spread of stress; None: no audit.
        tolerance: of the cache, relative to the spread of stress.
        range: of the surrogate.
        wider: range of the next surrogate, which also holds the states that the run met.
        added: number of samples taken in after the run.
        seconds: of the round.
    """

    round: int
    cell: CellName = None
    hits: float
    unknown: int
    samples: int
    held_out: float
    audit: float | None
    tolerance: float
    range: dict[str, Any]
    wider: dict[str, Any]
    added: int
    seconds: float

    @property
    def settled(self) -> bool:
        """True if no state was unknown and the audit found no larger error than the tolerance."""
        return self.unknown == 0 and (self.audit is None or self.audit <= self.tolerance)

    @property
    def sentence(self) -> str:
        """The result of the round in words."""
        whose = "" if self.cell is None else f"{self.cell}: "
        return (
            f"round {self.round}: {whose}{100 * self.hits:.4g} % hits, "
            f"{self.unknown} unknown states, {self.added} samples added"
        )


QUANTITIES: tuple[Quantity[Round], ...] = (
    Quantity("round", "", "", lambda row: row.round),
    Quantity("cell", "", "", lambda row: row.cell),
    Quantity("hits", "", percent(4), lambda row: row.hits),
    Quantity("unknown", "", "", lambda row: row.unknown),
    Quantity("samples", "", "", lambda row: row.samples),
    Quantity("held-out RMS", "", percent(2), lambda row: row.held_out),
    # a column even where no round was audited
    Quantity(
        "audit 99 %", "", "", lambda row: NONE if row.audit is None else percent(2)(row.audit)
    ),
    Quantity("time", "", time_text, lambda row: row.seconds),
)


def refine_surrogate(
    recipe: Recipe,
    out: Path,
    *,
    cell: str | None = None,
    rounds: int = 6,
    fresh: bool = False,
    stage: Stage = no_stage,
    tell: Callable[[Round], None] = lambda row: None,
) -> list[Round]:
    """Make rounds of run, sampling and training in a folder, until one meets nothing unknown.

    The run is in time, or at rest where the recipe has a [rest]. The first round runs on the
    recipe's surrogate, which is made where it is missing. Each later one is trained on the recipe's
    data set and everything sampled since; its range is the least box that also holds the states
    that left it. The last surrogate is `out`/surrogate.h5, of several cells
    `out`/surrogate-NAME.h5.

    Args:
        out: folder of the rounds.
        cell: name of the only cell to be refined; None: all are.
        rounds: largest number of rounds.
        fresh: whether rounds that are there are replaced.
        stage: reports the stages and their progress.
        tell: called with each finished row.

    Returns:
        The rows of all rounds.

    Raises:
        InputError: the recipe lacks a range, or the file of a data set or a surrogate.
        SimulationError: the last round of `rounds` is not settled.
    """
    if rounds < 1:
        raise InputError(f"rounds: {rounds}; it must be at least 1")
    studies = recipe.studies(cell)
    # what a recipe lacks is named before a folder is made or former rounds are removed
    for study in studies.values():
        study.sampling_range()
        study.data_path()
        study.training_path()
    with locked_folder(out):
        done = _open_rounds(recipe, studies, out, fresh)
        for k in range(rounds):
            if not any(row.round == k for row in done):
                done += _round(recipe, studies, out, done, k, stage)
                _write_rounds(recipe, studies, out, done)
            rows = [row for row in done if row.round == k]
            for row in rows:
                tell(row)
            if all(row.settled for row in rows):
                for name, study in studies.items():
                    last, _ = _learnt_from(study, out, done)
                    write_bytes(out / of_cell(SURROGATE, name), read_bytes(last.training_path()))
                return done
    unknown = sum(row.unknown for row in rows)
    raise SimulationError(
        f"{out}: {unknown} states still unknown after {rounds} rounds; continue with "
        f"--rounds {2 * rounds}",
        partial=done,
    )


def _open_rounds(recipe: Recipe, cells: Iterable[CellName], out: Path, fresh: bool) -> list[Round]:
    """Read the rounds that are finished."""
    begun = out / ROUNDS
    if begun.exists() and not fresh:
        stored = read_json(begun)
        wanted = {"--cell": [name or "" for name in cells]}
        begun_with = {"--cell": stored.get("cells", [""])}
        check_same(out, recipe.to_dict() | wanted, stored["recipe"] | begun_with)
        return [Round(**{**row, "cell": row["cell"] or None}) for row in stored["rounds"]]
    remove(begun)  # first, since it counts the folders that are removed next
    for folder in out.glob("round-*"):
        remove_tree(folder)
    for path in out.glob("surrogate*.h5"):
        remove(path)
    _write_rounds(recipe, cells, out, [])
    return []


def _write_rounds(
    recipe: Recipe, cells: Iterable[CellName], out: Path, done: Sequence[Round]
) -> None:
    """Write the rounds that are finished; the cell of [cell] is written as ""."""
    rows = [{**asdict(row), "cell": row.cell or ""} for row in done]
    names = [name or "" for name in cells]
    write_json(out / ROUNDS, {"recipe": recipe.to_dict(), "cells": names, "rounds": rows})


def _learnt_from(
    study: CellStudy, out: Path, done: Sequence[Round]
) -> tuple[CellStudy, list[Round]]:
    """Return a study with the surrogate after these rounds, and those that it learns from."""
    grown = [row for row in done if row.cell == study.name and row.added]
    if not grown:
        return study, []
    file = out / f"round-{grown[-1].round + 1}" / of_cell(SURROGATE, study.name)
    return study.with_cell(training_file=str(file.resolve())), grown


def _round(
    recipe: Recipe,
    studies: Mapping[CellName, CellStudy],
    out: Path,
    done: Sequence[Round],
    k: int,
    stage: Stage,
) -> list[Round]:
    """Make one round, a row for each cell; what it finished before an interruption is kept."""
    begin = time.perf_counter()
    folder = out / f"round-{k}"
    trained = {name: _train(study, out, done, k, stage) for name, study in studies.items()}
    files = {name: result.path for name, result in trained.items()}
    what = "run" if recipe.rest is None else "rest"
    with stage(f"round {k}: {what}", *extent_of(recipe)) as report:
        record = study_by_method(recipe, "cached", folder / "run", surrogates=files, report=report)
    rows = []
    for name, study in studies.items():
        counts = caches_of(record.cache)[name]["accepted"]
        hits = counts["hits"] / max(1, counts["hits"] + counts["fallbacks"])
        rows.append(_row(study, folder, k, trained[name], hits, begin, stage))
    return rows


def _train(study: CellStudy, out: Path, done: Sequence[Round], k: int, stage: Stage) -> Trained:
    """Return the surrogate of a cell that round k runs on, made where it is not there."""
    study, grown = _learnt_from(study, out, done)
    if not grown:
        _, trained = learn(study, stage=stage)
        return trained
    return train_surrogate(
        study,
        add=[out / f"round-{row.round}" / of_cell(_NEW, study.name) for row in grown],
        range=SamplingRange(**grown[-1].wider),
        stage=lambda what, *rest: stage(study.title(f"round {k}: {what}"), *rest),
    )


def _row(
    study: CellStudy,
    folder: Path,
    k: int,
    trained: Trained,
    hits: float,
    begin: float,
    stage: Stage,
) -> Round:
    """Collect what the run of a round met that its surrogate did not know, and sample there."""
    name = study.name
    cache = study.recipe.cache
    surrogate = trained.surrogate
    spread = surrogate.stress_spread
    tolerance = cache.tolerance
    source = folder / "run" / of_cell(HARVEST, name)
    harvest = read_harvest(source) if source.exists() else None  # None: the surrogate knew it all
    held = surrogate.with_tolerance(tolerance, cache.relative)
    unknown, audit = unknown_states(harvest, held, tolerance * spread)
    added = 0
    wider = surrogate.range
    if len(unknown) and harvest is not None:
        states = (harvest.F[unknown], harvest.F_dot[unknown])
        seed = study.cell.samples.seed + k + 1  # another one in each round
        wider = range_holding(surrogate.range, *states)
        count = min(len(unknown), MOST_NEIGHBOURS)
        wanted = [(NEIGHBOUR, *neighbours(wider, *states, count, seed))]
        if wider != surrogate.range:  # as many samples of it as the recipe has of its own
            count = stored_count(study.data_path()).rows
            wanted.append((WIDENED, *sample(wider, count, seed)))
        path = folder / of_cell(_NEW, name)
        added = _write_samples(path, study, harvest, wanted, read_seconds(source), k, stage)
    return Round(
        round=k,
        cell=name,
        hits=hits,
        unknown=len(unknown),
        samples=len(trained.samples.valid.F),
        held_out=max(surrogate.errors["rms"][component] for component in STRESSES),
        audit=None if audit is None else audit / spread,
        tolerance=tolerance,
        range=asdict(surrogate.range),
        wider=asdict(wider),
        added=added,
        seconds=time.perf_counter() - begin,
    )


def unknown_states(
    harvest: Harvest | None, surrogate: Surrogate, allowed: float
) -> tuple[Index, float | None]:
    """Find the states of a harvest that a surrogate does not know well enough.

    They are those that it cannot answer, and audited ones whose error is above what is allowed. A
    point also falls back where the surrogate knows its state but not where the step may lead; such
    states are not unknown.

    Args:
        harvest: RVEs' answers of a run; None: it had none.
        surrogate: with the tolerance of the run.
        allowed: error of a stress, µN/µm.

    Returns:
        Rows of the harvest, and the 99 % quantile of audited errors; None without audits.
    """
    if harvest is None:
        return np.empty(0, dtype=np.intp), None
    audited = np.flatnonzero((harvest.why == AUDIT) & (harvest.status == 0))
    fell_back = np.flatnonzero((harvest.why == FALLBACK) & (harvest.status == 0))
    unknown = np.zeros(len(harvest.why), dtype=bool)
    _, status, _ = surrogate.lookup(harvest.F[fell_back], harvest.F_dot[fell_back], 1.0)
    unknown[fell_back] = status != 0
    quantile = None
    if len(audited):
        answer, status, _ = surrogate.lookup(harvest.F[audited], harvest.F_dot[audited])
        error = stress_error(answer, harvest.stress[audited])
        error /= surrogate.local_tolerance(harvest.F[audited], harvest.F_dot[audited])
        error = np.where(status == 0, error, np.inf)
        unknown[audited[error > allowed]] = True
        quantile = float(np.quantile(error, AUDIT_QUANTILE))
    return np.flatnonzero(unknown), quantile


def _write_samples(
    path: Path,
    study: CellStudy,
    harvest: Harvest,
    wanted: list[tuple[int, Array, Array]],
    seconds: float | None,
    k: int,
    stage: Stage,
) -> int:
    """Write a harvest and RVEs' stresses at further states.

    Args:
        wanted: why states are sampled, and F and Ḟ of them.
        seconds: what the harvest took; None: not known.
        k: number of the round.

    Returns:
        The number of stresses.
    """
    law = laws.true_law(study)
    meter = Meter(seconds or 0.0)
    done = 0
    total = sum(len(F) for _, F, _ in wanted)
    writer = HarvestWriter(path, origin_of(study))
    writer(harvest.F, harvest.F_dot, harvest.stress, harvest.status, harvest.why)
    with stage(study.title(f"round {k}: sample"), total, "samples") as report:
        for why, all_F, all_F_dot in wanted:
            for first in range(0, len(all_F), CHUNK):
                F = all_F[first : first + CHUNK]
                F_dot = all_F_dot[first : first + CHUNK]
                answer = law.respond(F, F_dot)
                writer(F, F_dot, answer.stress, answer.status, np.full(len(F), why, np.int8))
                done += len(F)
                report(done, "")
    writer.flush(meter.seconds)
    return len(harvest.F) + done
