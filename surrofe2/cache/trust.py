"""Trust in the surrogate: one acceptance plan for windows of audits, and its factor.

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

# W and C: a window of which 2 % of the answers are wrong stands with a probability of at most 5 %,
# the consumer's risk, however often it is tried.
WRONG = 0.02
CONFIDENCE = 0.95
# k of a window of `audits_of` audits; more violations stand among so many more audits that the
# bound is kept. (359, 2) is the smallest plan of a first try by which besides a window with 0.1 %
# of wrong answers stands with a probability of at least 99 %, the producer's risk.
VIOLATIONS = 2
_WHOLE = 8  # audits that RVEs solve together for little more than one


def binomial(violations: int, audits: int, wrong: float) -> float:
    """Compute P(Bin(audits, wrong) ≤ violations) as a sum, which is short for few violations."""
    counts = range(violations + 1)
    return sum(comb(audits, k) * wrong**k * (1.0 - wrong) ** (audits - k) for k in counts)


@cache
def audits_of(tries: int) -> int:
    """Return n, the number of audits of a window at its try of this number, from 1.

    It is the smallest number, in whole tiles of RVEs, by which `VIOLATIONS` violations keep the
    consumer's risk of that try.
    """
    risk = _risk_of(tries)
    audits = _WHOLE
    while binomial(VIOLATIONS, audits, WRONG) > risk:
        audits += _WHOLE
    return audits


def _risk_of(tries: int) -> float:
    """Return the consumer's risk of the try of this number, from 1: α/2, α/4, …, together α."""
    return float((1.0 - CONFIDENCE) / 2.0**tries)


# After a window has failed, none of its violations would be answered again, by a margin: their
# risks exceed the limit, or one of their inputs exceeds its reach, by this factor.
MARGIN = 1.1
# A factor is raised at least so many times, so that few windows fail in a row.
LEAST_RAISE = 2.0
# A larger factor is not tried: then the bound says nothing of the error.
LARGEST_FACTOR = 100.0
# A reach is narrowed only where this fraction of the window's right answers stays within it, and so
# many times in all; else RVEs would answer nearly everything.
LEAST_KEPT = 0.1
MOST_NARROWED = 8
# Times as many answers are audited in the window after one that failed: a fault that is left shows
# after a quarter of the steps.
MORE_AUDITS = 4.0
# Fractions of the limit up to which the risk foreseen may rise for a point to stay with the
# surrogate, and to come back to it. What is foreseen is not met exactly, hence below 1; and they
# differ, so that no point goes to and fro.
STAY = 0.9
RETURN = 0.8
# The seven inputs of `tensors`, as messages name them.
INPUT_NAMES = (
    *(f"a {name} of U − I" for name in ("sum", "difference", "shear")),
    *(f"a {name} of RᵀḞ" for name in ("sum", "difference", "shear", "spin")),
)
_MOST_NAMED = 32  # points that a decision names

_log = logging.getLogger("surrofe2.cache")


def wrong_at_most(violations: int, audits: int, confidence: float = CONFIDENCE) -> float:
    """Compute the upper confidence bound on the fraction of wrong answers by Clopper and Pearson.

    Args:
        violations, audits: k wrong answers among n that were audited, a random sample of all.
        confidence: C.

    Returns:
        The w by which P(Bin(n, w) ≤ k) = 1 − C; 1 where all audited answers were wrong.
    """
    if violations >= audits:
        return 1.0
    # the closed form 1 − (1 − C)^(1/n), without loss of digits where w is small
    if violations == 0:
        return float(-np.expm1(np.log1p(-confidence) / audits))
    return float(scipy.special.betaincinv(violations + 1, audits - violations, confidence))


def stands(violations: int, audits: int, tries: int = 1) -> bool:
    """Return whether a window with so many violations among so many audits stands at this try.

    The tries are numbered from 1; see the head of the module for the plan.
    """
    confidence = 1.0 - _risk_of(tries)
    return violations <= VIOLATIONS or wrong_at_most(violations, audits, confidence) <= WRONG


# Audits of a window that is tried for the first time. No run has fewer.
AUDITS = audits_of(1)

# Columns of `Window.audits`.
_POINT = 0
_IS_WRONG = 1
_ERROR = 2
_IS_LEARNT = 3
_RISK = 4  # the sizes of the seven inputs stand behind it


@dataclass
class Window:
    """Accepted steps whose audits are judged together; plain values, for checkpoints.

    Attributes:
        begin: time of its begin, µs.
        step: number of accepted steps before it.
        limit: largest risk of an answer of the surrogate; negative: nothing is trusted.
        before: what a law must know to go back to its begin; None where nobody can go back.
        audits: a row for each audit: number of the point; 1 where the answer is wrong, else 0; its
            error in µN/µm, NaN where the RVE has no stress; 1 where the surrogate has learnt the
            RVE's stress since, else 0; its risk; the sizes of the seven inputs of `tensors`.
        failed: whether it was judged and does not stand.
        tries: how often it has been tried, this time counted.
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
        """The rows of the audits that found a wrong answer."""
        return [audit for audit in self.audits if audit[_IS_WRONG]]

    @property
    def is_full(self) -> bool:
        """True once the window has as many audits as this try needs, so that it can be judged."""
        return len(self.audits) >= audits_of(self.tries)

    @property
    def stands(self) -> bool:
        """True if the window stands by its audits, counted as at least `audits_of` this try."""
        return stands(len(self.wrong), len(self.audits), self.tries)

    def decision(self, t: float, step: int, limit: float, decision: str) -> dict[str, Any]:
        """Return an entry of the event log on this window.

        Args:
            t: end of the window, µs.
            step: number of accepted steps before its end.
            limit: largest risk from here on; negative: nothing is trusted.
            decision: "stands" or "rolled back".
        """
        known = [audit for audit in self.audits if not np.isnan(audit[_ERROR])]
        worst = max(known, key=lambda audit: audit[_ERROR], default=None)
        return {
            "decision": decision,
            "t": t,
            "from_t": self.begin,
            "steps": step - self.step,
            "try": self.tries,
            "audits": len(self.audits),
            "violations": len(self.wrong),
            "points": [int(audit[_POINT]) for audit in self.wrong[:_MOST_NAMED]],
            "true_error": None if worst is None else worst[_ERROR],
            "risk": None if worst is None else worst[_RISK],
            "limit_before": None if self.limit < 0.0 else self.limit,
            "limit_after": None if limit < 0.0 else limit,
        }


@dataclass
class Trust:
    """The trust in the surrogate, and what happened to it; plain values, for checkpoints.

    Attributes:
        factor: by which risks are multiplied before they are compared with 1.
        least_factor: what violations asked for; the factor does not fall below it.
        reach: sizes up to which the seven inputs of `tensors` are trusted; they only become
        smaller.
        is_off: whether RVEs answer everything.
        more_audits: by which the fraction of answers that are audited is multiplied.
        failures: number of windows that failed.
        standing: number of windows that stood since the factor changed.
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
        """The largest risk that is trusted; negative: nothing is."""
        return -1.0 if self.is_off else 1.0 / self.factor

    def fail(self, step: int, window: Window) -> None:
        """Trust the surrogate less after a window failed, so that none of its violations is
        answered again.

        Either the factor of all risks is raised, or the reach of one input is narrowed, whichever
        leaves more of the answers that were right. Where neither leaves anything, the cache is off.
        The factor may come down again from what violations asked for that the surrogate has learnt.

        Args:
            step: number of accepted steps so far, for the event log.
            window: the one that failed; it is marked so.
        """
        window.failed = True
        self.failures += 1
        self.standing = 0
        self.more_audits = MORE_AUDITS
        audits = np.array(window.audits)
        is_wrong = audits[:, _IS_WRONG] > 0.0
        is_learnt = audits[:, _IS_LEARNT] > 0.0
        # Columns: the risk, then the inputs. By each of them alone an answer would have been left
        # to an RVE if it had exceeded some bound, and all violations must exceed it.
        wrong = audits[is_wrong, _RISK:]
        right = audits[~is_wrong, _RISK:]
        least = wrong.min(axis=0, initial=np.inf)
        usable = (least > 0.0) & (least < np.inf)
        most = np.where(usable, least / MARGIN, 0.0)
        needed_factor = 1.0 / most[0] if usable[0] else np.inf
        factor = max(LEAST_RAISE * self.factor, needed_factor)
        most[0] = 1.0 / factor
        # the fraction of the right answers that each bound would leave
        kept = (right <= most).mean(axis=0) if len(right) else np.zeros(len(most))
        kept *= usable
        k = 1 + int(kept[1:].argmax())  # column of the best input
        may_narrow = kept[k] >= LEAST_KEPT and self.narrowed < MOST_NARROWED
        finding = f"{len(wrong)} of {len(wrong) + len(right)} audited answers are off by more than "
        finding += "the tolerance; "
        # a reach stays narrow, a factor may come down again: so narrow only for twice as much
        narrowing_is_better = may_narrow and kept[k] > 2.0 * kept[0]
        if factor <= LARGEST_FACTOR and not narrowing_is_better:
            self.factor = factor
            unlearnt = audits[is_wrong & ~is_learnt]
            asked = MARGIN / unlearnt[:, _RISK].min(initial=np.inf)  # 0 where all were learnt
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
        """Record that a window stood, and trust the surrogate a little more.

        Audits are as many as usual again. The factor is halved after as many windows as have failed
        so far, and one more; but it never falls below what violations asked for.
        """
        self.standing += 1
        self.more_audits = 1.0
        if self.standing > self.failures and self.factor > self.least_factor:
            self.factor = max(self.least_factor, 0.5 * self.factor)
            self.standing = 0

    def of_next_run(self) -> Trust:
        """Return the trust by which the same law begins another run.

        It has all that audits have shown of the surrogate, and one event that says so.
        """
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
        """Return plain values for run.json; an unlimited reach is None, and all unlimited: []."""
        is_narrowed = np.isfinite(self.reach).any()
        return {
            "factor": self.factor,
            "reach": [None if np.isinf(x) else x for x in self.reach] if is_narrowed else [],
            "off": self.is_off,
            "events": list(self.events),
        }

    def _note(self, step: int, sentence: str, action: str) -> None:
        """Log an event, and record it."""
        _log.warning("cache, step %d: %s", step, sentence)
        self.events.append({"step": step, "finding": sentence, "action": action})
