"""From displacement to deformation gradient, and from stress to forces on the nodes.

The loops over elements and points are compiled; of many points, all cores share them, and elements
add up in their order whatever their number. Points are numbered n_q e + q.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.tensors import cofactor, det
from surrofe2.macro.discretisation import Discretisation

Array = NDArray[np.float64]

MANY = 2000
"""Points from which on more than one core pays."""
_PART = 64  # elements that a core takes at a time


def deformation_gradient(
    discretisation: Discretisation, u: Array, v: Array
) -> tuple[Array, Array, Array]:
    """F, Ḟ (n_points, 2, 2) and det F (n_points,) from u, v (n, 2), n at least the nodes."""
    space, count = discretisation.arrays, discretisation.n_points
    found = np.empty((count, 2, 2)), np.empty((count, 2, 2)), np.empty(count)
    if count < MANY:
        set_deformation(0, len(space.elements), space, u, v, found)
    else:
        _set_deformation_parallel(space, u, v, found)
    return found


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
    space = discretisation.arrays
    of_elements = np.empty((*space.elements.shape, 2))
    if discretisation.n_points < MANY:
        set_forces(0, len(space.elements), space, F, stress, of_elements)
    else:
        _set_forces_parallel(space, F, stress, of_elements)
    total = np.zeros((len(discretisation.nodes) if n is None else n, 2))
    add_at_nodes(space.elements, of_elements, total)
    return total


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
def set_deformation(begin: Any, end: Any, space: Any, u: Any, v: Any, set_at: Any) -> None:
    """Set F = I + Σ_a u_a ⊗ ∇N_a, Ḟ = Σ_a v_a ⊗ ∇N_a and J = det F of elements `begin` to `end`.

    Args:
        space: `ElementArrays`.
        u, v: (n, 2).
        set_at: F, Ḟ (n_q n_el, 2, 2) and J (n_q n_el,).
    """
    elements, gradients, (F, F_dot, J) = space.elements, space.gradients, set_at
    n_q, k = gradients.shape[1], gradients.shape[2]
    nodal = np.zeros((k, 4))
    for e in range(begin, end):
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


@parallel_kernel
def _set_deformation_parallel(space: Any, u: Any, v: Any, set_at: Any) -> None:
    for part in prange((space.elements.shape[0] + _PART - 1) // _PART):
        end = min((part + 1) * _PART, space.elements.shape[0])
        set_deformation(part * _PART, end, space, u, v, set_at)


@kernel
def set_forces(begin: Any, end: Any, space: Any, F: Any, stress: Any, forces: Any) -> None:
    """Set f_a = Σ_Gauss J w dev(σ) F⁻ᵀ∇N_a + Σ_last J w tr(σ)/2 F⁻ᵀ∇N_a of elements.

    Of triangles Σ_Gauss J w σ F⁻ᵀ∇N_a. J F⁻ᵀ is the cofactor of F, so nothing is divided.

    Args:
        begin, end: of the elements.
        space: `ElementArrays`.
        F, stress: (n_q n_el, 2, 2).
        forces: (n_el, k, 2), µN.
    """
    n_q, k = space.gradients.shape[1], space.gradients.shape[2]
    for e in range(begin, end):
        forces[e] = 0.0
        for q in range(n_q):
            p = n_q * e + q
            s00, s01, s10, s11 = stress[p, 0, 0], stress[p, 0, 1], stress[p, 1, 0], stress[p, 1, 1]
            if k == 4:
                pressure = 0.5 * (s00 + s11)
                if q < n_q - 1:
                    s00, s11 = s00 - pressure, s11 - pressure
                else:
                    s00, s11, s01, s10 = pressure, pressure, 0.0, 0.0
            w = space.weights[e, q]
            c00, c01, c10, c11 = F[p, 1, 1], -F[p, 1, 0], -F[p, 0, 1], F[p, 0, 0]
            p00, p01 = w * (s00 * c00 + s01 * c10), w * (s00 * c01 + s01 * c11)
            p10, p11 = w * (s10 * c00 + s11 * c10), w * (s10 * c01 + s11 * c11)
            for a in range(k):
                gx, gy = space.gradients[e, q, a, 0], space.gradients[e, q, a, 1]
                forces[e, a, 0] += p00 * gx + p01 * gy
                forces[e, a, 1] += p10 * gx + p11 * gy


@parallel_kernel
def _set_forces_parallel(space: Any, F: Any, stress: Any, forces: Any) -> None:
    for part in prange((space.elements.shape[0] + _PART - 1) // _PART):
        end = min((part + 1) * _PART, space.elements.shape[0])
        set_forces(part * _PART, end, space, F, stress, forces)


@kernel
def add_at_nodes(elements: Any, forces: Any, total: Any) -> None:
    """Add forces (n_el, k, 2) on the nodes of elements to `total` (n, 2), in their order."""
    for e in range(elements.shape[0]):
        for a in range(elements.shape[1]):
            row = elements[e, a]
            total[row, 0] += forces[e, a, 0]
            total[row, 1] += forces[e, a, 1]
