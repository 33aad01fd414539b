"""The time scales of a problem.

They say whether its loads are slow against the oscillations of the tissue, and whether a run is
over long after all that is viscous has relaxed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy  # scipy.linalg is loaded where a viscous time is computed

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro import find_modes, find_rest
from surrofe2.macro.rest import check_held
from surrofe2.problem import Problem
from surrofe2.problem.amplitude import Amplitude
from surrofe2.problem.conditions import Foundation, InitialVelocity
from surrofe2.problem.mesh import extent
from surrofe2.recipe.recipe import Recipe
from surrofe2.workflow.laws import quadratic_law

# Periods of the slowest oscillation in which a load must grow for inertia to have no part: the rest
# is then followed within some per cent of the load.
SLOW = 10.0
# Slowest viscous times for which loads must stand still before nothing relaxes further.
LONG = 100.0
# Kinetic energy, relative to the largest energy of a run, below which the tissue is at rest.
_AT_REST = 1e-6
# Entry of a record's `met`: the slowest viscous time, and since when loads stand still, µs.
RELAXED = "relaxed"
# Times in each smooth piece of an amplitude at which its rate is evaluated.
_SAMPLES = 64
# A change of the factor from one piece of an amplitude to the next that is larger than this,
# relative to its largest value, is a jump.
_JUMP = 1e-9
# Strain by which the modulus is computed, as a difference.
_STRAIN = 1e-4
# Square of a frequency, relative to the fastest, below which nothing resists the motion.
_FREE = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeScales:
    """Times in µs by the moduli of the RVE at rest.

    Attributes:
        cell: time in which a wave crosses a plant cell.
        wave: time in which it crosses the tissue.
        swing: period of the slowest oscillation of the tissue as it is held, at least four times
            `wave`; infinite where nothing holds it, so that it has no rest.
        load: time in which the fastest load or motion grows; 0 of a sudden one, infinite without
            any.
        by_load_steps: True if the recipe computes the rest by load steps, without time.
    """

    cell: float
    wave: float
    swing: float
    load: float
    by_load_steps: bool = False

    @property
    def is_slow(self) -> bool:
        """True if the loads are so slow that the tissue is at rest under them at every time."""
        return self.load > SLOW * self.swing

    @property
    def sentence(self) -> str:
        """The time scales in words, and the method that they call for."""
        swings = "which nothing holds"
        if self.swing < np.inf:
            swings = f"which swings in {self.swing:.3g} µs"
        load = "the loads are sudden"
        if self.load > 0.0:
            load = f"the fastest load takes {self.load:.3g} µs"
        if self.by_load_steps:
            method = "the recipe states [rest]: load steps, without time"
        elif self.is_slow:
            method = f"{load}: quasi-static: use rest"
        else:
            method = f"{load}: dynamic"
        return (
            f"a wave crosses a plant cell in {self.cell:.3g} µs and the tissue in {self.wave:.3g} "
            f"µs, {swings}; {method}"
        )


def time_scales(recipe: Recipe, problem: Problem, law: StressLaw) -> TimeScales:
    """Compute the time scales of a recipe's problem by the law at rest; the mesh may be coarser."""
    low, high = extent(problem.mesh)
    # The points of a tissue of several cells have a density each, and are computed together.
    still = np.zeros((np.size(law.density), 2, 2))
    rest = still + np.eye(2)
    stretched = rest + np.diag([_STRAIN, 0.0])
    change = law.respond(stretched, still).stress - law.respond(rest, still).stress
    modulus = float(change[:, 0, 0].min()) / _STRAIN
    speed = np.sqrt(modulus / float(np.max(law.density)))
    wave = float((high - low).max() / speed)
    side = max(cell.parameters.cell_side for cell in recipe.cells.values())
    swing = max(4.0 * wave, _slowest_period(recipe, problem, law))
    return TimeScales(
        cell=side / speed,
        wave=wave,
        swing=swing,
        load=_fastest(problem),
        by_load_steps=recipe.rest is not None,
    )


def _slowest_period(recipe: Recipe, problem: Problem, law: StressLaw) -> float:
    """Compute the period of the slowest oscillation about the tissue without load, µs.

    It is infinite where nothing holds the tissue, 0 where it does not oscillate.
    """
    try:
        rest = find_rest(replace(problem, surface=None), law, recipe.macro, factor=0.0)
        check_held(rest.system, rest.stiffness)
    except (InputError, SimulationError):
        return np.inf
    try:
        frequency = float(find_modes(rest, 1).frequencies[0])
    except (SimulationError, RuntimeError, IndexError):  # RuntimeError: of a singular stiffness
        return 0.0
    # A tissue that only bodies hold moves freely until they press; rounding gives that a frequency.
    fastest = rest.stiffness.diagonal().max() / rest.system.free_mass.diagonal().min()
    if (2.0 * np.pi * frequency) ** 2 <= _FREE * fastest:
        return 0.0
    return 1.0 / frequency


def _fastest(problem: Problem) -> float:
    """Compute the time in which the fastest load or motion grows, µs."""
    moves = any(isinstance(condition, InitialVelocity) for condition in problem.conditions)
    flies = any(body.mass is not None for body in problem.bodies)
    if moves or flies:
        return 0.0
    times = [_growth(amplitude, problem) for amplitude in _acting(problem)]
    return min(times, default=np.inf)


def _acting(problem: Problem) -> Iterator[Amplitude]:
    """Yield the amplitudes of loads, and of motions of supports and bodies."""
    for condition in problem.conditions:
        amplitude = getattr(condition, "amplitude", None)
        if amplitude is not None:
            yield amplitude
    for body in problem.bodies:
        if any(body.displacement):
            yield body.amplitude


def _growth(amplitude: Amplitude, problem: Problem) -> float:
    """Compute the largest factor over its largest rate, µs; 0 where it jumps, at the start too."""
    largest = 0.0
    rate = 0.0
    before = 0.0
    for begin, end in pairwise(problem.corners()):
        within = 0.5 * (begin + end)
        values = [amplitude.at(t, within) for t in np.linspace(begin, end, _SAMPLES)]
        factors = [factor for factor, _, _ in values]
        rates = [first_rate for _, first_rate, _ in values]
        if abs(factors[0] - before) > _JUMP * max(1.0, largest):
            return 0.0
        before = factors[-1]
        largest = max(largest, *map(abs, factors))
        rate = max(rate, *map(abs, rates))
    return largest / rate if rate > 0.0 else np.inf


def viscous_time(law: StressLaw) -> float:
    """Compute the slowest time, µs, in which strains of a viscous law relax about its rest.

    At rest P = K : ε + C : ε̇, and without inertia C : ε̇ + K : ε = 0, so the times are the
    eigenvalues of C x = τ K x over the three strains. Motions of a tissue of this law that is held
    anywhere relax no slower, as each is a sum over its points.
    """
    rest = np.eye(2)[None]
    tangents = law.respond(rest, 0.0 * rest, tangents=True).tangents
    assert tangents is not None
    strains = np.array(
        [[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.5], [0.5, 0.0]]]
    )
    stiffness = _over_strains(tangents.P_by_F[0], strains)
    viscosity = _over_strains(tangents.P_by_F_dot[0], strains)
    is_finite = np.isfinite([stiffness, viscosity]).all()
    if not is_finite or np.linalg.eigvalsh(stiffness)[0] <= 0.0:  # it is not at rest there
        return np.inf
    times: Array = scipy.linalg.eigh(viscosity, stiffness, eigvals_only=True)
    return float(times.max())


def _over_strains(tangent: Array, strains: Array) -> Array:
    """Return the symmetric part (3, 3) of a tangent (2, 2, 2, 2) between strains (3, 2, 2)."""
    matrix = np.einsum("aij,ijkl,bkl->ab", strains, tangent, strains)
    return 0.5 * (matrix + matrix.T)


def held_since(problem: Problem) -> float:
    """Return the time, µs, from which on no load or motion changes; the end where one does then."""
    acting = [*_acting(problem)]
    since = problem.duration
    for begin, end in reversed([*pairwise(problem.corners())]):
        times = np.linspace(begin, end, _SAMPLES)
        within = 0.5 * (begin + end)
        rates = [amplitude.at(t, within)[1] for amplitude in acting for t in times]
        if any(rates):
            break
        since = float(begin)
    return since


def relaxed(
    recipe: Recipe, problem: Problem, energies: Mapping[str, Array] | None = None
) -> dict[str, Any]:
    """Describe, for a record's `met`, a run that ends long after its slowest viscous time.

    Args:
        energies: (m,) pJ of a run in time, which must have come to rest; None: of a rest.

    Returns:
        The entry `RELAXED`, or nothing where loads stand still for less than `LONG` viscous times,
        or the tissue still moves.
    """
    since = held_since(problem)
    if since >= problem.duration:
        return {}
    if energies is not None:
        largest = max(abs(energy).max() for energy in energies.values())
        if energies["kinetic"][-1] > _AT_REST * largest:
            return {}
    try:
        time = max(viscous_time(quadratic_law(study)) for study in recipe.studies().values())
    except InputError:  # a law without tangents
        return {}
    for condition in problem.conditions:
        if isinstance(condition, Foundation) and condition.damping:
            of_foundation = np.inf
            if condition.stiffness:
                of_foundation = condition.damping / condition.stiffness
            time = max(time, of_foundation)
    if problem.duration - since < LONG * time:
        return {}
    return {RELAXED: {"viscous_time": time, "held_since": since, "duration": problem.duration}}


def relaxation_notes(met: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    """Say where nothing relaxes further; no warning."""
    if RELAXED in met:
        of = met[RELAXED]
        yield (
            "nothing relaxes further in this model: its slowest viscous time is "
            f"{of['viscous_time']:.2g} µs, and loads stand still from {of['held_since']:g} to "
            f"{of['duration']:g} µs",
            False,
        )
