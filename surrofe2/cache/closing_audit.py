"""The closing audit: a bound of a run's wrong answers, by RVEs that have decided nothing.

Each answer of the cache at an accepted step draws a number u from [0, 1), by a generator of its
own, and the answers with the smallest u are kept (bottom-k or reservoir sampling). Going back to a
mark puts the sample back to what it was there. So at the end of a run it is a simple random sample
of all the answers that stand; and no decision, which windows went back or where RVEs answer,
depends on its u.
RVEs solve the sample at the end. Of the N answers that stand n were drawn, of which k are wrong: by
Clopper and Pearson (1934) the fraction of all that is wrong is at most

    w,  P(Bin(n, w) ≤ k) = 1 − C;    w = 1 − (1 − C)^(1/n) for k = 0,

with the confidence C, and where n = N it is k/N. Drawing without replacement scatters less than the
binomial distribution does, so the bound errs on the safe side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.cache.audit import (
    NO_QUESTION,
    ErrorRecord,
    Question,
    Starts,
    solve,
)
from surrofe2.cache.protocols import Fallback, Surrogate
from surrofe2.cache.trust import CONFIDENCE, wrong_at_most
from surrofe2.law.stress_law import StressResponse
from surrofe2.run.journal import part_of, within

# Answers that RVEs solve at once: each starts from the nearest of the batch before.
BATCH = 64
# n, of whole batches: without a wrong answer among them at most 0.93 % of all are wrong (0.95 %
# would take 313).
SAMPLE = 320
_STREAM = 1  # of random numbers, beside that of the audits by the same seed


class Sample(NamedTuple):
    """The answers with the smallest draws so far, among them the `SAMPLE` smallest.

    Attributes:
        kept: these answers.
        below: an answer with a larger draw cannot be among the smallest any more.
        answers: number of answers that were offered.
    """

    kept: Question = NO_QUESTION
    below: float = 1.0
    answers: int = 0

    def final(self) -> Question:
        """Return the answers with the `SAMPLE` smallest draws, or all, in the order of time."""
        order = np.argsort(self.kept.draw, kind="stable")[:SAMPLE]
        return self.kept.only(np.sort(order))

    def to_arrays(self) -> dict[str, NDArray]:
        """Return arrays for a checkpoint."""
        bounds = {"below": np.array(self.below), "answers": np.array(self.answers)}
        return {**bounds, **within("kept", self.kept._asdict())}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Sample:
        """Return the sample whose `to_arrays` gave these arrays."""
        kept = Question(**part_of(arrays, "kept"))
        return cls(kept, float(arrays["below"]), int(arrays["answers"]))


class Solved(NamedTuple):
    """A batch of the sample, solved by RVEs.

    Attributes:
        asked: the answers.
        truth: the RVEs' stresses.
        last: where the RVEs of the next batch may start from.
    """

    asked: Question
    truth: StressResponse
    last: Starts | None


class ClosingAudit:
    """Samples the answers that stand, and compares them with RVEs at the end of a run.

    RVEs start as those of the audits during the run do, see `audit.solve`.

    Args:
        surrogate: gives the local tolerance.
        fallback: solves the RVEs.
        seed: of the random draws.
        tolerance: allowed error, µN/µm.
        is_wanted: whether there is a closing audit.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        seed: int,
        tolerance: float,
        *,
        is_wanted: bool = True,
    ) -> None:
        self._surrogate = surrogate
        self._fallback = fallback
        self._is_wanted = is_wanted
        self._random = np.random.default_rng([seed, _STREAM])
        self._sample = Sample()
        self._at_mark = Sample()
        self._begin(tolerance)

    def _begin(self, tolerance: float) -> None:
        """Forget what RVEs have solved of the sample."""
        self.record = ErrorRecord(tolerance)
        self._last: Starts | None = None

    def take(
        self, step: int, points: Index, F: Array, F_dot: Array, stress: Array, risk: Array
    ) -> None:
        """Sample the answers at `points` of an accepted step.

        Args:
            step: number of accepted steps before it.
            F, F_dot, stress: (n, 2, 2) of all points.
            risk: (n,) of all points.
        """
        if not self._is_wanted or not len(points):
            return
        if self.record.audited:
            self._begin(self.record.tolerance)  # the run continues after its report
        kept, below, answers = self._sample
        draw = self._random.random(len(points))
        chosen = (draw < below).nonzero()[0]
        if len(chosen):
            new_points = points[chosen]
            steps = np.full(len(new_points), step)
            new = Question(
                steps,
                new_points,
                F[new_points],
                F_dot[new_points],
                stress[new_points],
                risk[new_points],
                draw[chosen],
            )
            kept = kept.and_also(new)
            # sorted out only when there are twice too many, since sorting costs time
            if len(kept.step) > 2 * SAMPLE:
                order = np.argsort(kept.draw, kind="stable")[:SAMPLE]
                kept = kept.only(np.sort(order))
                below = float(kept.draw.max())
        self._sample = Sample(kept, below, answers + len(points))

    def mark(self) -> None:
        """Remember the sample, to go back to it."""
        self._at_mark = self._sample

    def go_back(self) -> None:
        """Go back to the sample of the mark: what was answered since does not stand."""
        self._sample = self._at_mark

    @property
    def progress(self) -> tuple[int, int]:
        """Two numbers: answers that RVEs have solved, and all that they are to solve."""
        return self.record.audited, min(SAMPLE, self._sample.answers)

    def next_batch(self) -> Solved | None:
        """Compute the RVEs' stresses of the next batch; None where all are solved. Pure."""
        done, count = self.progress
        if done >= count:
            return None
        asked = self._sample.final().only(slice(done, done + BATCH))
        return Solved(asked, *solve(self._fallback, asked, self._last))

    def commit(self, solved: Solved) -> NDArray[np.bool_]:
        """Record a solved batch, and return which of its answers are wrong, (k,) flags."""
        self._last = solved.last
        local = self._surrogate.local_tolerance(solved.asked.F, solved.asked.F_dot)
        _, is_wrong = self.record.add(solved.asked, solved.truth, local)
        return is_wrong

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for run.json.

        They are the number of `answers` that stand, how many of them are `sampled`, the bound
        `wrong_at_most`, which is None until RVEs have solved all of these, and their errors.
        """
        done, count = self.progress
        record = self.record
        answers = self._sample.answers
        bound = None
        if count and done == count and np.isfinite(record.tolerance):
            # where every answer is in the sample the fraction is exact
            bound = record.violations / answers
            if count < answers:
                bound = wrong_at_most(record.violations, count)
        errors = record.to_dict()
        errors.pop("rolled_back")
        return {
            "answers": answers,
            "sampled": count,
            "wrong_at_most": bound,
            "confidence": CONFIDENCE if count < answers else 1.0,
            **errors,
        }

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the samples, and states to start from, for a checkpoint."""
        return {
            **within("sample", self._sample.to_arrays()),
            **within("mark", self._at_mark.to_arrays()),
            **({} if self._last is None else self._last.to_arrays(self._fallback)),
        }

    def to_values(self) -> dict[str, Any]:
        """Return the rest of the state for a checkpoint, as plain values."""
        return {"record": asdict(self.record), "random": self._random.bit_generator.state}

    def restore(self, arrays: Mapping[str, NDArray], values: Mapping[str, Any]) -> None:
        """Continue where another one gave these by `to_arrays` and `to_values`."""
        self._sample = Sample.from_arrays(part_of(arrays, "sample"))
        self._at_mark = Sample.from_arrays(part_of(arrays, "mark"))
        self._last = Starts.from_arrays(arrays, self._fallback)
        self.record = ErrorRecord(**values["record"])
        self._random.bit_generator.state = values["random"]
