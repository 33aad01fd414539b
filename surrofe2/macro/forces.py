"""Forces on the nodes besides the tissue's own: dead loads, follower pressure, foundations.

They are forms of scikit-fem over facets, whose unknowns are numbered as ours.

A force knows its slopes, which Newton's method needs. Unknown 2 a + i is component i of node a; the
positions of rigid bodies are numbered on after the nodes of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse
import skfem
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine

from surrofe2.problem.amplitude import ONE, Amplitude, Proportional
from surrofe2.problem.conditions import (
    BodyForce,
    DrivenCondition,
    Foundation,
    Pressure,
    Traction,
)
from surrofe2.problem.mesh import boundary, region
from surrofe2.problem.problem import Problem, label

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Matrix = Any
"""Sparse by columns, or dense where it is small."""
SIDES = {2: skfem.ElementLineP1(), 3: skfem.ElementLineP2()}
"""By the number of nodes of a side."""
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
class LinearForce:
    """f = A(t) (f₀ − K u − C v): dead loads, follower pressure, springs and dashpots.

    Attributes:
        dead: (n, 2) f₀, µN. slopes_at_one: K and C (2 n, 2 n), µN/µm and µN µs/µm; None: zero.
    """

    name: str
    dead: Array
    amplitude: Amplitude = ONE
    slopes_at_one: Slopes | None = None

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        force = self.dead
        if self.slopes_at_one is not None:
            K, C = self.slopes_at_one
            force = force - (K @ u.ravel() + C @ v.ravel()).reshape(u.shape)
        return self.amplitude.at(t, within)[0] * force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        if self.slopes_at_one is None:
            return None
        factor, (K, C) = self.amplitude.at(t, within)[0], self.slopes_at_one
        return factor * K, factor * C


def facet_basis(mesh: skfem.Mesh, facets: Index) -> skfem.FacetBasis:
    """Displacements along outer facets."""
    return skfem.FacetBasis(mesh, skfem.ElementVector(mesh.elem()), facets=facets)


def traction_load(mesh: skfem.Mesh, facets: Index, traction: tuple[float, float]) -> Array:
    """(n_nodes, 2) ∫ N_a t dL over reference facets, µN."""
    form = skfem.LinearForm(lambda v, w: traction[0] * v[0] + traction[1] * v[1])
    load: Array = form.assemble(facet_basis(mesh, facets)).reshape(-1, 2)
    return load


def pressure_load(mesh: skfem.Mesh, facets: Index, pressure: float) -> tuple[Array, Matrix]:
    """f₀ (n_nodes, 2) and B (2 n_nodes, 2 n_nodes) of a follower pressure.

    f = −p ∫ v · cof(I + ∇u) n dL: the current normal times length is the cofactor of F times the
    reference normal n times length, and in the plane the cofactor is linear in F.
    """

    def work(u: Any, v: Any, w: Any) -> Any:
        (xx, xy), (yx, yy) = u.grad
        return -pressure * (v[0] * (yy * w.n[0] - yx * w.n[1]) + v[1] * (xx * w.n[1] - xy * w.n[0]))

    basis = facet_basis(mesh, facets)
    dead = skfem.LinearForm(lambda v, w: -pressure * (v[0] * w.n[0] + v[1] * w.n[1]))
    slope = skfem.BilinearForm(work).assemble(basis)
    return dead.assemble(basis).reshape(-1, 2), slope


def foundation_matrix(mesh: skfem.Mesh, facets: Index, components: str) -> Matrix:
    """(2 n_nodes, 2 n_nodes) ∫ N_a N_b dL over reference facets for the components, µm."""
    x, y = float("x" in components), float("y" in components)
    form = skfem.BilinearForm(lambda u, v, w: x * u[0] * v[0] + y * u[1] * v[1])
    return form.assemble(facet_basis(mesh, facets))


def side_points(nodes: Array, sides: Index) -> tuple[Array, Array]:
    """Quadrature along sides: (m, 3) lengths and (3, k) shape functions, as `facet_basis` has it.

    Args:
        nodes: (n, 2) reference positions, µm.
        sides: (m, k) nodes of each side.
    """
    k = sides.shape[1]
    points, weights = get_quadrature(RefLine, 4)
    found = [SIDES[k].lbasis(points, a) for a in range(k)]
    shape, slopes = (np.stack([np.ravel(each[part]) for each in found], axis=1) for part in (0, 1))
    along = np.einsum("qa,mai->mqi", np.broadcast_to(slopes, shape.shape), nodes[sides])
    return np.linalg.norm(along, axis=2) * weights, shape


def make_loads(
    problem: Problem,
    mass_of: Callable[[Array], Matrix],
    n: int,
    proportional: bool,
) -> list[Force]:
    """The forces of the conditions and on free bodies, on n rows.

    Args:
        mass_of: the mass (2 n_nodes, 2 n_nodes) of a share (n_el,) of each element.
        proportional: as of `make_system`.
    """
    mesh, loads = problem.mesh, list[Force]()
    n_nodes = mesh.p.shape[1]

    def rows(load: Array) -> Array:
        """(n, 2), zero for bodies."""
        return np.pad(load, ((0, n - n_nodes), (0, 0)))

    def square(matrix: Matrix) -> Matrix:
        """(2 n, 2 n), zero for bodies."""
        grown = scipy.sparse.csc_matrix(matrix)
        grown.resize(2 * n, 2 * n)
        return grown

    for condition in problem.conditions:
        name, where = label(condition), f"{condition.kind()}.on"
        amplitude = condition.amplitude if isinstance(condition, DrivenCondition) else ONE
        amplitude = Proportional() if proportional else amplitude
        match condition:
            case BodyForce():
                inside = np.zeros(mesh.nelements)
                inside[region(mesh, condition.on, where)] = 1.0
                pulled = np.tile(condition.acceleration, n_nodes)
                load = (mass_of(inside) @ pulled).reshape(-1, 2)
                loads.append(LinearForce(name, rows(load), amplitude))
            case Traction():
                load = traction_load(mesh, boundary(mesh, condition.on, where), condition.traction)
                loads.append(LinearForce(name, rows(load), amplitude))
            case Pressure():
                facets = boundary(mesh, condition.on, where)
                unloaded, slope = pressure_load(mesh, facets, condition.pressure)
                slopes = -square(slope), 0.0 * square(slope)
                loads.append(LinearForce(name, rows(unloaded), amplitude, slopes))
            case Foundation():
                facets = boundary(mesh, condition.on, where)
                base = square(foundation_matrix(mesh, facets, condition.components))
                slopes = condition.stiffness * base, condition.damping * base
                loads.append(LinearForce(name, np.zeros((n, 2)), ONE, slopes))
    for k, body in enumerate(problem.bodies):
        if body.mass is not None and any(body.acceleration):
            load = np.zeros((n, 2))
            load[n_nodes + k] = body.mass * np.array(body.acceleration)
            amplitude = Proportional() if proportional else ONE
            loads.append(LinearForce(f"{body.name} load", load, amplitude))
    return loads
