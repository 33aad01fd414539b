"""Supports: the unknowns that conditions hold or move, each owned by one of them.

Places are nodes of a mesh or particles of a tissue; component i of place a is unknown 2 a + i.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.problem.amplitude import ONE, Amplitude
from surrofe2.problem.conditions import Condition, Fixed, PrescribedMotion, Symmetry
from surrofe2.problem.mesh import nodes_on
from surrofe2.problem.problem import Problem, label

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Support:
    """Unknowns that a condition holds or moves: `largest` times the amplitude, µm."""

    name: str
    unknowns: Index
    largest: Array
    amplitude: Amplitude


def supports_of(problem: Problem, places_of: Callable[[Condition], Index]) -> list[Support]:
    """A support for each condition that is one; they may share unknowns.

    Args:
        places_of: the places that a condition holds or moves.
    """
    found = []
    for condition in problem.conditions:
        match condition:
            case Fixed():
                components = [k for k in (0, 1) if "xy"[k] in condition.components]
                largest: dict[int, float] = dict.fromkeys(components, 0.0)
            case Symmetry():
                largest = {_normal_component(problem.mesh, condition): 0.0}
            case PrescribedMotion():
                given = enumerate(condition.displacement)
                largest = {k: value for k, value in given if value is not None}
            case _:
                continue
        places = places_of(condition)
        unknowns = (2 * places[:, None] + np.array([*largest], dtype=np.int64)).ravel()
        amplitude = condition.amplitude if isinstance(condition, PrescribedMotion) else ONE
        values = np.tile([*largest.values()], places.size)
        found.append(Support(label(condition), unknowns, values, amplitude))
    return found


def without_overlap(
    supports: Sequence[Support], at: Array, what: str = "node"
) -> tuple[Support, ...]:
    """Supports that share no unknown: fixed ones may meet, what moves must agree.

    Args:
        at: (n, 2) where the places are that may be shared, µm.
        what: a place is.

    Raises:
        InputError: two move one component differently.
    """
    size = max((int(each.unknowns.max(initial=-1)) for each in supports), default=-1) + 1
    owner, value, kept = np.full(size, -1), np.zeros(size), list[Support]()
    for k, support in enumerate(supports):
        before = owner[support.unknowns]
        others = [j for j in np.unique(before) if j >= 0]
        unlike = [j for j in others if supports[j].amplitude != support.amplitude]
        moves_apart = (support.largest != 0.0) & np.isin(before, unlike)
        clash = (before >= 0) & ((support.largest != value[support.unknowns]) | moves_apart)
        if clash.any():
            first = int(clash.argmax())
            place, component = divmod(int(support.unknowns[first]), 2)
            x, y = at[place]
            raise InputError(
                f"{support.name}: component {'xy'[component]} of the {what} at "
                f"({x:.6g}, {y:.6g}) µm; {supports[before[first]].name} prescribes it otherwise, "
                "and only one may"
            )
        mine = before < 0
        owned = replace(support, unknowns=support.unknowns[mine], largest=support.largest[mine])
        owner[owned.unknowns], value[owned.unknowns] = k, owned.largest
        kept.append(owned)
    return tuple(kept)


def _normal_component(mesh: skfem.Mesh, condition: Symmetry) -> int:
    nodes = mesh.p.T[nodes_on(mesh, condition.on, "symmetry.on")]
    extent = np.ptp(nodes, axis=0)
    component = int(extent.argmin())
    if extent[component] > 1e-9 * extent.max():
        raise InputError(
            f"{label(condition)}.on: {condition.on}; a symmetry must be straight along x or along y"
        )
    return component
