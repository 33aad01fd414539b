"""Finite elements: quadrature from bases of scikit-fem, F from displacement, forces from stress.

The stress law is asked at several points of each element, numbered n_q e + q over the mesh.

    quadrilaterals (4 nodes)   q = 0..3: 2 × 2 Gauss points,   q = 4: the element
    triangles (6 nodes)        q = 0..2: 3 Gauss points

Quadrilaterals are integrated selectively: the deviator σ − tr(σ)/2 I counts at the Gauss points,
the pressure part tr(σ)/2 I at a single point that stands for the whole element. Its gradient is the
mean over the element, weighted with the Gauss points' areas, and its weight their sum. This is the
L² projection of the gradient to constants, which passes the patch test on elements that are no
parallelograms, where the gradient at the centre does not. Triangles with as few points do not lock,
and need all of their stress at each: a pressure that is constant in a triangle lets it bend for
nothing.

Whatever depends linearly on displacement at some points, u ↦ S u by a sparse matrix S, has forces
Sᵀ t and slopes Sᵀ B S; F and the internal force, which runs need most often, are compiled loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import skfem

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel
from surrofe2.base.errors import InputError
from surrofe2.base.tensors import cofactor, det
from surrofe2.problem.mesh import CLOSED, DIGITS, element_nodes, region, region_numbers

Matrix = Any  # of scipy.sparse, which has no types

# The elements by their number of nodes.
ELEMENTS = {4: skfem.ElementQuad1(), 6: skfem.ElementTriP2()}
# The centre of each reference element, the unit square or the unit triangle.
CENTRE = {4: (0.5, 0.5), 6: (1.0 / 3.0, 1.0 / 3.0)}
# The degree of polynomials that the points of the stress law integrate exactly.
ORDER = {4: 3, 6: 2}

# `find_element`: an element is searched where the position lies in its box, widened by this
# fraction, since sides of six-node triangles may bulge beyond their nodes.
_BULGE = 0.1
# Reference coordinates within which a point on a side is still inside, at least.
_INSIDE = 1e-9
# Newton's method for reference coordinates: it ends at a step of this size, or after so many.
_LOCAL_STEP = 1e-14
_LOCAL_ITERATIONS = 20


class Discretisation(NamedTuple):
    """Arrays of the finite elements that never change; kernels take it as it is.

    Attributes:
        nodes: (n_nodes, 2) reference positions, µm.
        elements: (n_el, k) nodes of each element, k = 4 or 6.
        gradients: (n_el, n_q, k, 2) ∇N of node a by the reference position, 1/µm.
        weights: (n_el, n_q) reference area of each point, µm²: the Gauss points together cover the
            element once, and so does the last point of a quadrilateral.
        shape: (n_q, k) shape functions at the points."""

    nodes: Array
    elements: Index
    gradients: Array
    weights: Array
    shape: Array

    @property
    def points_per_element(self) -> int:
        """n_q, the number of points of an element at which the stress law is called."""
        return int(self.weights.shape[1])

    @property
    def pressure_apart(self) -> bool:
        """True if the last point of an element carries the pressure, the others the deviator."""
        return self.elements.shape[1] == 4

    @property
    def n_points(self) -> int:
        """The number of points at which the stress law is called."""
        return int(self.weights.size)

    @property
    def areas(self) -> Array:
        """Reference areas of the elements, (n_el,), µm²."""
        if self.pressure_apart:
            return np.asarray(self.weights[:, -1])  # the last point stands for the whole element
        return np.asarray(self.weights.sum(axis=1))

    def at_points(self, values: Array) -> Array:
        """Interpolate values of the nodes (n_nodes, 2) to all points, (n_points, 2)."""
        return np.einsum("qa,eai->eqi", self.shape, values[self.elements]).reshape(-1, 2)

    def point_positions(self) -> Array:
        """Return (n_points, 2), the reference positions of all points, µm."""
        return self.at_points(self.nodes)

    def point_near(self, node: int) -> int:
        """Return the number of the first quadrature point of an element at the node."""
        return self.points_per_element * int(np.argwhere(self.elements == node)[0, 0])

    def locate(self, point: Array, name: str = "point") -> tuple[Index, Array]:
        """Find a reference position in the mesh.

        Returns:
            Nodes (k,) and shape functions (k,), by which values at the position are N_a u_a.

        Raises:
            InputError: it is outside the mesh.
        """
        # A file of single precision has a node beside the place that its author means.
        distance = np.linalg.norm(self.nodes - point, axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] <= DIGITS * abs(self.nodes).max():
            return np.array([nearest]), np.ones(1)
        e, local = find_element(self.nodes, self.elements, point, name)
        shape, _ = reference_shapes(self.elements.shape[1], local[:, None])
        return self.elements[e], shape[0]


def make_discretisation(mesh: skfem.Mesh) -> Discretisation:
    """Make the finite elements of a mesh, integrated as the head of this file describes.

    Raises:
        InputError: an element is folded over within.
    """
    elements = element_nodes(mesh)
    k = elements.shape[1]
    basis = skfem.Basis(mesh, mesh.elem(), intorder=ORDER[k])
    area = basis.mapping.detDF(basis.X)
    # an element whose nodes go round clockwise is right; one with both signs is not
    area = area * np.sign(area.sum(axis=1, keepdims=True))
    worst = int(area.min(axis=1).argmin())
    if not area[worst].min() > 0.0:
        x, y = mesh.p[:, elements[worst]].mean(axis=1)
        raise InputError(f"mesh: element {worst} at ({x:.6g}, {y:.6g}) µm is inverted within")
    gradients = np.stack([field.grad for (field,) in basis.basis]).transpose(2, 3, 0, 1)
    weights = basis.dx
    points = basis.X
    if k == 4:
        # the point of the pressure, behind the Gauss points: mean gradient and whole area
        whole = weights.sum(axis=1, keepdims=True)
        mean = np.einsum("eq,eqaj->eaj", weights / whole, gradients)[:, None]
        points = np.concatenate([points, np.array(CENTRE[k])[:, None]], axis=1)
        gradients = np.concatenate([gradients, mean], axis=1)
        weights = np.concatenate([weights, whole], axis=1)
    return Discretisation(
        nodes=np.ascontiguousarray(mesh.p.T),
        elements=elements,
        gradients=np.ascontiguousarray(gradients),
        weights=np.ascontiguousarray(weights),
        shape=reference_shapes(k, points)[0],
    )


def displacement_basis(mesh: skfem.Mesh) -> skfem.Basis:
    """Make scikit-fem's basis of a displacement: unknown 2 a + i is component i of node a."""
    return skfem.Basis(mesh, skfem.ElementVector(mesh.elem()))


def n_points_of(mesh: skfem.Mesh) -> int:
    """Return the number of points at which the stress law is called on a mesh."""
    per_element = 5 if isinstance(mesh, skfem.MeshQuad1) else 3
    return int(mesh.nelements) * per_element


def points_by_region(
    mesh: skfem.Mesh, names: Sequence[str], where: str = "regions"
) -> dict[str, Index]:
    """Return the numbers of the points in each of the regions, which together must be the whole
    mesh.

    Args:
        names: names of the regions.
        where: name of the entry, for messages.

    Raises:
        InputError: an element is in none of them or in two, or there is no region of a name.
    """
    regions = {name: region(mesh, name, where) for name in names}
    region_numbers(mesh, regions, where, np.arange(mesh.nelements))
    n_q = n_points_of(mesh) // mesh.nelements
    offsets = np.arange(n_q)
    points = {}
    for name, elements in regions.items():
        points[name] = (n_q * elements[:, None] + offsets).ravel()
    return points


def find_element(
    nodes: Array, elements: Index, point: Array, name: str = "point"
) -> tuple[int, Array]:
    """Find an element that holds a reference position.

    scikit-fem's own search knows no triangles with curved sides.

    Returns:
        Number of the element, and (2,) the position in its reference.

    Raises:
        InputError: the position is outside the mesh.
    """
    corners = nodes[elements]
    k = elements.shape[1]
    size = np.ptp(corners, axis=1)
    low = corners.min(axis=1) - _BULGE * size
    high = corners.max(axis=1) + _BULGE * size
    # positions have the digits of the largest coordinate
    rounding = DIGITS * abs(nodes).max()
    for e in np.flatnonzero(((low <= point) & (point <= high)).all(axis=1)):
        local = _local_position(corners[e], point)
        # the square is x, y ≤ 1, the triangle x + y ≤ 1; both are x, y ≥ 0
        beyond = (local.max() if k == 4 else local.sum()) - 1.0
        outside = max(-local.min(), beyond)
        if outside <= min(max(_INSIDE, rounding / size[e].min()), CLOSED):
            return int(e), local
    low = nodes.min(axis=0)
    high = nodes.max(axis=0)
    raise InputError(
        f"{name}: ({point[0]:.6g}, {point[1]:.6g}) µm; it must lie within the mesh, which reaches "
        f"from ({low[0]:.6g}, {low[1]:.6g}) to ({high[0]:.6g}, {high[1]:.6g}) µm"
    )


def reference_shapes(k: int, points: Array) -> tuple[Array, Array]:
    """Return (q, k) shape functions and (q, k, 2) their slopes at points (2, q) of the
    reference.
    """
    functions = [ELEMENTS[k].lbasis(points, a) for a in range(k)]
    values = [np.broadcast_to(value, points.shape[1]) for value, _ in functions]
    slopes = [np.broadcast_to(slope, points.shape) for _, slope in functions]
    return np.stack(values, axis=1), np.stack(slopes).transpose(2, 0, 1)


def _local_position(corners: Array, point: Array) -> Array:
    """Compute the reference coordinates (2,) of a point of an element, by Newton's method."""
    k = len(corners)
    local = np.array(CENTRE[k])
    for _ in range(_LOCAL_ITERATIONS):
        shape, slopes = reference_shapes(k, local[:, None])
        step = np.linalg.solve(corners.T @ slopes[0], shape[0] @ corners - point)
        local = local - step
        if abs(step).max() < _LOCAL_STEP:
            break
    return local


def counted(space: Discretisation, stress: Array) -> Array:
    """Return (n_el, n_q, 2, 2), the part of a stress (n_points, 2, 2) that counts at each point.

    In triangles it is all of it; in quadrilaterals the pressure part at the last point, else the
    deviator.
    """
    stress = stress.reshape(*space.weights.shape, 2, 2)
    if not space.pressure_apart:
        return stress
    part = 0.5 * np.einsum("eqii->eq", stress)[:, :, None, None] * np.eye(2)
    part[:, :-1] = stress[:, :-1] - part[:, :-1]
    return part


def element_mean_stress(space: Discretisation, F: Array, stress: Array) -> Array:
    """Compute (n_el, 2, 2), the mean of the Cauchy stress in each element by current area.

    In quadrilaterals it is that of the deviator over the Gauss points, and the pressure part of the
    last point.
    """
    gauss = slice(0, -1) if space.pressure_apart else slice(None)
    area = (det(F).reshape(space.weights.shape) * space.weights)[:, gauss]
    part = counted(space, stress)
    mean: Array = np.einsum("eq,eqij->eij", area, part[:, gauss])
    mean /= area.sum(axis=1)[:, None, None]
    return mean + part[:, -1] if space.pressure_apart else mean


def element_mean_F(space: Discretisation, F: Array) -> Array:
    """Compute (n_el, 2, 2), the mean of F (n_points, 2, 2) over each element."""
    F = F.reshape(*space.weights.shape, 2, 2)
    if space.pressure_apart:
        return F[:, -1]
    mean: Array = np.einsum("eq,eqij->eij", space.weights, F)
    return mean / space.areas[:, None, None]


def stress_power(space: Discretisation, F: Array, F_dot: Array, stress: Array) -> Array:
    """Compute (n_el,), the power of a stress in each element, pJ/µs.

    Together they are internal force times velocity.
    """
    first_piola = counted(space, stress).reshape(F.shape) @ cofactor(F)
    power = np.einsum("nij,nij->n", first_piola, F_dot).reshape(space.weights.shape)
    whole: Array = (power * space.weights).sum(axis=1)
    return whole


def point_tangents(space: Discretisation, F: Array, P: Array, slope: Array) -> Array:
    """Compute w ∂T_ij/∂F_kl as (n_points, 4, 4), rows (j, i), columns (l, k): B of
    `gradient_matrix`.

    T is the first Piola stress of a point or, in quadrilaterals, the part of it that counts there.

    Args:
        P, slope: (n_points, 2, 2) stress, (n_points, 2, 2, 2, 2) ∂P/∂F; or 0 and ∂P/∂Ḟ.
    """
    if space.pressure_apart:
        slope = _effective_slope(F, P, slope, space.points_per_element)
    weighted = space.weights.reshape(-1, 1, 1, 1, 1) * slope
    blocks: Array = weighted.transpose(0, 2, 1, 4, 3).reshape(-1, 4, 4)
    return blocks


def gradient_matrix(space: Discretisation, n_rows: int) -> Matrix:
    """Make the sparse matrix (4 n_points, 2 n_rows) from displacement to ∂u_i/∂X_j, entry
    (point, j, i).
    """
    slopes = space.gradients.transpose(0, 1, 3, 2).reshape(2 * space.n_points, -1)
    columns = np.repeat(space.elements, 2 * space.points_per_element, axis=0)
    return for_components(sparse_rows(columns, slopes, n_rows))


def sparse_rows(columns: Index, values: Array, size: int) -> Matrix:
    """Make a sparse matrix (p, size) with values (p, k) in the columns (p, k) of each row."""
    p, k = values.shape
    parts = values.ravel(), columns.ravel(), k * np.arange(p + 1)
    return scipy.sparse.csr_matrix(parts, shape=(p, size))


def for_components(matrix: Matrix) -> Matrix:
    """Make the matrix that maps both components as the given one maps one.

    Entry 2 a + i is component i of row a.
    """
    return scipy.sparse.kron(matrix, np.eye(2), "csr")


def with_transpose(S: Matrix) -> tuple[Matrix, Matrix]:
    """Return S and Sᵀ, both by rows."""
    return S.tocsr(), S.T.tocsr()


def summed(S_and_transpose: tuple[Matrix, Matrix], blocks: Array) -> Matrix:
    """Compute Sᵀ B S, sparse by columns, with the blocks B (p, m, m) on a diagonal."""
    S, S_T = S_and_transpose
    p = np.arange(len(blocks) + 1)
    transposed = np.ascontiguousarray(blocks.transpose(0, 2, 1))
    # (Sᵀ Bᵀ S) by rows, transposed, is Sᵀ B S by columns, without a conversion.
    return (S_T @ (scipy.sparse.bsr_matrix((transposed, p[:-1], p)).tocsr() @ S)).T


def _effective_slope(F: Array, P: Array, slope: Array, points_per_element: int) -> Array:
    """Compute ∂T/∂F (n_points, 2, 2, 2, 2), T the part of P that a point of a quadrilateral
    contributes.

    The force is Σ w T ∇N with T = J dev(σ) F⁻ᵀ at Gauss points and J tr(σ)/2 F⁻ᵀ at the last.
    As J tr σ = P : F, the pressure part is T_c = ½ (P : F) F⁻ᵀ, the deviator's P − T_c, and

        ∂T_c,ij/∂F_kl = ½ (P_kl + F_mn ∂P_mn/∂F_kl) F⁻ᵀ_ij − ½ (P : F) F⁻ᵀ_il F⁻ᵀ_kj
        ∂T_c,ij/∂Ḟ_kl = ½ F_mn ∂P_mn/∂Ḟ_kl F⁻ᵀ_ij
    """
    inverse_T = np.asarray(np.linalg.inv(F), dtype=np.float64).transpose(0, 2, 1)
    of_work = P + np.einsum("nij,nijkl->nkl", F, slope)
    parts = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, of_work)
    work = np.einsum("nij,nij->n", P, F)
    parts -= 0.5 * np.einsum("n,nil,nkj->nijkl", work, inverse_T, inverse_T)
    gauss = np.arange(len(F)) % points_per_element < points_per_element - 1
    parts[gauss] = slope[gauss] - parts[gauss]
    return parts


@kernel
def deformation_gradient(space: Any, u: Any, v: Any) -> tuple[Array, Array, Array]:
    """Compute F = I + Σ_a u_a ⊗ ∇N_a, Ḟ = Σ_a v_a ⊗ ∇N_a (n_points, 2, 2) and det F (n_points,).

    Args:
        space: `Discretisation`.
        u, v: (n, 2) displacement and velocity; n may be more than the nodes, by rigid bodies.
    """
    elements = space.elements
    gradients = space.gradients
    n_q = gradients.shape[1]
    k = gradients.shape[2]
    count = n_q * elements.shape[0]
    F = np.empty((count, 2, 2))
    F_dot = np.empty((count, 2, 2))
    J = np.empty(count)
    nodal = np.empty((k, 4))  # u_x, u_y, v_x, v_y of the element's nodes
    for e in range(elements.shape[0]):
        for a in range(k):
            row = np.uint64(elements[e, a])  # numba tests signed indices for counting from the end
            nodal[a, 0] = u[row, 0]
            nodal[a, 1] = u[row, 1]
            nodal[a, 2] = v[row, 0]
            nodal[a, 3] = v[row, 1]
        for q in range(n_q):
            p = np.uint64(n_q * e + q)
            xx = 0.0
            xy = 0.0
            yx = 0.0
            yy = 0.0
            vxx = 0.0
            vxy = 0.0
            vyx = 0.0
            vyy = 0.0
            for a in range(k):
                gx = gradients[e, q, a, 0]
                gy = gradients[e, q, a, 1]
                xx += nodal[a, 0] * gx
                xy += nodal[a, 0] * gy
                yx += nodal[a, 1] * gx
                yy += nodal[a, 1] * gy
                vxx += nodal[a, 2] * gx
                vxy += nodal[a, 2] * gy
                vyx += nodal[a, 3] * gx
                vyy += nodal[a, 3] * gy
            xx = xx + 1.0
            yy = yy + 1.0
            F[p, 0, 0] = xx
            F[p, 0, 1] = xy
            F[p, 1, 0] = yx
            F[p, 1, 1] = yy
            F_dot[p, 0, 0] = vxx
            F_dot[p, 0, 1] = vxy
            F_dot[p, 1, 0] = vyx
            F_dot[p, 1, 1] = vyy
            J[p] = xx * yy - xy * yx
    return F, F_dot, J


@kernel
def internal_force(space: Any, F: Any, stress: Any, n: Any = None) -> Array:
    """Compute the internal force (n, 2) in µN: the stress integral of (58).

        f_a = ∫ dev σ ∇ₓN_a dv + ∫ tr(σ)/2 ∇ₓN_a dv,   ∇ₓN = F⁻ᵀ ∇N,   dv = det F dV,

    the first integral over the Gauss points, the second at the last point of a quadrilateral, each
    with gradient and volume at its own points (section 6.2); of a triangle both over the Gauss
    points. Positions follow from the total displacement, so this is the updated Lagrangian form
    without increments. The stress may be unsymmetric. det F F⁻ᵀ is the cofactor of F, so nothing is
    divided.

    It enters (58) as M a = load − f; (58) is printed with both signs reversed.

    Args:
        space: `Discretisation`.
        F, stress: (n_points, 2, 2).
        n: rows of the result, by default the nodes; further rows are 0.
    """
    total = np.zeros((space.nodes.shape[0] if n is None else n, 2))
    elements = space.elements
    gradients = space.gradients
    weights = space.weights
    n_q = gradients.shape[1]
    k = gradients.shape[2]
    forces = np.zeros((k, 2))
    for e in range(elements.shape[0]):
        forces[:] = 0.0
        for q in range(n_q):
            p = np.uint64(n_q * e + q)
            s00 = stress[p, 0, 0]
            s01 = stress[p, 0, 1]
            s10 = stress[p, 1, 0]
            s11 = stress[p, 1, 1]
            if k == 4:  # the part of the stress that counts at this point, as of `counted`
                pressure = 0.5 * (s00 + s11)
                if q < n_q - 1:
                    s00 = s00 - pressure
                    s11 = s11 - pressure
                else:
                    s00 = pressure
                    s11 = pressure
                    s01 = 0.0
                    s10 = 0.0
            w = weights[e, q]
            c00 = F[p, 1, 1]  # cof F, then w P = w σ cof F
            c01 = -F[p, 1, 0]
            c10 = -F[p, 0, 1]
            c11 = F[p, 0, 0]
            p00 = w * (s00 * c00 + s01 * c10)
            p01 = w * (s00 * c01 + s01 * c11)
            p10 = w * (s10 * c00 + s11 * c10)
            p11 = w * (s10 * c01 + s11 * c11)
            for a in range(k):
                gx = gradients[e, q, a, 0]
                gy = gradients[e, q, a, 1]
                forces[a, 0] += p00 * gx + p01 * gy
                forces[a, 1] += p10 * gx + p11 * gy
        for a in range(k):
            row = np.uint64(elements[e, a])
            total[row, 0] += forces[a, 0]
            total[row, 1] += forces[a, 1]
    return total
