"""What each part of the surrogate is worth: its parts added one by one, and what else there is.

Every contender learns from the first n samples of one Sobol sequence and is measured on another:
error by `stress_error`, relative to the spread of stress there; cost of a query by the wall time of
80 points at once, the number of the paper's bar. Writes ablation-printed.png, .csv, .json and .md
into the output folder; docs/ablation.md says what they show. Takes long, so a full run leaves it
out: ask for it by `python -m benchmarks --only ablation`.
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
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import NamedCell, Study, keep_study
from surrofe2.report.tables import Quantity, Table
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

_plain = partial(replace, baseline_degree=0, tangent_weight=0.0)
NETWORKS: Mapping[str, Callable[[TrainingSettings], TrainingSettings]] = {
    "plain MLP": _plain,
    "plain MLP, 4 × the iterations": lambda s: _plain(s, iterations=_TIMES_LONGER * s.iterations),
    "+ symmetry": _plain,
    "+ tangents": partial(_plain, tangent_weight=_WEIGHT),
    "+ Kelvin–Voigt": partial(replace, baseline_degree=1, tangent_weight=_WEIGHT),
    "+ polynomial": partial(replace, baseline_degree=3, tangent_weight=_WEIGHT),
    "+ polynomial − tangents": partial(replace, baseline_degree=3, tangent_weight=0.0),
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
    law = RveLaw(recipe.cell, recipe.rve)
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
    study, of = describe(results, recipe.training), NamedCell(recipe.cell, PRESET)
    asked = {"training": asdict(recipe.training), "counts": counts}
    keep_study(setting.out, "ablation", of, asked, lambda: study, fresh=True)
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
    return surrogate.extrapolate, _looked_up(surrogate)


def _looked_up(surrogate: Surrogate) -> Stress:
    return lambda F, F_dot: surrogate.lookup(F, F_dot)[0]


def is_of(name: str, settings: TrainingSettings) -> bool:
    """Whether a recipe's training is that contender."""
    change = NETWORKS.get(name)
    return change is not None and name not in WITHOUT_SYMMETRY and change(settings) == settings


def describe(results: list[Result], training: TrainingSettings) -> Study:
    """Error over samples and error over cost, with the table for people."""
    by_name = {
        name: {result.samples: result for result in results if result.contender == name}
        for name in dict.fromkeys(result.contender for result in results)
    }
    counts = sorted({result.samples for result in results})
    quantities: tuple[Quantity[dict[int, Result]], ...] = (
        Quantity("contender", "", "", lambda row: _last(row).contender),
        *(quantity for count in counts for quantity in _of_count(count)),
        Quantity("query", "µs a point", ".2g", lambda row: _last(row).query),
        Quantity("training", "CPU s", ".0f", lambda row: _last(row).training),
        Quantity(
            "recipe's own",
            "",
            lambda own: "yes" if own else "",
            lambda row: is_of(_last(row).contender, training),
        ),
    )
    return Study(
        title="Surrogate part by part, and what else there is",
        panels=_panels([list(found.values()) for found in by_name.values()]),
        columns=2,
        table=Table(quantities, list(by_name.values())),
        results={"all": [asdict(result) for result in results]},
    )


def _last(row: Mapping[int, Result]) -> Result:
    return row[max(row)]


def _of_count(count: int) -> tuple[Quantity[dict[int, Result]], ...]:
    """Errors of those that learnt from so many samples, and how much they answer."""

    def value(get: Callable[[Result], float]) -> Callable[[dict[int, Result]], float]:
        return lambda row: 100.0 * get(row[count]) if count in row else nan

    return (
        Quantity(f"{count} samples, RMS error", "%", ".2g", value(lambda result: result.rms)),
        Quantity(f"{count} samples, worst", "%", ".2g", value(lambda result: result.worst)),
        Quantity(f"{count} samples, answered", "%", ".3g", value(lambda result: result.answered)),
    )


def _panels(contenders: list[list[Result]]) -> tuple[Panel, Panel]:
    learning, costs = [], []
    for results in contenders:
        found = [result for result in results if result.answered > 0.0]
        if found:
            name, error = found[0].contender, np.array([100.0 * result.rms for result in found])
            samples = np.array([float(result.samples) for result in found])
            learning.append(Curve(name, samples, error))
            costs.append(Curve(name, np.array([found[-1].query]), error[-1:]))
    error_label = "RMS error (% of spread)"
    most = max(result.samples for results in contenders for result in results)
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
