"""Forces on the nodes besides the tissue's own: dead loads, follower pressure, foundations.

A force knows its slopes, which Newton's method needs. Unknown 2 a + i is component i of node a; the
positions of rigid bodies are numbered on after the nodes of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy  # scipy.sparse is loaded where a force has slopes
from numpy.typing import NDArray

from surrofe2.amplitude import ONE, Amplitude, Proportional
from surrofe2.macro.conditions import (
    BodyForce,
    DrivenCondition,
    Foundation,
    Pressure,
    Traction,
)
from surrofe2.macro.discretisation import SIDE_RULE, side_shapes
from surrofe2.macro.problem import Problem, label

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Matrix = Any
"""Sparse by columns, or dense where it is small; scipy.sparse is not loaded to name it."""
Slopes = tuple[Matrix, Matrix]


class Force(Protocol):
    """A force on nodes and rigid bodies.

    Attributes:
        name: of the condition it comes from.
    """

    @property
    def name(self) -> str: ...

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """(n, 2) µN at displacement u and velocity v (n, 2); `within` as of `Amplitude`."""

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        """−∂f/∂u and −∂f/∂v, (2 n, 2 n); None where both are zero."""


@dataclass(frozen=True, slots=True)
class DeadLoad:
    """A force that follows its amplitude and nothing else; `largest` is (n, 2) µN."""

    name: str
    largest: Array
    amplitude: Amplitude

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """As of `Force`."""
        return self.amplitude.at(t, within)[0] * self.largest

    def slopes(self, t: float, within: float, u: Array, v: Array) -> None:
        """None: it does not follow the tissue."""


@dataclass(frozen=True, slots=True)
class FollowerPressure:
    """f = A(t) (f₀ + B u): linear in u, for the normal times length is linear in positions.

    Attributes:
        unloaded: (n, 2) f₀, µN. slope: (2 n, 2 n) B, µN/µm.
    """

    name: str
    unloaded: Array
    slope: Matrix
    amplitude: Amplitude

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """As of `Force`."""
        force: Array = self.unloaded + (self.slope @ u.ravel()).reshape(u.shape)
        return self.amplitude.at(t, within)[0] * force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes:
        """As of `Force`."""
        return -self.amplitude.at(t, within)[0] * self.slope, 0.0 * self.slope


@dataclass(frozen=True, slots=True)
class SpringsAndDashpots:
    """f = −K u − C v with constant matrices (2 n, 2 n)."""

    name: str
    stiffness: Matrix
    damping: Matrix

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """As of `Force`."""
        force: Array = -(self.stiffness @ u.ravel()) - self.damping @ v.ravel()
        return force.reshape(u.shape)

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes:
        """As of `Force`."""
        return self.stiffness, self.damping


def side_points(nodes: Array, sides: Index) -> tuple[Array, Array, Array]:
    """Quadrature along sides: (m, 3) lengths, (3, k) shape functions and (3, k) their slopes.

    Args:
        nodes: (n, 2) reference positions, µm.
        sides: (m, k) nodes of each side.
    """
    shape, slopes = side_shapes(sides.shape[1])
    along = np.einsum("qa,mai->mqi", slopes, nodes[sides])
    return np.linalg.norm(along, axis=2) * SIDE_RULE[1], shape, slopes


def traction_load(nodes: Array, sides: Index, traction: tuple[float, float], n: int) -> Array:
    """(n, 2) ∫ N_a t dL over reference sides, µN."""
    lengths, shape, _ = side_points(nodes, sides)
    load = np.zeros((n, 2))
    np.add.at(load, sides, (lengths @ shape)[:, :, None] * np.array(traction))
    return load


def pressure_load(
    nodes: Array, sides: Index, pressure: float, n: int
) -> tuple[Array, scipy.sparse.csc_matrix]:
    """f₀ (n, 2) and B (2 n, 2 n) of a follower pressure, f_a = −p ∫ N_a (dy, −dx)."""
    shape, slopes = side_shapes(sides.shape[1])
    coupling = np.einsum("q,qa,qb->ab", SIDE_RULE[1], shape, slopes)
    # The tissue lies on the left of a side, so the outward normal times length is (dy, −dx).
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    block = -pressure * np.einsum("ab,ij->aibj", coupling, turn)
    k = sides.shape[1]
    unknowns = (2 * sides[:, :, None] + np.arange(2)).reshape(-1, 2 * k)
    row = np.repeat(unknowns, 2 * k, axis=1)
    column = np.tile(unknowns, (1, 2 * k))
    values = np.tile(block.reshape(-1), len(sides))
    slope = scipy.sparse.csc_matrix((values, (row.ravel(), column.ravel())), shape=(2 * n, 2 * n))
    positions = np.zeros((n, 2))
    positions[: len(nodes)] = nodes
    return (slope @ positions.ravel()).reshape(n, 2), slope


def side_mass(nodes: Array, sides: Index, components: str, n: int) -> Matrix:
    """(2 n, 2 n) ∫ N_a N_b dL over reference sides for the components, µm."""
    lengths, shape, _ = side_points(nodes, sides)
    blocks = np.einsum("mq,qa,qb->mab", lengths, shape, shape)
    row, column = np.broadcast_arrays(sides[:, :, None], sides[:, None, :])
    scalar = scipy.sparse.csc_matrix((blocks.ravel(), (row.ravel(), column.ravel())), shape=(n, n))
    return scipy.sparse.csc_matrix(
        scipy.sparse.kron(scalar, np.diag([float("x" in components), float("y" in components)]))
    )


def make_loads(
    problem: Problem,
    mass_of: Callable[[Array], tuple[Array, Index, Index]],
    n: int,
    proportional: bool,
) -> list[Force]:
    """The forces of the conditions and on free bodies, on n rows.

    Args:
        mass_of: the mass matrix of a share (n_el,) of each element, entries, rows and columns.
        proportional: as of `make_system`.
    """
    mesh, loads = problem.mesh, list[Force]()
    for condition in problem.conditions:
        name, where = label(condition), f"{condition.kind()}.on"
        amplitude = condition.amplitude if isinstance(condition, DrivenCondition) else ONE
        amplitude = Proportional() if proportional else amplitude
        match condition:
            case BodyForce():
                inside = np.zeros(len(mesh.elements))
                inside[mesh.region(condition.on, where)] = 1.0
                entries, row, _ = mass_of(inside)
                nodal = np.bincount(row, entries)
                load = np.zeros((n, 2))
                load[: nodal.size] = np.outer(nodal, condition.acceleration)
                loads.append(DeadLoad(name, load, amplitude))
            case Traction():
                sides = mesh.boundary(condition.on, where)
                load = traction_load(mesh.nodes, sides, condition.traction, n)
                loads.append(DeadLoad(name, load, amplitude))
            case Pressure():
                sides = mesh.boundary(condition.on, where)
                both = pressure_load(mesh.nodes, sides, condition.pressure, n)
                loads.append(FollowerPressure(name, *both, amplitude))
            case Foundation():
                sides = mesh.boundary(condition.on, where)
                base = side_mass(mesh.nodes, sides, condition.components, n)
                loads.append(
                    SpringsAndDashpots(name, condition.stiffness * base, condition.damping * base)
                )
    for k, body in enumerate(problem.bodies):
        if body.mass is not None and any(body.acceleration):
            load = np.zeros((n, 2))
            load[len(mesh.nodes) + k] = body.mass * np.array(body.acceleration)
            loads.append(
                DeadLoad(f"{body.name} load", load, Proportional() if proportional else ONE)
            )
    return loads
