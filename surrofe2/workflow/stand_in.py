"""What a surrogate will cost, timed on one that learns the quadratic law of the RVE at rest.

It has as many samples, the same network and the same paths, so its iterations, its fits and its
lookups take as long as those of the true one; RVEs, which it does not need, are timed apart. Where
a recipe leaves the number of samples out, 512 are taken for enough, without symmetry twice as many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surrofe2.compilation import clock
from surrofe2.io.surrogates import read_surrogate
from surrofe2.macro.discretisation import n_points_of
from surrofe2.recipe import Recipe
from surrofe2.rve import RveLaw
from surrofe2.sampling import training_points
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.deformation_paths import random_walks, true_stress
from surrofe2.surrogate.training import train
from surrofe2.workflow import laws
from surrofe2.workflow.calibrate import calibrate
from surrofe2.workflow.generate import counts_of, sample_stress
from surrofe2.workflow.train import is_trained

_FEW, _MANY = 16, 512
_FILE = 0.03
"""Seconds of opening, writing and closing a data set."""
_ITERATIONS, _TO_BOUND = 60, 400
"""Of the stand-in, and of a training that ends when it meets its bound: 100 to 600 did so."""
_PART, _WAVES = 0.01, 3.0
"""Of the stress of a stand-in that is no quadratic law's, so that there is something to learn."""
_ROUND = 20
"""Iterations between two reports of a training."""
_SHAPING = 1.0 + 1.0 / 3.0
"""Paths in all for each that calibrates."""
_SINGLE = 3.0
"""Kinds of paths of one state, each solved cold: anywhere, in corners, near rest."""
_COARSE = 4
"""Elements of a bar in each direction, in runs that make paths."""


@dataclass(frozen=True, slots=True)
class Learnt:
    """A surrogate, and what is missing to make it.

    Attributes:
        is_true: whether it is the recipe's, finished before; else a stand-in.
        data, training: s.
    """

    law: SurrogateLaw
    is_true: bool
    data: float = 0.0
    training: float = 0.0


def learnt_of(part: Recipe, seconds: float) -> Learnt:
    """The surrogate of a recipe of one cell, or a stand-in.

    Args:
        seconds: for each kind of solve that is timed.
    """
    true, settings, wanted = laws.true_law(part), part.samples, part.sampling_range()

    def sampled(tangents: bool) -> float:
        def work(count: int) -> None:
            sample_stress(true, wanted, count, seed=settings.seed, tangents=tangents)

        return seconds_each(work, seconds)

    if is_trained(part):
        return Learnt(read_surrogate(part.training_path()), True)
    cold = sampled(False)
    data = 0.0
    if not part.data_path().exists():
        data = _FILE + _counts(part)[-1] * (sampled(True) if settings.tangents else cold)
    samples, stand_in = _samples(part, true), laws.quadratic_law(part)
    surrogate, learning = _trained(part, samples)
    learning *= sum(_counts(part)) / _counts(part)[-1]
    surrogate, fitting = _calibrated(part, surrogate, samples, stand_in)
    asking = _asking(part, true, cold, seconds)
    return Learnt(surrogate, False, data, learning + fitting + asking)


def _counts(part: Recipe) -> tuple[int, ...]:
    """How many samples training will probably take, in turn: without symmetry it needs more."""
    return counts_of(part)[: 1 if part.cell.symmetry == "D4" else 2]


def seconds_each(work: Callable[[int], Any], seconds: float) -> float:
    """Seconds for each of a number of things, from a few and then from as many as time allows."""
    work(_FEW)
    began = clock()
    work(_FEW)
    each = (clock() - began) / _FEW
    count = int(np.clip(0.5 * seconds / each, _FEW, _MANY))
    began = clock()
    work(count)
    return (clock() - began) / count


def _samples(part: Recipe, true: RveLaw) -> StressSamples:
    """As many samples as training comes to, of the quadratic law and a little more."""
    settings, wanted, law = part.samples, part.sampling_range(), laws.quadratic_law(part)
    F, F_dot = training_points(wanted, _counts(part)[-1], settings.seed)
    answer = law.respond(F, F_dot, tangents=settings.tangents)
    wave = np.sin(_WAVES * (F - np.eye(2)) / np.abs(F - np.eye(2)).max()).sum(axis=(1, 2))
    stress, slopes = (1.0 + _PART * wave[:, None, None]) * answer.stress, answer.tangents
    return StressSamples(
        F=F,
        F_dot=F_dot,
        stress=stress,
        status=answer.status,
        cell=part.cell,
        initialisation=part.rve.initialisation,
        range=wanted,
        seed=settings.seed,
        rest_length=true.rest_length,
        P_by_F=None if slopes is None else slopes.P_by_F,
        P_by_F_dot=None if slopes is None else slopes.P_by_F_dot,
    )


def _trained(part: Recipe, samples: StressSamples) -> tuple[SurrogateLaw, float]:
    """A surrogate after a few iterations, and the seconds of all that the recipe wants."""
    marks: list[float] = []
    most = part.training.iterations
    if part.training.bound:
        most = min(most, _TO_BOUND)
    few = replace(part.training, iterations=min(_ITERATIONS, most))
    began = clock()
    surrogate = train(samples, few, progress=lambda *_: marks.append(clock()))
    taken = clock() - began
    if len(marks) > 1:
        a_round = float(np.diff(marks).min())  # the first have more trials along a line
        taken += (most / _ROUND - len(marks)) * a_round
    return surrogate, taken


def _calibrated(
    part: Recipe, surrogate: SurrogateLaw, samples: StressSamples, law: StressLaw
) -> tuple[SurrogateLaw, float]:
    """The surrogate with a bound, and the seconds of all that is no RVE: fits, and runs by it."""
    paths = part.calibration
    began = clock()
    plain = replace(paths, runs=0, states=paths.states or max(paths.walks, paths.runs))
    bounded = calibrate(surrogate, samples, law, plain)
    taken = clock() - began
    if paths.runs:
        one = replace(paths, walks=0, states=0, runs=1, share=0.5)
        began = clock()
        calibrate(surrogate, samples, law, one, problem=part.load or part.problem(),
                  macro=part.macro)  # fmt: skip
        taken += 0.5 * (clock() - began) * _SHAPING * paths.runs  # it was two runs
    return bounded, taken


def _asking(part: Recipe, true: RveLaw, cold: float, seconds: float) -> float:
    """Seconds of the RVEs along the paths of calibration."""
    paths = part.calibration
    wanted, length = part.sampling_range(), paths.length

    def walk(count: int) -> None:
        true_stress(random_walks(wanted, count, length, seed=0), true)

    warm = seconds_each(walk, seconds) / length if paths.walks or paths.runs else 0.0
    points = n_points_of(part.problem().mesh)
    if part.stated is None:
        nx, ny = part.macro.elements
        points = points * min(nx, _COARSE) * min(ny, _COARSE) // (nx * ny)
    along_runs = paths.runs * -(-length // 3) * points
    solved = (paths.walks * length + along_runs) * warm + _SINGLE * paths.states * cold
    return _SHAPING * solved
