"""Audits: answers of the cache, chosen at random, are compared with RVEs.

Each answer at a kept step draws a number u from [0, 1). It is audited at once where u is below the
audited fraction. Answers with the next smallest u are remembered, as many as `trust.AUDITS` audits
are short of, and audited where a run ends with fewer: so a run of any length has at least so many
audits, and those of a window are a simple random sample of its answers (bottom-k sampling).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.simd import TILE
from surrofe2.base.tensors import stress_error
from surrofe2.cache.branches import Indices, beyond_bifurcation
from surrofe2.cache.protocols import Fallback, Surrogate
from surrofe2.cache.trust import AUDITS, wrong_at_most
from surrofe2.law.stress_law import StressResponse
from surrofe2.run.journal import part_of, within

Array = NDArray[np.float64]

BATCH = 16
"""Audits that wait for each other: RVEs are solved several at once for little more than one."""
BINS_A_DECADE = 50
"""A quantile is the upper edge of its bin: at most 4.7 % too large, never too small."""
_LOWEST, _HIGHEST = -12, 6
_EDGES = 10.0 ** np.linspace(_LOWEST, _HIGHEST, (_HIGHEST - _LOWEST) * BINS_A_DECADE + 1)
QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass
class ErrorRecord:
    """Audited answers of a cache and the error each had, as often as it counts, µN/µm.

    Attributes:
        tolerance: allowed error, µN/µm; inf: none is.
        audited: answers that were audited; rolled_back: more, at steps that do not stand.
        unsolved: of these, those for which the RVE has no stress.
        violations: errors above the tolerance, and the unsolved.
        bins: (b,) errors by size, in logarithmic bins; a list is taken too.
        stress_squares: sum of the squares of what stresses come to, as often as errors count.
        worst: the largest error with what was asked and answered.
    """

    tolerance: float
    audited: int = 0
    rolled_back: int = 0
    unsolved: int = 0
    violations: int = 0
    largest: float = 0.0
    sum_of_squares: float = 0.0
    stress_squares: float = 0.0
    bins: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(len(_EDGES) + 1, dtype=np.int64)
    )
    worst: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        self.bins = np.array(self.bins, dtype=np.int64)

    def add(self, error: Array, size: Array | float = np.inf) -> NDArray[np.bool_]:
        """Record errors (k,), NaN where there is no truth, and sizes of the stresses; which of them
        are violations."""
        broken: NDArray[np.bool_] = ~(error <= self.tolerance)
        known = error[~np.isnan(error)]
        self.audited += len(error)
        self.unsolved += len(error) - len(known)
        self.violations += int(broken.sum())
        self.sum_of_squares += float(known @ known)
        sizes = np.broadcast_to(size, error.shape)[~np.isnan(error)]
        self.stress_squares += float((sizes**2).sum())
        np.add.at(self.bins, np.searchsorted(_EDGES, known, side="left"), 1)
        return broken

    @property
    def says_little(self) -> bool:
        """Whether errors as large as the stresses themselves would have been let pass, by as many
        audits as a window has."""
        solved = self.audited - self.unsolved
        is_known = np.isfinite(self.tolerance) and solved >= AUDITS
        return bool(is_known and self.stress_squares < solved * self.tolerance**2)

    def quantile(self, share: float) -> float:
        """The error that a share of the solved audits does not exceed, µN/µm; NaN without any."""
        solved = int(self.bins.sum())
        if not solved:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self.bins), share * solved - 1e-9, side="left"))
        edge = _EDGES[place] if place < len(_EDGES) else np.inf
        return float(min(edge, self.largest))

    def to_values(self) -> dict[str, Any]:
        """Plain values of which `ErrorRecord` makes the same record."""
        return {**asdict(self), "bins": self.bins.tolist()}

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json; µN/µm."""
        solved = self.audited - self.unsolved
        filled = self.bins.nonzero()[0]
        return {
            "audited": self.audited,
            "rolled_back": self.rolled_back,
            "unsolved": self.unsolved,
            "violations": self.violations,
            "wrong_at_most": wrong_at_most(self.violations, self.audited) if self.audited else None,
            "tolerance": self.tolerance,
            "rms": float(np.sqrt(self.sum_of_squares / solved)) if solved else None,
            "largest": self.largest if solved else None,
            "quantiles": {f"{q:g}": self.quantile(q) for q in QUANTILES if solved},
            "histogram": {
                "bins_a_decade": BINS_A_DECADE,
                "smallest_edge": float(_EDGES[0]),
                "bins": filled.tolist(),
                "counts": self.bins[filled].tolist(),
            },
            "worst": self.worst,
        }


class Question(NamedTuple):
    """Answers of the cache to be audited: accepted `step`s before, `points`, what was asked and
    answered (k, 2, 2), risk, and the `draw` u by which they were chosen."""

    step: NDArray[np.int64]
    points: Indices
    F: Array
    F_dot: Array
    stress: Array
    risk: Array
    draw: Array

    def only(self, chosen: NDArray[Any]) -> Question:
        return Question(*(part[chosen] for part in self))


class Finding(NamedTuple):
    """What an audit found, with the fallback's state for these points, and where the tolerance was
    broken."""

    asked: Question
    stress: Array
    status: NDArray[np.int8]
    error: Array
    broken: NDArray[np.bool_]
    state: Any


class Audit:
    """Chooses answers at random and compares them batch by batch; `record` is of all so far.

    Args:
        fraction: of the answers that are audited at once; 0: none is, at the end neither.
        tolerance: allowed error, µN/µm.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        fraction: float,
        seed: int,
        tolerance: float,
    ) -> None:
        self.record = ErrorRecord(tolerance)
        self._surrogate, self._fallback = surrogate, fallback
        self._fraction = fraction
        self._random = np.random.default_rng(seed)
        self._waiting: list[Question] = []
        self._spare: list[Question] = []
        self._below = 1.0  # u of answers that may still be among the remembered
        self._last: tuple[Indices, Array, Any] | None = None

    def choose(
        self,
        step: int,
        points: Indices,
        F: Array,
        F_dot: Array,
        stress: Array,
        risk: Array,
        more: float = 1.0,
    ) -> bool:
        """Choose among the answers at `points` of all (n, …) of a step, `more` times as many as
        usually; whether an audit is due."""
        if self._fraction == 0.0 or not len(points):
            return False
        draw, fraction = self._random.random(len(points)), min(1.0, more * self._fraction)
        short = AUDITS - self.record.audited - _count(self._waiting)
        if short <= 0:
            self._spare = []
        chosen = (draw < (max(fraction, self._below) if short > 0 else fraction)).nonzero()[0]
        if not len(chosen):
            return False
        at, draw = points[chosen], draw[chosen]
        steps = np.full(len(at), step)
        asked = Question(steps, at, F[at], F_dot[at], stress[at], risk[at], draw)
        now = draw < fraction
        if now.any():
            self._waiting.append(asked.only(now))
        if short > 0 and not now.all():
            self._spare.append(asked.only(~now))
            if _count(self._spare) > 2 * AUDITS:
                self._spare = [self._smallest(short)]
                self._below = float(self._spare[0].draw.max())
        return _count(self._waiting) >= BATCH

    def begin(self) -> None:
        """A window begins: answers before it stand, and are not remembered any more."""
        self._spare, self._below = [], 1.0

    def end(self) -> None:
        """The run is over: let as many wait as it is short of `trust.AUDITS` audits."""
        short = AUDITS - self.record.audited - _count(self._waiting)
        if short > 0 and self._spare:
            self._waiting.append(self._smallest(short))
        self._spare = []

    def _smallest(self, count: int) -> Question:
        """The remembered answers with the smallest draws, at most so many, in the order of time."""
        spare = _joined(self._spare)
        return spare.only(np.sort(np.argsort(spare.draw, kind="stable")[:count]))

    def run(self, *, whole: bool = True) -> Finding | None:
        """Audit what waits, or of several steps as much as fills tiles of RVEs; None: nothing."""
        if not self._waiting:
            return None
        one_step = len(self._waiting) == 1
        asked, self._waiting = _joined(self._waiting), []
        left = 0 if whole or one_step else len(asked.points) % TILE
        if left:
            self._waiting = [asked.only(np.arange(len(asked.points))[-left:])]
            asked = asked.only(np.arange(len(asked.points) - left))
        truth = self._solve(asked)
        error = stress_error(asked.stress, truth.stress)
        local = self._surrogate.local_tolerance(asked.F, asked.F_dot)
        error /= local
        error[truth.status != 0] = np.nan
        broken = self.record.add(error, np.sqrt((truth.stress**2).sum(axis=(1, 2))) / local)
        self._note_worst(asked, truth.stress, error)
        return Finding(asked, truth.stress, truth.status, error, broken, truth.state)

    def go_back(self, step: int, record: Mapping[str, Any]) -> None:
        """Have this record, and forget all that was chosen after so many steps."""
        self.begin()
        rolled_back = self.record.rolled_back + self.record.audited - record["audited"]
        self.record = ErrorRecord(**{**record, "rolled_back": rolled_back})
        kept = [each.only(each.step <= step) for each in self._waiting]
        self._waiting = [each for each in kept if len(each.step)]

    def to_arrays(self) -> dict[str, NDArray]:
        arrays: dict[str, NDArray] = {}
        for name, questions in (("waiting", self._waiting), ("spare", self._spare)):
            if questions:
                arrays |= within(name, _joined(questions)._asdict())
        if self._last is not None:
            points, at, state = self._last
            arrays |= {"last_points": points, "last_at": at, **within("last", state.to_arrays())}
        return arrays

    def to_values(self) -> dict[str, Any]:
        return {
            "record": self.record.to_values(),
            "below": self._below,
            "random": self._random.bit_generator.state,
        }

    def restore(self, arrays: Mapping[str, NDArray], values: Mapping[str, Any]) -> None:
        """Continue where another audit gave these by `to_arrays` and `to_values`."""
        waiting, spare = part_of(arrays, "waiting"), part_of(arrays, "spare")
        self._waiting = [Question(**waiting)] if waiting else []
        self._spare = [Question(**spare)] if spare else []
        self._last = None
        if "last_points" in arrays:
            state = self._fallback.state_from_arrays(part_of(arrays, "last"))
            self._last = arrays["last_points"].astype(np.intp), arrays["last_at"], state
        self.record = ErrorRecord(**values["record"])
        self._below = float(values["below"])
        self._random.bit_generator.state = values["random"]

    def _solve(self, asked: Question) -> StressResponse:
        """The RVE, from the last batch: of the same points, or else of nearest (F, Ḟ)."""
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
            "risk": float(asked.risk[k]),
            "step": int(asked.step[k]),
            "point": int(asked.points[k]),
            "F": asked.F[k].tolist(),
            "F_dot": asked.F_dot[k].tolist(),
            "stress": asked.stress[k].tolist(),
            "true_stress": truth[k].tolist(),
        }


def _count(questions: list[Question]) -> int:
    return sum(len(each.points) for each in questions)


def _joined(questions: list[Question]) -> Question:
    return Question(*(np.concatenate(part) for part in zip(*questions, strict=True)))


def together(F: Array, F_dot: Array) -> Array:
    """(n, 8) F and Ḟ times 1 µs side by side."""
    return np.concatenate([F.reshape(-1, 4), F_dot.reshape(-1, 4)], axis=1)


def nearest(known: Array, asked: Array) -> Indices:
    """(n,) the place in `known` (k, 8), k ≥ 1, that is nearest to each of `asked` (n, 8)."""
    return np.array([((known - each) ** 2).sum(axis=1).argmin() for each in asked], dtype=np.intp)
