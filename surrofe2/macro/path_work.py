"""Works along a path of equilibria: ∫ f · du by cubics through four neighbouring load steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.evaluation import Evaluation
from surrofe2.macro.system import System

Array = NDArray[np.float64]

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Exact for a cubic times the slope of a cubic."""


def acting(equations: EquationsOfMotion, now: Evaluation) -> Array:
    """(k + 3, n, 2) displacement, internal force, the k other forces and the reaction."""
    return np.stack([now.u, now.internal, *now.forces, equations.reaction(now)])


def works_along(factors: Array, acts: Array) -> Array:
    """(s, k + 2) works, pJ, from the first of s load steps to each of them.

    Both factors of f · du/dλ are cubics through the four nearest steps, so the error is of fourth
    order in the step where the path is smooth, of second where it is not, and three steps or two
    have a parabola or a straight line. A sum of forces that is zero does no work.

    Args:
        factors: (s,) load factors λ, increasing or decreasing.
        acts: (s, k + 3, n, 2) as of `acting`.
    """
    works = np.zeros((len(factors), acts.shape[1] - 1))
    points = min(4, len(factors))
    for step in range(len(factors) - 1):
        first = min(max(step - 1, 0), len(factors) - points)
        near = slice(first, first + points)
        length = factors[step + 1] - factors[step]
        nodes = (factors[near] - factors[step]) / length
        inverse = np.linalg.inv(np.vander(nodes))
        # Rows of Lagrange's polynomials and of their slopes at Gauss's points.
        places = 0.5 * (1.0 + _PLACES)
        values = np.vander(places, points) @ inverse
        powers = np.arange(points - 1, 0, -1)
        slopes = np.vander(places, points)[:, 1:] * powers @ inverse[:-1]
        forces = np.tensordot(values, acts[near, 1:], 1)
        moved = np.tensordot(slopes, acts[near, 0], 1)
        done = np.einsum("g,gkni,gni->k", 0.5 * _WEIGHTS, forces, moved)
        works[step + 1] = works[step] + done
    return works


def energies_along(system: System, factors: Array, acts: Array) -> dict[str, Array]:
    """By name, (s,) pJ, what `MacroRun.energies` has but for what needs velocities."""
    internal, *others, motion = works_along(factors, acts).T
    works = {force.name: work for force, work in zip(system.forces, others, strict=True)}
    if system.moving:
        works["motion"] = motion
    contact = {}
    if system.contacts:
        stored = np.array([sum(each.energy(u) for each in system.contacts) for u in acts[:, 0]])
        done = np.sum([works[each.name] for each in system.contacts], axis=0)
        contact = {"contact": stored, "contact dissipated": stored[0] - stored - done}
    balance = np.sum([*works.values()], axis=0) - internal
    return {"internal": internal, **works, **contact, "balance": balance}
