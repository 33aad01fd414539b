"""What is learnt, P̂ = RᵀP in components, and its slopes: from Cauchy stress and tangents and back.

`QuadraticLaw` is the law whose slopes are those of another at rest, everywhere.

With F = R U, P = det F σ F⁻ᵀ gives P̂ = det U (Rᵀ σ R) U⁻¹. Along a change B = RᵀdF of F the
rotation turns by dθ = (B₂₁ − B₁₂)/tr U, with E the turn by 90°:

    dU = B − dθ E U        dA = RᵀdḞ − dθ E A        RᵀdP = dP̂ + dθ E P̂
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import SimulationError
from surrofe2.base.tensors import (
    det,
    from_components,
    rotation,
    to_components,
    to_inputs,
    transpose,
)
from surrofe2.law.stress_law import (
    StressLaw,
    StressResponse,
    Tangents,
    check_deformation,
    describe,
    require_tangents,
)

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
    return transpose(to_components(np.concatenate(sides, axis=1)))


def to_tangents(F: Array, F_dot: Array, components: Array, slopes: Array) -> Tangents:
    """∂P/∂F and ∂P/∂Ḟ from the components of P̂ (n, 4) and their slopes (n, 4, 7)."""
    inputs, R = to_inputs(F, F_dot)
    B = np.zeros((len(F), 4, 2, 2))  # RᵀdF for the four unit dF
    B[:, 0, :, 0] = B[:, 1, :, 1] = R[:, 0]
    B[:, 2, :, 0] = B[:, 3, :, 1] = R[:, 1]
    U, A = transpose(R) @ F, transpose(R) @ F_dot
    turned = (B[:, :, 1, 0] - B[:, :, 0, 1]) / (2.0 + inputs[:, :1])
    direct, E_U, E_A = (to_components(each) for each in (B, TURN @ U, TURN @ A))
    changes = np.empty((len(F), 4, 7))
    changes[..., :_SPINLESS] = direct[..., :_SPINLESS] - turned[..., None] * E_U[:, None, :3]
    changes[..., _SPINLESS:] = -turned[..., None] * E_A[:, None]
    across = transpose(slopes)
    by_F = from_components(changes @ across)
    by_F += turned[..., None, None] * (TURN @ from_components(components))[:, None]
    by_rate = from_components(direct @ across[:, _SPINLESS:])
    # R dP̂, put as [n, a, b, c, d] = ∂P_ab by the change of entry (c, d)
    entries = (np.moveaxis(R[:, None] @ by, 1, 3) for by in (by_F, by_rate))
    return Tangents(*(np.ascontiguousarray(by.reshape(-1, 2, 2, 2, 2)) for by in entries))


@dataclass(frozen=True, eq=False, slots=True)
class QuadraticLaw:
    """P̂ = RᵀP linear in U − I and RᵀḞ: another law's elastic and viscous moduli at rest.

    It turns with the material, and knows neither that law's stiffening nor its loss of stability.
    Sum, difference and shear of P̂ are linear; its spin is the one by which σ stays symmetric.

    Attributes:
        slopes: (4, 7) components of P̂ by the inputs of `tensors`, µN/µm and µN µs/µm.
        density: mass per reference area, ng/µm².
    """

    slopes: Array
    density: float | Array
    has_tangents: bool = True

    @classmethod
    def of(cls, law: StressLaw) -> QuadraticLaw:
        """That of a law's tangents at rest.

        Raises:
            InputError: the law has no tangents.
            SimulationError: it has no stress at rest.
        """
        require_tangents(law, "quadratic law")
        F, F_dot = np.eye(2)[None], np.zeros((1, 2, 2))
        answer = law.respond(F, F_dot, tangents=True)
        if answer.status.any() or answer.tangents is None:
            raise SimulationError(f"quadratic law: at rest {describe(answer.status[0])}")
        slopes = to_slopes(F, answer.tangents.P_by_F, answer.tangents.P_by_F_dot)
        return cls(slopes[0], law.density)

    def respond(
        self, F: Any, F_dot: Any, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        F, F_dot = check_deformation(F, F_dot)
        x, _ = to_inputs(F, F_dot)
        P = x @ self.slopes.T
        stretch = 2.0 + x[:, 0]
        spin = (P[:, 1] * x[:, 2] - P[:, 2] * x[:, 1]) / stretch
        by = np.tile(self.slopes, (len(F) if tangents else 0, 1, 1))
        if tangents:
            rise = by[:, 1] * x[:, 2:3] - by[:, 2] * x[:, 1:2]
            rise[:, 2] += P[:, 1]
            rise[:, 1] -= P[:, 2]
            rise[:, 0] -= spin
            by[:, 3] += rise / stretch[:, None]
        P[:, 3] += spin
        slopes = to_tangents(F, F_dot, P, by) if tangents else None
        status = np.zeros(len(F), dtype=np.int8)
        return StressResponse(to_cauchy(F, P), status, state, {}, slopes)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        return response
