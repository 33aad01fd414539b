"""Points that the fallback answers, with its warm start for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Fallback
from surrofe2.stress_law import StressResponse

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class PointSet:
    """Points in any order, each once.

    Attributes:
        points: (k,) indices.
        why: (k,) int8 `Status` for which the surrogate first did not answer them.
        state: the fallback's state for the k points in this order, or None.
    """

    points: Indices
    why: NDArray[np.int8]
    state: Any = None

    def __len__(self) -> int:
        return len(self.points)

    def only(self, chosen: NDArray[np.bool_]) -> PointSet:
        """The points chosen (k,)."""
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


NOBODY = PointSet(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int8))


def state_of_both(first: Any, count: int, second: Any, more: int) -> Any:
    """The fallback's state for `count` points and then `more` others; None: it keeps none."""
    if first is None or second is None:
        return second if first is None else first
    places = np.zeros(count + more, dtype=np.intp)  # any will do for those to be put over
    places[:count] = np.arange(count)
    return first.take(places).put(np.arange(count, count + more), second)


def beyond_bifurcation(state: Any, count: int) -> NDArray[np.bool_]:
    """(count,) whether the fallback's state says that the stress there is one of several."""
    left: NDArray[np.bool_]
    left = np.zeros(count, dtype=np.bool_) if state is None else state.left_points
    return left


def answer_both(
    law: Fallback,
    F: Array,
    F_dot: Array,
    known: PointSet,
    new: Indices,
    *,
    tangents: bool = False,
) -> StressResponse:
    """The law at the known points, warm, and then at new ones, cold."""
    if not len(new):
        return law.respond(F[known.points], F_dot[known.points], known.state, tangents=tangents)
    cold = law.respond(F[new], F_dot[new], None, tangents=tangents)
    if not len(known):
        return cold
    warm = law.respond(F[known.points], F_dot[known.points], known.state, tangents=tangents)
    return StressResponse(
        np.concatenate([warm.stress, cold.stress]),
        np.concatenate([warm.status, cold.status]),
        state_of_both(warm.state, len(known), cold.state, len(new)),
        added(warm.effort, cold.effort),
        joined_tangents(warm, cold),
    )


def joined_tangents(first: StressResponse, second: StressResponse) -> Any:
    """Tangents of both one after the other; None where there are none."""
    one, two = first.tangents, second.tangents
    if one is None or two is None:
        return None
    return type(one)(
        np.concatenate([one.P_by_F, two.P_by_F]),
        np.concatenate([one.P_by_F_dot, two.P_by_F_dot]),
    )


def added(effort: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Sum by name."""
    total = dict(effort)
    for name, value in more.items():
        total[name] = total.get(name, 0) + value
    return total
