"""Audits: a share of the cache's answers is given to the true law too, and compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.error_record import ErrorRecord
from surrofe2.cache.point_set import Indices, beyond_bifurcation
from surrofe2.cache.protocols import Fallback
from surrofe2.stress_law import StressResponse
from surrofe2.tensors import stress_error

Array = NDArray[np.float64]

BATCH = 16
"""Audits that wait for each other: RVEs are solved several at once for little more than one."""


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
        self._last: tuple[Indices, Array, Any] | None = None

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
        """The true law, from the last batch: of the same points, or else of nearest (F, Ḟ)."""
        at, start = together(asked.F, asked.F_dot), None
        if self._last is not None:
            points, known, state = self._last
            same = np.array_equal(points, asked.points)
            start = state if same else state.take(nearest(known, at))
        answer = self._fallback.respond(asked.F, asked.F_dot, start)
        accepted = self._fallback.accept(asked.F, asked.F_dot, answer)
        self._remember(asked.points, at, accepted.status, accepted.state)
        return StressResponse(answer.stress, accepted.status, accepted.state)

    def _remember(self, points: Indices, at: Array, status: NDArray[np.int8], state: Any) -> None:
        """Keep what can be started from: stable, on the branch of the reference."""
        good = ((status == 0) & ~beyond_bifurcation(state, len(at))).nonzero()[0]
        if state is not None and len(good):
            self._last = points[good], at[good], state.take(good)

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
