"""Finite elements of the clamped bar: mesh, quadrature points, mass and load.

Bilinear quadrilaterals with selective reduced integration. The stress law is asked at five points
of each element, numbered 5 e + q over the mesh:

    q = 0..3   2 × 2 Gauss points: the deviator σ − tr(σ)/2 I
    q = 4      element centre:     the pressure part tr(σ)/2 I

Every array over points has this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.load_case import LoadCase

Array = NDArray[np.float64]
Index = NDArray[np.int64]

N_GAUSS = 4
CENTRE = 4
N_POINTS = 5
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Of the reference square, counter-clockwise."""
_LEFT, _RIGHT = 0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)
_POINTS = np.array([[_LEFT, _LEFT], [_LEFT, _RIGHT], [_RIGHT, _LEFT], [_RIGHT, _RIGHT], [0.5, 0.5]])
_WEIGHTS = np.array([0.25, 0.25, 0.25, 0.25, 1.0])


@dataclass(frozen=True, slots=True)
class GridMass:
    """Consistent mass matrix M of one displacement component on a grid, ng: `along_x` ⊗ `along_y`.

    Bilinear shape functions are products of those of lines, and so is M; its inverse is the
    product of theirs (Lynch, Rice and Thomas 1964, Numer. Math. 6, 185-199). Fields are
    (n_free, …), y running first.
    """

    along_x: Array
    along_y: Array

    @classmethod
    def of(cls, x: Array, y: Array, density: float) -> GridMass:
        """Of the nodes at x, without the first, and y; density in ng/µm²."""
        return cls(density * _line_mass(x)[1:, 1:], _line_mass(y))

    def __matmul__(self, field: Array) -> Array:
        """M applied to a field."""
        return _on_grid(self.along_x, self.along_y, field)

    def inverse(self) -> GridMass:
        """M⁻¹."""
        return GridMass(
            *(np.asarray(np.linalg.inv(m), np.float64) for m in (self.along_x, self.along_y))
        )


def _line_mass(x: Array) -> Array:
    """(n, n) ∫ N_a N_b dx of linear shape functions."""
    mass, third = np.zeros((len(x), len(x))), np.diff(x) / 3.0
    k = np.arange(len(third))
    mass[k, k] += third
    mass[k + 1, k + 1] += third
    mass[k, k + 1] = mass[k + 1, k] = third / 2.0
    return mass


def _on_grid(along_x: Array, along_y: Array, field: Array) -> Array:
    columns = (along_x @ field.reshape(len(along_x), -1)).reshape(len(along_x), len(along_y), -1)
    return (along_y @ columns).reshape(field.shape)


@dataclass(frozen=True, slots=True)
class Discretisation:
    """Everything of the finite elements that never changes; nodes at x = 0 are held.

    Unknowns live on the `n_free` nodes that are not held, in the order of `free`: displacement
    u and velocity v are (n_free, 2).

    Attributes:
        nodes: (n_nodes, 2) reference positions, µm.
        quads: (n_el, 4) nodes of each element, counter-clockwise.
        free: (n_free,) nodes that are not held.
        rows: (n_el, 4) row of each element's node among the unknowns, -1 where it is held.
        gradients: (n_el, 5, 4, 2) ∇N of node a by the reference position, 1/µm.
        weights: (n_el, 5) reference area of each point, µm²: the four Gauss points together
            cover the element once, and so does the centre.
        shape: (5, 4) shape functions at the points.
        mass: (n_free, n_free) consistent mass of one displacement component, ng (eq. 59 with the
            reference density over the reference area, which mass conservation makes constant).
        inverse_mass: mass⁻¹.
        load: (n_free, 2) ∫ ρ N g dV at amplitude 1, µN. Eq. (58) prints ∇N and no ρ.
        watched_rows, watched_weights: (k,) unknowns and shape function values of the watched point.
    """

    nodes: Array
    quads: Index
    free: Index
    rows: Index
    gradients: Array
    weights: Array
    shape: Array
    mass: GridMass
    inverse_mass: GridMass
    load: Array
    watched_rows: Index
    watched_weights: Array

    @property
    def n_points(self) -> int:
        """Points at which the stress law is asked: five an element."""
        return N_POINTS * len(self.quads)

    def on_all_nodes(self, unknowns: Array) -> Array:
        """(n_nodes, 2) from (n_free, 2), zero at the held nodes."""
        values = np.zeros_like(self.nodes)
        values[self.free] = unknowns
        return values

    def at_watched_point(self, unknowns: Array) -> Array:
        """(2,) value of a field of unknowns (n_free, 2) at the watched point."""
        return self.watched_weights @ unknowns[self.watched_rows]

    def point_position(self, point: int) -> Array:
        """(2,) reference position of quadrature point number `point`, µm."""
        element, q = divmod(point, N_POINTS)
        return self.shape[q] @ self.nodes[self.quads[element]]

    def point_near(self, row: int) -> int:
        """First quadrature point of an element at the free node in row `row`."""
        return N_POINTS * int(np.argwhere(self.rows == row)[0, 0])


def make_discretisation(
    load_case: LoadCase, elements: tuple[int, int], density: float
) -> Discretisation:
    """The bar of `load_case` on elements[0] × elements[1] equal rectangles."""
    x = np.linspace(0.0, load_case.width, elements[0] + 1)
    y = np.linspace(0.0, load_case.height, elements[1] + 1)
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(nodes)).reshape(len(x), len(y))
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    free = np.flatnonzero(nodes[:, 0] > 0.0)
    row_of_node = np.full(len(nodes), -1)
    row_of_node[free] = np.arange(free.size)
    gradients, weights, shape = at_points(nodes, quads)
    nodal_area = np.bincount(quads.ravel(), (weights[:, :N_GAUSS] @ shape[:N_GAUSS]).ravel())
    watched_x, watched_y = load_case.watched
    watched = np.outer(_shape_functions(x, watched_x), _shape_functions(y, watched_y)).ravel()[free]
    watched_rows = np.flatnonzero(watched)
    mass = GridMass.of(x, y, density)
    return Discretisation(
        nodes=nodes,
        quads=quads,
        free=free,
        rows=row_of_node[quads],
        gradients=gradients,
        weights=weights,
        shape=shape,
        mass=mass,
        inverse_mass=mass.inverse(),
        load=np.outer(density * nodal_area[free], load_case.body_force),
        watched_rows=watched_rows,
        watched_weights=watched[watched_rows],
    )


def at_points(nodes: Array, quads: Index) -> tuple[Array, Array, Array]:
    """`gradients`, `weights` and `shape` of a `Discretisation` with these elements."""
    # A shape function is the product over x and y of ξ or 1 − ξ, whichever is 1 at its corner.
    factor = 1.0 - abs(_CORNERS - _POINTS[:, None])
    slope = (2.0 * _CORNERS - 1.0) * factor[..., ::-1]
    jacobian = np.einsum("eai,qaj->eqij", nodes[quads], slope)
    gradients = slope @ np.linalg.inv(jacobian)
    weights = np.linalg.det(jacobian) * _WEIGHTS
    return np.ascontiguousarray(gradients), weights, factor.prod(axis=-1)


def _shape_functions(x: Array, at: float) -> Array:
    """(n,) linear shape functions of the nodes x at one place."""
    return np.array([np.interp(at, x, each) for each in np.eye(len(x))])
