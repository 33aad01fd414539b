"""Audits: answers of the cache, chosen at random, are compared with RVEs.

Each answer at an accepted step draws a number u from [0, 1). It is audited at once where u is below
the audited fraction. Answers with the next smallest u are remembered, as many as audits are wanted
beyond those, and audited where a run ends with fewer: `trust.AUDITS` of a run of any length, and
of a window that is tried again all that its try asks for. So the audits of a window are a simple
random sample of its answers (bottom-k sampling).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.simd import TILE
from surrofe2.base.tensors import stress_error
from surrofe2.cache.branches import are_unique
from surrofe2.cache.protocols import Fallback, Surrogate
from surrofe2.cache.trust import AUDITS
from surrofe2.law.stress_law import StressResponse, state_arrays, state_of
from surrofe2.run.journal import part_of, within

BATCH = 16
"""Audits that wait for each other: RVEs are solved several at once for little more than one."""
BINS_A_DECADE = 50
"""A quantile is the upper edge of its bin: at most 4.7 % too large, never too small."""
_LOWEST = -12
_HIGHEST = 6
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
        bins: errors by size, in logarithmic bins.
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
    bins: list[int] = field(default_factory=lambda: [0] * (len(_EDGES) + 1))
    worst: Mapping[str, Any] | None = None

    def add(self, asked: Question, truth: StressResponse, local: Array) -> tuple[Array, Flags]:
        """Record what was asked and the truth, with (k,) local tolerances, shares of the whole:
        errors (k,), NaN where there is no truth, and which of them are violations."""
        error = stress_error(asked.stress, truth.stress) / local
        error[truth.status != 0] = np.nan
        broken = ~(error <= self.tolerance)
        known = ~np.isnan(error)
        self.audited += len(error)
        self.unsolved += int((~known).sum())
        self.violations += int(broken.sum())
        solved = error[known]
        self.sum_of_squares += float(solved @ solved)
        sizes = (truth.stress**2).sum(axis=(1, 2)) / local**2
        self.stress_squares += float(sizes[known].sum())
        places = np.searchsorted(_EDGES, solved, side="left")
        self.bins = (np.bincount(places, minlength=len(self.bins)) + self.bins).tolist()
        k = int(np.nan_to_num(error, nan=-1.0).argmax())
        if known[k] and (self.worst is None or error[k] > self.largest):
            self.largest = float(error[k])
            self.worst = {
                "error": self.largest,
                "risk": float(asked.risk[k]),
                "step": int(asked.step[k]),
                "point": int(asked.points[k]),
                "F": asked.F[k].tolist(),
                "F_dot": asked.F_dot[k].tolist(),
                "stress": asked.stress[k].tolist(),
                "true_stress": truth.stress[k].tolist(),
            }
        return error, broken

    @property
    def says_little(self) -> bool:
        """Whether errors as large as the stresses themselves would have been let pass, by as many
        audits as a window has."""
        solved = self.audited - self.unsolved
        is_known = np.isfinite(self.tolerance) and solved >= AUDITS
        return bool(is_known and self.stress_squares < solved * self.tolerance**2)

    def quantile(self, share: float) -> float:
        """The error that a fraction of the solved audits does not exceed, µN/µm."""
        below = np.cumsum(self.bins)
        place = int(np.searchsorted(below, share * below[-1] - 1e-9, side="left"))
        edge = _EDGES[place] if place < len(_EDGES) else np.inf
        return float(min(edge, self.largest))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json; µN/µm."""
        solved = self.audited - self.unsolved
        filled = [k for k, count in enumerate(self.bins) if count]
        return {
            "audited": self.audited,
            "rolled_back": self.rolled_back,
            "unsolved": self.unsolved,
            "violations": self.violations,
            "tolerance": self.tolerance,
            "rms": float(np.sqrt(self.sum_of_squares / solved)) if solved else None,
            "largest": self.largest if solved else None,
            "quantiles": {f"{q:g}": self.quantile(q) for q in QUANTILES if solved},
            "histogram": {
                "bins_a_decade": BINS_A_DECADE,
                "smallest_edge": float(_EDGES[0]),
                "bins": filled,
                "counts": [self.bins[k] for k in filled],
            },
            "worst": self.worst,
        }


class Question(NamedTuple):
    """Answers of the cache to be audited: accepted `step`s before, `points`, what was asked and
    answered (k, 2, 2), risk, and the `draw` u by which they were chosen."""

    step: Index
    points: Index
    F: Array
    F_dot: Array
    stress: Array
    risk: Array
    draw: Array

    def only(self, chosen: Any) -> Question:
        return Question(*(part[chosen] for part in self))

    def and_also(self, others: Question) -> Question:
        pairs: Any = zip(self, others, strict=True)
        return Question(*map(np.concatenate, pairs))


NO_QUESTION = Question(
    np.empty(0, np.int64), np.empty(0, np.intp), *np.empty((3, 0, 2, 2)), *np.empty((2, 0))
)


class Finding(NamedTuple):
    """What an audit found: the RVE's response, the error, NaN where that has none, and where the
    tolerance was broken."""

    asked: Question
    truth: StressResponse
    error: Array
    broken: Flags


class Starts(NamedTuple):
    """Where RVEs of an audit may start from: `points` of the last batch that were stable and on the
    branch of the reference, where each was in (F, Ḟ times 1 µs) (k, 8), and the fallback's state.
    """

    points: Index
    at: Array
    state: Any

    def to_arrays(self, fallback: Fallback) -> dict[str, NDArray]:
        state = within("last", state_arrays(fallback, self.state))
        return {"last_points": self.points, "last_at": self.at, **state}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], fallback: Fallback) -> Starts | None:
        """Return what `to_arrays` gave; None where there is nothing."""
        if "last_points" not in arrays:
            return None
        state = state_of(fallback, part_of(arrays, "last"))
        return cls(arrays["last_points"].astype(np.intp), arrays["last_at"], state)


def solve(
    fallback: Fallback, asked: Question, last: Starts | None
) -> tuple[StressResponse, Starts | None]:
    """The RVEs' answer to what was asked, and where the next batch may start from.

    RVEs start from the last batch: each from that of the same point where the points are the same,
    else from the one that is nearest in (F, Ḟ times 1 µs); without a batch from the reference.
    """
    F = asked.F
    F_dot = asked.F_dot
    at = np.concatenate([F.reshape(-1, 4), F_dot.reshape(-1, 4)], axis=1)
    start = None
    if last is not None:
        start = last.state
        if not np.array_equal(last.points, asked.points):
            nearest = [((last.at - each) ** 2).sum(axis=1).argmin() for each in at]
            start = start.take(np.array(nearest))
    answer = fallback.respond(F, F_dot, start)
    accepted = fallback.accept(F, F_dot, answer)
    status = accepted.status
    state = accepted.state
    good = ((status == 0) & are_unique(state, len(at))).nonzero()[0]
    if state is not None and len(good):
        last = Starts(asked.points[good], at[good], state.take(good))
    return StressResponse(answer.stress, status, state), last


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
        self._surrogate = surrogate
        self._fallback = fallback
        self._fraction = fraction
        self._random = np.random.default_rng(seed)
        self._waiting = self._spare = NO_QUESTION
        self._below = 1.0  # u of answers that may still be among the remembered
        self._last: Starts | None = None

    def choose(
        self,
        step: int,
        points: Index,
        F: Array,
        F_dot: Array,
        stress: Array,
        risk: Array,
        *,
        wanted: int,
        more: float = 1.0,
    ) -> bool:
        """Choose among the answers at `points` of all (n, …) of a step, `more` times as many as
        usually, where so many audits are `wanted` beyond those made; whether an audit is due."""
        if self._fraction == 0.0 or not len(points):
            return False
        draw = self._random.random(len(points))
        fraction = min(1.0, more * self._fraction)
        short = self._short(wanted)
        if short <= 0:
            self._spare = NO_QUESTION
        chosen = (draw < (max(fraction, self._below) if short > 0 else fraction)).nonzero()[0]
        if not len(chosen):
            return False
        at = points[chosen]
        draw = draw[chosen]
        steps = np.full(len(at), step)
        asked = Question(steps, at, F[at], F_dot[at], stress[at], risk[at], draw)
        self._waiting = self._waiting.and_also(asked.only(draw < fraction))
        if short > 0:
            self._spare = self._spare.and_also(asked.only(draw >= fraction))
            if len(self._spare.step) > 2 * max(short, AUDITS):
                self._spare = self._smallest(short)
                self._below = float(self._spare.draw.max())
        return len(self._waiting.step) >= BATCH

    def begin(self) -> None:
        """A window begins: answers before it stand, and are not remembered any more."""
        self._spare = NO_QUESTION
        self._below = 1.0

    def end(self, wanted: int) -> None:
        """The window is over: let as many wait as are `wanted` beyond the audits made."""
        self._waiting = self._waiting.and_also(self._smallest(max(self._short(wanted), 0)))
        self._spare = NO_QUESTION

    def _short(self, wanted: int) -> int:
        """Return how many of the audits that are wanted do not wait yet."""
        return wanted - len(self._waiting.step)

    def _smallest(self, count: int) -> Question:
        """The remembered answers with the smallest draws, at most so many, in the order of time."""
        order = np.argsort(self._spare.draw, kind="stable")
        return self._spare.only(np.sort(order[:count]))

    def run(self, *, whole: bool = True) -> Finding | None:
        """Audit what waits, or of several steps as much as fills tiles of RVEs; None: nothing."""
        asked = self._waiting
        count = len(self._waiting.step)
        if not count:
            return None
        if not whole and asked.step[0] < asked.step[-1]:
            count -= count % TILE
        asked, self._waiting = asked.only(slice(count)), asked.only(slice(count, None))
        truth, self._last = solve(self._fallback, asked, self._last)
        local = self._surrogate.local_tolerance(asked.F, asked.F_dot)
        return Finding(asked, truth, *self.record.add(asked, truth, local))

    def go_back(self, step: int, record: Mapping[str, Any]) -> None:
        """Have this record, and forget all that was chosen after so many steps."""
        self.begin()
        rolled_back = self.record.rolled_back + self.record.audited - record["audited"]
        self.record = ErrorRecord(**{**record, "rolled_back": rolled_back})
        self._waiting = self._waiting.only(self._waiting.step <= step)

    def to_arrays(self) -> dict[str, NDArray]:
        arrays: dict[str, NDArray] = {}
        for name, asked in (("waiting", self._waiting), ("spare", self._spare)):
            if len(asked.step):
                arrays |= within(name, asked._asdict())
        if self._last is not None:
            arrays |= self._last.to_arrays(self._fallback)
        return arrays

    def to_values(self) -> dict[str, Any]:
        return {"below": self._below, "random": self._random.bit_generator.state}

    def restore(
        self, arrays: Mapping[str, NDArray], values: Mapping[str, Any], record: Mapping[str, Any]
    ) -> None:
        """Continue where another audit gave these by `to_arrays` and `to_values`, with a record."""
        self._waiting, self._spare = (
            Question(**part) if (part := part_of(arrays, name)) else NO_QUESTION
            for name in ("waiting", "spare")
        )
        self._last = Starts.from_arrays(arrays, self._fallback)
        self.record = ErrorRecord(**record)
        self._below = float(values["below"])
        self._random.bit_generator.state = values["random"]
