"""Supports: the unknowns that conditions hold or move, each owned by one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.problem.amplitude import ONE, Amplitude, Proportional
from surrofe2.problem.conditions import Fixed, PrescribedMotion, Symmetry
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


def make_supports(problem: Problem, proportional: bool) -> tuple[Support, ...]:
    """Those of the conditions and of bodies without mass; `proportional` as of `make_system`."""
    mesh, found = problem.mesh, []
    for condition in problem.conditions:
        where = f"{condition.kind()}.on"
        match condition:
            case Fixed():
                components = [k for k in (0, 1) if "xy"[k] in condition.components]
                largest: dict[int, float] = dict.fromkeys(components, 0.0)
            case Symmetry():
                largest = {_normal_component(problem, condition): 0.0}
            case PrescribedMotion():
                given = enumerate(condition.displacement)
                largest = {k: value for k, value in given if value is not None}
            case _:
                continue
        nodes = nodes_on(mesh, condition.on, where)
        unknowns = (2 * nodes[:, None] + np.array([*largest], dtype=np.int64)).ravel()
        amplitude = condition.amplitude if isinstance(condition, PrescribedMotion) else ONE
        values = np.tile([*largest.values()], nodes.size)
        found.append(Support(label(condition), unknowns, values, amplitude))
    for k, body in enumerate(problem.bodies):
        if body.mass is None:
            unknowns = 2 * (mesh.p.shape[1] + k) + np.arange(2)
            values = np.array(body.displacement)
            found.append(Support(f"{body.name} position", unknowns, values, body.amplitude))
    if proportional:
        found = [Support(each.name, each.unknowns, each.largest, Proportional()) for each in found]
    return _without_overlap(found, problem)


def _without_overlap(supports: list[Support], problem: Problem) -> tuple[Support, ...]:
    """Supports that share no unknown: fixed ones may meet, what moves must agree."""
    owner: dict[int, tuple[str, float, Amplitude]] = {}
    kept = []
    for support in supports:
        mine = np.ones(support.unknowns.size, dtype=bool)
        for j, (unknown, value) in enumerate(zip(support.unknowns, support.largest, strict=True)):
            claim = (support.name, float(value), support.amplitude)
            other = owner.setdefault(int(unknown), claim)
            if other is claim:
                continue
            mine[j] = False
            both_rest = other[1] == value == 0.0
            if not both_rest and other[1:] != claim[1:]:
                x, y = problem.mesh.p[:, unknown // 2]
                raise InputError(
                    f"{support.name}: component {'xy'[unknown % 2]} of the node at "
                    f"({x:.6g}, {y:.6g}) µm; {other[0]} prescribes it otherwise, "
                    "and only one may"
                )
        kept.append(
            Support(support.name, support.unknowns[mine], support.largest[mine], support.amplitude)
        )
    return tuple(kept)


def _normal_component(problem: Problem, condition: Symmetry) -> int:
    nodes = problem.mesh.p.T[nodes_on(problem.mesh, condition.on, "symmetry.on")]
    extent = np.ptp(nodes, axis=0)
    component = int(extent.argmin())
    if extent[component] > 1e-9 * extent.max():
        raise InputError(
            f"{label(condition)}.on: {condition.on}; a symmetry must be straight along x or along y"
        )
    return component
