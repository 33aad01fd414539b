"""A problem with the law of its tissue: the system that they make."""

from __future__ import annotations

import numpy as np

from surrofe2.load_case import LoadCase
from surrofe2.macro.discretisation import n_points_of
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.system import System, make_system
from surrofe2.problem.problem import Problem, bar
from surrofe2.stress_law import StressLaw


def as_problem(problem: Problem | LoadCase, settings: MacroSettings) -> Problem:
    """A load case as the bar that it is."""
    return bar(problem, settings.elements) if isinstance(problem, LoadCase) else problem


def system_of(problem: Problem, law: StressLaw, *, proportional: bool = False) -> System:
    """The system of a problem with the law's density and, where bodies touch it, its modulus."""
    if not problem.bodies:
        return make_system(problem, law.density, proportional=proportional)
    modulus = _modulus(law, n_points_of(problem.mesh))
    return make_system(problem, law.density, modulus=modulus, proportional=proportional)


def _modulus(law: StressLaw, n_points: int) -> float:
    """Largest modulus of uniaxial strain at rest of any point, µN/µm."""
    strain, largest = 1e-4, 0.0
    still = np.zeros((n_points, 2, 2))
    for k in (0, 1):
        F = np.tile(np.eye(2), (n_points, 1, 1))
        before = law.respond(F, still).stress[:, k, k]
        F[:, k, k] += strain
        after = law.respond(F, still).stress[:, k, k]
        largest = max(largest, float(np.nanmax(after - before)) / strain)
    return largest
