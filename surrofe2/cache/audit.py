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

# Audits wait until there are so many: RVEs are solved several at once for little more than one.
BATCH = 16
# In a large tissue more of them wait: one per so many points, but at most `_LARGEST_BATCH`. A few
# steps bring as many.
_POINTS_PER_AUDIT = 256
_LARGEST_BATCH = 64
# Errors are counted in logarithmic bins from 1e-12 to 1e6 µN/µm. A quantile is the upper edge of
# its bin: at most 4.7 % too large, never too small.
BINS_A_DECADE = 50
_LOWEST = -12
_HIGHEST = 6
_EDGES = 10.0 ** np.linspace(_LOWEST, _HIGHEST, (_HIGHEST - _LOWEST) * BINS_A_DECADE + 1)
QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass
class ErrorRecord:
    """Audited answers of a cache, and how wrong they were.

    An error is divided by the local tolerance, a fraction of the whole, so that all compare with
    one tolerance, µN/µm.

    Attributes:
        tolerance: allowed error, µN/µm; inf: any is.
        audited: number of answers that were audited.
        rolled_back: number of further ones, at steps that do not stand.
        unsolved: number of audited answers for which the RVE has no stress.
        violations: number of errors above the tolerance, the unsolved included.
        largest: largest error, µN/µm.
        sum_of_squares: sum of the squared errors, (µN/µm)².
        stress_squares: sum of the squared stresses, divided by the local tolerance as the errors.
        bins: number of errors by size, in logarithmic bins.
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
        """Record audited answers and their errors.

        Args:
            asked: the answers.
            truth: the stresses by RVEs.
            local: (k,) local tolerances, as fractions of the whole tolerance.

        Returns:
            (k,) errors, NaN where there is no truth; and (k,) whether each is a violation.
        """
        error = stress_error(asked.stress, truth.stress) / local
        error[truth.status != 0] = np.nan
        broken = ~(error <= self.tolerance)  # an error of NaN is a violation, too
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
        k = int(np.nan_to_num(error, nan=-1.0).argmax())  # the largest that is known, if any is
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
        """True if errors as large as the stresses themselves would have passed the tolerance.

        It is asked only after as many audits as a window has.
        """
        solved = self.audited - self.unsolved
        is_known = np.isfinite(self.tolerance) and solved >= AUDITS
        return bool(is_known and self.stress_squares < solved * self.tolerance**2)

    def quantile(self, share: float) -> float:
        """Return the error that this fraction of the solved audits does not exceed, µN/µm."""
        below = np.cumsum(self.bins)
        # rounding must not put a fraction of a whole number above that number
        place = int(np.searchsorted(below, share * below[-1] - 1e-9, side="left"))
        edge = _EDGES[place] if place < len(_EDGES) else np.inf
        return float(min(edge, self.largest))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for run.json; errors in µN/µm, None where nothing was solved."""
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
    """Answers of the cache that are to be audited.

    Attributes:
        step: (k,) number of accepted steps before each answer.
        points: (k,) numbers of the points.
        F, F_dot, stress: (k, 2, 2) what was asked and answered.
        risk: (k,) bound of the error over the error allowed.
        draw: (k,) the random number u in [0, 1) by which it was chosen.
    """

    step: Index
    points: Index
    F: Array
    F_dot: Array
    stress: Array
    risk: Array
    draw: Array

    def only(self, chosen: Any) -> Question:
        """Return those of the answers that an index array, slice or flags choose."""
        return Question(*(part[chosen] for part in self))

    def and_also(self, others: Question) -> Question:
        """Return these answers, and others behind them."""
        pairs: Any = zip(self, others, strict=True)
        return Question(*map(np.concatenate, pairs))


NO_QUESTION = Question(
    np.empty(0, np.int64), np.empty(0, np.intp), *np.empty((3, 0, 2, 2)), *np.empty((2, 0))
)


class Finding(NamedTuple):
    """The result of an audit of k answers.

    Attributes:
        asked: the answers.
        truth: the response of the RVEs.
        error: (k,) µN/µm, NaN where the RVE has no stress.
        broken: (k,) whether the tolerance was broken.
    """

    asked: Question
    truth: StressResponse
    error: Array
    broken: Flags


class Starts(NamedTuple):
    """States from which RVEs of the next audit may start.

    They are those of the last batch that were stable and on the branch of the reference.

    Attributes:
        points: (k,) numbers of their points.
        at: (k, 8) entries of F and of Ḟ times 1 µs, where each was solved.
        state: the fallback's state for them.
    """

    points: Index
    at: Array
    state: Any

    def to_arrays(self, fallback: Fallback) -> dict[str, NDArray]:
        """Return arrays for a checkpoint."""
        state = within("last", state_arrays(fallback, self.state))
        return {"last_points": self.points, "last_at": self.at, **state}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], fallback: Fallback) -> Starts | None:
        """Return what `to_arrays` gave as these arrays; None where there is nothing."""
        if "last_points" not in arrays:
            return None
        state = state_of(fallback, part_of(arrays, "last"))
        return cls(arrays["last_points"].astype(np.intp), arrays["last_at"], state)


def solve(
    fallback: Fallback, asked: Question, last: Starts | None
) -> tuple[StressResponse, Starts | None]:
    """Solve RVEs for what was asked.

    RVEs start from the last batch: each from the state of its own point where the points are the
    same, else from the one that is nearest in (F, Ḟ times 1 µs). Without a batch they start from
    the reference.

    Returns:
        The RVEs' response, and where the next batch may start from.
    """
    F = asked.F
    F_dot = asked.F_dot
    places = np.concatenate([F.reshape(-1, 4), F_dot.reshape(-1, 4)], axis=1)
    start = None
    if last is not None:
        start = last.state
        if not np.array_equal(last.points, asked.points):
            nearest = [((last.at - place) ** 2).sum(axis=1).argmin() for place in places]
            start = start.take(np.array(nearest))
    answer = fallback.respond(F, F_dot, start)
    accepted = fallback.accept(F, F_dot, answer)
    status = accepted.status
    state = accepted.state
    good = ((status == 0) & are_unique(state, len(places))).nonzero()[0]
    if state is not None and len(good):
        last = Starts(asked.points[good], places[good], state.take(good))
    return StressResponse(answer.stress, status, state), last


class Audit:
    """Chooses answers at random and compares them with RVEs, batch by batch.

    `record` is of all audits so far.

    Args:
        surrogate: gives the local tolerance.
        fallback: solves the RVEs.
        fraction: of the answers that are audited at once; 0: none is, at the end neither.
        seed: of the random choice.
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
        self._waiting = NO_QUESTION  # chosen, but not solved yet
        self._spare = NO_QUESTION  # remembered, for a window with too few audits
        self._below = 1.0  # answers with a larger u cannot be among the remembered any more
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
        """Choose among the answers of a step those to be audited.

        Args:
            step: number of accepted steps before it.
            points: numbers of the points that the surrogate answered.
            F, F_dot, stress: (n, 2, 2) of all points.
            risk: (n,).
            wanted: how many audits the window needs beyond those made.
            more: factor of the audited fraction.

        Returns:
            Whether so many answers wait that an audit is due.
        """
        if self._fraction == 0.0 or not len(points):
            return False
        draw = self._random.random(len(points))
        fraction = min(1.0, more * self._fraction)
        short = self._short(wanted)
        if short <= 0:
            self._spare = NO_QUESTION
        below = max(fraction, self._below) if short > 0 else fraction
        chosen = (draw < below).nonzero()[0]
        if not len(chosen):
            return False
        chosen_points = points[chosen]
        draw = draw[chosen]
        steps = np.full(len(chosen_points), step)
        asked = Question(
            steps,
            chosen_points,
            F[chosen_points],
            F_dot[chosen_points],
            stress[chosen_points],
            risk[chosen_points],
            draw,
        )
        self._waiting = self._waiting.and_also(asked.only(draw < fraction))
        if short > 0:
            self._spare = self._spare.and_also(asked.only(draw >= fraction))
            # sorted out only when there are twice too many, since sorting costs time
            if len(self._spare.step) > 2 * max(short, AUDITS):
                self._spare = self._smallest(short)
                self._below = float(self._spare.draw.max())
        batch = min(max(BATCH, len(F) // _POINTS_PER_AUDIT), _LARGEST_BATCH)
        return len(self._waiting.step) >= batch

    def begin(self) -> None:
        """Begin a window: answers before it stand, and are not remembered any more."""
        self._spare = NO_QUESTION
        self._below = 1.0

    def end(self, wanted: int) -> None:
        """End a window: of the remembered answers, so many wait as are `wanted` beyond those
        that do.
        """
        self._waiting = self._waiting.and_also(self._smallest(max(self._short(wanted), 0)))
        self._spare = NO_QUESTION

    def _short(self, wanted: int) -> int:
        """Return how many of the audits that are wanted do not wait yet."""
        return wanted - len(self._waiting.step)

    def _smallest(self, count: int) -> Question:
        """Return the remembered answers with the smallest draws, at most so many, in the order
        of time.
        """
        order = np.argsort(self._spare.draw, kind="stable")
        return self._spare.only(np.sort(order[:count]))

    def run(self, *, whole: bool = True) -> Finding | None:
        """Audit the answers that wait.

        Args:
            whole: whether all of them are. Else, where they are of several steps, only as many as
                fill tiles of RVEs; the rest waits on.

        Returns:
            The result; None where nothing waits.
        """
        asked = self._waiting
        count = len(self._waiting.step)
        if not count:
            return None
        if not whole and asked.step[0] < asked.step[-1]:
            count -= count % TILE
        self._waiting = asked.only(slice(count, None))
        asked = asked.only(slice(count))
        truth, self._last = solve(self._fallback, asked, self._last)
        local = self._surrogate.local_tolerance(asked.F, asked.F_dot)
        return Finding(asked, truth, *self.record.add(asked, truth, local))

    def go_back(self, step: int, record: Mapping[str, Any]) -> None:
        """Go back to an earlier step: take its record, and forget all that was chosen after it.

        Audits that were made since count as rolled back.
        """
        self.begin()
        rolled_back = self.record.rolled_back + self.record.audited - record["audited"]
        self.record = ErrorRecord(**{**record, "rolled_back": rolled_back})
        self._waiting = self._waiting.only(self._waiting.step <= step)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the answers that wait, and states to start from, for a checkpoint."""
        arrays: dict[str, NDArray] = {}
        for name, asked in (("waiting", self._waiting), ("spare", self._spare)):
            if len(asked.step):
                arrays |= within(name, asked._asdict())
        if self._last is not None:
            arrays |= self._last.to_arrays(self._fallback)
        return arrays

    def to_values(self) -> dict[str, Any]:
        """Return the rest of the state for a checkpoint, as plain values."""
        return {"below": self._below, "random": self._random.bit_generator.state}

    def restore(
        self, arrays: Mapping[str, NDArray], values: Mapping[str, Any], record: Mapping[str, Any]
    ) -> None:
        """Continue from `to_arrays` and `to_values` of another audit, with its record."""
        waiting = part_of(arrays, "waiting")
        spare = part_of(arrays, "spare")
        self._waiting = Question(**waiting) if waiting else NO_QUESTION
        self._spare = Question(**spare) if spare else NO_QUESTION
        self._last = Starts.from_arrays(arrays, self._fallback)
        self.record = ErrorRecord(**record)
        self._below = float(values["below"])
        self._random.bit_generator.state = values["random"]
