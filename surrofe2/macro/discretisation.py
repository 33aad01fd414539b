"""Finite elements of the clamped bar: mesh, quadrature points, mass and load.

Bilinear quadrilaterals with selective reduced integration. The stress law is asked at five points
of each element, numbered 5 e + q over the mesh:

    q = 0..3   2 × 2 Gauss points: the deviator σ − tr(σ)/2 I
    q = 4      element centre:     the pressure part tr(σ)/2 I

Every array over points has this order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad

from surrofe2.load_case import LoadCase

Array = NDArray[np.float64]
Index = NDArray[np.int64]

N_GAUSS = 4
CENTRE = 4
N_POINTS = 5


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
        solve_mass: mass⁻¹ applied to (n_free, 2), factorised once.
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
    mass: csc_matrix
    solve_mass: Callable[[Array], Array]
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
    return make_discretisation_on(make_mesh(load_case, elements), load_case, density)


def make_mesh(load_case: LoadCase, elements: tuple[int, int]) -> skfem.MeshQuad:
    """elements[0] × elements[1] equal rectangles."""
    mesh = skfem.MeshQuad.init_tensor(
        np.linspace(0.0, load_case.width, elements[0] + 1),
        np.linspace(0.0, load_case.height, elements[1] + 1),
    )
    clockwise_to_counter = [0, 3, 2, 1]
    return skfem.MeshQuad(mesh.p, mesh.t[clockwise_to_counter])


def make_discretisation_on(
    mesh: skfem.MeshQuad, load_case: LoadCase, density: float
) -> Discretisation:
    """The bar of `load_case` on any mesh of quadrilaterals that covers it."""
    basis = skfem.Basis(mesh, skfem.ElementQuad1())
    nodes = np.ascontiguousarray(mesh.p.T)
    quads = np.ascontiguousarray(basis.element_dofs.T, dtype=np.int64)
    free = np.flatnonzero(nodes[:, 0] > 0.0)
    row_of_node = np.full(len(nodes), -1)
    row_of_node[free] = np.arange(free.size)

    gauss_points, gauss_weights = get_quadrature(RefQuad, 3)
    at_points = skfem.Basis(
        mesh,
        skfem.ElementQuad1(),
        quadrature=(
            np.concatenate([gauss_points, [[0.5], [0.5]]], axis=1),
            np.append(gauss_weights, 1.0),
        ),
    )
    gradients = np.stack([at_points.basis[a][0].grad for a in range(4)])

    mass = density * skfem.BilinearForm(lambda u, v, w: u * v).assemble(basis)
    mass = csc_matrix(mass[free][:, free])
    nodal_mass = density * skfem.LinearForm(lambda v, w: 1.0 * v).assemble(basis)
    watched = _shape_functions_at(np.array(load_case.watched), basis, nodes)[free]
    watched_rows = np.flatnonzero(watched)
    return Discretisation(
        nodes=nodes,
        quads=quads,
        free=free,
        rows=row_of_node[quads],
        gradients=np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)),
        weights=np.ascontiguousarray(at_points.dx),
        shape=np.stack([np.asarray(at_points.basis[a][0])[0] for a in range(4)], axis=1),
        mass=mass,
        solve_mass=_factorise(mass),
        load=np.outer(nodal_mass[free], load_case.body_force),
        watched_rows=watched_rows,
        watched_weights=watched[watched_rows],
    )


def _shape_functions_at(point: Array, basis: skfem.Basis, nodes: Array) -> Array:
    """(n_nodes,) shape functions at a point; at a node without a search, which is slow to load."""
    at = (nodes == point).all(axis=1)
    if at.any():
        return at.astype(np.float64)
    values: Array = basis.probes(point[:, None]).toarray()[0]
    return values


def _factorise(mass: csc_matrix) -> Callable[[Array], Array]:
    """Symmetric positive definite, so no pivoting and an ordering that keeps symmetry."""
    factor = splu(
        mass,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    solve: Callable[[Array], Array] = factor.solve
    return solve
