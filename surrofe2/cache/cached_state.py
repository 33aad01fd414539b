"""What a cached law carries from step to step, and who answers which point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.foresight import look_ahead
from surrofe2.cache.point_set import NOBODY, Indices, PointSet
from surrofe2.cache.protocols import Surrogate
from surrofe2.errors import InputError
from surrofe2.stress_law import Status, Tangents

Array = NDArray[np.float64]

NOT_TRUSTED = np.int8(Status.NOT_TRUSTED)
STAY, RETURN = 0.9, 0.8
"""Shares of the tolerance up to which the bound foreseen may rise for a point to stay with the
surrogate, and to come back to it: what is foreseen is not met exactly, and none goes to and fro."""


@dataclass(frozen=True, slots=True)
class CachedState:
    """Who is answered by the fallback, and what the next step needs to know.

    Attributes:
        count: n, the points there are.
        held: those the fallback answers until the step is accepted, with its warm start.
        tolerance: that bounds are compared with during this step, µN/µm; negative: none holds.
        bound: (n,) of the answer this came with, inf where the fallback gave it; or None.
        before: (F, Ḟ) at the last accepted step, or None.
    """

    count: int
    held: PointSet = NOBODY
    tolerance: float = np.inf
    bound: Array | None = None
    before: tuple[Array, Array] | None = None

    def free(self) -> NDArray[np.bool_]:
        """(n,) the points that the surrogate may answer."""
        free = np.ones(self.count, dtype=bool)
        free[self.held.points] = False
        return free


def look_up(
    surrogate: Surrogate, F: Array, F_dot: Array, state: CachedState
) -> tuple[Array, NDArray[np.int8], Array]:
    """As `Surrogate.lookup`, with stress 0, status 0 and an infinite bound at points held."""
    if not len(state.held) and state.tolerance >= 0.0:
        return surrogate.lookup(F, F_dot, state.tolerance)
    stress, bound = np.zeros_like(F), np.full(len(F), np.inf)
    status = np.zeros(len(F), dtype=np.int8)
    free = state.free()
    if state.tolerance < 0.0:
        status[free] = Status.NOT_TRUSTED
    elif free.any():
        answer = surrogate.lookup(F[free], F_dot[free], state.tolerance)
        stress[free], status[free], bound[free] = answer
    return stress, status, bound


def leaving_and_returning(
    surrogate: Surrogate, F: Array, F_dot: Array, state: CachedState, tolerance: float
) -> tuple[NDArray[np.int8], Array, NDArray[np.int8], NDArray[np.bool_]]:
    """Who must leave the surrogate for the next step, and which of the points held may return.

    Returns:
        (n,) int8: why a free point must leave, 0 where it may stay.
        (k, 2, 2), (k,): the surrogate's stress and status at the k points held, here and now.
        (k,): whether each of them may return.
    """
    points = state.held.points
    there = look_ahead(F, F_dot, state.before)
    ahead, bound_ahead = surrogate.status_and_bound(*there, tolerance)
    if state.bound is not None and np.isfinite(tolerance):
        rising = (bound_ahead > STAY * tolerance) & (bound_ahead > state.bound)
        ahead = np.where((ahead == 0) & rising, NOT_TRUSTED, ahead)
    narrower = tolerance < state.tolerance
    if not len(points) and not narrower:
        return ahead, np.empty((0, 2, 2)), ahead[:0], np.empty(0, dtype=bool)
    leaving = np.where(state.free(), ahead, np.int8(0))
    if state.bound is not None and narrower:
        leaving[state.free() & (leaving == 0) & ~(state.bound <= tolerance)] = Status.NOT_TRUSTED
    if not len(points):
        return leaving, np.empty((0, 2, 2)), ahead[:0], np.empty(0, dtype=bool)
    stress, status, bound = surrogate.lookup(F[points], F_dot[points], tolerance)
    limit = RETURN * tolerance
    returning = (status == 0) & (bound <= limit)
    returning &= (ahead[points] == 0) & (bound_ahead[points] <= limit)
    return leaving, stress, status, returning


def check_state(state: Any, count: int) -> CachedState:
    """The state, or an InputError if it is not one for so many points."""
    if not isinstance(state, CachedState) or state.count != count:
        raise InputError(
            f"state: not a state of a CachedLaw for {count} points; pass what an earlier answer "
            "for the same points carried, or None"
        )
    return state


def put_together(
    count: int, free: Indices, of_free: Tangents, held: Indices, of_held: Tangents | None
) -> Tangents:
    """Tangents of all points from those of two parts of them."""
    if of_held is None:
        return of_free
    by_F, by_F_dot = np.empty((2, count, 2, 2, 2, 2))
    by_F[free], by_F_dot[free] = of_free.P_by_F, of_free.P_by_F_dot
    by_F[held], by_F_dot[held] = of_held.P_by_F, of_held.P_by_F_dot
    return Tangents(by_F, by_F_dot)
