"""What is learnt, P̂ = RᵀP in components, and its slopes: from Cauchy stress and tangents and back.

With F = R U, P = det F σ F⁻ᵀ gives P̂ = det U (Rᵀ σ R) U⁻¹. Along a change B = RᵀdF of F the
rotation turns by dθ = (B₂₁ − B₁₂)/tr U, with E the turn by 90°:

    dU = B − dθ E U        dA = RᵀdḞ − dθ E A        RᵀdP = dP̂ + dθ E P̂
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.tensors import (
    det,
    from_components,
    rotation,
    to_components,
    to_inputs,
    transpose,
)
from surrofe2.law.stress_law import Tangents

Array = NDArray[np.float64]

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
_UNIT = from_components(np.eye(4))  # (4, 2, 2): tensors with one component 1
_SPINLESS = 3


def to_piola(F: Array, stress: Array) -> Array:
    """Components (n, 4) of P̂ from the Cauchy stress (n, 2, 2)."""
    R = rotation(F)
    P = det(F)[:, None, None] * np.einsum("nac,nbc->nab", stress, np.linalg.inv(F))
    return to_components(transpose(R) @ P)


def to_cauchy(F: Array, components: Array) -> Array:
    """σ (n, 2, 2) from the components of P̂ (n, 4)."""
    P = rotation(F) @ from_components(components)
    return P @ transpose(F) / det(F)[:, None, None]


def to_slopes(F: Array, P_by_F: Array, P_by_F_dot: Array) -> Array:
    """∂P̂ (n, 4) by the 7 inputs, (n, 4, 7), from tangents at (F, Ḟ); (n, 2, 2, 2, 2) each.

    Along an input of U the rotation stays, so it takes R into both ends of the tangent.
    """
    R = rotation(F)
    turned = [np.einsum("nea,nebfd,nfc->nabcd", R, by, R) for by in (P_by_F, P_by_F_dot)]
    sides = [
        np.einsum("nabcd,kcd->nkab", by, directions)
        for by, directions in zip(turned, (_UNIT[:_SPINLESS], _UNIT), strict=True)
    ]
    along = np.concatenate(sides, axis=1)
    slopes = to_components(along.reshape(-1, 2, 2)).reshape(len(F), -1, 4)
    return transpose(slopes)


def to_tangents(F: Array, F_dot: Array, components: Array, slopes: Array) -> Tangents:
    """∂P/∂F and ∂P/∂Ḟ from the components of P̂ (n, 4) and their slopes (n, 4, 7)."""
    inputs, R = to_inputs(F, F_dot)
    B = np.einsum("nec,kef->nkcf", R, np.eye(4).reshape(4, 2, 2))  # RᵀdF for the four unit dF
    U, A = transpose(R) @ F, transpose(R) @ F_dot
    turned = (B[:, :, 1, 0] - B[:, :, 0, 1]) / (2.0 + inputs[:, :1])
    dU = B - turned[..., None, None] * (TURN @ U)[:, None]
    dA = -turned[..., None, None] * (TURN @ A)[:, None]
    changes = np.concatenate(
        [_components(dU)[..., :_SPINLESS], _components(np.broadcast_to(dA, dU.shape))], axis=2
    )
    P = from_components(components)
    by_F = _tensors(np.einsum("nij,nkj->nki", slopes, changes))
    by_F = by_F + turned[..., None, None] * (TURN @ P)[:, None]
    by_rate = _tensors(np.einsum("nij,nkj->nki", slopes[:, :, _SPINLESS:], _components(B)))
    return Tangents(*(_closed(R, by) for by in (by_F, by_rate)))


def _components(tensors: Array) -> Array:
    return to_components(tensors.reshape(-1, 2, 2)).reshape(*tensors.shape[:2], 4)


def _tensors(components: Array) -> Array:
    shape = components.shape
    return from_components(components.reshape(-1, 4)).reshape(*shape[:2], 2, 2)


def _closed(R: Array, by: Array) -> Array:
    """R by (n, 4, 2, 2), put as [n, a, b, c, d] = ∂P_ab by the change of entry (c, d)."""
    turned = np.einsum("nae,nkeb->nabk", R, by)
    return np.ascontiguousarray(turned.reshape(len(R), 2, 2, 2, 2))
