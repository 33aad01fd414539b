"""Data sets of stresses over a range of (F, Ḟ), and the samples that training takes of them."""

from __future__ import annotations

import builtins
import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import FileError, InputError
from surrofe2.base.sampling import SamplingRange, training_points
from surrofe2.base.tensors import stress_error, stress_spread
from surrofe2.law.samples import TANGENTS, StressSamples
from surrofe2.law.stress_law import StressLaw, StressResponse, describe
from surrofe2.recipe.recipe import CellStudy
from surrofe2.run.loop import Report, Stage, no_report, no_stage
from surrofe2.rve import RveLaw
from surrofe2.store.hdf5 import read_header
from surrofe2.store.samples import (
    DATA_SET,
    DataSetHeader,
    Harvest,
    check_harvest,
    read_data_set,
    read_harvest,
    rows_of,
    stored_count,
    writing_data_set,
)
from surrofe2.store.store import check_same
from surrofe2.workflow import laws
from surrofe2.workflow.workers import in_pieces

log = logging.getLogger(__name__)

Part = tuple[Array, Array, StressResponse]  # F and Ḟ of some samples, and the answer there

CHUNK = 512  # samples that are solved together
# Fraction of the spread of stress within which two stresses are the same.
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class Generated:
    """A finished data set.

    Attributes:
        path: its file.
        samples: all of them.
        added: number of those that this call computed; 0 if it was finished before.
    """

    path: Path
    samples: StressSamples
    added: int


def wanted_count(study: CellStudy, *, fresh: bool = False) -> int:
    """Return how many samples the data set of a plant cell is to have.

    These are as many as training begins with, or as many as it has needed before.
    """
    counts = study.cell.samples.counts(study.cell.training.bound)
    path = study.data_path()
    if len(counts) == 1 or fresh or not path.exists():
        return counts[0]
    stored = stored_count(path).rows
    return next((count for count in counts if count >= stored), counts[-1])


def generate_data_set(
    study: CellStudy,
    *,
    count: int = 0,
    fresh: bool = False,
    chunk: int = CHUNK,
    executor: Any = None,
    report: Report = no_report,
) -> Generated:
    """Sample a plant cell's range, solve the RVE there, and write the data set.

    Each sample is solved for itself, without a warm start, so a data set that was continued, or
    made by several processes, equals one made at once, to the bit.

    Args:
        count: number of samples in the end, or `wanted_count` if that is more.
        fresh: whether a data set that is there is replaced.
        chunk: samples that are solved together.
        executor: of processes that solve chunks; None: this one does.
        report: called with the number of samples.

    Raises:
        InputError: tangents are wanted of RVEs that have none.
    """
    path = study.data_path()
    settings = study.cell.samples
    wanted = study.sampling_range()
    rve = study.recipe.rve
    if settings.tangents and rve.solver == "iterated":
        raise InputError('samples.tangents: true; it needs rve.solver = "direct"')
    law = laws.true_law(study)
    count = max(count, wanted_count(study, fresh=fresh))
    header = DataSetHeader(
        cell=study.cell.parameters,
        rve=asdict(rve),
        range=wanted,
        count=count,
        seed=settings.seed,
        chunk=chunk,
        version=version("surrofe2"),
        recipe=study.to_dict(),
        rest_length=law.rest_length,
        tangents=settings.tangents,
        is_open=settings.count is None,
    )
    with writing_data_set(path, header, fresh=fresh) as data:
        added = count - data.completed
        failures = np.count_nonzero(data.to_arrays()["status"])
        report(data.completed, f"{failures} failed")
        work = partial(_sampled, law, wanted, settings.seed, settings.tangents)
        for F, F_dot, answer in in_pieces(work, range(data.completed, count), chunk, executor):
            data.append(F, F_dot, answer)
            failures += np.count_nonzero(answer.status)
            report(data.completed, f"{failures} failed")
        return Generated(path, data.finish(), added)


def _sampled(
    law: StressLaw, wanted: SamplingRange, seed: int, tangents: bool, first: int, count: int
) -> Part:
    """Solve the points `first` to `first + count` of a sequence."""
    F, F_dot = training_points(wanted, count, seed, start=first)
    answer = law.respond(F, F_dot, tangents=tangents)
    return F, F_dot, replace(answer, state=None)  # a warm start takes 20 kB per sample


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
    """Sample the stress of an RVE over a range, for `train`; the numbers are those of `generate`.

    Args:
        count: number of samples.
        seed: of their sequence.
        tangents: whether ∂P/∂F and ∂P/∂Ḟ are sampled too, from which training learns more.
        executor: of processes that solve chunks; None: this one does.
        report: called with the number of samples.

    Raises:
        InputError: `count` or `seed` is no such number, or the law has no tangents.

    Examples:
        >>> from surrofe2 import RveLaw, SamplingRange, sample_stress
        >>> range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=1e-3)
        >>> samples = sample_stress(RveLaw("apple"), range, 16)
        >>> len(samples.valid.F), samples.P_by_F.shape
        (16, (16, 2, 2, 2, 2))
    """
    if count < 1:
        raise InputError(f"count: {count}; it must be at least 1")
    parts = list[dict[str, Array]]()
    done = 0
    work = partial(_sampled, law, range, seed, tangents)
    for F, F_dot, answer in in_pieces(work, builtins.range(count), CHUNK, executor):
        parts.append(rows_of(F, F_dot, answer))
        done += len(F)
        report(done, "")
    return StressSamples(
        cell=law.cell,
        initialisation=law.initialisation,
        range=range,
        seed=seed,
        rest_length=law.rest_length,
        **_joined(parts),
    )


def _joined(parts: Sequence[dict[str, Array]]) -> dict[str, Any]:
    """Concatenate arrays by name."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def data_summary(generated: Generated) -> str:
    """Say how many samples there are and how many are usable; each is counted once."""
    samples = generated.samples
    count = len(samples.F)
    usable = len(samples.valid.F)
    codes = np.sort(samples.status[samples.status != 0]).tolist()
    failed = Counter(map(describe, codes))
    unstable = count - usable - failed.total()
    text = f"{count} samples"
    if not generated.added:
        text += " (already finished)"
    text = f"{text}, {'all' if usable == count else usable} usable"
    if failed:
        reasons = "; ".join(f"{n}: {reason}" for reason, n in failed.most_common())
        text = f"{text}, {failed.total()} failed ({reasons})"
    if unstable:
        text += (
            f", {unstable} left a bifurcation and are not trained on: in {unstable / count:.1%} of "
            "the recipe's range the stress has more than one value; narrow it where that matters"
        )
    return text


def training_samples(
    study: CellStudy, count: int, harvests: Sequence[Path] = (), *, stage: Stage = no_stage
) -> StressSamples:
    """Return the first `count` samples of a plant cell's data set, and all of the harvests.

    A data set whose number of samples the recipe leaves out is continued where it has fewer.

    Raises:
        FileError: there is no data set.
        MismatchError: it is of another recipe.
    """
    path = study.data_path()
    if not path.exists():
        command = f"surrofe2 generate {study.recipe.path}"
        raise FileError(f"{path}: no such file; make it with `{command}`")
    stored = stored_count(path)
    may_grow = stored.is_open and study.cell.samples.count is None
    if may_grow and not (stored.is_finished and stored.rows >= count):
        wanted = max(count, wanted_count(study))
        with stage("generate", wanted, "samples") as report:
            generate_data_set(study, count=wanted, report=report)
    samples = read_data_set(path)
    check_data(study, path)
    first = samples if len(samples.F) <= count else samples.at(np.arange(count))
    return with_harvests(first, harvests, study)


def check_data(study: CellStudy, source: Path) -> None:
    """Refuse a data set of another recipe.

    Raises:
        MismatchError: naming what differs.
    """
    samples = study.cell.samples
    wanted = {
        "cell": study.cell.parameters.to_dict(),
        "rve": {"initialisation": study.recipe.rve.initialisation},
        "range": asdict(study.sampling_range()),
        "samples": {"seed": samples.seed, "count": samples.count},
    }
    advice = f"generate it again with `surrofe2 generate {study.recipe.path} --fresh`"
    check_same(source, wanted, read_header(source, DATA_SET)["compared"], advice)


def with_harvests(
    samples: StressSamples, paths: Iterable[Path], study: CellStudy, law: StressLaw | None = None
) -> StressSamples:
    """Join samples and, after them, the RVE stresses in these harvests.

    The range stays that of the samples. Where these have tangents, those of harvested states are
    computed by `law` from rest; states where it finds another stress are omitted.

    Raises:
        MismatchError: a harvest is of other cell parameters or initialisation.
    """
    parts = [_arrays_of(samples)]
    omitted = 0
    for path in paths:
        harvest = read_harvest(path)
        check_harvest(path, harvest, samples.cell, samples.initialisation)
        part = _arrays_of(harvest)
        if samples.P_by_F is not None:
            spread = stress_spread(samples.stress[samples.status == 0])
            part = _with_tangents(law or laws.true_law(study), part, _SAME * spread)
        omitted += len(harvest.F) - len(part["F"])
        parts.append(part)
    if len(parts) == 1:
        return samples
    if omitted:
        log.warning("%d harvested states left out: RVEs from rest differ there", omitted)
    arrays = _joined(parts)
    has_left = samples.left_bifurcation
    if has_left is not None:  # harvests have no answers from beyond a bifurcation
        arrays["left_bifurcation"] = np.pad(has_left, (0, len(arrays["F"]) - len(has_left)))
    return replace(samples, **arrays)


def _with_tangents(law: StressLaw, harvest: dict[str, Any], same: float) -> dict[str, Any]:
    """Add tangents to harvested states.

    States that have failed stay. Of the others those stay whose stress is the same from rest.

    Args:
        same: error of a stress up to which it is the same, µN/µm.
    """
    shape = (len(harvest["F"]), 2, 2, 2, 2)
    by_F = np.full(shape, np.nan)
    by_F_dot = np.full(shape, np.nan)
    kept = harvest["status"] != 0
    valid = np.flatnonzero(~kept)
    for first in range(0, len(valid), CHUNK):
        rows = valid[first : first + CHUNK]
        answer: Any = law.respond(harvest["F"][rows], harvest["F_dot"][rows], tangents=True)
        error = stress_error(answer.stress, harvest["stress"][rows])
        kept[rows] = (answer.status == 0) & (error <= same)
        by_F[rows] = answer.tangents.P_by_F
        by_F_dot[rows] = answer.tangents.P_by_F_dot
    arrays = harvest | {"P_by_F": by_F, "P_by_F_dot": by_F_dot}
    return {name: values[kept] for name, values in arrays.items()}


def _arrays_of(answers: Harvest | StressSamples) -> dict[str, Any]:
    """Return the arrays that samples and harvests have, and tangents where there are some."""
    names = ("F", "F_dot", "stress", "status", *TANGENTS)
    arrays = {name: getattr(answers, name, None) for name in names}
    return {name: values for name, values in arrays.items() if values is not None}
