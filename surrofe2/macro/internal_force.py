"""From displacement to deformation gradient, and from stress to forces on the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.macro.kernels import deformation, nodal_forces
from surrofe2.macro.mesh import Bar
from surrofe2.macro.selective_quadrature import CENTRE, N_GAUSS, N_POINTS

Array = NDArray[np.float64]


def deformation_gradient(bar: Bar, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """F, Ḟ (n_points, 2, 2) and det F (n_points,) from u, v (n_free, 2)."""
    F, F_dot, J = deformation(bar.rows, bar.quadrature.gradients, u, v)
    return F, F_dot, J


def internal_force(bar: Bar, F: Array, stress: Array) -> Array:
    """Internal force on the free nodes, (n_free, 2) in µN: the stress integral of eq. (58).

        f_a = ∫ dev σ ∇ₓN_a dv + ∫ tr(σ)/2 ∇ₓN_a dv,   ∇ₓN = F⁻ᵀ ∇N,   dv = det F dV,

    the first integral over the 2 × 2 Gauss points, the second at the element centre, each with
    gradient and volume at its own points (section 6.2). Positions follow from the total
    displacement, so this is the updated Lagrangian form without increments. Its power f·v is
    Σ dev σ : L dv + Σ tr(σ)/2 tr L dv at the same points. The stress may be unsymmetric.

    It enters (58) as M a = load − f; (58) is printed with both signs reversed.
    """
    quadrature = bar.quadrature
    force: Array = nodal_forces(
        bar.rows, quadrature.gradients, quadrature.weights, F, stress, len(bar.free)
    )
    return force


def element_mean_stress(bar: Bar, J: Array, stress: Array) -> Array:
    """(n_el, 2, 2) Cauchy stress: mean deviator over the Gauss points by current area, and the
    pressure part of the centre.
    """
    stress = stress.reshape(-1, N_POINTS, 2, 2)
    half_trace = 0.5 * np.einsum("eqii->eq", stress)[:, :, None, None] * np.eye(2)
    area = (J.reshape(-1, N_POINTS) * bar.quadrature.weights)[:, :N_GAUSS, None, None]
    deviator = (area * (stress - half_trace)[:, :N_GAUSS]).sum(axis=1) / area.sum(axis=1)
    mean: Array = deviator + half_trace[:, CENTRE]
    return mean
