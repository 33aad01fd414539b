"""How far the surrogate is trusted: one acceptance plan for windows of audits, and its factor.

Answers of the cache are audited at random, and errors above the tolerance are violations. A window
of n audits with k violations stands where the exact upper bound of Clopper and Pearson (1934) on
the share w of wrong answers is at most W, at a confidence that depends on how often the window has
been tried: the try number m has the consumer's risk α/2^m, so that all tries have α together,

    P(Bin(n, W) ≤ k) ≤ α/2^m,    α = 1 − C,

and while it has no more than the k that `audits_of(m)` audits may have. A window that fails is
rolled back where a time loop can. From there on none of its violations would be answered: risks
count more often, or, where the fault is a local one that the risk does not tell from what was
right, one input of `tensors` is trusted less far. Only where neither leaves anything the cache is
off. Both hold for the rest of the run, unless the surrogate has learnt what it was wrong about.

What stands was selected by these audits, so they state no bound: `closing_audit` does.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import cache
from math import comb
from typing import Any

import numpy as np
import scipy  # scipy.special is loaded where a window has more violations than `VIOLATIONS`

from surrofe2.base.tensors import INPUTS

WRONG = 0.02
CONFIDENCE = 0.95
"""W and C: a window of which 2 % of the answers are wrong stands with a probability of at most 5 %,
the consumer's risk, however often it is tried."""
VIOLATIONS = 2
"""k of a window of `audits_of` audits; more violations stand among so many more audits that the
bound is kept. (359, 2) is the smallest plan of a first try by which besides a window with 0.1 % of
wrong answers stands with a probability of at least 99 %, the producer's risk."""
_WHOLE = 8  # audits that are solved together


def binomial(violations: int, audits: int, wrong: float) -> float:
    """P(Bin(audits, wrong) ≤ violations), of a few violations."""
    counts = range(violations + 1)
    return sum(comb(audits, k) * wrong**k * (1.0 - wrong) ** (audits - k) for k in counts)


@cache
def audits_of(tries: int) -> int:
    """n of a window at its try of this number, from 1: the smallest, in whole tiles of RVEs, by
    which `VIOLATIONS` keep the consumer's risk of that try."""
    risk = _risk_of(tries)
    audits = _WHOLE
    while binomial(VIOLATIONS, audits, WRONG) > risk:
        audits += _WHOLE
    return audits


def _risk_of(tries: int) -> float:
    """The consumer's risk of the try of this number, from 1."""
    return float((1.0 - CONFIDENCE) / 2.0**tries)


MARGIN = 1.1
"""By so much the risks of the violations exceed the limit after the factor was raised, or one of
their inputs its reach after that was narrowed."""
LEAST_RAISE = 2.0
"""A factor is raised at least so many times, so that few windows fail in a row."""
LARGEST_FACTOR = 100.0
"""Beyond it the bound says nothing of the error."""
LEAST_KEPT = 0.1
MOST_NARROWED = 8
"""Share of the window's right answers that a narrower reach has to leave; times it is narrowed."""
MORE_AUDITS = 4.0
"""Times as many answers are audited in the window after one that failed, which finds a fault that
is left after a quarter of the steps."""
STAY = 0.9
RETURN = 0.8
"""Shares of the limit up to which the risk foreseen may rise for a point to stay with the
surrogate, and to come back to it: what is foreseen is not met exactly, and none goes to and fro."""
INPUT_NAMES = (
    *(f"a {name} of U − I" for name in ("sum", "difference", "shear")),
    *(f"a {name} of RᵀḞ" for name in ("sum", "difference", "shear", "spin")),
)
_MOST_NAMED = 32  # points that a decision names

_log = logging.getLogger("surrofe2.cache")


def wrong_at_most(violations: int, audits: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound on the share of wrong answers, of which a random sample was audited:
    the w by which P(Bin(audits, w) ≤ violations) = 1 − confidence; 1 where all were wrong."""
    if violations >= audits:
        return 1.0
    if violations == 0:
        return float(-np.expm1(np.log1p(-confidence) / audits))
    return float(scipy.special.betaincinv(violations + 1, audits - violations, confidence))


def stands(violations: int, audits: int, tries: int = 1) -> bool:
    """Whether a window with so many violations among so many audits stands at its try of this
    number, see the module."""
    confidence = 1.0 - _risk_of(tries)
    return violations <= VIOLATIONS or wrong_at_most(violations, audits, confidence) <= WRONG


AUDITS = audits_of(1)
"""Audits of a window that is tried for the first time. No run has fewer."""


@dataclass
class Window:
    """Accepted steps whose audits are judged together; plain values, for checkpoints.

    Attributes:
        begin: µs; step: accepted steps before it.
        limit: that risks are compared with; negative: nothing is trusted.
        before: what a law has to know that goes back to its begin; None where none can.
        audits: of each the point, whether it is a violation, error in µN/µm (NaN where the RVE has
            no stress), whether the surrogate has learnt the RVE's stress there, risk, and the sizes
            of the seven inputs of `tensors`.
        tries: how often it has been tried, with this time.
    """

    begin: float
    step: int
    limit: float
    before: dict[str, Any] | None = None
    audits: list[list[float]] = field(default_factory=list)
    failed: bool = False
    tries: int = 1

    @property
    def wrong(self) -> list[list[float]]:
        return [each for each in self.audits if each[1]]

    @property
    def is_full(self) -> bool:
        return len(self.audits) >= audits_of(self.tries)

    @property
    def stands(self) -> bool:
        """Whether it does by its audits so far, of which it will have at least `audits_of`."""
        return stands(len(self.wrong), len(self.audits), self.tries)

    def decision(self, t: float, step: int, limit: float, decision: str) -> dict[str, Any]:
        """A line of the event log, of a window that ends at t after so many accepted steps."""
        known = [each for each in self.audits if not np.isnan(each[2])]
        worst = max(known, key=lambda each: each[2], default=[None] * 5)
        return {
            "decision": decision,
            "t": t,
            "from_t": self.begin,
            "steps": step - self.step,
            "try": self.tries,
            "audits": len(self.audits),
            "violations": len(self.wrong),
            "points": [int(each[0]) for each in self.wrong[:_MOST_NAMED]],
            "true_error": worst[2],
            "risk": worst[4],
            "limit_before": None if self.limit < 0.0 else self.limit,
            "limit_after": None if limit < 0.0 else limit,
        }


@dataclass
class Trust:
    """What is answered, and what happened to that; plain values, for checkpoints.

    Attributes:
        factor: by which risks are multiplied before they are compared with 1.
        least_factor: what violations asked for; the factor does not fall below it.
        reach: of the seven inputs of `tensors`, the sizes up to which they are trusted; they only
            become smaller.
        more_audits: by which the fraction of answers that are audited is multiplied.
        failures: windows that failed; standing: that stood since the factor changed.
        narrowed: how often the reach was narrowed.
        events: what was found and done, in order, each with its step.
    """

    factor: float = 1.0
    least_factor: float = 1.0
    reach: list[float] = field(default_factory=lambda: [np.inf] * INPUTS)
    is_off: bool = False
    more_audits: float = 1.0
    failures: int = 0
    standing: int = 0
    narrowed: int = 0
    events: list[dict[str, Any]] = field(default_factory=list)

    @property
    def limit(self) -> float:
        """What a risk may be at most; negative: nothing is trusted."""
        return -1.0 if self.is_off else 1.0 / self.factor

    def fail(self, step: int, window: Window) -> None:
        """Answer none of the window's violations any more: raise the factor or narrow the reach,
        whichever leaves more of what was right, or switch off where neither leaves anything.

        The factor may come down again from what violations asked for that the surrogate has learnt.
        """
        window.failed = True
        self.failures += 1
        self.standing = 0
        self.more_audits = MORE_AUDITS
        audits = np.array(window.audits)
        is_wrong = audits[:, 1] > 0.0
        is_learnt = audits[:, 3] > 0.0
        wrong = audits[is_wrong, 4:]
        right = audits[~is_wrong, 4:]
        least = wrong.min(axis=0, initial=np.inf)
        usable = (least > 0.0) & (least < np.inf)
        most = np.where(usable, least / MARGIN, 0.0)
        factor = max(LEAST_RAISE * self.factor, 1.0 / most[0] if usable[0] else np.inf)
        most[0] = 1.0 / factor
        kept = (right <= most).mean(axis=0) if len(right) else np.zeros(len(most))
        kept *= usable
        k = 1 + int(kept[1:].argmax())
        may_narrow = kept[k] >= LEAST_KEPT and self.narrowed < MOST_NARROWED
        finding = f"{len(wrong)} of {len(wrong) + len(right)} audited answers are off by more than "
        finding += "the tolerance; "
        if factor <= LARGEST_FACTOR and not (may_narrow and kept[k] > 2.0 * kept[0]):
            self.factor = factor
            unlearnt = audits[is_wrong & ~is_learnt]
            asked = MARGIN / unlearnt[:, 4].min(initial=np.inf)
            self.least_factor = max(self.least_factor, float(asked))
            does = f"the risks count {factor:.3g} times from here on"
            action = "tightened"
        elif may_narrow:
            # An answer from before the reach was narrowed may lie farther out than it is now.
            self.reach[k - 1] = min(self.reach[k - 1], float(most[k]))
            self.narrowed += 1
            does = f"states with {INPUT_NAMES[k - 1]} of more than {most[k]:.3g} are left to RVEs"
            does = f"{does} from here on"
            action = "narrowed"
        else:
            self.is_off = True
            does = "the cache is off from here on, RVEs answer"
            action = "off"
        self._note(step, finding + does, action)

    def stand(self) -> None:
        """Take note of a window that stood: audits are as many as before, and the factor is halved
        after as many windows as failed, and one, but never below what violations asked for."""
        self.standing += 1
        self.more_audits = 1.0
        if self.standing > self.failures and self.factor > self.least_factor:
            self.factor = max(self.least_factor, 0.5 * self.factor)
            self.standing = 0

    def of_next_run(self) -> Trust:
        """What is known of the surrogate when the same law begins another run: all that its audits
        have shown, and one event that says so."""
        trust = Trust(
            self.factor,
            self.least_factor,
            list(self.reach),
            self.is_off,
            failures=self.failures,
            narrowed=self.narrowed,
        )
        if self.failures:
            does = f"risks count {self.factor:.3g} times"
            for name, size in zip(INPUT_NAMES, self.reach, strict=True):
                if np.isfinite(size):
                    does += f", states with {name} of more than {size:.3g} are left to RVEs"
            if self.is_off:
                does = "RVEs answer"
            finding = f"audits of an earlier run by this law found wrong answers; {does}"
            trust._note(0, f"{finding} (reset_counts begins again)", "none")
        return trust

    def warn(self, step: int, finding: str) -> None:
        """Report something that changes nothing, once."""
        if all(event["finding"] != finding for event in self.events):
            self._note(step, finding, "none")

    def to_dict(self) -> dict[str, Any]:
        is_narrowed = np.isfinite(self.reach).any()
        return {
            "factor": self.factor,
            "reach": [None if np.isinf(x) else x for x in self.reach] if is_narrowed else [],
            "off": self.is_off,
            "events": list(self.events),
        }

    def _note(self, step: int, sentence: str, action: str) -> None:
        _log.warning("cache, step %d: %s", step, sentence)
        self.events.append({"step": step, "finding": sentence, "action": action})
