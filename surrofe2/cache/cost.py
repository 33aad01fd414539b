"""Whether the cache pays: seconds a stress by the cache, all included, and by true RVEs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Fallback

Array = NDArray[np.float64]
Place = tuple[Array, Array]

FEW, MANY = 16, 256
"""Points by which the true law is timed: few where it is dear."""
FIRST_SAMPLE = 16
"""Kept steps before the true law is timed; then again at 32, 64, 128, …"""
SHARE = 0.02
"""Of the seconds spent in the law, what timing the true law may take."""
_DEAR = 0.02  # s


@dataclass
class Meter:
    """Seconds spent in the law, in total and by part, and the points it was asked for.

    Attributes:
        seconds: in "total", of these in "fallback" and in "audit", which does not count as
            fallback; "sampling" is spent on timing the true law, not in total.
        asked, calls, steps: points, answers and kept steps.
        true: s a stress of the true law as timed last, None before.
    """

    seconds: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(("total", "fallback", "audit", "sampling"), 0.0)
    )
    asked: int = 0
    calls: int = 0
    steps: int = 0
    true: float | None = None

    def answered(self, points: int, seconds: float) -> None:
        """Count an answer for so many points."""
        self.seconds["total"] += seconds
        self.asked += points
        self.calls += 1

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time within for "total", "fallback" or "audit"."""
        began = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - began

    def sample(self, law: Fallback, before: Place | None, now: Place) -> None:
        """Time the true law where the run is, warm from a step before, where it is time to.

        before, now: (F, F_dot), (n, 2, 2) each, at the ends of the last two kept steps.
        """
        is_due = self.steps >= FIRST_SAMPLE and not self.steps & (self.steps - 1)
        if before is None or not is_due or self.seconds["sampling"] > SHARE * self.seconds["total"]:
            return
        began = perf_counter()
        many = FEW if self.true is None or self.seconds["sampling"] > _DEAR else MANY
        old, new = ((F[:many], F_dot[:many]) for F, F_dot in (before, now))
        cold = law.respond(*old)
        if not cold.status.any():
            state = law.accept(*old, cold).state
            calls_a_step = max(self.calls / self.steps, 1.0)
            found = []
            for _ in range(2):  # the first call finds cold caches of the processor
                start = perf_counter()
                answer = law.respond(*new, state)
                asked = perf_counter()
                law.accept(*new, answer)
                found.append(asked - start + (perf_counter() - asked) / calls_a_step)
            self.true = min(found) / len(new[0])
        self.seconds["sampling"] += perf_counter() - began

    def report(self, *, all_true: bool) -> dict[str, Any] | None:
        """Seconds a stress, for run.json; None where the true law was never timed.

        `cached` is the total, `lookup` looking up and switching, `fallback` and `audit` the RVEs
        for either, `true` the true law, warm, as a run without the cache would ask it.

        all_true: whether the true law answered all of the run, which then says what it costs.
        """
        share = 1.0 / max(self.asked, 1)
        cached, fallback, audit = (
            share * self.seconds[name] for name in ("total", "fallback", "audit")
        )
        true = fallback if all_true and fallback else self.true
        if true is None:
            return None
        lookup, faster = cached - fallback - audit, true / cached
        if faster > 1.0:
            verdict, change = "the cache pays", f"{faster:.3g} times faster"
        else:
            verdict = "the cache does not pay here; use --law rve"
            change = f"{1.0 / faster:.3g} times slower"
        saved = abs(true - cached) * self.asked
        return {
            "cached": cached,
            "lookup": lookup,
            "fallback": fallback,
            "audit": audit,
            "true": true,
            "stresses": self.asked,
            "times_faster": faster,
            "pays": faster > 1.0,
            "sentence": f"{verdict}: {1e6 * cached:.3g} µs a stress (lookup {1e6 * lookup:.3g}, "
            f"fallback {1e6 * fallback:.3g}, audit {1e6 * audit:.3g}) against {1e6 * true:.3g} µs "
            f"by RVEs: {change}, {saved:.3g} s {'saved' if faster > 1.0 else 'lost'}",
        }
