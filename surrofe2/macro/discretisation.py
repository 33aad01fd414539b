"""Interpolation and quadrature of a mesh, from bases of scikit-fem, as arrays that kernels read.

The stress law is asked at several points of each element, numbered n_q e + q over the mesh.

    quadrilaterals (4 nodes)   q = 0..3: 2 × 2 Gauss points,   q = 4: the element
    triangles (6 nodes)        q = 0..2: 3 Gauss points

Quadrilaterals are integrated selectively by two bases on one mesh: the deviator σ − tr(σ)/2 I
counts at the Gauss points of the one, the pressure part tr(σ)/2 I at the single point of the other.
That point stands for the whole element: its gradient is the mean over the element, weighted with
the Gauss points' areas, and its weight their sum. This is the L² projection of the gradient to
constants, which passes the patch test on elements that are no parallelograms, where the gradient at
the centre does not. Triangles with as few points do not lock, and need all of their stress at each:
a pressure that is constant in a triangle lets it bend for nothing. Every array over points has this
order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.problem.mesh import element_nodes, region

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ELEMENTS = {4: skfem.ElementQuad1(), 6: skfem.ElementTriP2()}
"""By the number of nodes."""
CENTRE = {4: (0.5, 0.5), 6: (1.0 / 3.0, 1.0 / 3.0)}
"""Of the unit square and the unit triangle, which are the references."""
ORDER = {4: 3, 6: 2}
"""Of the polynomials that the points at which the stress law is asked integrate exactly."""


class ElementArrays(NamedTuple):
    """The arrays of `Discretisation` that kernels read."""

    elements: Index
    gradients: Array
    weights: Array


@dataclass(frozen=True, slots=True)
class Discretisation:
    """Everything of the finite elements that never changes.

    Attributes:
        mesh: of scikit-fem.
        nodes: (n_nodes, 2) reference positions, µm.
        elements: (n_el, k) nodes of each element, k = 4 or 6.
        gradients: (n_el, n_q, k, 2) ∇N of node a by the reference position, 1/µm.
        weights: (n_el, n_q) reference area of each point, µm²: the Gauss points together cover
            the element once, and so does the last point of a quadrilateral.
        shape: (n_q, k) shape functions at the points.
    """

    mesh: skfem.Mesh
    nodes: Array
    elements: Index
    gradients: Array
    weights: Array
    shape: Array

    @property
    def arrays(self) -> ElementArrays:
        """What kernels read."""
        return ElementArrays(self.elements, self.gradients, self.weights)

    @property
    def points_per_element(self) -> int:
        """n_q."""
        return int(self.weights.shape[1])

    @property
    def pressure_apart(self) -> bool:
        """Whether the last point of an element carries the pressure, the others the deviator."""
        return self.elements.shape[1] == 4

    @property
    def n_points(self) -> int:
        """Points at which the stress law is asked."""
        return int(self.weights.size)

    @property
    def areas(self) -> Array:
        """(n_el,) reference areas, µm²."""
        if self.pressure_apart:
            return self.weights[:, -1]
        whole: Array = self.weights.sum(axis=1)
        return whole

    def point_position(self, point: int) -> Array:
        """(2,) reference position of quadrature point number `point`, µm."""
        element, q = divmod(point, self.points_per_element)
        return self.shape[q] @ self.nodes[self.elements[element]]

    def point_positions(self) -> Array:
        """(n_points, 2) reference positions of all points, µm."""
        return self.at_points(self.nodes)

    def at_points(self, values: Array) -> Array:
        """(n_points, 2) at all points of what nodes have, (n_nodes, 2)."""
        return np.einsum("qa,eai->eqi", self.shape, values[self.elements]).reshape(-1, 2)

    def point_near(self, node: int) -> int:
        """First quadrature point of an element at the node."""
        return self.points_per_element * int(np.argwhere(self.elements == node)[0, 0])

    def locate(self, point: Array, name: str = "point") -> tuple[Index, Array]:
        """Nodes and shape functions at a reference position, so that values there are N_a u_a.

        Raises:
            InputError: it is outside the mesh.
        """
        at = np.flatnonzero((self.nodes == point).all(axis=1))
        if at.size:
            return at[:1], np.ones(1)
        e, local = find_element(self.nodes, self.elements, point, name)
        shape, _ = reference_shapes(self.elements.shape[1], local[:, None])
        return self.elements[e], shape[0]


def make_discretisation(mesh: skfem.Mesh) -> Discretisation:
    """The finite elements of a mesh, integrated as the head of this file says.

    Raises:
        InputError: an element folds over within.
    """
    elements = element_nodes(mesh)
    k = elements.shape[1]
    basis = skfem.Basis(mesh, mesh.elem(), intorder=ORDER[k])
    area = basis.mapping.detDF(basis.X)
    area = area * np.sign(area.sum(axis=1, keepdims=True))
    worst = int(area.min(axis=1).argmin())
    if not area[worst].min() > 0.0:
        x, y = mesh.p[:, elements[worst]].mean(axis=1)
        raise InputError(f"mesh: element {worst} at ({x:.6g}, {y:.6g}) µm is inverted within")
    gradients = np.stack([each[0].grad for each in basis.basis]).transpose(2, 3, 0, 1)
    weights, points = basis.dx, basis.X
    if k == 4:
        whole = weights.sum(axis=1, keepdims=True)
        mean = np.einsum("eq,eqaj->eaj", weights / whole, gradients)[:, None]
        points = np.concatenate([points, np.array(CENTRE[k])[:, None]], axis=1)
        gradients = np.concatenate([gradients, mean], axis=1)
        weights = np.concatenate([weights, whole], axis=1)
    return Discretisation(
        mesh=mesh,
        nodes=np.ascontiguousarray(mesh.p.T),
        elements=elements,
        gradients=np.ascontiguousarray(gradients),
        weights=np.ascontiguousarray(weights),
        shape=reference_shapes(k, points)[0],
    )


def displacement_basis(mesh: skfem.Mesh) -> skfem.Basis:
    """scikit-fem's basis of a displacement: unknown 2 a + i is component i of node a."""
    return skfem.Basis(mesh, skfem.ElementVector(mesh.elem()))


def n_points_of(mesh: skfem.Mesh) -> int:
    """Points at which the stress law is asked on a mesh."""
    return int(mesh.nelements) * (5 if isinstance(mesh, skfem.MeshQuad1) else 3)


def points_by_region(
    mesh: skfem.Mesh, names: Sequence[str], where: str = "regions"
) -> dict[str, Index]:
    """Numbers of the points in each of the regions, which together must be the whole mesh.

    Args:
        where: who asks, for the sentence.

    Raises:
        InputError: an element is in none of them or in two, or there is no region of a name.
    """
    claims = np.zeros(mesh.nelements, dtype=np.int64)
    for name in names:
        claims[region(mesh, name, where)] += 1
    wrong = np.flatnonzero(claims != 1)
    if wrong.size:
        x, y = mesh.p[:, element_nodes(mesh)[wrong[0]]].mean(axis=1)
        raise InputError(
            f"{where}: element {wrong[0]} at ({x:.6g}, {y:.6g}) µm is in {claims[wrong[0]]} of "
            f"{', '.join(names)}; every element must be in one"
        )
    n_q = n_points_of(mesh) // mesh.nelements
    return {name: (n_q * region(mesh, name)[:, None] + np.arange(n_q)).ravel() for name in names}


def find_element(
    nodes: Array, elements: Index, point: Array, name: str = "point"
) -> tuple[int, Array]:
    """Number of an element that holds a reference position, and (2,) where in its reference.

    scikit-fem's own search knows no triangles with curved sides.

    Raises:
        InputError: the position is outside the mesh.
    """
    corners, k = nodes[elements], elements.shape[1]
    size = np.ptp(corners, axis=1)
    low, high = corners.min(axis=1) - 0.1 * size, corners.max(axis=1) + 0.1 * size
    for e in np.flatnonzero(((low <= point) & (point <= high)).all(axis=1)):
        local = _local_position(corners[e], point)
        outside = max(-local.min(), (local.max() if k == 4 else local.sum()) - 1.0)
        if outside <= 1e-9:
            return int(e), local
    raise InputError(f"{name}: ({point[0]:.6g}, {point[1]:.6g}) µm; it must lie within the mesh")


def reference_shapes(k: int, points: Array) -> tuple[Array, Array]:
    """(q, k) shape functions and (q, k, 2) their slopes at points (2, q) of the reference."""
    found = [ELEMENTS[k].lbasis(points, a) for a in range(k)]
    values = [np.broadcast_to(value, points.shape[1]) for value, _ in found]
    slopes = [np.broadcast_to(slope, points.shape) for _, slope in found]
    return np.stack(values, axis=1), np.stack(slopes).transpose(2, 0, 1)


def _local_position(corners: Array, point: Array) -> Array:
    """(2,) reference coordinates of a point of an element, by Newton's method."""
    k = len(corners)
    local = np.array(CENTRE[k])
    for _ in range(20):
        shape, slopes = reference_shapes(k, local[:, None])
        step = np.linalg.solve(corners.T @ slopes[0], shape[0] @ corners - point)
        local = local - step
        if abs(step).max() < 1e-14:
            break
    return local
