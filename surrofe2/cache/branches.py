"""Which point is answered by the surrogate, which by the fallback, and when that changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.tensors import to_inputs
from surrofe2.cache.protocols import Fallback, Surrogate
from surrofe2.cache.trust import RETURN, STAY
from surrofe2.law.stress_law import Status, StressResponse, Tangents
from surrofe2.run.journal import part_of, within

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NOT_TRUSTED = np.int8(Status.NOT_TRUSTED)


def is_ready(tensors: Any) -> bool:
    """Whether tensors are a contiguous float64 array (n, 2, 2), as it must be."""
    return (
        isinstance(tensors, np.ndarray)
        and tensors.dtype == np.float64
        and tensors.shape[1:] == (2, 2)
        and tensors.flags.c_contiguous
    )


@dataclass(frozen=True, slots=True)
class PointSet:
    """Points in any order, each once.

    Attributes:
        why: (k,) int8 `Status` for which the surrogate first did not answer them.
        state: the fallback's state for the k points in this order, or None.
    """

    points: Indices
    why: NDArray[np.int8]
    state: Any = None

    def __len__(self) -> int:
        return len(self.points)

    def only(self, chosen: NDArray[np.bool_]) -> PointSet:
        if chosen.all():
            return self
        places = chosen.nonzero()[0]
        state = self.state if self.state is None or not len(places) else self.state.take(places)
        return PointSet(self.points[places], self.why[places], state if len(places) else None)

    def and_also(self, points: Indices, why: NDArray[np.int8], state: Any) -> PointSet:
        """These points and others, with the fallback's state for those."""
        return PointSet(
            np.concatenate([self.points, points]),
            np.concatenate([self.why, why]),
            state_of_both(self.state, len(self), state, len(points)),
        )


NO_POINTS = PointSet(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int8))


@dataclass(frozen=True, slots=True)
class CachedState:
    """Who is answered by the fallback, and what the next step needs to know.

    Attributes:
        count: n, the points there are.
        on_fallback: those the fallback answers until the step is accepted, with its warm start.
        limit: that risks are compared with during this step; negative: nothing is trusted.
        reach: (7,) sizes of inputs up to which the surrogate is trusted; None: wherever it answers.
        risk: (n,) of the answer this came with, inf where the fallback gave it; or None.
        before: (F, Ḟ) at the last accepted step, or None.
    """

    count: int
    on_fallback: PointSet = NO_POINTS
    limit: float = np.inf
    reach: Array | None = None
    risk: Array | None = None
    before: tuple[Array, Array] | None = None

    def to_arrays(self) -> dict[str, NDArray]:
        """Of a state that was accepted, which carries no risk."""
        before = np.empty((0, self.count, 2, 2)) if self.before is None else np.stack(self.before)
        fallback = self.on_fallback.state
        return {
            "count": np.array(self.count),
            "limit": np.array(self.limit),
            "reach": as_array(self.reach),
            "points": self.on_fallback.points,
            "why": self.on_fallback.why,
            "before": before,
            **within("fallback", {} if fallback is None else fallback.to_arrays()),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], fallback: Fallback) -> CachedState:
        """The state whose `to_arrays` gave `arrays`, with the warm start of this fallback."""
        known, before = part_of(arrays, "fallback"), arrays["before"]
        state = fallback.state_from_arrays(known) if known else None
        on_fallback = PointSet(arrays["points"].astype(np.intp), arrays["why"], state)
        return cls(
            count=int(arrays["count"]),
            on_fallback=on_fallback,
            limit=float(arrays["limit"]),
            reach=arrays["reach"] if len(arrays["reach"]) else None,
            before=(before[0], before[1]) if len(before) else None,
        )

    def free(self) -> NDArray[np.bool_]:
        """(n,) the points that the surrogate may answer."""
        free = np.ones(self.count, dtype=bool)
        free[self.on_fallback.points] = False
        return free


@dataclass(frozen=True, slots=True)
class Narrowed:
    """A surrogate that is trusted only where no input is larger than `reach` (7,)."""

    surrogate: Surrogate
    reach: Array

    def lookup(self, F: Array, F_dot: Array, limit: float) -> tuple[Array, NDArray[np.int8], Array]:
        stress, status, risk = self.surrogate.lookup(F, F_dot, limit)
        known = np.flatnonzero(status == 0)
        x, _ = to_inputs(F[known], F_dot[known])
        beyond = known[(np.abs(x) > self.reach).any(axis=1)]
        stress[beyond], status[beyond], risk[beyond] = np.nan, Status.NOT_TRUSTED, np.inf
        return stress, status, risk

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float
    ) -> tuple[NDArray[np.int8], Array]:
        return self.lookup(F, F_dot, limit)[1:]


def as_array(reach: Array | None) -> Array:
    """A reach as an array, empty where there is none."""
    return np.empty(0) if reach is None else reach


def trusted(surrogate: Surrogate, reach: Array | None, share: float = 1.0) -> Surrogate | Narrowed:
    """The surrogate, or so far as it is trusted, or a share of that."""
    return surrogate if reach is None else Narrowed(surrogate, share * reach)


def look_up(
    surrogate: Surrogate, F: Array, F_dot: Array, state: CachedState
) -> tuple[Array, NDArray[np.int8], Array]:
    """As `Surrogate.lookup`, with stress 0, status 0 and an infinite risk at points held."""
    known = trusted(surrogate, state.reach)
    if not len(state.on_fallback) and state.limit >= 0.0:
        return known.lookup(F, F_dot, state.limit)
    stress, risk = np.zeros_like(F), np.full(len(F), np.inf)
    status = np.zeros(len(F), dtype=np.int8)
    free = state.free()
    if state.limit < 0.0:
        status[free] = Status.NOT_TRUSTED
    elif free.any():
        answer = known.lookup(F[free], F_dot[free], state.limit)
        stress[free], status[free], risk[free] = answer
    return stress, status, risk


def choose_branches(
    surrogate: Surrogate,
    F: Array,
    F_dot: Array,
    state: CachedState,
    limit: float,
    reach: Array | None,
) -> tuple[NDArray[np.int8], Array, NDArray[np.int8], NDArray[np.bool_]]:
    """Which points must leave the surrogate for the next step, and which may return to it.

    Returns:
        (n,) int8: why a free point must leave, 0 where it may stay.
        (k, 2, 2), (k,): the surrogate's stress and status at the k points on the fallback, now.
        (k,): whether each of them may return.
    """
    points, free = state.on_fallback.points, state.free()
    there = extrapolate(F, F_dot, state.before)
    known = trusted(surrogate, reach)
    ahead, risk_ahead = known.status_and_risk(*there, limit)
    if state.risk is not None:
        rising = (risk_ahead > STAY * limit) & (risk_ahead > state.risk)
        ahead = np.where((ahead == 0) & rising, NOT_TRUSTED, ahead)
    leaving = np.where(free, ahead, np.int8(0))
    is_same = reach is state.reach or np.array_equal(as_array(reach), as_array(state.reach))
    if limit < state.limit or not is_same:
        now = known.lookup(F, F_dot, limit)[1]
        leaving = np.where(free & (leaving == 0), now, leaving)
    if not len(points):
        return leaving, np.empty((0, 2, 2)), ahead[:0], np.empty(0, dtype=bool)
    near = trusted(surrogate, reach, RETURN)
    stress, status, risk = near.lookup(F[points], F_dot[points], limit)
    returning = (status == 0) & (risk <= RETURN * limit)
    returning &= (ahead[points] == 0) & (risk_ahead[points] <= RETURN * limit)
    return leaving, stress, status, returning


def check_state(state: Any, count: int) -> CachedState:
    """The state, or an InputError if it is not one for so many points."""
    if not isinstance(state, CachedState) or state.count != count:
        raise InputError(
            f"state: not a state of a CachedLaw for {count} points; pass what an earlier answer "
            "for the same points carried, or None"
        )
    return state


def extrapolate(F: Array, F_dot: Array, before: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """Hermite extrapolation of (F, Ḟ) over one step ahead of the same length h as the last.

        F₊ = F − 5 ΔF + h (4 Ḟ + 2 Ḟ₋),    Ḟ₊ = 8 Ḟ + 5 Ḟ₋ − 12 ΔF/h

    A law is not told h; here it is that by which the mean of the two rates comes closest to
    ΔF = F − F₋, over all points. Without rates, as in a quasi-static run, F goes straight on;
    without a step before all is as it is now.
    """
    if before is None or before[0].shape != F.shape:
        return F, F_dot
    change, rates = F - before[0], F_dot + before[1]
    speed = np.vdot(rates, rates)
    length = 2.0 * np.vdot(change, rates) / speed if speed > 0.0 else 0.0
    if not length > 0.0:
        return F + change, F_dot
    return (
        F - 5.0 * change + length * (4.0 * F_dot + 2.0 * before[1]),
        8.0 * F_dot + 5.0 * before[1] - (12.0 / length) * change,
    )


def state_of_both(first: Any, count: int, second: Any, more: int) -> Any:
    """The fallback's state for `count` points and then `more` others; None: it keeps none."""
    if first is None or second is None:
        return second if first is None else first
    places = np.append(np.arange(count), np.zeros(more, dtype=np.intp))  # the rest is put over
    return first.take(places).put(np.arange(count, count + more), second)


def beyond_bifurcation(state: Any, count: int) -> NDArray[np.bool_]:
    """(count,) where, by the fallback's state, the stress is one of several."""
    return np.zeros(count, dtype=np.bool_) if state is None else np.asarray(state.left_points)


def answer_both(
    law: Fallback, F: Array, F_dot: Array, known: PointSet, new: Indices, *, tangents: bool = False
) -> StressResponse:
    """The law at the known points, warm, and then at new ones, cold."""
    at_known = F[known.points], F_dot[known.points]
    if not len(new):
        return law.respond(*at_known, known.state, tangents=tangents)
    cold = law.respond(F[new], F_dot[new], None, tangents=tangents)
    if not len(known):
        return cold
    warm = law.respond(*at_known, known.state, tangents=tangents)
    return StressResponse(
        np.concatenate([warm.stress, cold.stress]),
        np.concatenate([warm.status, cold.status]),
        state_of_both(warm.state, len(known), cold.state, len(new)),
        added(warm.effort, cold.effort),
        joined_tangents(warm.tangents, cold.tangents),
    )


def accept_known(law: Fallback, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
    """The response after the fallback has accepted its points."""
    state: CachedState = response.state
    points = state.on_fallback.points
    if not len(points):
        return response
    warm = state.on_fallback.state
    answer = StressResponse(response.stress[points], response.status[points], warm)
    accepted = law.accept(F[points], F_dot[points], answer)
    status, stress, left = response.status.copy(), response.stress, None
    status[points] = accepted.status
    if accepted.left_bifurcation is not None:
        stress, left = stress.copy(), np.zeros(len(status), dtype=np.bool_)
        stress[points], left[points] = accepted.stress, accepted.left_bifurcation
    state = replace(state, on_fallback=replace(state.on_fallback, state=accepted.state))
    return replace(response, stress=stress, status=status, state=state, left_bifurcation=left)


def joined_tangents(first: Tangents | None, second: Tangents | None) -> Tangents | None:
    """Tangents of both, one after the other; of either where the other has none."""
    if first is None or second is None:
        return second if first is None else first
    pairs = (first.P_by_F, second.P_by_F), (first.P_by_F_dot, second.P_by_F_dot)
    return Tangents(*map(np.concatenate, pairs))


def tangents_of_both(
    surrogate: Surrogate, F: Array, F_dot: Array, state: CachedState, of_known: Tangents | None
) -> Tangents | None:
    """Those of the surrogate at free points and of the fallback, `of_known`, at its own."""
    free, known = state.free().nonzero()[0], state.on_fallback.points
    if not len(known):
        return surrogate.tangents(F, F_dot)
    both = joined_tangents(surrogate.tangents(F[free], F_dot[free]), of_known)
    if both is None:
        return None
    place = np.argsort(np.concatenate([free, known]))
    return Tangents(both.P_by_F[place], both.P_by_F_dot[place])


def added(effort: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Sum by name."""
    return {name: effort.get(name, 0) + more.get(name, 0) for name in {**effort, **more}}
