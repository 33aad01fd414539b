"""What each part of the surrogate is worth: its parts added one by one, and what else there is.

Every contender learns from the first n samples of one Sobol sequence and is measured on another:
error by `stress_error`, relative to the spread of stress there; cost of a query by the wall time of
80 points at once, the number of the paper's bar. docs/validation/ablation.md explains them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from time import perf_counter, process_time

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from benchmarks.timing import threads
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS, canonical_image
from surrofe2.base.tensors import stress_error, stress_spread, to_inputs
from surrofe2.cache import StressTable
from surrofe2.law.samples import StressSamples
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import BLUE, GREEN
from surrofe2.rve import RveLaw
from surrofe2.surrogate import train
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.piola import to_cauchy, to_piola
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.workflow.generate import sample_stress
from validation.case import Setting

Array = NDArray[np.float64]
Stress = Callable[[Array, Array], Array]
"""Cauchy stress (n, 2, 2) at (F, Ḟ); NaN where no answer is given."""

POINTS, REPEATS = 80, 25
TEST_SEED = 987_654
TABLE_TOLERANCE = 1e-3  # of a `StressTable`, relative to the spread of stress
_SOLVES_A_RECORD = 8
_TUNED_ON = 512  # samples that the length scales of the Gaussian process are fitted to
_WEIGHT = 0.1
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)  # µs

_plain = partial(replace, baseline_degree=0, tangent_weight=0.0)
NETWORKS: Mapping[str, Callable[[TrainingSettings], TrainingSettings]] = {
    "plain MLP": _plain,
    "plain MLP, 4 × the iterations": lambda s: _plain(s, iterations=4 * s.iterations),
    "+ symmetry": _plain,
    "+ tangents": partial(_plain, tangent_weight=_WEIGHT),
    "+ Kelvin–Voigt": partial(replace, baseline_degree=1, tangent_weight=_WEIGHT),
    "+ polynomial": partial(replace, baseline_degree=3, tangent_weight=_WEIGHT),
    "+ polynomial − tangents": partial(replace, baseline_degree=3, tangent_weight=0.0),
}
"""The last but one is the recipe's own."""
WITHOUT_SYMMETRY = tuple(NETWORKS)[:2]
TABLE = "table"


class GaussianProcess:
    """Squared exponentials with a length scale per input as a stress law of a square plant cell.

    Inputs are those of the network (U and RᵀḞ, so rotations are out), folded by the square's group
    into difference ≥ 0 and shear ≥ 0; components of P̂ = RᵀP share the kernel.
    """

    def __init__(self, samples: StressSamples) -> None:
        valid = samples.valid
        self.scale = input_scale(samples.range)
        x, signs = self._folded(valid.F, valid.F_dot)
        P = signs * to_piola(valid.F, valid.stress)
        self.spread = P.std(axis=0)
        kernel = RBF(np.full(x.shape[1], 4.0), (0.5, 1e3))
        first = GaussianProcessRegressor(kernel, alpha=1e-10)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound
            first.fit(x[:_TUNED_ON], (P / self.spread)[:_TUNED_ON])
        last = GaussianProcessRegressor(first.kernel_, alpha=1e-10, optimizer=None)
        self.model = last.fit(x, P / self.spread)

    def _folded(self, F: Array, F_dot: Array) -> tuple[Array, Array]:
        """Folded inputs (n, 7), and the signs (n, 4) of the components there."""
        x = to_inputs(F, F_dot)[0] / self.scale
        image = canonical_image(x)
        return x * INPUT_SIGNS[image], COMPONENT_SIGNS[image]

    def stress(self, F: Array, F_dot: Array) -> Array:
        """Cauchy stress (n, 2, 2)."""
        x, signs = self._folded(F, F_dot)
        return to_cauchy(F, signs * np.asarray(self.model.predict(x)) * self.spread)


GAUSSIAN = "Gaussian process"
CONTENDERS = (*NETWORKS, GAUSSIAN, TABLE)


@dataclass(frozen=True, slots=True)
class Result:
    """One contender at one number of samples.

    rms, worst: error relative to the spread of stress, over what is answered; NaN where nothing
    is. answered: fraction of the points that are. query: µs per point of `POINTS` at once.
    training: s of CPU time.
    """

    contender: str
    samples: int
    rms: float
    worst: float
    answered: float
    query: float
    training: float


QUANTITIES: tuple[Quantity[Result], ...] = (
    Quantity("contender", "", "", lambda row: row.contender),
    Quantity("samples", "", "d", lambda row: row.samples),
    Quantity("RMS error", "%", ".2g", lambda row: 100.0 * row.rms),
    Quantity("worst", "%", ".2g", lambda row: 100.0 * row.worst),
    Quantity("answered", "%", ".3g", lambda row: 100.0 * row.answered),
    Quantity("query", "µs", ".2g", lambda row: row.query),
    Quantity("training", "CPU s", ".0f", lambda row: row.training),
)


def ablation(setting: Setting) -> Study:
    """All contenders at all numbers of samples, for the recipe's plant cell, law and range."""
    study = setting.study()
    law = RveLaw(study.cell.parameters, study.recipe.rve)
    range_ = study.sampling_range()
    counts = (64, 128) if setting.quick else (256, 1024)
    samples = sample_stress(law, range_, max(counts), seed=study.cell.samples.seed)
    truth = sample_stress(law, range_, 256 if setting.quick else 2048, seed=TEST_SEED).valid
    results = []
    with threads(1):
        for count in counts:
            for name in CONTENDERS:
                few = samples.at(np.arange(count))
                results.append(compete(name, law, few, study.cell.training, truth))
                print(f"{name}, {count} samples: {100.0 * results[-1].rms:.2g} %", flush=True)
    return describe(results)


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
    for _ in range(REPEATS):
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
        return (lambda F, F_dot: table.lookup(F, F_dot)[0],) * 2
    if name == GAUSSIAN:
        return (GaussianProcess(samples).stress,) * 2
    symmetry = "none" if name in WITHOUT_SYMMETRY else None
    surrogate = train(samples, NETWORKS[name](settings), symmetry=symmetry)
    return surrogate.extrapolate, lambda F, F_dot: surrogate.lookup(F, F_dot)[0]


def learn_table(law: RveLaw, samples: StressSamples) -> StressTable:
    """A table that has spent as many RVE solves as there are samples, a record about each 8th."""
    spread = stress_spread(samples.valid.stress)
    most = max(1, len(samples.F) // _SOLVES_A_RECORD)
    table = StressTable(law, TABLE_TOLERANCE * spread, samples.range, spread, most_records=most)
    valid = samples.valid
    table.learn(valid.F[:most], valid.F_dot[:most], valid.stress[:most])
    return table


def describe(results: list[Result]) -> Study:
    """The table for people, and the picture."""
    return Study(
        title="Surrogate part by part, and what else there is",
        drawing=picture(results),
        table=Table(QUANTITIES, results),
    )


def picture(results: list[Result]) -> Figure:
    """Error by the fewest and the most samples, and cost of a query, a row for each contender."""
    figure = Figure(figsize=(9.2, 3.9), layout="constrained")
    errors, costs = figure.subplots(1, 2, width_ratios=(1.6, 1.0), sharey=True)
    few, *_, many = sorted({result.samples for result in results})
    names = [name for name in CONTENDERS if any(each.contender == name for each in results)]
    for row, name in enumerate(names):
        of = {each.samples: each for each in results if each.contender == name and each.answered}
        colour = GREEN if name == "+ polynomial" else BLUE  # that of the recipe
        ends = [100.0 * of[count].rms for count in (few, many) if count in of]
        errors.plot(ends, [row] * len(ends), color=colour, linewidth=1.3)
        errors.plot(ends[:1], [row], "o", color=colour, fillstyle="none", markersize=6.0)
        errors.plot(ends[-1:], [row], "o", color=colour, markersize=6.0)
        if many in of:
            costs.plot([of[many].query], [row], "o", color=colour, markersize=6.0)
    errors.set_yticks(range(len(names)), names)
    errors.invert_yaxis()
    errors.set(xscale="log", xlabel="RMS error (% of the stresses' standard deviation)")
    errors.set_title(f"○ {few:,} samples, ● {many:,}; green: the recipe's own", fontsize=10)
    costs.set(xscale="log", xlabel="time per query (µs)")
    costs.set_title(f"{POINTS} points at once, one thread", fontsize=10)
    costs.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    costs.set_xticks([], minor=True)
    costs.set_xlim(TICKS[0], max(10.0, *costs.get_xlim()))
    for axes in (errors, costs):
        axes.grid(alpha=0.25)
    return figure
