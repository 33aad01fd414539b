"""The time scales of a problem: whether its loads are slow against what swings in the tissue."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro import find_modes, find_rest
from surrofe2.problem import Problem
from surrofe2.problem.amplitude import Amplitude
from surrofe2.problem.conditions import InitialVelocity
from surrofe2.problem.mesh import extent
from surrofe2.recipe.recipe import Recipe

SLOW = 10.0
"""Periods of the slowest oscillation, in which a load must grow for inertia to have no part: the
rest is then followed within some per cent of the load."""
_SAMPLES = 64
"""Times in each smooth piece of an amplitude at which its rate is looked at."""
_STRAIN = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeScales:
    """Times in µs by the moduli of the RVE at rest.

    Attributes:
        cell: in which a wave crosses a plant cell; wave: the tissue.
        swing: period of the slowest oscillation of the tissue as it is held, four times `wave`
            where nothing holds it.
        load: in which the fastest load or motion grows; 0 of a sudden one, infinite without any.
    """

    cell: float
    wave: float
    swing: float
    load: float

    @property
    def is_slow(self) -> bool:
        """Whether the loads are so slow that the tissue is at rest under them at every time."""
        return self.load > SLOW * self.swing

    @property
    def sentence(self) -> str:
        """The time scales, and which method they call for."""
        load = "the loads are sudden"
        if self.load > 0.0:
            load = f"the fastest load takes {self.load:.3g} µs"
        verdict = "quasi-static: use rest" if self.is_slow else "dynamic"
        return (
            f"a wave crosses a plant cell in {self.cell:.3g} µs and the tissue in {self.wave:.3g} "
            f"µs, which swings in {self.swing:.3g} µs; {load}: {verdict}"
        )


def time_scales(recipe: Recipe, problem: Problem, law: StressLaw) -> TimeScales:
    """The time scales of a recipe's problem, on a mesh that may be coarser, by the law at rest."""
    low, high = extent(problem.mesh)
    stretched, still = np.tile(np.eye(2), (2, 1, 1)), np.zeros((2, 2, 2))
    stretched[1, 0, 0] += _STRAIN
    count = np.size(law.density)
    if count > 1:  # the points of a tissue of several cells
        stretched = np.concatenate([np.tile(each, (count, 1, 1)) for each in stretched])
        answers = [law.respond(part, np.zeros_like(part)).stress for part in np.split(stretched, 2)]
    else:
        answers = np.split(law.respond(stretched, still).stress, 2)
    modulus = float((answers[1] - answers[0])[:, 0, 0].min()) / _STRAIN
    speed = np.sqrt(modulus / float(np.max(law.density)))
    wave = float((high - low).max() / speed)
    side = max(part.cell.cell_side for part in recipe.parts().values())
    swing = 4.0 * wave
    try:
        rest = find_rest(replace(problem, surface=None), law, recipe.macro, factor=0.0)
        swing = max(swing, float(find_modes(rest, 1).periods[0]))
    except (InputError, SimulationError, IndexError, ArithmeticError):
        pass  # nothing holds the tissue, or it does not oscillate
    return TimeScales(cell=side / speed, wave=wave, swing=swing, load=_fastest(problem))


def _fastest(problem: Problem) -> float:
    """The time in which the fastest load or motion grows, µs."""
    moves = any(isinstance(each, InitialVelocity) for each in problem.conditions)
    flies = any(body.mass is not None for body in problem.bodies)
    if moves or flies:
        return 0.0
    return min((_growth(each, problem) for each in _acting(problem)), default=np.inf)


def _acting(problem: Problem) -> Iterator[Amplitude]:
    """Amplitudes of loads and motions that are not zero."""
    for each in problem.conditions:
        amplitude = getattr(each, "amplitude", None)
        if amplitude is not None:
            yield amplitude
    for body in problem.bodies:
        if any(body.displacement):
            yield body.amplitude


def _growth(amplitude: Amplitude, problem: Problem) -> float:
    """Largest factor over its largest rate, µs; 0 where the factor jumps, at the start too."""
    corners = problem.corners()
    largest, rate, before = 0.0, 0.0, 0.0
    for begin, end in pairwise(corners):
        within = 0.5 * (begin + end)
        values = [amplitude.at(t, within) for t in np.linspace(begin, end, _SAMPLES)]
        if abs(values[0][0] - before) > 1e-9 * max(1.0, largest):
            return 0.0
        before = values[-1][0]
        largest = max(largest, *(abs(value[0]) for value in values))
        rate = max(rate, *(abs(value[1]) for value in values))
    return largest / rate if rate > 0.0 else np.inf
