"""A chunk of steps, whose audits decide together whether it stands; and the log of decisions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.audit import Finding
from surrofe2.cache.trust import NOMINAL

AUDITS, STEPS = 320, 16
"""Audits and steps that a chunk has at least. Of a chunk with a wrong share of 2 %, fewer than one
in 600 have no violation among so many audits; with 5 %, one in 10⁷."""
MOST_TOLD = 32
"""Points that a decision names."""


@dataclass
class Chunk:
    """Steps since the last decision; plain values, for checkpoints.

    Attributes:
        begin: µs; step: kept steps before it.
        threshold: that bounds are compared with, µN/µm; negative: nothing is trusted.
        before: counts, what left the range, faults and audits when it began, to go back to.
        audits, violations: since then; points: of the violations, the first of them.
        error, bound: of the worst audit, µN/µm; None where the true law has no stress.
        is_wrong: whether it was found wrong before its end.
    """

    begin: float
    step: int
    threshold: float
    before: dict[str, Any]
    audits: int = 0
    violations: int = 0
    points: list[int] = field(default_factory=list)
    error: float | None = None
    bound: float | None = None
    is_wrong: bool = False

    def add(self, found: Finding) -> None:
        """Take note of audits."""
        broken: NDArray[np.intp] = found.broken.nonzero()[0]
        self.audits += len(found.error)
        self.violations += len(broken)
        room = MOST_TOLD - len(self.points)
        self.points += found.asked.points[broken[:room]].tolist()
        error = np.nan_to_num(found.error, nan=-1.0)
        worst = int(error.argmax())
        if error[worst] > (-1.0 if self.error is None else self.error):
            self.error, self.bound = float(error[worst]), float(found.asked.bound[worst])

    def breaks(self, *, over: bool) -> bool:
        """Whether more audits broke the tolerance than the nominal share of them, or before the
        chunk is over, than of all that it will have at least."""
        return self.violations > NOMINAL * (self.audits if over else max(self.audits, AUDITS))

    def is_due(self, step: int) -> bool:
        """Whether it has the audits and the steps to be decided."""
        return self.audits >= AUDITS and step - self.step >= STEPS

    def decision(self, t: float, step: int, threshold: float, decision: str) -> dict[str, Any]:
        """A line of the log, of a chunk that ends at t after so many kept steps."""
        return {
            "decision": decision,
            "t": t,
            "from_t": self.begin,
            "steps": step - self.step,
            "audits": self.audits,
            "violations": self.violations,
            "points": self.points,
            "true_error": self.error,
            "bound": self.bound,
            "threshold_before": None if self.threshold < 0.0 else self.threshold,
            "threshold_after": None if threshold < 0.0 else threshold,
        }
