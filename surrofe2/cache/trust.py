"""How far the surrogate is believed: its bound times a factor, until audits say otherwise."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

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

_log = logging.getLogger("surrofe2.cache")


class Trust:
    """The tolerance that lookups get, and what happened to it.

    Attributes:
        allowed: the user's tolerance, µN/µm.
        factor: by which bounds are multiplied before they are compared with it.
        is_off: the cache answers nothing any more.
        events: what was found and done, in order, each with its step.
    """

    def __init__(self, allowed: float) -> None:
        self.allowed = allowed
        self.factor = 1.0
        self.is_off = False
        self.events: list[dict[str, Any]] = []
        self._forget()

    @property
    def tolerance(self) -> float:
        """What a bound may be at most, µN/µm; negative: nothing is trusted."""
        return -1.0 if self.is_off else self.allowed / self.factor

    def judge(self, step: int, broken: NDArray[np.bool_], error: Array, bound: Array) -> None:
        """Take note of audits (k,); tighten or switch off if too many broke the tolerance."""
        self._broken.extend(broken.tolist())
        with np.errstate(divide="ignore", invalid="ignore"):
            self._ratios.extend((error / bound).tolist())
        self._audits += len(broken)
        self._violations += int(broken.sum())
        recent = sum(self._broken)
        for violations, audits in ((self._violations, self._audits), (recent, len(self._broken))):
            if chance(violations, audits) < ALARM:
                self._tighten(step, violations, audits)
                return

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

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Go on from what `to_dict` gave."""
        self.factor, self.is_off = stored["factor"], stored["off"]
        self.events = [dict(event) for event in stored["events"]]

    def _tighten(self, step: int, violations: int, audits: int) -> None:
        """Multiply the bound so that it would have held over the audits that raised the alarm."""
        finding = (
            f"{violations} of {audits} audited answers are off by more than the tolerance of "
            f"{self.allowed:.3g} µN/µm (at most {100.0 * NOMINAL:g} % should be)"
        )
        ratios = np.array(self._ratios)
        wanted = np.inf
        if np.isfinite(ratios).all() and ratios.max() > 0.0:
            wanted = _MARGIN * float(np.quantile(ratios, 1.0 - NOMINAL, method="higher"))
        factor = max(2.0 * self.factor, wanted)
        self._forget()
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

    def _forget(self) -> None:
        """Audits under an earlier factor say nothing of this one."""
        self._audits = self._violations = 0
        self._broken: deque[bool] = deque(maxlen=RECENT)
        self._ratios: deque[float] = deque(maxlen=RECENT)


def chance(violations: int, audits: int) -> float:
    """Probability of so many violations or more among so many audits at the nominal share."""
    return float(bdtrc(violations - 1, audits, NOMINAL)) if violations else 1.0
