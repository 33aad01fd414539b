"""Audits: a share of the cache's answers is given to the true law too, and compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.error_record import ErrorRecord
from surrofe2.cache.parts import Fallback
from surrofe2.cache.point_set import Indices, beyond_bifurcation, state_of_both
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


@dataclass(frozen=True, slots=True)
class Audited:
    """What later audits may start from.

    Attributes:
        points: (k,) where audits were, each once. at: (k, 8) `together` of F and Ḟ there.
        state: the fallback's for these points, in this order.
    """

    points: Indices
    at: Array
    state: Any

    def only(self, chosen: NDArray[np.bool_]) -> Audited:
        """The points chosen (k,)."""
        places = chosen.nonzero()[0]
        return Audited(self.points[places], self.at[places], self.state.take(places))

    def and_also(self, more: Audited) -> Audited:
        """These points and others."""
        return Audited(
            np.concatenate([self.points, more.points]),
            np.concatenate([self.at, more.at]),
            state_of_both(self.state, len(self.points), more.state, len(more.points)),
        )


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
        self._known = Audited(np.empty(0, dtype=np.intp), np.empty((0, 8)), None)

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
        """The true law, each point from its own last audit, or else from that of nearest (F, Ḟ)."""
        known, start = self._known, None
        if len(known.points):
            places = np.full(1 + max(asked.points.max(), known.points.max()), -1)
            places[known.points] = np.arange(len(known.points))
            place = places[asked.points]
            new = (place < 0).nonzero()[0]
            if len(new):
                place[new] = nearest(known.at, together(asked.F[new], asked.F_dot[new]))
            start = known.state.take(place)
        answer = self._fallback.respond(asked.F, asked.F_dot, start)
        accepted = self._fallback.accept(asked.F, asked.F_dot, answer)
        self._remember(asked, accepted.status, accepted.state)
        return StressResponse(answer.stress, accepted.status, accepted.state)

    def _remember(self, asked: Question, status: NDArray[np.int8], state: Any) -> None:
        """Keep the state of the latest solved audit of each point."""
        if state is None:
            return
        points = asked.points
        latest = np.sort(len(points) - 1 - np.unique(points[::-1], return_index=True)[1])
        latest = latest[(status[latest] == 0) & ~beyond_bifurcation(state, len(points))[latest]]
        if not len(latest):
            return
        at = together(asked.F[latest], asked.F_dot[latest])
        fresh = Audited(points[latest], at, state.take(latest))
        old = ~np.isin(self._known.points, fresh.points)
        few = len(latest) <= 2 * BATCH and old.sum() + len(latest) <= REMEMBERED
        self._known = self._known.only(old).and_also(fresh) if few and old.any() else fresh

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


def together(F: Array, F_dot: Array) -> Array:
    """(n, 8) F and Ḟ times 1 µs side by side."""
    return np.concatenate([F.reshape(-1, 4), F_dot.reshape(-1, 4)], axis=1)


def nearest(known: Array, asked: Array) -> Indices:
    """(n,) the place in `known` (k, 8), k ≥ 1, that is nearest to each of `asked` (n, 8)."""
    from scipy.spatial import cKDTree  # here, because it takes long to import

    place: Indices = cKDTree(known).query(asked)[1].astype(np.intp)
    return place


def _joined(questions: list[Question]) -> Question:
    if len(questions) == 1:
        return questions[0]
    names = ("step", "points", "F", "F_dot", "stress", "bound")
    return Question(
        **{name: np.concatenate([getattr(each, name) for each in questions]) for name in names}
    )
