"""From displacement to deformation gradient, and from stress to forces on the nodes.

The two loops over elements and points are compiled, one thread each: for 64 × 64 elements they
take well under a millisecond, and a stress law more than ten times that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.macro.discretisation import CENTRE, N_GAUSS, N_POINTS, Discretisation
from surrofe2.tensors import det

Array = NDArray[np.float64]


def deformation_gradient(
    discretisation: Discretisation, u: Array, v: Array
) -> tuple[Array, Array, Array]:
    """F, Ḟ (n_points, 2, 2) and det F (n_points,) from u, v (n_free, 2)."""
    F, F_dot, J = deformation(discretisation.rows, discretisation.gradients, u, v)
    return F, F_dot, J


def internal_force(discretisation: Discretisation, F: Array, stress: Array) -> Array:
    """Internal force on the free nodes, (n_free, 2) in µN: the stress integral of eq. (58).

        f_a = ∫ dev σ ∇ₓN_a dv + ∫ tr(σ)/2 ∇ₓN_a dv,   ∇ₓN = F⁻ᵀ ∇N,   dv = det F dV,

    the first integral over the 2 × 2 Gauss points, the second at the element centre, each with
    gradient and volume at its own points (section 6.2). Positions follow from the total
    displacement, so this is the updated Lagrangian form without increments. Its power f·v is
    Σ dev σ : L dv + Σ tr(σ)/2 tr L dv at the same points. The stress may be unsymmetric.

    It enters (58) as M a = load − f; (58) is printed with both signs reversed.
    """
    space = discretisation
    force: Array = nodal_forces(
        space.rows, space.gradients, space.weights, F, stress, len(space.free)
    )
    return force


def element_mean_stress(discretisation: Discretisation, F: Array, stress: Array) -> Array:
    """(n_el, 2, 2) Cauchy stress: mean deviator over the Gauss points by current area, and the
    pressure part of the centre.
    """
    stress = stress.reshape(-1, N_POINTS, 2, 2)
    half_trace = 0.5 * np.einsum("eqii->eq", stress)[:, :, None, None] * np.eye(2)
    area = (det(F).reshape(-1, N_POINTS) * discretisation.weights)[:, :N_GAUSS, None, None]
    deviator = (area * (stress - half_trace)[:, :N_GAUSS]).sum(axis=1) / area.sum(axis=1)
    mean: Array = deviator + half_trace[:, CENTRE]
    return mean


@kernel
def deformation(rows: Any, gradients: Any, u: Any, v: Any) -> Any:
    """F = I + Σ_a u_a ⊗ ∇N_a, Ḟ = Σ_a v_a ⊗ ∇N_a and J = det F at all points.

    Args:
        rows: (n_el, 4) row of each node in u and v, -1 where it is held.
        gradients: (n_el, 5, 4, 2) reference gradients.
        u, v: (n_free, 2).

    Returns:
        F, F_dot: (5 n_el, 2, 2); J: (5 n_el,).
    """
    n_points = N_POINTS * rows.shape[0]
    F = np.empty((n_points, 2, 2))
    F_dot = np.empty((n_points, 2, 2))
    J = np.empty(n_points)
    nodal = np.zeros((4, 4))
    for e in range(rows.shape[0]):
        for a in range(4):
            row = rows[e, a]
            for i in range(2):
                nodal[a, i] = u[row, i] if row >= 0 else 0.0
                nodal[a, 2 + i] = v[row, i] if row >= 0 else 0.0
        for q in range(N_POINTS):
            p = N_POINTS * e + q
            for i in range(2):
                for j in range(2):
                    strain = 0.0
                    rate = 0.0
                    for a in range(4):
                        strain += nodal[a, i] * gradients[e, q, a, j]
                        rate += nodal[a, 2 + i] * gradients[e, q, a, j]
                    F[p, i, j] = strain
                    F_dot[p, i, j] = rate
            F[p, 0, 0] += 1.0
            F[p, 1, 1] += 1.0
            J[p] = F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0]
    return F, F_dot, J


@kernel
def nodal_forces(rows: Any, gradients: Any, weights: Any, F: Any, stress: Any, n_free: int) -> Any:
    """f_a = Σ_Gauss J w dev(σ) F⁻ᵀ∇N_a + Σ_centre J w tr(σ)/2 F⁻ᵀ∇N_a, see `internal_force`.

    J F⁻ᵀ is the cofactor of F, so nothing is divided. Elements add up in their order.

    Args:
        rows, gradients: as for `deformation`.
        weights: (n_el, 5) reference areas.
        F, stress: (5 n_el, 2, 2).

    Returns:
        (n_free, 2) µN.
    """
    force = np.zeros((n_free, 2))
    for e in range(rows.shape[0]):
        for q in range(N_POINTS):
            p = N_POINTS * e + q
            pressure = 0.5 * (stress[p, 0, 0] + stress[p, 1, 1])
            if q < N_GAUSS:
                s00, s11 = stress[p, 0, 0] - pressure, stress[p, 1, 1] - pressure
                s01, s10 = stress[p, 0, 1], stress[p, 1, 0]
            else:
                s00, s11, s01, s10 = pressure, pressure, 0.0, 0.0
            w = weights[e, q]
            c00, c01, c10, c11 = F[p, 1, 1], -F[p, 1, 0], -F[p, 0, 1], F[p, 0, 0]
            p00, p01 = w * (s00 * c00 + s01 * c10), w * (s00 * c01 + s01 * c11)
            p10, p11 = w * (s10 * c00 + s11 * c10), w * (s10 * c01 + s11 * c11)
            for a in range(4):
                row = rows[e, a]
                if row >= 0:
                    gx, gy = gradients[e, q, a, 0], gradients[e, q, a, 1]
                    force[row, 0] += p00 * gx + p01 * gy
                    force[row, 1] += p10 * gx + p11 * gy
    return force
