"""How far the surrogate is trusted: one acceptance plan for windows of audits, and its factor.

Answers of the cache are audited at random, and errors above the tolerance are violations. Audits
are judged in windows: a window of n audits with k violations stands where the exact upper bound of
Clopper and Pearson (1934) on the share w of wrong answers, at the confidence C, is at most W,

    P(Bin(n, W) ≤ k) ≤ 1 − C,

and while it has no more than the k that `AUDITS` audits may have. A window that fails is rolled
back where a time loop can, and the risks count more often from there on.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # scipy.special is loaded where a window has more violations than `VIOLATIONS`
from numpy.typing import NDArray

Array = NDArray[np.float64]

WRONG, CONFIDENCE = 0.02, 0.95
"""W and C: a window of which 2 % of the answers are wrong stands with a probability of at most 5 %,
the consumer's risk."""
AUDITS, VIOLATIONS = 320, 2
"""n and k of a window. (313, 2) is the smallest plan by which besides a window with 0.1 % of wrong
answers stands with a probability of at least 99.5 %, the producer's risk; 320 are ten batches of
RVEs more than nothing: n may be larger, k then follows from the bound. No run has fewer audits."""
MARGIN = 1.1
"""By so much the risks of the violations exceed the limit after the factor was raised."""
LEAST_RAISE = 2.0
"""A factor is raised at least so many times, so that few windows fail in a row."""
LARGEST_FACTOR = 100.0
"""Beyond it the bound says nothing of the error, and the cache is switched off."""
MORE_AUDITS = 4.0
"""Times as many answers are audited in the window after one that failed, which finds a fault that
is left after a quarter of the steps."""
STAY, RETURN = 0.9, 0.8
"""Shares of the limit up to which the risk foreseen may rise for a point to stay with the
surrogate, and to come back to it: what is foreseen is not met exactly, and none goes to and fro."""
_MOST_NAMED = 32  # points that a decision names

_log = logging.getLogger("surrofe2.cache")


def wrong_at_most(violations: int, audits: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound on the share of wrong answers, of which a random sample was audited.

    The share w by which P(Bin(audits, w) ≤ violations) = 1 − confidence; 1 where all were wrong.
    """
    if violations >= audits:
        return 1.0
    if violations == 0:
        return float(-np.expm1(np.log1p(-confidence) / audits))
    return float(scipy.special.betaincinv(violations + 1, audits - violations, confidence))


def stands(violations: int, audits: int) -> bool:
    """Whether a window with so many violations among so many audits stands, see the module."""
    return violations <= VIOLATIONS or wrong_at_most(violations, audits) <= WRONG


@dataclass
class Window:
    """Kept steps whose audits are judged together; plain values, for checkpoints.

    Attributes:
        begin: µs; step: kept steps before it.
        limit: that risks are compared with; negative: nothing is trusted.
        before: what a law has to know that goes back to its begin; None where none can.
        audits, violations: so far; points: of the violations, the first of them.
        least_risk: smallest of the risks that the violations had.
        error, risk: of the worst audit, the error in µN/µm; None where the RVE has no stress.
        failed: whether it was found wrong.
    """

    begin: float
    step: int
    limit: float
    before: dict[str, Any] | None = None
    audits: int = 0
    violations: int = 0
    points: list[int] = field(default_factory=list)
    least_risk: float = np.inf
    error: float | None = None
    risk: float | None = None
    failed: bool = False

    def add(
        self, points: NDArray[np.intp], is_wrong: NDArray[np.bool_], error: Array, risk: Array
    ) -> None:
        """Take note of audits (k,): where, violations, error (NaN without RVE stress), risk."""
        wrong = is_wrong.nonzero()[0]
        self.audits += len(error)
        self.violations += len(wrong)
        self.points += points[wrong[: _MOST_NAMED - len(self.points)]].tolist()
        self.least_risk = min(self.least_risk, float(risk[wrong].min(initial=np.inf)))
        known = np.nan_to_num(error, nan=-1.0)
        worst = int(known.argmax())
        if known[worst] > (-1.0 if self.error is None else self.error):
            self.error, self.risk = float(known[worst]), float(risk[worst])

    @property
    def is_full(self) -> bool:
        """Whether it has the audits of the plan."""
        return self.audits >= AUDITS

    def counts(self) -> dict[str, Any]:
        """Its audits, for a window that continues them."""
        return {
            "audits": self.audits,
            "violations": self.violations,
            "points": list(self.points),
            "least_risk": self.least_risk,
            "error": self.error,
            "risk": self.risk,
        }

    @property
    def stands(self) -> bool:
        """Whether it does by its audits so far, of which it will have at least `AUDITS`."""
        return stands(self.violations, self.audits)

    def decision(self, t: float, step: int, limit: float, decision: str) -> dict[str, Any]:
        """A line of the event log, of a window that ends at t after so many kept steps."""
        return {
            "decision": decision,
            "t": t,
            "from_t": self.begin,
            "steps": step - self.step,
            "audits": self.audits,
            "violations": self.violations,
            "points": self.points,
            "true_error": self.error,
            "risk": self.risk,
            "limit_before": None if self.limit < 0.0 else self.limit,
            "limit_after": None if limit < 0.0 else limit,
        }


@dataclass
class Trust:
    """The largest risk that is answered, and what happened to it; plain values, for checkpoints.

    Attributes:
        factor: by which risks are multiplied before they are compared with 1.
        is_off: the cache answers nothing any more.
        more_audits: by which the fraction of answers that are audited is multiplied.
        failures: windows that failed; standing: that stood since the factor changed.
        events: what was found and done, in order, each with its step.
    """

    factor: float = 1.0
    is_off: bool = False
    more_audits: float = 1.0
    failures: int = 0
    standing: int = 0
    events: list[dict[str, Any]] = field(default_factory=list)

    @property
    def limit(self) -> float:
        """What a risk may be at most; negative: nothing is trusted."""
        return -1.0 if self.is_off else 1.0 / self.factor

    def fail(self, step: int, window: Window) -> None:
        """Raise the factor so that none of the window's violations would have been answered, or
        switch off where that takes too large a one."""
        window.failed = True
        self.failures += 1
        self.standing, self.more_audits = 0, MORE_AUDITS
        wrong, audits = window.violations, window.audits
        finding = f"{wrong} of {audits} audited answers are off by more than the tolerance"
        has_risk = 0.0 < window.least_risk < np.inf
        just_enough = MARGIN / window.least_risk if has_risk else np.inf
        factor = max(LEAST_RAISE * self.factor, just_enough)
        if factor <= LARGEST_FACTOR:
            self.factor = factor
            does = f"the risks count {factor:.3g} times from here on"
        else:
            self.is_off = True
            does = "the cache is off from here on, RVEs answer"
        self._note(step, f"{finding}; {does}", "off" if self.is_off else "tightened")

    def stand(self) -> None:
        """Take note of a window that stood: audits are as many as before, and the factor is halved
        after as many windows as failed, and one."""
        self.standing += 1
        self.more_audits = 1.0
        if self.standing > self.failures and self.factor > 1.0:
            self.factor, self.standing = max(1.0, 0.5 * self.factor), 0

    def warn(self, step: int, finding: str) -> None:
        """Report something that changes nothing."""
        self._note(step, finding, "none")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {"factor": self.factor, "off": self.is_off, "events": list(self.events)}

    def _note(self, step: int, sentence: str, action: str) -> None:
        _log.warning("cache, step %d: %s", step, sentence)
        self.events.append({"step": step, "finding": sentence, "action": action})
