"""A stress law as the material of FElupe's `SolidBody`, in the plane.

FElupe gives F at all points at once and keeps a state of each from substep to substep. The rate
over a substep of `dt` is that of backward differences::

    Ḟ = (F − F₀)/dt,    ∂P/∂F (whole) = ∂P/∂F + (1/dt) ∂P/∂Ḟ

With `dt` infinite, as it is at first, the material is at rest: quasi-static without rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.tensors import cofactor
from surrofe2.law.stress_law import StressLaw, StressResponse, describe

Array = NDArray[np.float64]


class FelupeMaterial:
    """`umat` of `felupe.SolidBody(umat, field)` for fields in the plane.

    A material belongs to one body, for it keeps warm starts of its points.

    Args:
        law: gives stress and tangents; RVEs, a surrogate, or a law of one's own.

    Attributes:
        dt: length of the substep, µs. Set it before a job, or before each of its substeps by a
            plugin of `felupe.Job` with a method `before_substep(context, state)`.
        x: shapes of F and of the state, as FElupe asks for them: F and F − 1.

    Raises:
        InputError: the law has no tangents.
    """

    def __init__(self, law: StressLaw) -> None:
        if not law.has_tangents:
            raise InputError("law: it has no tangents, which FElupe's Newton method needs")
        self.law, self.dt = law, np.inf
        self.x: list[Array] = [np.eye(2), np.zeros(4)]
        self._state: Any = None

    def gradient(self, x: Sequence[Array]) -> list[Array]:
        """[P (2, 2, q, c) in µN/µm, the state at the end of the substep (4, q, c)]."""
        F, answer = self._answer(x)
        P = answer.stress @ cofactor(F)
        trailing = x[0].shape[2:]
        return [_last(P, trailing), _last((F - np.eye(2)).reshape(-1, 4), trailing)]

    def hessian(self, x: Sequence[Array]) -> list[Array]:
        """[∂P/∂F (2, 2, 2, 2, q, c) over the substep, µN/µm]."""
        _, answer = self._answer(x, tangents=True)
        assert answer.tangents is not None
        whole = answer.tangents.P_by_F + answer.tangents.P_by_F_dot / self.dt
        return [_last(whole, x[0].shape[2:])]

    def _answer(
        self, x: Sequence[Array], *, tangents: bool = False
    ) -> tuple[Array, StressResponse]:
        """F (n, 2, 2) and the law's answer there.

        Raises:
            SimulationError: a point has no stress.
        """
        F, before = _first(x[0], (2, 2)), _first(x[1], (4,))
        F_dot = (F - np.eye(2) - before.reshape(-1, 2, 2)) / self.dt
        answer = self.law.respond(F, F_dot, self._state, tangents=tangents)
        failed = np.flatnonzero(answer.status)
        if failed.size:
            why = describe(answer.status[failed[0]])
            raise SimulationError(f"point {failed[0]} of {len(F)}: {why}")
        self._state = answer.state
        return F, answer


def _first(values: Array, shape: tuple[int, ...]) -> Array:
    """(n, …) from (…, q, c)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(*shape, -1), -1, 0))


def _last(values: Array, trailing: tuple[int, ...]) -> Array:
    """(…, q, c) from (n, …)."""
    moved = np.moveaxis(values, 0, -1)
    return np.ascontiguousarray(moved.reshape(*moved.shape[:-1], *trailing))
