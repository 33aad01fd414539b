"""P̂ = RᵀP in components, which is what is learnt, from Cauchy stress and tangents and back.

`QuadraticLaw` has everywhere the slopes that another law has at rest.

With F = R U, P = det F σ F⁻ᵀ gives P̂ = det U (Rᵀ σ R) U⁻¹. A change dF of F changes R, too. With
E the turn by 90°, dR = dθ R E, and B = RᵀdF,

    B = dθ E U + dU

As dU is symmetric, the spin of this equation is B₂₁ − B₁₂ = dθ tr U, which gives dθ. With A = RᵀḞ
and P = R P̂ follow

    dU = B − dθ E U        dA = RᵀdḞ − dθ E A        RᵀdP = dP̂ + dθ E P̂
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import SimulationError
from surrofe2.base.square_symmetry import DIFFERENCE, SHEAR, SPIN, SUM
from surrofe2.base.tensors import (
    INPUTS,
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
"""The turn by 90°, E above."""
_UNIT = from_components(np.eye(4))
"""Tensors (4, 2, 2) of which one component is 1: sum, difference, shear or spin."""
_OF_U = slice(0, SPIN)
_OF_A = slice(SPIN, INPUTS)
"""The inputs of U and those of A: U is symmetric and has no spin, so that it has three."""


def to_piola(F: Array, stress: Array) -> Array:
    """Return the components (n, 4) of P̂ from the Cauchy stress (n, 2, 2), both in µN/µm."""
    R = rotation(F)
    P = det(F)[:, None, None] * np.einsum("nac,nbc->nab", stress, np.linalg.inv(F))
    return to_components(transpose(R) @ P)


def to_cauchy(F: Array, components: Array) -> Array:
    """Return σ (n, 2, 2) from the components of P̂ (n, 4), both in µN/µm."""
    P = rotation(F) @ from_components(components)
    return P @ transpose(F) / det(F)[:, None, None]


def to_slopes(F: Array, P_by_F: Array, P_by_F_dot: Array) -> Array:
    """Return the slopes of P̂ by the 7 inputs, (n, 4, 7), from tangents (n, 2, 2, 2, 2) at (F, Ḟ).

    Along an input of U the rotation stays, so R is taken out of both ends of the tangent.
    """
    R = rotation(F)
    by_U = np.einsum("nea,nebfd,nfc->nabcd", R, P_by_F, R)
    by_A = np.einsum("nea,nebfd,nfc->nabcd", R, P_by_F_dot, R)
    slopes_by_U = np.einsum("nabcd,kcd->nkab", by_U, _UNIT[_OF_U])
    slopes_by_A = np.einsum("nabcd,kcd->nkab", by_A, _UNIT)
    return transpose(to_components(np.concatenate([slopes_by_U, slopes_by_A], axis=1)))


def to_tangents(F: Array, F_dot: Array, components: Array, slopes: Array) -> Tangents:
    """Return ∂P/∂F and ∂P/∂Ḟ from the components of P̂ (n, 4) and their slopes (n, 4, 7).

    It goes through the four unit changes of F, of one entry by 1 each, and those of Ḟ: how U and A
    change, by that how P̂ does, and by that P. The formulas are at the head of this file.
    """
    inputs, R = to_inputs(F, F_dot)
    # B = RᵀdF for the unit changes of F₁₁, F₁₂, F₂₁ and F₂₂, (n, 4, 2, 2)
    B = np.zeros((len(F), 4, 2, 2))
    B[:, 0, :, 0] = R[:, 0]
    B[:, 1, :, 1] = R[:, 0]
    B[:, 2, :, 0] = R[:, 1]
    B[:, 3, :, 1] = R[:, 1]
    U = transpose(R) @ F
    A = transpose(R) @ F_dot
    trace_U = 2.0 + inputs[:, :1]
    turn = (B[:, :, 1, 0] - B[:, :, 0, 1]) / trace_U  # dθ, (n, 4)
    B_components = to_components(B)
    EU_components = to_components(TURN @ U)[:, None]
    EA_components = to_components(TURN @ A)[:, None]
    # changes of the seven inputs: dU = B − dθ E U, and dA = −dθ E A where Ḟ does not change
    changes = np.empty((len(F), 4, INPUTS))
    changes[..., _OF_U] = (B_components - turn[..., None] * EU_components)[..., _OF_U]
    changes[..., _OF_A] = -turn[..., None] * EA_components
    inputs_first = transpose(slopes)  # (n, 7, 4)
    by_F = from_components(changes @ inputs_first)
    by_F += turn[..., None, None] * (TURN @ from_components(components))[:, None]
    # a unit change of Ḟ changes A alone, by RᵀdḞ, which is B again
    by_rate = from_components(B_components @ inputs_first[:, _OF_A])
    return Tangents(_with_entries_last(R, by_F), _with_entries_last(R, by_rate))


def _with_entries_last(R: Array, changes: Array) -> Array:
    """Return (n, 2, 2, 2, 2) ∂P_ab by entry (c, d) from the changes of RᵀP, (n, 4, 2, 2).

    changes: RᵀdP by the unit change of each entry.
    """
    entries_last = np.moveaxis(R[:, None] @ changes, 1, 3)
    return np.ascontiguousarray(entries_last.reshape(-1, 2, 2, 2, 2))


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
        """Make the quadratic law of another law's tangents at rest.

        Raises:
            InputError: the law has no tangents.
            SimulationError: it has no stress at rest.
        """
        require_tangents(law, "quadratic law")
        F = np.eye(2)[None]
        F_dot = np.zeros((1, 2, 2))
        answer = law.respond(F, F_dot, tangents=True)
        if answer.status.any() or answer.tangents is None:
            raise SimulationError(f"quadratic law: at rest {describe(answer.status[0])}")
        slopes = to_slopes(F, answer.tangents.P_by_F, answer.tangents.P_by_F_dot)
        return cls(slopes[0], law.density)

    def respond(
        self, F: Any, F_dot: Any, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at n points; there is one everywhere. See `StressLaw.respond`."""
        F, F_dot = check_deformation(F, F_dot)
        x, _ = to_inputs(F, F_dot)
        P = x @ self.slopes.T
        # Inputs of U − I and components of P̂ have the same numbers, SUM to SHEAR.
        trace_U = 2.0 + x[:, SUM]
        # the spin by which σ is symmetric: (P̂'s difference × U's shear − shear × difference)/tr U
        spin = (P[:, DIFFERENCE] * x[:, SHEAR] - P[:, SHEAR] * x[:, DIFFERENCE]) / trace_U
        P_with_spin = P.copy()
        P_with_spin[:, SPIN] += spin
        slopes = None
        if tangents:
            P_by_inputs = np.tile(self.slopes, (len(F), 1, 1))
            # slope of the spin, times tr U, by the product and the quotient rule
            rise = P_by_inputs[:, DIFFERENCE] * x[:, SHEAR, None]
            rise = rise - P_by_inputs[:, SHEAR] * x[:, DIFFERENCE, None]
            rise[:, SHEAR] += P[:, DIFFERENCE]
            rise[:, DIFFERENCE] -= P[:, SHEAR]
            rise[:, SUM] -= spin
            P_by_inputs[:, SPIN] += rise / trace_U[:, None]
            slopes = to_tangents(F, F_dot, P_with_spin, P_by_inputs)
        status = np.zeros(len(F), dtype=np.int8)
        return StressResponse(to_cauchy(F, P_with_spin), status, state, {}, slopes)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Return the response as it is: there is nothing to check or to commit."""
        return response
