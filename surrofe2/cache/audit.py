"""Audits: a share of the cache's answers is given to the true law too, and compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.error_record import ErrorRecord
from surrofe2.cache.parts import Fallback
from surrofe2.cache.point_set import NOBODY, Indices, PointSet, answer_both
from surrofe2.stress_error import stress_error
from surrofe2.stress_law import StressResponse

Array = NDArray[np.float64]

BATCH = 16
"""Audits that wait for each other: RVEs are solved several at once for little more than one."""
REMEMBERED = 256
"""Points whose last audit is kept to start the next from; only the last batch, if it is large."""


@dataclass(frozen=True, slots=True)
class Question:
    """Answers of the cache to be audited, all arrays over k points.

    Attributes:
        step: (k,) accepted steps before them. points: (k,) where.
        F, F_dot, stress: (k, 2, 2) what was asked and answered. bound: (k,) of the error, µN/µm.
    """

    step: NDArray[np.int64]
    points: Indices
    F: Array
    F_dot: Array
    stress: Array
    bound: Array


@dataclass(frozen=True, slots=True)
class Finding:
    """What an audit found: the question, the truth, and where the tolerance was broken.

    state: the fallback's for these points.
    """

    asked: Question
    stress: Array
    status: NDArray[np.int8]
    error: Array
    broken: NDArray[np.bool_]
    state: Any


class Audit:
    """Chooses answers at random, by a seed, and compares them batch by batch.

    Attributes:
        record: of all audits so far.
    """

    def __init__(self, fallback: Fallback, share: float, seed: int, tolerance: float) -> None:
        self.record = ErrorRecord(tolerance)
        self._fallback = fallback
        self._share = share
        self._random = np.random.default_rng(seed)
        self._waiting: list[Question] = []
        self._known: PointSet = NOBODY

    def choose(self, points: Indices) -> Indices:
        """Those of the points that are to be audited, each with the share's probability."""
        if self._share == 0.0:
            return points[:0]
        return points[self._random.random(len(points)) < self._share]

    def wait(self, question: Question) -> bool:
        """Put a question on the pile; whether the pile is due."""
        if len(question.points):
            self._waiting.append(question)
        return sum(len(each.points) for each in self._waiting) >= BATCH

    def hold(self) -> Finding | None:
        """Audit all that waits; None where nothing does."""
        if not self._waiting:
            return None
        asked = _joined(self._waiting)
        self._waiting = []
        truth = self._solve(asked)
        error = stress_error(asked.stress, truth.stress)
        error[truth.status != 0] = np.nan
        broken = self.record.add(error)
        self._note_worst(asked, truth.stress, error)
        return Finding(asked, truth.stress, truth.status, error, broken, truth.state)

    def _solve(self, asked: Question) -> StressResponse:
        """The true law in the order of the question; warm at points that were audited before,
        where that is most of them.
        """
        places = np.full(1 + max(asked.points.max(), self._known.points.max(initial=0)), -1)
        places[self._known.points] = np.arange(len(self._known))
        place = places[asked.points]
        known, new = (place >= 0).nonzero()[0], (place < 0).nonzero()[0]
        warm = NOBODY
        if len(known) >= len(new) and self._known.state is not None:
            unchanged = np.array_equal(place, np.arange(len(self._known)))
            state = self._known.state if unchanged else self._known.state.take(place[known])
            warm = PointSet(known, np.zeros(len(known), dtype=np.int8), state)
        else:
            known, new = known[:0], np.arange(len(place))
        order = np.concatenate([known, new])
        answer = answer_both(self._fallback, asked.F, asked.F_dot, warm, new)
        F, F_dot = asked.F[order], asked.F_dot[order]
        accepted = self._fallback.accept(F, F_dot, answer)
        self._remember(asked.points[order], accepted.status, accepted.state)
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        state = accepted.state
        if state is not None and not np.array_equal(back, np.arange(len(back))):
            state = state.take(back)
        return StressResponse(answer.stress[back], accepted.status[back], state)

    def _remember(self, points: Indices, status: NDArray[np.int8], state: Any) -> None:
        """Keep the state of the latest solved audit of each point."""
        if state is None:
            return
        latest = np.unique(points[::-1], return_index=True)[1]
        latest = np.sort(len(points) - 1 - latest)
        chosen = np.zeros(len(points), dtype=bool)
        chosen[latest[status[latest] == 0]] = True
        fresh = PointSet(points, status, state).only(chosen)
        old = self._known.only(~np.isin(self._known.points, points))
        few = len(fresh) <= 2 * BATCH and len(old) + len(fresh) <= REMEMBERED
        if len(old) and len(fresh) and few:
            fresh = old.and_also(fresh.points, fresh.why, fresh.state)
        self._known = fresh if len(fresh) else self._known

    def _note_worst(self, asked: Question, truth: Array, error: Array) -> None:
        known = np.nan_to_num(error, nan=-1.0)
        k = int(known.argmax())
        if known[k] < 0.0 or (self.record.worst and known[k] <= self.record.largest):
            return
        self.record.largest = float(known[k])
        self.record.worst = {
            "error": float(known[k]),
            "bound": float(asked.bound[k]),
            "step": int(asked.step[k]),
            "point": int(asked.points[k]),
            "F": asked.F[k].tolist(),
            "F_dot": asked.F_dot[k].tolist(),
            "stress": asked.stress[k].tolist(),
            "true_stress": truth[k].tolist(),
        }


def _joined(questions: list[Question]) -> Question:
    if len(questions) == 1:
        return questions[0]
    names = ("step", "points", "F", "F_dot", "stress", "bound")
    return Question(
        **{name: np.concatenate([getattr(each, name) for each in questions]) for name in names}
    )
