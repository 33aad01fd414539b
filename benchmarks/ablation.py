"""What each part of the surrogate is worth: its parts added one by one, and what else there is.

Every contender learns from the first n samples of one Sobol sequence and is measured on another:
error by `stress_error`, relative to the spread of stress there; cost of a query by the wall time of
80 points at once, the number of the paper's bar. Writes ablation.png, .csv, .json and .md into the
output folder; docs/ablation.md says what they show. Takes long, so a full run leaves it out: ask
for it by `python -m benchmarks --only ablation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import nan
from time import perf_counter, process_time

import numpy as np

from benchmarks.rivals import (
    Folded,
    GaussianProcess,
    LinearFromNearest,
    NearestNeighbours,
    Regressor,
    learn_table,
)
from benchmarks.row import Row
from benchmarks.setting import POINTS, Array, Setting
from benchmarks.timing import threads
from surrofe2.cache.protocols import Surrogate
from surrofe2.recipe import Recipe
from surrofe2.report.study import Curve, Panel, Study
from surrofe2.report.study_files import write_study
from surrofe2.rve import RveLaw
from surrofe2.sampling import sample
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import train
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.tensors import stress_error, stress_spread

Stress = Callable[[Array, Array], Array]
"""Cauchy stress (n, 2, 2) at (F, Ḟ); NaN where no answer is given."""

TITLE = "The surrogate part by part, beside other regressions"
PRESET = "printed"
TEST_SEED = 987_654
_REPEATS = 25
_MOST_OF_A_PROCESS = 4096  # samples of a Gaussian process, whose cost rises with their cube
_WEIGHT = 0.1
_TIMES_LONGER = 4

_plain = partial(replace, form="stress", baseline_degree=0, tangent_weight=0.0)
NETWORKS: Mapping[str, Callable[[TrainingSettings], TrainingSettings]] = {
    "plain MLP": _plain,
    "plain MLP, 4 × the iterations": lambda s: _plain(s, iterations=_TIMES_LONGER * s.iterations),
    "+ symmetry": _plain,
    "+ energy": partial(_plain, form="energy"),
    "+ tangents": partial(_plain, form="energy", tangent_weight=_WEIGHT),
    "+ Kelvin–Voigt": partial(replace, form="energy", baseline_degree=1, tangent_weight=_WEIGHT),
    "+ polynomial": partial(replace, form="energy", baseline_degree=3, tangent_weight=_WEIGHT),
    "+ polynomial − tangents": partial(
        replace, form="energy", baseline_degree=3, tangent_weight=0.0
    ),
    "+ polynomial − energy": partial(
        replace, form="stress", baseline_degree=3, tangent_weight=_WEIGHT
    ),
    "+ polynomial − both": partial(replace, form="stress", baseline_degree=3, tangent_weight=0.0),
}
WITHOUT_SYMMETRY = tuple(NETWORKS)[:2]
RIVALS: Mapping[str, Callable[[], Regressor]] = {
    "nearest neighbours": NearestNeighbours,
    "Gaussian process": GaussianProcess,
    "linear from nearest": LinearFromNearest,
}
TABLE = "table"
CONTENDERS = (*NETWORKS, *RIVALS, TABLE)
"""All names, the networks first, part by part."""


@dataclass(frozen=True, slots=True)
class Result:
    """One contender at one number of samples.

    rms, worst: error relative to the spread of stress, over what is answered; NaN where nothing
    is. answered: share of the points that are. query: µs a point of `POINTS` at once.
    training: s of CPU time.
    """

    contender: str
    samples: int
    rms: float
    worst: float
    answered: float
    query: float
    training: float


def run(setting: Setting) -> list[Row]:
    """All contenders at all numbers of samples, for the recipe's plant cell, law and range."""
    recipe = setting.recipe(PRESET)
    law = RveLaw.from_settings(recipe.cell, recipe.rve)
    counts = setting.pick((256, 1024), (64, 128))
    samples = ask_rve(law, recipe, max(counts), recipe.samples.seed)
    truth = ask_rve(law, recipe, setting.pick(2048, 256), TEST_SEED).valid
    results = []
    with threads(1):
        for count in counts:
            few = first(samples, count)
            for name in CONTENDERS:
                if name == "Gaussian process" and count > _MOST_OF_A_PROCESS:
                    continue
                results.append(compete(name, law, few, recipe.training, truth))
                print(f"    {name}, {count} samples: {_errors(results[-1])}", flush=True)
    study = describe(results, recipe.training, PRESET)
    write_study(setting.out, study, recipe.cell, PRESET)
    return [_row(result) for result in results]


def ask_rve(law: RveLaw, recipe: Recipe, count: int, seed: int) -> StressSamples:
    """Samples of an RVE with tangents over the range of a recipe."""
    F, F_dot = sample(recipe.range, count, seed)
    answer = law.respond(F, F_dot, tangents=True)
    assert answer.tangents is not None
    return StressSamples(
        F=F,
        F_dot=F_dot,
        stress=answer.stress,
        status=answer.status,
        cell=recipe.cell,
        initialisation=recipe.rve.initialisation,
        range=recipe.range,
        seed=seed,
        rest_length=law.rest_length,
        P_by_F=answer.tangents.P_by_F,
        P_by_F_dot=answer.tangents.P_by_F_dot,
    )


def first(samples: StressSamples, count: int) -> StressSamples:
    """The first samples of those with tangents."""
    assert samples.P_by_F is not None
    assert samples.P_by_F_dot is not None
    return replace(
        samples,
        F=samples.F[:count],
        F_dot=samples.F_dot[:count],
        stress=samples.stress[:count],
        status=samples.status[:count],
        P_by_F=samples.P_by_F[:count],
        P_by_F_dot=samples.P_by_F_dot[:count],
    )


def compete(
    name: str,
    law: RveLaw,
    samples: StressSamples,
    settings: TrainingSettings,
    truth: StressSamples,
) -> Result:
    """One contender: learnt from `samples`, measured on `truth`; the table asks `law`, too."""
    begin = process_time()
    reference, query = _learn(name, law, samples, settings)
    training = process_time() - begin
    found = reference(truth.F, truth.F_dot)
    answered = np.isfinite(found).all(axis=(1, 2))
    error = stress_error(found[answered], truth.stress[answered]) / stress_spread(truth.stress)
    F, F_dot = (np.ascontiguousarray(array[:POINTS]) for array in (truth.F, truth.F_dot))
    query(F, F_dot)
    times = []
    for _ in range(_REPEATS):
        begin = perf_counter()
        query(F, F_dot)
        times.append(perf_counter() - begin)
    return Result(
        contender=name,
        samples=len(samples.F),
        rms=float(np.sqrt((error**2).mean())) if error.size else nan,
        worst=float(error.max()) if error.size else nan,
        answered=float(answered.mean()),
        query=1e6 * min(times) / len(F),
        training=training,
    )


def _learn(
    name: str, law: RveLaw, samples: StressSamples, settings: TrainingSettings
) -> tuple[Stress, Stress]:
    """(stress for errors, stress as a run asks for it)."""
    if name == TABLE:
        table = learn_table(law, samples)
        return _looked_up(table), _looked_up(table)
    if name in RIVALS:
        stress = Folded(RIVALS[name](), samples).stress
        return stress, stress
    symmetry = "none" if name in WITHOUT_SYMMETRY else None
    surrogate = train(samples, NETWORKS[name](settings), symmetry=symmetry)
    return surrogate.reference, _looked_up(surrogate)


def _looked_up(surrogate: Surrogate) -> Stress:
    return lambda F, F_dot: surrogate.lookup(F, F_dot)[0]


def is_of(name: str, settings: TrainingSettings) -> bool:
    """Whether a recipe's training is that contender."""
    change = NETWORKS.get(name)
    return change is not None and name not in WITHOUT_SYMMETRY and change(settings) == settings


def describe(results: list[Result], training: TrainingSettings, preset: str) -> Study:
    """Error over samples and error over cost, with the table for people."""
    by_name = {
        name: [result for result in results if result.contender == name]
        for name in dict.fromkeys(result.contender for result in results)
    }
    return Study(
        name="ablation",
        title=f"Surrogate part by part, and what else there is; preset “{preset}”",
        panels=_panels(by_name),
        columns=2,
        table={
            "contender": [result.contender for result in results],
            "samples": [result.samples for result in results],
            "rms (of spread)": [result.rms for result in results],
            "worst (of spread)": [result.worst for result in results],
            "answered": [result.answered for result in results],
            "query (µs/point)": [result.query for result in results],
            "training (CPU s)": [result.training for result in results],
        },
        results={"rows": [asdict(result) for result in results]},
        units={
            "rms": "1",
            "worst": "1",
            "answered": "1",
            "query": "µs a point",
            "training": "s of CPU time",
        },
        settings={"training": training.to_dict()},
        shown=_shown(by_name, training),
    )


def _panels(by_name: Mapping[str, list[Result]]) -> tuple[Panel, Panel]:
    answering = {
        name: [result for result in found if result.answered > 0.0]
        for name, found in by_name.items()
    }
    learning, costs = [], []
    for name, found in answering.items():
        if found:
            error = np.array([100.0 * result.rms for result in found])
            samples = np.array([float(result.samples) for result in found])
            learning.append(Curve(name, samples, error))
            costs.append(Curve(name, np.array([found[-1].query]), error[-1:]))
    error_label = "RMS error (% of spread)"
    most = max(result.samples for found in by_name.values() for result in found)
    return (
        Panel(
            x_label="RVE samples",
            y_label=error_label,
            curves=tuple(learning),
            log_x=True,
            log_y=True,
        ),
        Panel(
            x_label=f"cost a query (µs a point at {POINTS})",
            y_label=error_label,
            curves=tuple(costs),
            title=f"{most} samples, or as many as it bears",
            log_x=True,
            log_y=True,
        ),
    )


def _shown(by_name: Mapping[str, list[Result]], training: TrainingSettings) -> dict[str, list[str]]:
    counts = sorted({result.samples for found in by_name.values() for result in found})
    table: dict[str, list[str]] = {
        "contender": [f"**{name}**" if is_of(name, training) else name for name in by_name]
    }
    for count in counts:
        table[f"{count} samples, RMS / worst, %"] = [
            next((_errors(result) for result in found if result.samples == count), "–")
            for found in by_name.values()
        ]
    table["query, µs"] = [f"{found[-1].query:.2g}" for found in by_name.values()]
    table["training, CPU s"] = [f"{found[-1].training:.0f}" for found in by_name.values()]
    return table


def _errors(result: Result) -> str:
    if result.answered == 0.0:
        return "none answered"
    part = "" if result.answered == 1.0 else f" ({100.0 * result.answered:.2g} % answered)"
    return f"{100.0 * result.rms:.2g} / {100.0 * result.worst:.2g}{part}"


def _row(result: Result) -> Row:
    name = f"{result.contender}, {result.samples} samples: RMS error"
    note = f"query {result.query:.2g} µs a point, training {result.training:.2g} s"
    if result.answered == 0.0:
        return Row(name=name, value=None, unit="%", note="none answered")
    return Row(name=name, value=100.0 * result.rms, unit="%", note=note)
