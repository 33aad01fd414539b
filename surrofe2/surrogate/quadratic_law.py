"""`QuadraticLaw`: another law's tangents at F = I, Ḟ = 0 as an objective law, at no cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import SimulationError
from surrofe2.base.tensors import to_inputs
from surrofe2.law.stress_law import (
    Acceptance,
    StressLaw,
    StressResponse,
    check_deformation,
    describe,
    require_tangents,
)
from surrofe2.surrogate.piola import to_cauchy, to_slopes, to_tangents

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class QuadraticLaw:
    """P̂ = RᵀP linear in U − I and RᵀḞ, so its energy is quadratic in U − I.

    It has another law's elastic and viscous moduli at rest, and turns with the material. It knows
    neither that law's stiffening nor its loss of stability. Sum, difference and shear of P̂ are
    linear; its spin, which is of second order, is the one by which σ stays symmetric.

    Attributes:
        slopes: (4, 7) components of P̂ by the inputs of `tensors`, µN/µm and µN µs/µm.
        density: mass per reference area, ng/µm².
    """

    slopes: Array
    density: float | Array

    @classmethod
    def of(cls, law: StressLaw) -> QuadraticLaw:
        """That of a law's tangents, which is asked at one point.

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

    @property
    def has_tangents(self) -> bool:
        """Yes."""
        return True

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

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """As of `StressLaw`; nothing to check."""
        return Acceptance(response.status, response.state)
