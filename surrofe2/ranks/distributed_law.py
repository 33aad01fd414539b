"""`DistributedLaw`: RVEs on many ranks, a stress law as any other on rank 0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.tiles import unpack
from surrofe2.ranks import rank_states
from surrofe2.ranks.crew_law import CrewLaw
from surrofe2.ranks.dealing import Index, deal, is_uneven, redeal
from surrofe2.ranks.desk import Told, dense
from surrofe2.ranks.rank_states import Place, RankState
from surrofe2.ranks.tasks import Accept, Answered, Respond
from surrofe2.rve.rve_law import RveLaw
from surrofe2.stress_law import Acceptance, StressResponse, check_deformation, require_tangents

Array = NDArray[np.float64]

PATIENCE = 8
"""Kept steps after which points may be dealt anew."""
_WEIGHT = 0.25
"""Of the latest step in how long the ranks take."""
_BYTES = {"respond": 96, "tangents": 256, "accept": 96}
"""A point that came and went."""


class DistributedLaw(CrewLaw[RveLaw]):
    """σ(F, Ḟ) of RVEs that live on the ranks of a crew; see `StressLaw` and `cache.Fallback`.

    Points are dealt in blocks of whole tiles. RVE states, with their factors, stay where they were
    made: on rank 0 a `RankState` stands for them. (F, Ḟ) and stresses travel. Answers are those
    of `law` itself, by any number of ranks. Where some ranks take longer than others, `accept`
    deals the points of the next step by what they cost.
    """

    @property
    def has_tangents(self) -> bool:
        """Whether `respond` gives tangents when asked."""
        return self.law.has_tangents

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> RankState:
        """The state whose `to_arrays`, or that of an `RveState`, gave these arrays."""
        points = int(arrays["points"])
        left = unpack(arrays["left"], points)
        state = self._new_state(self._dealt(points), left)
        self.crew.do(Place(state.number, self._number, state.cuts), arrays)
        return state

    def respond(
        self, F: Array, F_dot: Array, state: RankState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """As of `StressLaw`."""
        F, F_dot = check_deformation(F, F_dot)
        if tangents:
            require_tangents(self)
        if not len(F):
            return StressResponse(np.empty((0, 2, 2)), np.empty(0, np.int8), state, {})
        if state is None:
            cuts, before = self._dealt(len(F)), None
        else:
            cuts, before = self._checked(state, len(F)).cuts, state.number
        after = self._new_state(cuts, np.zeros(len(F), dtype=np.bool_))
        task = Respond(self._number, before, after.number, cuts, tangents)
        answer: Answered = self.crew.do(task, F, F_dot)
        size = _BYTES["respond"] + _BYTES["tangents"] * tangents
        seconds = self.crew.count(answer.told, size * self._away(after))
        if state is None:
            after.seconds = seconds
        else:
            after.seconds, after.steps = state.seconds + _WEIGHT * seconds, state.steps
        told, left = answer.told, _marked(len(F), answer.told)
        after.left_points = dense(len(F), [_ones(each.left) for each in told], np.bool_)
        effort: Counter[str] = Counter()
        for each in told:
            effort.update(each.effort)
        assert answer.values is not None
        return StressResponse(
            answer.values,
            dense(len(F), [each.status for each in told], np.int8),
            after,
            dict(effort),
            answer.tangents,
            left_bifurcation=left,
            reasons={k: why for each in told for k, why in each.reasons.items()},
        )

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """As of `StressLaw`; where that pays the points are dealt anew."""
        if not len(F):
            return Acceptance(response.status, response.state)
        F, F_dot = check_deformation(F, F_dot)
        state = self._checked(response.state, len(F))
        after = self._new_state(state.cuts, state.left_points)
        task = Accept(self._number, state.number, after.number, state.cuts)
        stress = np.ascontiguousarray(response.stress)
        answer: Answered = self.crew.do(task, F, F_dot, stress, response.status)
        spent = self.crew.count(answer.told, _BYTES["accept"] * self._away(after))
        after.seconds = (1.0 - _WEIGHT) * (state.seconds + _WEIGHT * spent)
        after.steps = state.steps + 1
        told, left = answer.told, _marked(len(F), answer.told)
        after.left_points = dense(len(F), [_ones(each.left) for each in told], np.bool_)
        changed = None
        for each in told:
            if each.stress is not None:
                changed = response.stress.copy() if changed is None else changed
                changed[each.stress[0]] = each.stress[1]
        status = dense(len(F), [each.status for each in told], np.int8)
        return Acceptance(status, self._levelled(after), changed, left)

    def _levelled(self, state: RankState) -> RankState:
        """The state dealt anew where some ranks take so much longer than others that it pays."""
        if state.steps < PATIENCE or not state.is_shared or not is_uneven(state.seconds):
            return state
        state.steps = 0
        cuts = redeal(state.cuts, state.seconds)
        return state if (cuts == state.cuts).all() else state.dealt(cuts)

    def _new_state(self, cuts: NDArray[np.int64], left: NDArray[np.bool_]) -> RankState:
        return RankState(self.crew, self._number, cuts, left)

    def _dealt(self, points: int) -> Index:
        return deal(points, self.crew.ranks, rank_states.LEAST)

    def _away(self, state: RankState) -> int:
        """Points of other ranks than 0."""
        return state.points - int(state.cuts[1])

    def _checked(self, state: Any, points: int) -> RankState:
        if isinstance(state, RankState) and state.points == points and state.law == self._number:
            return state
        raise InputError(
            f"state: not a state of this DistributedLaw for {points} points; pass what an earlier "
            "answer for the same points carried, or None"
        )


def _ones(points: NDArray[np.intp] | None) -> tuple[NDArray[np.intp], Any] | None:
    return None if points is None else (points, True)


def _marked(count: int, told: list[Told]) -> NDArray[np.bool_] | None:
    """(count,) points that left their branch; None: no rank says so."""
    if all(each.newly_left is None for each in told):
        return None
    return dense(count, [_ones(each.newly_left) for each in told], np.bool_)
