"""The branch of each point, surrogate or fallback, and when it changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.compilation import kernel
from surrofe2.base.tensors import to_inputs
from surrofe2.cache.protocols import Fallback, Surrogate
from surrofe2.cache.trust import RETURN, STAY
from surrofe2.law.stress_law import Status, state_arrays, state_of
from surrofe2.run.journal import part_of, within

NOT_TRUSTED = np.int8(Status.NOT_TRUSTED)


@dataclass(frozen=True, slots=True)
class PointSet:
    """Points in any order, each once.

    Attributes:
        points: (k,) their numbers.
        why: (k,) int8 `Status` for which the surrogate first did not answer them.
        state: the fallback's state for the k points in this order, or None.
    """

    points: Index
    why: NDArray[np.int8]
    state: Any = None

    def __len__(self) -> int:
        return len(self.points)

    def only(self, chosen: Flags) -> PointSet:
        """Return those of the points that are chosen, (k,) flags, with their states."""
        places = chosen.nonzero()[0]
        if not len(places):
            return NO_POINTS
        if len(places) == len(self):
            return self
        state = None if self.state is None else self.state.take(places)
        return PointSet(self.points[places], self.why[places], state)

    def and_also(self, others: PointSet) -> PointSet:
        """Return these points, and others behind them, with the states of both."""
        if not len(self):
            return others
        if not len(others):
            return self
        count = len(self)
        state = self.state
        if state is not None:
            # make room by copies of the first point's state, then put the others' states there
            places = np.append(np.arange(count), np.zeros(len(others), dtype=np.intp))
            state = state.take(places).put(np.arange(count, len(places)), others.state)
        points = np.concatenate([self.points, others.points])
        return PointSet(points, np.concatenate([self.why, others.why]), state)


NO_POINTS = PointSet(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int8))


@dataclass(frozen=True, slots=True)
class CachedState:
    """The points that the fallback answers, and what the next step needs to know.

    Attributes:
        count: n, the number of points.
        on_fallback: those that the fallback answers until the step is accepted, with its state.
        limit: largest risk of an answer of the surrogate in this step; negative: nothing is
            trusted.
        reach: (7,) sizes of inputs up to which the surrogate is trusted.
        risk: (n,) of the answer that carries this state, inf where the fallback gave it; or None.
        before: (F, Ḟ) at the last accepted step, or None.
    """

    count: int
    on_fallback: PointSet
    limit: float
    reach: Array
    risk: Array | None = None
    before: tuple[Array, Array] | None = None

    def to_arrays(self, fallback: Fallback) -> dict[str, NDArray]:
        """Return arrays for a checkpoint.

        The state must be that of an accepted step, which carries no risk, or one to begin cold
        from, which knows no accepted step either.
        """
        return {
            "count": np.array(self.count),
            "limit": np.array(self.limit),
            "reach": self.reach,
            "points": self.on_fallback.points,
            "why": self.on_fallback.why,
            **({} if self.before is None else {"before": np.stack(self.before)}),
            **within("fallback", state_arrays(fallback, self.on_fallback.state)),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], fallback: Fallback) -> CachedState:
        """Return the state whose `to_arrays` gave `arrays`, with a warm start of this fallback."""
        state = state_of(fallback, part_of(arrays, "fallback"))
        return cls(
            count=int(arrays["count"]),
            on_fallback=PointSet(arrays["points"].astype(np.intp), arrays["why"], state),
            limit=float(arrays["limit"]),
            reach=arrays["reach"],
            before=tuple(arrays["before"]) if "before" in arrays else None,
        )

    def free(self) -> Flags:
        """Return (n,) flags: the points that the surrogate may answer."""
        free = np.ones(self.count, dtype=bool)
        free[self.on_fallback.points] = False
        return free


def look_up(
    surrogate: Surrogate, F: Array, F_dot: Array, limit: float, reach: Array
) -> tuple[Array, NDArray[np.int8], Array]:
    """Look up stresses of the surrogate; none is trusted where an input exceeds `reach` (7,).

    Returns:
        As `Surrogate.lookup`: stress (n, 2, 2), status (n,) and risk (n,).
    """
    stress, status, risk = surrogate.lookup(F, F_dot, limit)
    if np.isfinite(reach).any():
        known = np.flatnonzero(status == 0)
        x, _ = to_inputs(F[known], F_dot[known])
        beyond = known[(np.abs(x) > reach).any(axis=1)]
        stress[beyond] = np.nan
        status[beyond] = NOT_TRUSTED
        risk[beyond] = np.inf
    return stress, status, risk


def look_up_free(
    surrogate: Surrogate, F: Array, F_dot: Array, state: CachedState
) -> tuple[Array, NDArray[np.int8], Array]:
    """Look up stresses of the surrogate at the points that it may answer by this state.

    Returns:
        As `look_up`, with stress 0, status 0 and an infinite risk at points on the fallback.
    """
    if not len(state.on_fallback) and state.limit >= 0.0:
        return look_up(surrogate, F, F_dot, state.limit, state.reach)
    stress = np.zeros_like(F)
    risk = np.full(len(F), np.inf)
    status = np.zeros(len(F), dtype=np.int8)
    free = state.free()
    if state.limit < 0.0:
        status[free] = NOT_TRUSTED
    elif free.any():
        answer = look_up(surrogate, F[free], F_dot[free], state.limit, state.reach)
        stress[free], status[free], risk[free] = answer
    return stress, status, risk


def choose_branches(
    surrogate: Surrogate,
    F: Array,
    F_dot: Array,
    state: CachedState,
    limit: float,
    reach: Array,
) -> tuple[NDArray[np.int8], Array, NDArray[np.int8], Flags]:
    """Choose which points must leave the surrogate for the next step, and which may return to it.

    The choice is by the risk now and at (F, Ḟ) extrapolated to the end of the next step, so that
    few points have to leave within it, which would repeat the step.

    Args:
        F, F_dot: (n, 2, 2) at the end of an accepted step.
        state: which points are on the fallback, and by which limit and reach.
        limit, reach: those of the next step.

    Returns:
        (n,) int8: why a free point must leave, 0 where it may stay.
        (k, 2, 2), (k,): the surrogate's stress and status at the k points on the fallback, now;
            of none where nothing is trusted.
        (k,): whether each of them may return.
    """
    points = state.on_fallback.points
    free = state.free()
    no_stress = np.empty((0, 2, 2))
    no_status = np.empty(0, dtype=np.int8)
    none_returns = np.zeros(len(points), dtype=np.bool_)
    if limit < 0.0:
        return np.where(free, NOT_TRUSTED, np.int8(0)), no_stress, no_status, none_returns
    F_next, F_dot_next = extrapolate(F, F_dot, state.before)
    if np.isfinite(reach).any():
        _, ahead, risk_ahead = look_up(surrogate, F_next, F_dot_next, limit, reach)
    else:
        ahead, risk_ahead = surrogate.status_and_risk(F_next, F_dot_next, limit)
    if state.risk is not None:
        # near the limit only a rising risk is a reason to leave
        rising = (risk_ahead > STAY * limit) & (risk_ahead > state.risk)
        ahead = np.where((ahead == 0) & rising, NOT_TRUSTED, ahead)
    leaving = np.where(free, ahead, np.int8(0))
    if limit < state.limit or not np.array_equal(reach, state.reach):
        # with less trust than in this step, what it answered now may not be trusted any more
        now = look_up(surrogate, F, F_dot, limit, reach)[1]
        leaving = np.where(free & (leaving == 0), now, leaving)
    if not len(points):
        return leaving, no_stress, no_status, none_returns
    stress, status, risk = look_up(surrogate, F[points], F_dot[points], limit, RETURN * reach)
    returning = (status == 0) & (risk <= RETURN * limit)
    returning &= (ahead[points] == 0) & (risk_ahead[points] <= RETURN * limit)
    return leaving, stress, status, returning


def extrapolate(F: Array, F_dot: Array, before: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """Extrapolate (F, Ḟ) over one step ahead of the same length h as the last, by Hermite's cubic.

        F₊ = F − 5 ΔF + h (4 Ḟ + 2 Ḟ₋),    Ḟ₊ = 8 Ḟ + 5 Ḟ₋ − 12 ΔF/h

    A law is not told h. Here it is the length by which the mean of the two rates comes closest to
    ΔF = F − F₋, over all points. Without rates, as in a quasi-static run, F is extrapolated
    linearly. Without a step `before`, F and Ḟ are returned as they are.
    """
    if before is None or before[0].shape != F.shape:
        return F, F_dot
    F_before, F_dot_before = before
    F_next, F_dot_next = _ahead(F, F_dot, F_before, F_dot_before)
    return F_next, F_dot_next


@kernel
def _ahead(F: Any, F_dot: Any, F_before: Any, F_dot_before: Any) -> Any:
    """Compute `extrapolate` with a step before, in two passes over the entries of all points.

    With s = Ḟ + Ḟ₋, least squares give h = 2 (ΔF·s)/(s·s).
    """
    now = F.ravel()
    rate = F_dot.ravel()
    before = F_before.ravel()
    rate_before = F_dot_before.ravel()
    sum_squared = 0.0  # s·s
    change_by_sum = 0.0  # ΔF·s
    for k in range(now.size):
        both = rate[k] + rate_before[k]
        sum_squared += both * both
        change_by_sum += (now[k] - before[k]) * both
    length = 2.0 * change_by_sum / sum_squared if sum_squared > 0.0 else 0.0
    F_next = np.empty_like(F)
    F_dot_next = np.empty_like(F_dot)
    out = F_next.ravel()
    rate_out = F_dot_next.ravel()
    if not length > 0.0:
        for k in range(now.size):
            out[k] = now[k] + (now[k] - before[k])
            rate_out[k] = rate[k]
        return F_next, F_dot_next
    for k in range(now.size):
        change = now[k] - before[k]
        out[k] = now[k] - 5.0 * change + length * (4.0 * rate[k] + 2.0 * rate_before[k])
        turned = 8.0 * rate[k] + 5.0 * rate_before[k]
        rate_out[k] = turned - (12.0 / length) * change
    return F_next, F_dot_next


def are_unique(state: Any, count: int) -> Flags:
    """Return (count,) False where, by the fallback's state, the stress is one of several.

    So it is at points that have left a branch at a bifurcation. Without a state there are none.
    """
    if state is None:
        return np.ones(count, dtype=np.bool_)
    return ~np.asarray(state.left_points)
