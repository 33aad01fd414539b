"""Finite elements of a mesh: shape functions, quadrature points and mass.

The stress law is asked at several points of each element, numbered n_q e + q over the mesh.

    quadrilaterals (4 nodes)   q = 0..3: 2 × 2 Gauss points,   q = 4: the element
    triangles (6 nodes)        q = 0..2: 3 Gauss points

In quadrilaterals, by selective reduced integration, the deviator σ − tr(σ)/2 I counts at the Gauss
points and the pressure part tr(σ)/2 I at the last, which stands for the whole element: the gradient
there is the mean over the element. Triangles with as few points do not lock, and need all of their
stress at each: a pressure that is constant in a triangle lets it bend for nothing. Every array over
points has this order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.macro.mesh import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CENTRE = {4: (0.5, 0.5), 6: (1.0 / 3.0, 1.0 / 3.0)}
"""Of the unit square and the unit triangle, which are the references."""
SIDE_RULE = np.polynomial.legendre.leggauss(3)
"""Points and weights on [-1, 1] along a side."""


class ElementArrays(NamedTuple):
    """The arrays of `Discretisation` that kernels read."""

    elements: Index
    gradients: Array
    weights: Array


@dataclass(frozen=True, slots=True)
class Discretisation:
    """Everything of the finite elements that never changes.

    Attributes:
        nodes: (n_nodes, 2) reference positions, µm.
        elements: (n_el, k) nodes of each element, k = 4 or 6.
        gradients: (n_el, n_q, k, 2) ∇N of node a by the reference position, 1/µm.
        weights: (n_el, n_q) reference area of each point, µm²: the Gauss points together cover
            the element once, and so does the last point of a quadrilateral.
        shape: (n_q, k) shape functions at the points.
    """

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

    def mass(self, density: Array | float) -> tuple[Array, Index, Index]:
        """Entries, rows and columns of the consistent mass of one displacement component, ng.

        Eq. 59 with the reference density over the reference area, which mass conservation makes
        constant. Entries of the same place add up.

        Args:
            density: ng/µm², one or (n_el,).
        """
        points, rule = quadrature(self.elements.shape[1], 4)
        shape, _ = reference_shapes(self.elements.shape[1], points)
        _, area = _mapped(self.nodes, self.elements, points)
        weights = area * rule * np.broadcast_to(density, len(area))[:, None]
        blocks = np.einsum("eq,qa,qb->eab", weights, shape, shape)
        row, column = np.broadcast_arrays(self.elements[:, :, None], self.elements[:, None, :])
        return blocks.ravel(), row.ravel(), column.ravel()

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


def find_element(
    nodes: Array, elements: Index, point: Array, name: str = "point"
) -> tuple[int, Array]:
    """Number of an element that holds a reference position, and (2,) where in its reference.

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


def make_discretisation(mesh: Mesh) -> Discretisation:
    """The finite elements of a mesh, integrated as the head of this file says.

    Raises:
        InputError: an element folds over within.
    """
    k = mesh.elements.shape[1]
    points, rule = quadrature(k, 2)
    gradients, area = _mapped(mesh.nodes, mesh.elements, points)
    worst = int(area.min(axis=1).argmin())
    if not area[worst].min() > 0.0:
        x, y = mesh.nodes[mesh.elements[worst]].mean(axis=0)
        raise InputError(f"mesh: element {worst} at ({x:.6g}, {y:.6g}) µm is inverted within")
    weights = area * rule
    if k == 4:
        whole = weights.sum(axis=1, keepdims=True)
        mean = np.einsum("eq,eqaj->eaj", weights / whole, gradients)[:, None]
        points = np.concatenate([points, np.array(CENTRE[k])[:, None]], axis=1)
        gradients = np.concatenate([gradients, mean], axis=1)
        weights = np.concatenate([weights, whole], axis=1)
    return Discretisation(
        nodes=mesh.nodes,
        elements=mesh.elements,
        gradients=np.ascontiguousarray(gradients),
        weights=np.ascontiguousarray(weights),
        shape=reference_shapes(k, points)[0],
    )


def n_points_of(mesh: Mesh) -> int:
    """Points at which the stress law is asked on a mesh."""
    k = mesh.elements.shape[1]
    return len(mesh.elements) * (quadrature(k, 2)[1].size + (k == 4))


def points_by_region(mesh: Mesh, names: Sequence[str], where: str = "regions") -> dict[str, Index]:
    """Numbers of the points in each of the regions, which together must be the whole mesh.

    Args:
        where: who asks, for the sentence.

    Raises:
        InputError: an element is in none of them or in two, or there is no region of a name.
    """
    claims = np.zeros(len(mesh.elements), dtype=np.int64)
    for name in names:
        claims[mesh.region(name, where)] += 1
    wrong = np.flatnonzero(claims != 1)
    if wrong.size:
        x, y = mesh.nodes[mesh.elements[wrong[0]]].mean(axis=0)
        raise InputError(
            f"{where}: element {wrong[0]} at ({x:.6g}, {y:.6g}) µm is in {claims[wrong[0]]} of "
            f"{', '.join(names)}; every element must be in one"
        )
    n_q = n_points_of(mesh) // len(mesh.elements)
    return {name: (n_q * mesh.region(name)[:, None] + np.arange(n_q)).ravel() for name in names}


def quadrature(k: int, order: int) -> tuple[Array, Array]:
    """Points (2, q) and weights (q,) on the reference, exact to order 2 or 4 (3 and 5 on squares).

    Triangles: Strang and Fix 1973, An Analysis of the Finite Element Method, table 4.1.
    """
    if k == 4:
        x, w = np.polynomial.legendre.leggauss(order // 2 + 1)
        both = np.meshgrid(0.5 + 0.5 * x, 0.5 + 0.5 * x, indexing="ij")
        return np.stack(both).reshape(2, -1), 0.25 * np.outer(w, w).ravel()
    rings = [(1 / 6, 1 / 6)] if order == 2 else [
        (0.445948490915965, 0.111690794839005), (0.091576213509771, 0.054975871827661),
    ]  # fmt: skip
    points = [[a, a] for a, _ in rings], [[1 - 2 * a, a] for a, _ in rings]
    third = [[a, 1 - 2 * a] for a, _ in rings]
    return np.array([*points[0], *points[1], *third]).T, np.array([w for _, w in rings] * 3)


def reference_shapes(k: int, points: Array) -> tuple[Array, Array]:
    """(q, k) shape functions and (q, k, 2) their slopes at points (2, q) of the reference."""
    x, y = points
    zero, one = np.zeros_like(x), np.ones_like(x)
    if k == 4:
        values = [(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y]
        slopes = [(y - 1, x - 1), (1 - y, -x), (y, x), (-y, 1 - x)]
    else:
        z = 1 - x - y
        values = [
            z * (2 * z - 1),
            x * (2 * x - 1),
            y * (2 * y - 1),
            4 * x * z,
            4 * x * y,
            4 * y * z,
        ]
        slopes = [
            (1 - 4 * z, 1 - 4 * z), (4 * x - 1, zero), (zero, 4 * y - 1),
            (4 * (z - x), -4 * x), (4 * y, 4 * x), (-4 * y, 4 * (z - y)),
        ]  # fmt: skip
    both = [np.stack([a * one, b * one], axis=-1) for a, b in slopes]
    return np.stack(values, axis=1), np.stack(both, axis=1)


def side_shapes(k: int) -> tuple[Array, Array]:
    """(3, m) shape functions of a side's m nodes and their slopes at the points of `SIDE_RULE`."""
    s = SIDE_RULE[0]
    if k == 2:
        return np.stack([0.5 * (1 - s), 0.5 * (1 + s)], 1), np.tile([-0.5, 0.5], (3, 1))
    values = np.stack([0.5 * s * (s - 1), 0.5 * s * (s + 1), 1 - s**2], axis=1)
    return values, np.stack([s - 0.5, s + 0.5, -2 * s], axis=1)


def _mapped(nodes: Array, elements: Index, points: Array) -> tuple[Array, Array]:
    """(n_el, q, k, 2) gradients by the reference position, (n_el, q) area of a unit of the map."""
    _, slopes = reference_shapes(elements.shape[1], points)
    jacobian = np.einsum("eai,qaj->eqij", nodes[elements], slopes)
    a, b = jacobian[..., 0, 0], jacobian[..., 0, 1]
    c, d = jacobian[..., 1, 0], jacobian[..., 1, 1]
    area = a * d - b * c
    cofactor = np.stack([np.stack([d, -c], -1), np.stack([-b, a], -1)], -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        gradients = np.einsum("qaj,eqij->eqai", slopes, cofactor) / area[..., None, None]
    return gradients, area


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
