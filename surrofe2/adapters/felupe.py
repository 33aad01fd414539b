"""A stress law as the material of FElupe's `SolidBody`, in the plane.

FElupe gives F at all points at once and keeps a state of each from substep to substep. The rate
over a substep of `dt` is that of backward differences, so that the slope is `Tangents.over_step`::

    Ḟ = (F − F₀)/dt,    ∂P/∂F (whole) = ∂P/∂F + (1/dt) ∂P/∂Ḟ

With `dt` infinite, as it is at first, the material is at rest: quasi-static without rates.

FElupe is under the GPL, version 3 or later. This file imports nothing of it and has none of its
code.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import SimulationError
from surrofe2.law.stress_law import StressLaw, StressResponse, describe, require_tangents


class _Answer(NamedTuple):
    """The law's response at one deformation in a substep.

    Attributes:
        dt: length of the substep, µs.
        F: (n, 2, 2).
        before: (n, 4) F₀ − 1 at the begin of the substep.
        F_dot: (n, 2, 2) rate over the substep, 1/µs.
        response: of the law.
    """

    dt: float
    F: Array
    before: Array
    F_dot: Array
    response: StressResponse


class FelupeMaterial:
    """A `umat` of `felupe.SolidBody(umat, field)` for fields in the plane.

    A material belongs to one body, for it keeps the law's states of its points. At the end of a
    substep the law commits its response. As one of the `plugins` of `felupe.Job` the material sees
    to that at once, else when the next substep begins: then call `after_substep` after the last.

    Args:
        law: gives stress and tangents; one without tangents is an InputError.

    Attributes:
        dt: length of the substep, µs. Set it before a job, or before each of its substeps by a
            plugin of `felupe.Job` with a method `before_substep(context, state)`.
        left_bifurcation: (n,) points that left their branch at a bifurcation so far; None: none
            did. Each time more do, there is a warning, for other substeps may lead elsewhere.
        x: shapes of F and of the state, as FElupe asks for them: F and F − 1.
    """

    def __init__(self, law: StressLaw) -> None:
        require_tangents(law, "law")
        self.law = law
        self.dt = np.inf
        self.left_bifurcation: Flags | None = None
        self.x: list[Array] = [np.eye(2), np.zeros(4)]
        self._state: Any = None
        self._last: _Answer | None = None

    def gradient(self, x: Sequence[Array]) -> list[Array]:
        """Return [P (2, 2, q, c) in µN/µm, the state at the end of the substep (4, q, c)].

        Raises:
            SimulationError: a point has no stress, or the law does not accept the last substep.
        """
        answer = self._answer(x)
        trailing = x[0].shape[2:]
        P = answer.response.first_piola(answer.F)
        end = answer.F - np.eye(2)
        return [_last(P, trailing), _last(end.reshape(-1, 4), trailing)]

    def hessian(self, x: Sequence[Array]) -> list[Array]:
        """Return [∂P/∂F (2, 2, 2, 2, q, c) over the substep, µN/µm]; raises as `gradient`."""
        tangents = self._answer(x).response.tangents
        assert tangents is not None
        return [_last(tangents.over_step(self.dt), x[0].shape[2:])]

    def after_substep(self, context: Any = None, state: Any = None) -> None:
        """Commit the substep that has ended; called by `felupe.Job` if the material is a plugin.

        Raises:
            SimulationError: the law does not accept a point.
        """
        if self._last is None:
            return
        last = self._last
        self._last = None
        accepted = self.law.accept(last.F, last.F_dot, last.response)
        require_stress(accepted)
        self._state = accepted.state
        self._report(accepted.left_bifurcation)

    def _answer(self, x: Sequence[Array]) -> _Answer:
        """Return the response at F, the last one where nothing has changed since."""
        F_of_felupe, state_before = x
        F = _first(F_of_felupe, (2, 2))
        before = _first(state_before, (4,))
        last = self._last
        if last is not None and not np.array_equal(before, last.before):
            # FElupe took over the state of the last answer: its substep has ended.
            self.after_substep()
        elif last is not None and last.dt == self.dt and np.array_equal(F, last.F):
            return last
        F_dot = (F - np.eye(2) - before.reshape(-1, 2, 2)) / self.dt
        response = self.law.respond(F, F_dot, self._state, tangents=True)
        require_stress(response)
        self._last = _Answer(self.dt, F, before, F_dot, response)
        self._report(response.left_bifurcation)
        return self._last

    def _report(self, is_beyond: Flags | None) -> None:
        """Warn of points that left their branch since the last call; None: not known."""
        if is_beyond is None:
            return
        known = self.left_bifurcation
        if known is None:
            known = np.zeros_like(is_beyond)
        new = np.flatnonzero(is_beyond & ~known)
        if new.size:
            self.left_bifurcation = known | is_beyond
            warnings.warn(
                f"law: {new.size} of {is_beyond.size} points left their branch at a bifurcation, "
                f"the first is point {new[0]}; the stress is that of a stable equilibrium, but "
                "depends on the way: compare with shorter substeps",
                RuntimeWarning,
                stacklevel=2,
            )


def require_stress(response: StressResponse) -> None:
    """Raise a `SimulationError` that names the first point without a stress, if there is one."""
    failed = np.flatnonzero(response.status)
    if failed.size:
        reason = response.reasons.get(failed[0], "")
        raise SimulationError(
            f"point {failed[0]} of {len(response.status)}: {describe(response.status[failed[0]])}"
            + (f": {reason}" if reason else "")
        )


def _first(values: Array, shape: tuple[int, ...]) -> Array:
    """Move the axes of the points to the front: (n, …) of (…, q, c)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(*shape, -1), -1, 0))


def _last(values: Array, trailing: tuple[int, ...]) -> Array:
    """Move the points to the last axes: (…, q, c) of (n, …)."""
    moved = np.moveaxis(values, 0, -1)
    return np.ascontiguousarray(moved.reshape(*moved.shape[:-1], *trailing))
