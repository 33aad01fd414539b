"""From displacement to deformation gradient, and from stress to forces on the nodes.

Two loops over elements and points are compiled. Points are numbered n_q e + q.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.macro.discretisation import Discretisation
from surrofe2.tensors import cofactor, det

Array = NDArray[np.float64]


def deformation_gradient(
    discretisation: Discretisation, u: Array, v: Array
) -> tuple[Array, Array, Array]:
    """F, Ḟ (n_points, 2, 2) and det F (n_points,) from u, v (n, 2), n at least the nodes."""
    F, F_dot, J = deformation(discretisation.arrays, u, v)
    return F, F_dot, J


def internal_force(
    discretisation: Discretisation, F: Array, stress: Array, n: int | None = None
) -> Array:
    """Internal force on n rows, by default the nodes, (n, 2) in µN: the stress integral of (58).

        f_a = ∫ dev σ ∇ₓN_a dv + ∫ tr(σ)/2 ∇ₓN_a dv,   ∇ₓN = F⁻ᵀ ∇N,   dv = det F dV,

    the first integral over the Gauss points, the second at the last point of a quadrilateral, each
    with gradient and volume at its own points (section 6.2); of a triangle both over the Gauss
    points. Positions follow from the total displacement, so this is the updated Lagrangian form
    without increments. Its power f·v is Σ dev σ : L dv + Σ tr(σ)/2 tr L dv at the same points. The
    stress may be unsymmetric.

    It enters (58) as M a = load − f; (58) is printed with both signs reversed.
    """
    space = discretisation
    rows = len(space.nodes) if n is None else n
    force: Array = nodal_forces(space.arrays, F, stress, np.zeros((rows, 2)))
    return force


def element_mean_stress(discretisation: Discretisation, F: Array, stress: Array) -> Array:
    """(n_el, 2, 2) Cauchy stress: mean over the Gauss points by current area, of quadrilaterals
    that of the deviator, and the pressure part of the last point.
    """
    stress = stress.reshape(len(discretisation.elements), -1, 2, 2)
    area = (det(F).reshape(stress.shape[:2]) * discretisation.weights)[:, :, None, None]
    if not discretisation.pressure_apart:
        whole: Array = (area * stress).sum(axis=1) / area.sum(axis=1)
        return whole
    half_trace = 0.5 * np.einsum("eqii->eq", stress)[:, :, None, None] * np.eye(2)
    deviator = (area * (stress - half_trace))[:, :-1].sum(axis=1) / area[:, :-1].sum(axis=1)
    mean: Array = deviator + half_trace[:, -1]
    return mean


def element_mean_F(discretisation: Discretisation, F: Array) -> Array:
    """(n_el, 2, 2) mean of F (n_points, 2, 2) over each element."""
    space = discretisation
    F = F.reshape(*space.weights.shape, 2, 2)
    if space.pressure_apart:
        return F[:, -1]
    mean: Array = np.einsum("eq,eqij->eij", space.weights, F)
    return mean / space.weights.sum(axis=1)[:, None, None]


def stress_power(discretisation: Discretisation, F: Array, F_dot: Array, stress: Array) -> Array:
    """(n_el,) power of a stress in each element, pJ/µs; together internal force times velocity."""
    if discretisation.pressure_apart:
        half = 0.5 * np.trace(stress, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        n_q = discretisation.points_per_element
        last = (np.arange(len(F)) % n_q == n_q - 1)[:, None, None]
        stress = np.where(last, half, stress - half)
    power = np.einsum("nij,nij->n", stress @ cofactor(F), F_dot)
    per_element: Array = (power.reshape(discretisation.weights.shape) * discretisation.weights).sum(
        axis=1
    )
    return per_element


@kernel
def deformation(space: Any, u: Any, v: Any) -> Any:
    """F = I + Σ_a u_a ⊗ ∇N_a, Ḟ = Σ_a v_a ⊗ ∇N_a and J = det F at all points.

    Args:
        space: `ElementArrays`.
        u, v: (n, 2).

    Returns:
        F, F_dot: (n_q n_el, 2, 2); J: (n_q n_el,).
    """
    elements, gradients = space.elements, space.gradients
    n_q, k = gradients.shape[1], gradients.shape[2]
    n_points = space.weights.size
    F, F_dot, J = np.empty((n_points, 2, 2)), np.empty((n_points, 2, 2)), np.empty(n_points)
    nodal = np.zeros((k, 4))
    for e in range(elements.shape[0]):
        for a in range(k):
            row = elements[e, a]
            for i in range(2):
                nodal[a, i] = u[row, i]
                nodal[a, 2 + i] = v[row, i]
        for q in range(n_q):
            p = n_q * e + q
            xx, xy, yx, yy, vxx, vxy, vyx, vyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(k):
                gx, gy = gradients[e, q, a, 0], gradients[e, q, a, 1]
                xx += nodal[a, 0] * gx
                xy += nodal[a, 0] * gy
                yx += nodal[a, 1] * gx
                yy += nodal[a, 1] * gy
                vxx += nodal[a, 2] * gx
                vxy += nodal[a, 2] * gy
                vyx += nodal[a, 3] * gx
                vyy += nodal[a, 3] * gy
            xx, yy = xx + 1.0, yy + 1.0
            F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1] = xx, xy, yx, yy
            F_dot[p, 0, 0], F_dot[p, 0, 1], F_dot[p, 1, 0], F_dot[p, 1, 1] = vxx, vxy, vyx, vyy
            J[p] = xx * yy - xy * yx
    return F, F_dot, J


@kernel
def nodal_forces(space: Any, F: Any, stress: Any, total: Any) -> Any:
    """Add f_a = Σ_Gauss J w dev(σ) F⁻ᵀ∇N_a + Σ_last J w tr(σ)/2 F⁻ᵀ∇N_a of all elements.

    Of triangles Σ_Gauss J w σ F⁻ᵀ∇N_a. J F⁻ᵀ is the cofactor of F, so nothing is divided.

    Args:
        space: `ElementArrays`.
        F, stress: (n_q n_el, 2, 2).
        total: (n, 2) µN, to which they are added.

    Returns:
        total.
    """
    n_q, k = space.gradients.shape[1], space.gradients.shape[2]
    force = np.empty((k, 2))
    for e in range(space.elements.shape[0]):
        force[:] = 0.0
        for q in range(n_q):
            p = n_q * e + q
            add_force(e, q, space, F[p], stress[p], force)
        for a in range(k):
            row = space.elements[e, a]
            total[row, 0] += force[a, 0]
            total[row, 1] += force[a, 1]
    return total


@kernel
def add_force(e: Any, q: Any, space: Any, F: Any, stress: Any, force: Any) -> None:
    """Add what a point of element e contributes to the force (k, 2) on its nodes."""
    n_q, k = space.gradients.shape[1], space.gradients.shape[2]
    s00, s01, s10, s11 = stress[0, 0], stress[0, 1], stress[1, 0], stress[1, 1]
    if k == 4:
        pressure = 0.5 * (s00 + s11)
        if q < n_q - 1:
            s00, s11 = s00 - pressure, s11 - pressure
        else:
            s00, s11, s01, s10 = pressure, pressure, 0.0, 0.0
    w = space.weights[e, q]
    c00, c01, c10, c11 = F[1, 1], -F[1, 0], -F[0, 1], F[0, 0]
    p00, p01 = w * (s00 * c00 + s01 * c10), w * (s00 * c01 + s01 * c11)
    p10, p11 = w * (s10 * c00 + s11 * c10), w * (s10 * c01 + s11 * c11)
    for a in range(k):
        gx, gy = space.gradients[e, q, a, 0], space.gradients[e, q, a, 1]
        force[a, 0] += p00 * gx + p01 * gy
        force[a, 1] += p10 * gx + p11 * gy
