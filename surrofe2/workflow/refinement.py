"""Rounds of cached run, sampling and training, until a surrogate knows what its runs meet."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Surrogate
from surrofe2.costs import NOTHING, Cost, Meter
from surrofe2.errors import SimulationError
from surrofe2.io.data_sets import stored_count
from surrofe2.io.files import (
    make_folder,
    read_bytes,
    read_json,
    write_bytes,
    write_json,
)
from surrofe2.io.harvest import Harvest, HarvestWriter, read_harvest
from surrofe2.io.lock import locked_folder
from surrofe2.io.provenance import read_cost
from surrofe2.io.run_folder import caches_of
from surrofe2.io.surrogates import read_surrogate, write_surrogate
from surrofe2.recipe import Recipe
from surrofe2.sampling import SamplingRange, neighbours, range_holding, sample
from surrofe2.stress_law import StressLaw, StressResponse
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import SurrogateLaw, train
from surrofe2.tensors import stress_error
from surrofe2.workflow import laws
from surrofe2.workflow.calibrate import WantedBound, calibrate_surrogate, shaping_truths
from surrofe2.workflow.generate import generate_data_set, wanted_count
from surrofe2.workflow.rounds import SURROGATE, Round, open_rounds, write_rounds
from surrofe2.workflow.run import run_study
from surrofe2.workflow.run_lifecycle import Report, Stage, silent
from surrofe2.workflow.run_outputs import HARVEST, of_cell, origin_of
from surrofe2.workflow.samples import samples_in_turn, with_harvests
from surrofe2.workflow.train import STRESSES, train_surrogate, training_note
from surrofe2.workflow.workers import in_pieces

Array = NDArray[np.float64]

_NEW, _STARTED = "new.h5", "round.json"
FALLBACK, AUDIT, NEIGHBOUR, WIDENED = 0, 1, 2, 3
AUDIT_QUANTILE = 0.99
MOST_NEIGHBOURS = 20_000
"""Largest number of neighbours sampled in a round; as many as unknown states below it."""
CHUNK = 512


def refine_surrogate(
    recipe: Recipe,
    out: Path,
    *,
    cell: str | None = None,
    rounds: int = 6,
    fresh: bool = False,
    executor: Any = None,
    stage: Stage = silent,
    tell: Callable[[Round], None] = lambda row: None,
) -> list[Round]:
    """Rounds of cached run, harvest, sampling and training in a folder, until one is settled.

    The first round runs on the recipe's surrogate, which is made where it is not there. Each
    later one was trained anew on the recipe's data set and everything sampled since; where states
    left the range, the range of the surrogate is the least box that holds them too. The last
    surrogate is `out`/surrogate.safetensors, of several cells `out`/surrogate-NAME.safetensors.

    Args:
        cell: the only one of several that is refined; None: all, each until it is settled.
        rounds: how many at most.
        executor: samples, see `surrofe2.workflow.workers`; None: this process.
        tell: called with the rows of each finished round.

    Raises:
        SimulationError: the last round is not settled.
    """
    parts = recipe.parts(cell)
    with locked_folder(out):
        done = open_rounds(recipe, parts, out, fresh)
        for k in range(rounds):
            rows = [row for row in done if row.round == k]
            if not rows:
                rows = _round(recipe, parts, out, k, stage, executor)
                done += rows
                write_rounds(recipe, parts, out, done)
            for row in rows:
                tell(row)
            if all(row.settled for row in rows):
                for name in (of_cell(SURROGATE, cell) for cell in parts):
                    write_bytes(out / name, read_bytes(out / f"round-{k}" / name))
                return done
    unknown = sum(row.unknown for row in rows)
    raise SimulationError(
        f"{out}: {unknown} states still unknown after {rounds} rounds; go on with "
        f"--rounds {2 * rounds}",
        partial=done,
    )


def _round(
    recipe: Recipe, parts: Mapping[str, Recipe], out: Path, k: int, stage: Stage, executor: Any
) -> list[Round]:
    """One round, a row for each cell; what it has finished before an interruption is kept."""
    begin = time.perf_counter()
    folder = out / f"round-{k}"
    make_folder(folder)
    learnt = {name: _surrogate(part, out, k, stage, executor) for name, part in parts.items()}
    files = {name: folder / of_cell(SURROGATE, name) for name in parts}
    with stage(f"round {k}: run", recipe.duration, "µs") as report:
        record = run_study(recipe, "cached", folder / "run", surrogates=files, report=report)
    caches = caches_of(record.cache)
    return [
        _row(part, folder, k, learnt[name], caches[name]["accepted"], begin, stage, executor)
        for name, part in parts.items()
    ]


def _row(
    recipe: Recipe,
    folder: Path,
    k: int,
    learnt: tuple[SurrogateLaw, StressSamples],
    counts: Mapping[str, int],
    begin: float,
    stage: Stage,
    executor: Any,
) -> Round:
    """What the run of a round met that its surrogate did not know, and the samples of that."""
    (surrogate, samples), name = learnt, recipe.cell_name or ""
    spread, tolerance = surrogate.stress_spread, recipe.cache.tolerance
    source = folder / "run" / of_cell(HARVEST, name)
    harvest = read_harvest(source) if source.exists() else None  # None: the surrogate knew it all
    held = surrogate.with_tolerance(tolerance, recipe.cache.relative)
    unknown, audit = unknown_states(harvest, held, tolerance * spread)
    added, wider = 0, surrogate.range
    if len(unknown) and harvest is not None:
        states = harvest.F[unknown], harvest.F_dot[unknown]
        wider = range_holding(surrogate.range, *states)
        seed = recipe.samples.seed + k + 1
        asked = _new_states(recipe, states, wider, wider != surrogate.range, seed)
        with stage(f"round {k}: sample {name}".rstrip(), 1.0, "of the samples") as report:
            path = folder / of_cell(_NEW, name)
            cost = read_cost(source) or NOTHING
            added = _write_samples(path, recipe, harvest, asked, cost, executor, report)
        write_json(folder / of_cell(_STARTED, name), {"range": wider})
    return Round(
        round=k,
        cell=name,
        hits=counts["hits"] / max(1, counts["hits"] + counts["fallbacks"]),
        unknown=len(unknown),
        samples=len(samples.valid.F),
        held_out=max(surrogate.errors["rms"][name] for name in STRESSES),
        audit=None if audit is None else audit / spread,
        tolerance=tolerance,
        range=asdict(surrogate.range),
        added=added,
        seconds=time.perf_counter() - begin,
    )


def _surrogate(
    recipe: Recipe, out: Path, k: int, stage: Stage, executor: Any
) -> tuple[SurrogateLaw, StressSamples]:
    """The surrogate of a cell that round k runs on, in its folder, and the samples behind it."""
    name = recipe.cell_name or ""
    file, new, started = (of_cell(each, name) for each in (SURROGATE, _NEW, _STARTED))
    path, first = out / f"round-{k}" / file, recipe.training_path()
    if k == 0:  # the recipe's, made where it is not there
        with stage(f"generate {name}".strip(), wanted_count(recipe), "samples") as report:
            generate_data_set(recipe, executor=executor, report=report)
        train_surrogate(recipe, executor=executor, stage=stage)
    # A round in which a cell was settled has no new samples of it.
    grown = [out / f"round-{j}" for j in range(k) if (out / f"round-{j}" / started).exists()]
    begin = read_surrogate(first if k == 0 else out / "round-0" / file).data_fingerprint
    samples, _ = next(samples_in_turn(recipe, recipe.added_paths(), stage, begin))
    samples = with_harvests(samples, [folder / new for folder in grown], recipe)
    if grown:
        wider = SamplingRange(**read_json(grown[-1] / started)["range"])
        samples = replace(samples, range=wider)
    if not path.exists():
        before = out / f"round-{k - 1}"
        if k == 0:
            write_bytes(path, read_bytes(first))
        elif before not in grown:
            write_bytes(path, read_bytes(before / file))
        else:
            title = f"round {k} {name}".rstrip()
            known = (read_cost(each) for each in (grown[-1] / new, *recipe.added_paths()))
            made = [*read_surrogate(before / file).cost.values(), *(each for each in known if each)]
            better = _trained(recipe, samples, title, stage, sum(made, start=NOTHING))
            write_surrogate(better, path)
    return read_surrogate(path), samples


def _trained(
    recipe: Recipe, samples: StressSamples, name: str, stage: Stage, data: Cost
) -> SurrogateLaw:
    """A surrogate of these samples with a calibrated bound.

    Args:
        data: what they cost, the rounds before included.
    """
    meter, wider = Meter(), replace(recipe, range=samples.range)
    with stage(f"{name}: train", recipe.training.iterations, "iterations") as report:
        known = shaping_truths(wider, samples)
        wanted = WantedBound(wider, samples, known)

        def enough(each: SurrogateLaw, _: bool) -> bool:
            return wanted.share_of(each) <= 1.0

        surrogate = train(
            samples,
            recipe.training,
            progress=lambda i, n, figures: report(i, training_note(figures)),
            enough=enough if recipe.training.bound else None,
        )
    with stage(f"{name}: calibrate", 1.0, "of the paths") as report:
        training, meter = meter.cost, Meter()
        surrogate = calibrate_surrogate(wider, surrogate, samples, report, known)
    spent = {"data": data, "training": training, "calibration": meter.cost}
    return replace(surrogate, cost=spent)


def unknown_states(
    harvest: Harvest | None, surrogate: Surrogate, allowed: float
) -> tuple[NDArray[np.intp], float | None]:
    """(rows of the harvest that were not known well enough, 99 % quantile of audited errors).

    A point also falls back where the surrogate knows its state but not what the step may come to;
    such states are not unknown.

    Args:
        allowed: error of a stress, µN/µm.
    """
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
        error /= surrogate.local_tolerance(harvest.F[audited], harvest.F_dot[audited])
        error = np.where(status == 0, error, np.inf)
        unknown[audited[error > allowed]] = True
        quantile = float(np.quantile(error, AUDIT_QUANTILE))
    return np.flatnonzero(unknown), quantile


def _new_states(
    recipe: Recipe, states: tuple[Array, Array], wider: SamplingRange, is_new: bool, seed: int
) -> list[tuple[Array, Array, int]]:
    """(F, F_dot, why) to ask RVEs for.

    As many neighbours as unknown states (F, F_dot), and where their range had to be widened, as
    many samples of it as the recipe has of its own.
    """
    count = min(len(states[0]), MOST_NEIGHBOURS)
    asked = [(*neighbours(wider, *states, count, seed), NEIGHBOUR)]
    if is_new:
        asked.append((*sample(wider, stored_count(recipe.data_path()).rows, seed), WIDENED))
    return asked


def _write_samples(
    path: Path,
    recipe: Recipe,
    harvest: Harvest,
    asked: list[tuple[Array, Array, int]],
    before: Cost,
    executor: Any,
    report: Report,
) -> int:
    """Write the harvest and the true answers at further states, whole or not at all; how many.

    Args:
        before: what the harvest cost.
        report: called with the share that is done and a remark.
    """
    law, meter = laws.true_law(recipe), Meter(before)
    done, total = 0, sum(len(F) for F, _, _ in asked)
    writer = HarvestWriter(path, origin_of(recipe))
    writer(harvest.F, harvest.F_dot, harvest.stress, harvest.status, harvest.why)
    for F, F_dot, why in asked:
        work = partial(_true_answers, law, F, F_dot)
        for first, count, answer in in_pieces(work, range(len(F)), CHUNK, executor, meter):
            rows = slice(first, first + count)
            reasons = np.full(count, why, dtype=np.int8)
            writer(F[rows], F_dot[rows], answer.stress, answer.status, reasons)
            done += count
            report(done / total, f"{done} of {total} new samples")
    writer.flush(meter.cost)
    return len(harvest.F) + done


def _true_answers(law: StressLaw, F: Array, F_dot: Array, first: int, count: int) -> StressResponse:
    """The answers at points `first` to `first + count`."""
    rows = slice(first, first + count)
    return replace(law.respond(F[rows], F_dot[rows]), state=None)
