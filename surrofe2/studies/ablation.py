"""What each part of the surrogate buys: its parts added one by one, and what else there is.

Every contender learns from the first n samples of one Sobol sequence and is measured on another:
error by `stress_error`, relative to the spread of stress there; cost a query by the wall time of
80 points at once, the number of the paper's bar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.parts import Surrogate
from surrofe2.rve import RveLaw
from surrofe2.sampling import sample
from surrofe2.stress_samples import StressSamples
from surrofe2.studies.ablation_rivals import (
    Folded,
    GaussianProcess,
    LinearFromNearest,
    NearestNeighbours,
    Regressor,
    learn_table,
)
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.tensors import stress_error, stress_spread

Array = NDArray[np.float64]
Stress = Callable[[Array, Array], Array]
"""Cauchy stress (n, 2, 2) at (F, Ḟ); NaN where no answer is given."""

QUERIED = 80
TEST_POINTS = 2048
_REPEATS = 25
_MOST_OF_A_PROCESS = 4096  # samples of a Gaussian process, whose cost rises with their cube
_WEIGHT = 0.1
_LONGER, _TIMES_LONGER = "plain MLP, 4 × the iterations", 4
_TABLE = "table"
_NETWORKS: Mapping[str, dict[str, Any]] = {
    "plain MLP": {"form": "stress", "baseline_degree": 0, "tangent_weight": 0.0, "square": False},
    _LONGER: {"form": "stress", "baseline_degree": 0, "tangent_weight": 0.0, "square": False},
    "+ symmetry": {"form": "stress", "baseline_degree": 0, "tangent_weight": 0.0},
    "+ energy": {"form": "energy", "baseline_degree": 0, "tangent_weight": 0.0},
    "+ tangents": {"form": "energy", "baseline_degree": 0, "tangent_weight": _WEIGHT},
    "+ Kelvin–Voigt": {"form": "energy", "baseline_degree": 1, "tangent_weight": _WEIGHT},
    "+ polynomial": {"form": "energy", "baseline_degree": 3, "tangent_weight": _WEIGHT},
    "+ polynomial − tangents": {"form": "energy", "baseline_degree": 3, "tangent_weight": 0.0},
    "+ polynomial − energy": {"form": "stress", "baseline_degree": 3, "tangent_weight": _WEIGHT},
    "+ polynomial − both": {"form": "stress", "baseline_degree": 3, "tangent_weight": 0.0},
}
_RIVALS: Mapping[str, Callable[[], Regressor]] = {
    "nearest neighbours": NearestNeighbours,
    "Gaussian process": GaussianProcess,
    "linear from nearest": LinearFromNearest,
}


@dataclass(frozen=True, slots=True)
class Row:
    """One contender at one number of samples.

    rms, worst: error relative to the spread of stress, over what is answered; None where nothing
    is. answered: share of the points that are. query: µs a point of `QUERIED` at once.
    training: s of CPU time.
    """

    contender: str
    samples: int
    rms: float | None
    worst: float | None
    answered: float
    query: float
    training: float


def contenders() -> tuple[str, ...]:
    """All names, the networks first, part by part."""
    return (*_NETWORKS, *_RIVALS, _TABLE)


def is_of(name: str, settings: TrainingSettings) -> bool:
    """Whether a recipe's training is that contender."""
    changes = {k: v for k, v in _NETWORKS.get(name, {"form": None}).items() if k != "square"}
    plain = "square" in _NETWORKS.get(name, {})
    return not plain and all(getattr(settings, key) == value for key, value in changes.items())


def ask_rve(law: RveLaw, start: StressSamples, count: int, seed: int) -> StressSamples:
    """Samples of an RVE with tangents over the range of `start`, which may hold none."""
    F, F_dot = sample(start.range, count, seed)
    answer = law.respond(F, F_dot, tangents=True)
    assert answer.tangents is not None
    by_F, by_rate = answer.tangents.P_by_F, answer.tangents.P_by_F_dot
    return replace(
        start, F=F, F_dot=F_dot, stress=answer.stress, status=answer.status, seed=seed,
        P_by_F=by_F, P_by_F_dot=by_rate,
    )  # fmt: skip


def compete(
    law: RveLaw,
    samples: StressSamples,
    test: StressSamples,
    settings: TrainingSettings,
    counts: tuple[int, ...],
    *,
    known: Mapping[tuple[str, int], Row] | None = None,
) -> Iterator[Row]:
    """Every contender at every number of samples; those that are known are not trained again.

    Args:
        law: whose stress it is; the table asks it.
        samples: with tangents, at least the largest of `counts`.
        test: on which the errors are measured.
        settings: of the recipe; its sizes, iterations and seed are those of all networks.
        known: rows of an earlier, interrupted call, by contender and number of samples.
    """
    truth = test.valid
    for count in counts:
        few = first(samples, count)
        for name in contenders():
            if name == "Gaussian process" and count > _MOST_OF_A_PROCESS:
                continue
            row = (known or {}).get((name, count))
            if row is None:
                begin = process_time()
                reference, query = _learn(name, law, few, settings)
                row = _measure(name, count, reference, query, truth, process_time() - begin)
            yield row


def first(samples: StressSamples, count: int) -> StressSamples:
    """The first samples, with all that they hold."""
    names = ("F", "F_dot", "stress", "status", "P_by_F", "P_by_F_dot")
    arrays = {name: getattr(samples, name) for name in names}
    cut = {name: array[:count] for name, array in arrays.items() if array is not None}
    return replace(samples, **cut)


def _learn(
    name: str, law: RveLaw, samples: StressSamples, settings: TrainingSettings
) -> tuple[Stress, Stress]:
    """(stress for errors, stress as a run asks for it)."""
    if name == _TABLE:
        table = learn_table(law, samples)
        return _looked_up(table), _looked_up(table)
    if name in _RIVALS:
        stress = Folded(_RIVALS[name](), samples).stress
        return stress, stress
    from surrofe2.surrogate import train

    changes = dict(_NETWORKS[name])
    symmetry = None if changes.pop("square", True) else "none"
    if name == _LONGER:
        changes["iterations"] = _TIMES_LONGER * settings.iterations
    surrogate = train(samples, replace(settings, **changes), symmetry=symmetry)
    return surrogate.reference, _looked_up(surrogate)


def _looked_up(surrogate: Surrogate) -> Stress:
    return lambda F, F_dot: surrogate.lookup(F, F_dot)[0]


def _measure(
    name: str, count: int, reference: Stress, query: Stress, truth: StressSamples, training: float
) -> Row:
    found = reference(truth.F, truth.F_dot)
    answered = np.isfinite(found).all(axis=(1, 2))
    error = stress_error(found[answered], truth.stress[answered]) / stress_spread(truth.stress)
    rms = float(np.sqrt((error**2).mean())) if error.size else None
    worst = float(error.max()) if error.size else None
    F, F_dot = (np.ascontiguousarray(array[:QUERIED]) for array in (truth.F, truth.F_dot))
    query(F, F_dot)
    times = []
    for _ in range(_REPEATS):
        begin = perf_counter()
        query(F, F_dot)
        times.append(perf_counter() - begin)
    return Row(
        contender=name,
        samples=count,
        rms=rms,
        worst=worst,
        answered=float(answered.mean()),
        query=1e6 * min(times) / len(F),
        training=training,
    )
