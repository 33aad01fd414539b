"""Decides how far the surrogate is trusted: by audits, and by signs of a fault without any."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # scipy.special is loaded where an audit finds a violation
from numpy.typing import NDArray

from surrofe2.stress_law import Status
from surrofe2.tensors import transpose

Array = NDArray[np.float64]

NOMINAL = 0.01
"""Share of answers whose error may exceed the bound."""
ALARM = 1e-4
"""An alarm is raised when at most the nominal share would give so many violations by chance
with no more than this probability."""
RECENT = 500
"""Audits over which a fault that begins late is looked for."""
LARGEST_FACTOR = 100.0
_MARGIN = 1.1

SILENT_STEPS, SILENT_POINTS = 20, 1000
"""Accepted steps and points from the start of a run, at rest, that should have had a hit. Later
silence may be honest: the tissue left the range, or what the tolerance allows."""
PATIENCE_WITH_LEARNERS = 40
"""As many times longer is waited for a surrogate that knows little at first and learns."""
EVERY = 5
"""Steps between looks at the answers."""
LOOKS = 3
"""Looks in a row that must find the same fault."""
_DISTINCT = 1e-3
"""Spread of FᵀF from which points are different questions."""

_REASONS = {
    Status.OUT_OF_RANGE: "out of range",
    Status.NOT_FINITE: "not finite",
    Status.NOT_TRUSTED: "not trusted",
}

_log = logging.getLogger("surrofe2.cache")


@dataclass
class Trust:
    """The tolerance that lookups get, and what happened to it; plain values, for checkpoints.

    Attributes:
        allowed: the user's tolerance, µN/µm.
        factor: by which bounds are multiplied before they are compared with it.
        is_off: the cache answers nothing any more.
        events: what was found and done, in order, each with its step.
        audits, violations: under this factor.
        broken, ratios: of the latest of these, whether each was a violation, and error/bound.
    """

    allowed: float
    factor: float = 1.0
    is_off: bool = False
    events: list[dict[str, Any]] = field(default_factory=list)
    audits: int = 0
    violations: int = 0
    broken: list[bool] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)

    @property
    def tolerance(self) -> float:
        """What a bound may be at most, µN/µm; negative: nothing is trusted."""
        return -1.0 if self.is_off else self.allowed / self.factor

    def judge(self, step: int, broken: NDArray[np.bool_], error: Array, bound: Array) -> bool:
        """Take note of audits (k,); tighten or switch off if too many broke the tolerance, and say
        whether."""
        self.broken = [*self.broken, *broken.tolist()][-RECENT:]
        with np.errstate(divide="ignore", invalid="ignore"):
            self.ratios = [*self.ratios, *(error / bound).tolist()][-RECENT:]
        self.audits += len(broken)
        self.violations += int(broken.sum())
        recent = sum(self.broken), len(self.broken)
        for violations, audits in ((self.violations, self.audits), recent):
            if chance(violations, audits) < ALARM:
                self.tighten(step, violations, audits)
                return True
        return False

    def switch_off(self, step: int, finding: str) -> None:
        """Stop using the cache for good."""
        self.is_off = True
        self._note(step, f"{finding}; the cache is off from here on, RVEs answer", "off")

    def warn(self, step: int, finding: str) -> None:
        """Say something that changes nothing."""
        self._note(step, finding, "none")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {"factor": self.factor, "off": self.is_off, "events": list(self.events)}

    def tighten(self, step: int, violations: int, audits: int) -> None:
        """Multiply the bound so that no answer would have been given that broke the tolerance."""
        finding = (
            f"{violations} of {audits} audited answers are off by more than the tolerance of "
            f"{self.allowed:.3g} µN/µm (at most {100.0 * NOMINAL:g} % should be)"
        )
        ratios = np.array(self.ratios)[np.array(self.broken, dtype=bool)]
        wanted = _MARGIN * float(ratios.max()) if np.isfinite(ratios).all() else np.inf
        factor = max(2.0 * self.factor, wanted)
        self.audits = self.violations = 0  # under this factor they say nothing of the next
        self.broken, self.ratios = [], []
        if not factor <= LARGEST_FACTOR:
            self.switch_off(step, finding)
            return
        self.factor = factor
        self._note(
            step, f"{finding}; its bound counts {factor:.3g} times from here on", "tightened"
        )

    def _note(self, step: int, sentence: str, action: str) -> None:
        _log.warning("cache, step %d: %s", step, sentence)
        self.events.append({"step": step, "finding": sentence, "action": action})


@dataclass
class FaultDetector:
    """Detects a broken surrogate without audits: no hits, a constant answer, or a constant bound.

    Attributes:
        learns: whether it may begin empty.
        steps: accepted ones; silent_steps, silent_points: those without any hit so far.
        one_answer, constant_bound: looks in a row that found the fault.
        bound: at the first hit of the latest look.
    """

    learns: bool
    steps: int = 0
    silent_steps: int = 0
    silent_points: int = 0
    one_answer: int = 0
    constant_bound: int = 0
    bound: float | None = None
    has_hit: bool = False

    def check(
        self,
        F: Array,
        stress: Array,
        bound: Array,
        hits: NDArray[np.intp],
        why: NDArray[np.int8],
        tolerance: float,
    ) -> str | None:
        """Take note of an accepted step.

        Args:
            F, stress: (n, 2, 2) of all points. bound: (n,), used at hits alone.
            hits: (k,) points the surrogate answered; why: (n − k,) why it did not, elsewhere.
            tolerance: that bounds were compared with, µN/µm.
        """
        self.steps += 1
        if not len(hits):
            return None if self.has_hit else self._silence(why)
        self.has_hit = True
        if self.steps % EVERY or not _differ(F[hits]):
            return None
        self.one_answer = self.one_answer + 1 if _is_one_answer(stress[hits]) else 0
        if self.one_answer >= LOOKS:
            return f"the surrogate gave one answer at {len(hits)} different deformations"
        changes = self._bound_changes(bound[hits], tolerance)
        self.constant_bound = 0 if changes else self.constant_bound + 1
        if self.constant_bound >= LOOKS:
            return f"the surrogate's bound stands still at {self.bound:.3g} µN/µm"
        return None

    def _silence(self, why: NDArray[np.int8]) -> str | None:
        self.silent_steps += 1
        self.silent_points += len(why)
        patience = PATIENCE_WITH_LEARNERS if self.learns else 1
        if (
            self.silent_steps < SILENT_STEPS * patience
            or self.silent_points < SILENT_POINTS * patience
        ):
            return None
        codes, counts = np.unique(why, return_counts=True)
        most = Status(int(codes[counts.argmax()]))
        return (
            f"no hit in {self.silent_steps} steps ({self.silent_points} points, most of them "
            f"{_REASONS.get(most, most.name)})"
        )

    def _bound_changes(self, bound: Array, tolerance: float) -> bool:
        """A bound that is the tolerance itself is no estimate of this point, and may stand."""
        before, self.bound = self.bound, float(bound[0])
        if not np.isfinite(self.bound) or self.bound in (0.0, tolerance):
            return True
        same = bool((bound == bound[0]).all())
        return not same or (before is not None and before != self.bound)


def _differ(F: Array) -> bool:
    return bool(np.ptp(transpose(F) @ F, axis=0).max() > _DISTINCT)


def _is_one_answer(stress: Array) -> bool:
    """Whether trace and norm are the same everywhere: rotations of one stress are one answer."""
    norm = np.sqrt((stress**2).sum(axis=(1, 2)))
    spread = np.ptp(norm) + np.ptp(stress[:, 0, 0] + stress[:, 1, 1])
    return bool(spread <= 1e-9 * norm.max())


def chance(violations: int, audits: int) -> float:
    """Probability of so many violations or more among so many audits at the nominal share."""
    return float(scipy.special.bdtrc(violations - 1, audits, NOMINAL)) if violations else 1.0
