"""The loops over elements and points, compiled. Each has a plain twin in the tests.

One thread each: for 64 × 64 elements they take well under a millisecond, and a stress law more
than ten times that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.macro.selective_quadrature import N_GAUSS, N_POINTS


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


@kernel
def widen_extremes(lowest: Any, highest: Any, F: Any, F_dot: Any) -> None:
    """Widen `lowest` and `highest`, both (4, 2, 2), by F, Ḟ, U = RᵀF and RᵀḞ of all points.

    R is the rotation of the polar decomposition, cos θ : sin θ = F₁₁ + F₂₂ : F₂₁ − F₁₂.
    """
    values = np.empty((4, 2, 2))
    for p in range(F.shape[0]):
        c, s = F[p, 0, 0] + F[p, 1, 1], F[p, 1, 0] - F[p, 0, 1]
        norm = np.sqrt(c * c + s * s)
        c, s = c / norm, s / norm
        for j in range(2):
            for i in range(2):
                values[0, i, j] = F[p, i, j]
                values[1, i, j] = F_dot[p, i, j]
            for k in range(2):
                values[2 + k, 0, j] = c * values[k, 0, j] + s * values[k, 1, j]
                values[2 + k, 1, j] = c * values[k, 1, j] - s * values[k, 0, j]
        for k in range(4):
            for i in range(2):
                for j in range(2):
                    lowest[k, i, j] = min(lowest[k, i, j], values[k, i, j])
                    highest[k, i, j] = max(highest[k, i, j], values[k, i, j])
