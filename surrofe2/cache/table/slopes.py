"""Tangents of a table's stress, exact to rounding.

The answer of `lookup` is the mean of linear models m_k with weights w_k = (L/b_k − 1)², b_k their
bounds and L the largest that is allowed. So

    ∂s/∂x = Σ w_k (∂m_k/∂x) / W + Σ (m_k − s) ⊗ ∂w_k/∂x / W,    W = Σ w_k.

The weights and their slopes vanish at the surface of an ellipsoid, so these tangents are continuous
and Newton's method converges as with those of a smooth law. They are not those of the RVE: from
these the first sum differs by what the records' slopes change over an ellipsoid, the second by up
to the table's tolerance over its size. That changes how fast an equilibrium is found, not which.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS
from surrofe2.base.tensors import (
    INPUTS,
    cofactor,
    from_components,
    to_components,
    to_inputs,
    transpose,
)
from surrofe2.cache.table.lookup import NEAREST
from surrofe2.cache.table.records import OUTPUTS, Records
from surrofe2.law.stress_law import Tangents

_AT_ONCE = 64  # points that a core answers at once
_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # T, the rotation by a right angle


def table_tangents(
    F: Array, F_dot: Array, tolerances: tuple[float, float], images: int, records: Records
) -> Tangents:
    """Compute ∂P/∂F and ∂P/∂Ḟ of the stress that `lookup.look_up` gives by the same arguments.

    Args:
        F, F_dot: contiguous float64 (n, 2, 2), det F > 0.
        tolerances: the tolerance that is asked for, and the table's own, µN/µm.
        images: 4 with the symmetry D4, 1 without.

    Returns:
        NaN where no ellipsoid holds the point.
    """
    x, R = to_inputs(F, F_dot)
    tolerance, size = tolerances
    limit = min(size, tolerance * abs(tolerance) / size)
    components = np.empty((len(x), OUTPUTS))
    slopes = np.empty((len(x), OUTPUTS, INPUTS))
    _all_slopes(x, limit, size, images, records, components, slopes)
    return _of_first_piola(F, F_dot, R, components, slopes)


@parallel_kernel
def _all_slopes(x, limit, size, images, records, components, slopes):  # type: ignore[no-untyped-def]
    """Fill components (n, 4) and slopes (n, 4, 7) at inputs x (n, 7)."""
    count = x.shape[0]
    for part in prange((count + _AT_ONCE - 1) // _AT_ONCE):
        for p in range(part * _AT_ONCE, min((part + 1) * _AT_ONCE, count)):
            _slopes_at(x[p], limit, size, images, records, components[p], slopes[p])


@kernel
def _slopes_at(x, limit, size, images, records, components, slopes):  # type: ignore[no-untyped-def]
    """Fill components (4,) and slopes (4, 7) at one point."""
    total = 0.0
    total_slope = np.zeros(INPUTS)
    away = np.empty(INPUTS)
    pull = np.empty(INPUTS)
    weight_slope = np.empty(INPUTS)
    components[:] = 0.0
    slopes[:] = 0.0
    for k in range(records.centre.shape[0]):
        for flips in range(images):
            bound = 0.0
            for i in range(INPUTS):
                away[i] = x[i] * INPUT_SIGNS[flips, i] - records.centre[k, i]
            for i in range(INPUTS):
                pull[i] = 0.0
                for j in range(INPUTS):
                    pull[i] += records.curvature[k, i, j] * away[j]
                bound += pull[i] * away[i]
            if not bound < limit:
                continue
            nearest = NEAREST * size
            floor = max(bound, nearest)
            root = (limit - bound) / floor + NEAREST
            weight = root * root
            # d√w/db = −L/b², and where the bound is as good as none the record answers alone.
            fall = -2.0 * root * limit / (floor * floor) if bound > nearest else 0.0
            total += weight
            for i in range(INPUTS):
                weight_slope[i] = fall * 2.0 * pull[i] * INPUT_SIGNS[flips, i]
                total_slope[i] += weight_slope[i]
            for c in range(OUTPUTS):
                sign = COMPONENT_SIGNS[flips, c]
                value = records.stress[k, c]
                for i in range(INPUTS):
                    value += records.slope[k, c, i] * away[i]
                components[c] += sign * weight * value
                for i in range(INPUTS):
                    slope = records.slope[k, c, i] * INPUT_SIGNS[flips, i]
                    slopes[c, i] += sign * (weight * slope + weight_slope[i] * value)
    if total == 0.0:
        components[:] = np.nan
        slopes[:] = np.nan
        return
    for c in range(OUTPUTS):
        components[c] /= total
        for i in range(INPUTS):
            slopes[c, i] = (slopes[c, i] - components[c] * total_slope[i]) / total


def _of_first_piola(F: Array, F_dot: Array, R: Array, components: Array, slopes: Array) -> Tangents:
    """Compute tangents of P from components s (n, 4) of S = Rᵀ σ R and ∂s/∂x (n, 4, 7).

    With R = exp(θ T), T the rotation by a right angle: dU = Rᵀ dF − T U dθ, dA = Rᵀ dḞ − T A dθ,
    dσ = R (dS + (T S − S T) dθ) Rᵀ and dP = dσ cof F + σ cof dF, for in the plane the cofactor is
    linear.
    """
    across = transpose(R)
    U = across @ F
    A = across @ F_dot
    S = from_components(components)
    stress = R @ S @ across
    twist = _TURN @ S - S @ _TURN
    cofactors = cofactor(F)
    trace = U[:, 0, 0] + U[:, 1, 1]
    by_F = np.empty((len(F), 2, 2, 2, 2))
    by_F_dot = np.empty_like(by_F)
    for c in range(2):
        for d in range(2):
            change = np.zeros_like(F)
            change[:, c, d] = 1.0
            turned = across @ change
            # tan θ = (F₂₁ − F₁₂)/(F₁₁ + F₂₂), so dθ = spin of RᵀdF over the trace of U
            angle = ((turned[:, 1, 0] - turned[:, 0, 1]) / trace)[:, None, None]
            dU = turned - angle * (_TURN @ U)
            dA = -angle * (_TURN @ A)
            dx = np.concatenate([to_components(dU)[:, :3], to_components(dA)], axis=1)
            dS = from_components(np.einsum("nki,ni->nk", slopes, dx)) + angle * twist
            by_F[..., c, d] = R @ dS @ across @ cofactors + stress @ cofactor(change)
            rate = to_components(turned)
            dS = from_components(np.einsum("nki,ni->nk", slopes[:, :, 3:], rate))
            by_F_dot[..., c, d] = R @ dS @ across @ cofactors
    return Tangents(by_F, by_F_dot)
