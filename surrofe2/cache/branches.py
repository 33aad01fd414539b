"""Which point is answered by the surrogate, which by the fallback, and when that changes."""

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
        why: (k,) int8 `Status` for which the surrogate first did not answer them.
        state: the fallback's state for the k points in this order, or None.
    """

    points: Index
    why: NDArray[np.int8]
    state: Any = None

    def __len__(self) -> int:
        return len(self.points)

    def only(self, chosen: Flags) -> PointSet:
        places = chosen.nonzero()[0]
        if len(places) in (0, len(self)):
            return self if len(places) else NO_POINTS
        state = None if self.state is None else self.state.take(places)
        return PointSet(self.points[places], self.why[places], state)

    def and_also(self, others: PointSet) -> PointSet:
        """These points, and others behind them."""
        if not len(self) or not len(others):
            return self if len(self) else others
        count = len(self)
        state = self.state
        if state is not None:
            places = np.append(np.arange(count), np.zeros(len(others), dtype=np.intp))
            state = state.take(places).put(np.arange(count, len(places)), others.state)
        points = np.concatenate([self.points, others.points])
        return PointSet(points, np.concatenate([self.why, others.why]), state)


NO_POINTS = PointSet(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int8))


@dataclass(frozen=True, slots=True)
class CachedState:
    """Who is answered by the fallback, and what the next step needs to know.

    Attributes:
        count: n, the points there are.
        on_fallback: those the fallback answers until the step is accepted, with its warm start.
        limit: that risks are compared with during this step; negative: nothing is trusted.
        reach: (7,) sizes of inputs up to which the surrogate is trusted.
        risk: (n,) of the answer this came with, inf where the fallback gave it; or None.
        before: (F, Ḟ) at the last accepted step, or None.
    """

    count: int
    on_fallback: PointSet
    limit: float
    reach: Array
    risk: Array | None = None
    before: tuple[Array, Array] | None = None

    def to_arrays(self, fallback: Fallback) -> dict[str, NDArray]:
        """Arrays of a state that was accepted, which carries no risk, or of one to begin cold from,
        which knows no accepted step either."""
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
        """The state whose `to_arrays` gave `arrays`, with the warm start of this fallback."""
        state = state_of(fallback, part_of(arrays, "fallback"))
        return cls(
            count=int(arrays["count"]),
            on_fallback=PointSet(arrays["points"].astype(np.intp), arrays["why"], state),
            limit=float(arrays["limit"]),
            reach=arrays["reach"],
            before=tuple(arrays["before"]) if "before" in arrays else None,
        )

    def free(self) -> Flags:
        """(n,) the points that the surrogate may answer."""
        free = np.ones(self.count, dtype=bool)
        free[self.on_fallback.points] = False
        return free


def look_up(
    surrogate: Surrogate, F: Array, F_dot: Array, limit: float, reach: Array
) -> tuple[Array, NDArray[np.int8], Array]:
    """As `Surrogate.lookup`, not trusted where an input is larger than `reach` (7,)."""
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
    """As `look_up`, with stress 0, status 0 and an infinite risk at points on the fallback."""
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
    """Return which points must leave the surrogate for the next step, and which may return to it.

    Returns:
        (n,) int8: why a free point must leave, 0 where it may stay.
        (k, 2, 2), (k,): the surrogate's stress and status at the k points on the fallback, now;
            of none where nothing is trusted.
        (k,): whether each of them may return.
    """
    points = state.on_fallback.points
    free = state.free()
    none = np.empty((0, 2, 2)), np.empty(0, dtype=np.int8), np.zeros(len(points), dtype=np.bool_)
    if limit < 0.0:
        return np.where(free, NOT_TRUSTED, np.int8(0)), *none
    there = extrapolate(F, F_dot, state.before)
    if np.isfinite(reach).any():
        _, ahead, risk_ahead = look_up(surrogate, *there, limit, reach)
    else:
        ahead, risk_ahead = surrogate.status_and_risk(*there, limit)
    if state.risk is not None:
        rising = (risk_ahead > STAY * limit) & (risk_ahead > state.risk)
        ahead = np.where((ahead == 0) & rising, NOT_TRUSTED, ahead)
    leaving = np.where(free, ahead, np.int8(0))
    if limit < state.limit or not np.array_equal(reach, state.reach):
        now = look_up(surrogate, F, F_dot, limit, reach)[1]
        leaving = np.where(free & (leaving == 0), now, leaving)
    if not len(points):
        return leaving, *none
    stress, status, risk = look_up(surrogate, F[points], F_dot[points], limit, RETURN * reach)
    returning = (status == 0) & (risk <= RETURN * limit)
    returning &= (ahead[points] == 0) & (risk_ahead[points] <= RETURN * limit)
    return leaving, stress, status, returning


def extrapolate(F: Array, F_dot: Array, before: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """Hermite extrapolation of (F, Ḟ) over one step ahead of the same length h as the last.

        F₊ = F − 5 ΔF + h (4 Ḟ + 2 Ḟ₋),    Ḟ₊ = 8 Ḟ + 5 Ḟ₋ − 12 ΔF/h

    A law is not told h; here it is that by which the mean of the two rates comes closest to
    ΔF = F − F₋, over all points. Without rates, as in a quasi-static run, F goes straight on;
    without a step before all is as it is now.
    """
    if before is None or before[0].shape != F.shape:
        return F, F_dot
    there, rate_there = _ahead(F, F_dot, *before)
    return there, rate_there


@kernel
def _ahead(F: Any, F_dot: Any, F_before: Any, F_dot_before: Any) -> Any:
    """`extrapolate` with a step before, in two passes over the points."""
    now = F.ravel()
    rate = F_dot.ravel()
    before = F_before.ravel()
    rate_before = F_dot_before.ravel()
    speed = 0.0
    done = 0.0
    for k in range(now.size):
        both = rate[k] + rate_before[k]
        speed += both * both
        done += (now[k] - before[k]) * both
    length = 2.0 * done / speed if speed > 0.0 else 0.0
    there = np.empty_like(F)
    rate_there = np.empty_like(F_dot)
    out = there.ravel()
    rate_out = rate_there.ravel()
    if not length > 0.0:
        for k in range(now.size):
            out[k] = now[k] + (now[k] - before[k])
            rate_out[k] = rate[k]
        return there, rate_there
    for k in range(now.size):
        change = now[k] - before[k]
        out[k] = now[k] - 5.0 * change + length * (4.0 * rate[k] + 2.0 * rate_before[k])
        turned = 8.0 * rate[k] + 5.0 * rate_before[k]
        rate_out[k] = turned - (12.0 / length) * change
    return there, rate_there


def are_unique(state: Any, count: int) -> Flags:
    """(count,) False where, by the fallback's state, the stress is one of several."""
    return np.ones(count, dtype=np.bool_) if state is None else ~np.asarray(state.left_points)
