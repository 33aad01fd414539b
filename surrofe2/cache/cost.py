"""Whether the cache pays: seconds a stress by the cache, all included, and by true RVEs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
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


class Meter:
    """Seconds spent in the law, in total and by part, and the points it was asked for.

    Attributes:
        total, fallback, audit: s; audit does not count as fallback.
        asked, calls, steps: points, answers and kept steps.
        sampling: s, spent on timing the true law, not in total.
        true: s a stress of the true law as timed last, None before.
    """

    def __init__(self, law: Fallback) -> None:
        self._law = law
        self.total = self.fallback = self.audit = self.sampling = 0.0
        self.asked = self.calls = self.steps = 0
        self.true: float | None = None

    def answered(self, points: int, seconds: float) -> None:
        """Count an answer for so many points."""
        self.total += seconds
        self.asked += points
        self.calls += 1

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time within for "total", "fallback" or "audit"."""
        began = perf_counter()
        try:
            yield
        finally:
            seconds = perf_counter() - began
            if name == "audit":
                self.audit += seconds
            elif name == "fallback":
                self.fallback += seconds
            else:
                self.total += seconds

    def sample(self, before: Place | None, now: Place) -> None:
        """Time the true law where the run is, warm from a step before, where it is time to.

        before, now: (F, F_dot), (n, 2, 2) each, at the ends of the last two kept steps.
        """
        is_due = self.steps >= FIRST_SAMPLE and not self.steps & (self.steps - 1)
        if before is None or not is_due or self.sampling > SHARE * self.total:
            return
        began = perf_counter()
        many = FEW if self.true is None or self.sampling > _DEAR else MANY
        old, new = ((F[:many], F_dot[:many]) for F, F_dot in (before, now))
        cold = self._law.respond(*old, None)
        if not cold.status.any():
            state = self._law.accept(*old, cold).state
            self.true = self._time_step(*new, state) / len(new[0])
        self.sampling += perf_counter() - began

    def _time_step(self, F: Array, F_dot: Array, state: Any) -> float:
        """Seconds of a call of the true law, with its part of the acceptance of a step."""
        began = perf_counter()
        answer = self._law.respond(F, F_dot, state)
        asked = perf_counter()
        self._law.accept(F, F_dot, answer)
        calls_a_step = max(self.calls / max(self.steps, 1), 1.0)
        return asked - began + (perf_counter() - asked) / calls_a_step

    def cost(self, *, all_true: bool) -> Cost | None:
        """The cost a stress; None where nothing was asked or the true law was never timed.

        all_true: whether the true law answered all of the run, which then says what it costs.
        """
        if not self.asked:
            return None
        share = 1.0 / self.asked
        true = self.fallback * share if all_true and self.fallback else self.true
        if true is None:
            return None
        return Cost(
            cached=self.total * share,
            lookup=(self.total - self.fallback - self.audit) * share,
            fallback=self.fallback * share,
            audit=self.audit * share,
            true=true,
            points=self.asked,
        )

    def to_values(self) -> dict[str, Any]:
        """All that was measured, for `from_values`."""
        return {
            "total": self.total,
            "fallback": self.fallback,
            "audit": self.audit,
            "sampling": self.sampling,
            "asked": self.asked,
            "calls": self.calls,
            "steps": self.steps,
            "true": self.true,
        }

    def from_values(self, values: Mapping[str, Any]) -> None:
        """Go on from what another has measured."""
        self.total, self.fallback = values["total"], values["fallback"]
        self.audit, self.sampling = values["audit"], values["sampling"]
        self.asked, self.calls = values["asked"], values["calls"]
        self.steps, self.true = values["steps"], values["true"]


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds a stress of the cached law and of the true one, measured within one run.

    Attributes:
        cached: total; lookup: looking up and switching; fallback, audit: RVEs for either.
        true: the true law, warm, as a run without the cache would ask it.
        points: stresses that were asked for.
    """

    cached: float
    lookup: float
    fallback: float
    audit: float
    true: float
    points: int

    @property
    def times_faster(self) -> float:
        """true / cached."""
        return self.true / self.cached

    @property
    def pays(self) -> bool:
        """Whether the cached law is the quicker one."""
        return self.times_faster > 1.0

    def sentence(self) -> str:
        """What the user should know."""
        verdict = "the cache pays" if self.pays else "the cache does not pay here; use --law rve"
        change = (
            f"{self.times_faster:.3g} times faster"
            if self.pays
            else f"{1.0 / self.times_faster:.3g} times slower"
        )
        saved = abs(self.true - self.cached) * self.points
        return (
            f"{verdict}: {1e6 * self.cached:.3g} µs a stress (lookup {1e6 * self.lookup:.3g}, "
            f"fallback {1e6 * self.fallback:.3g}, audit {1e6 * self.audit:.3g}) against "
            f"{1e6 * self.true:.3g} µs by RVEs: {change}, {saved:.3g} s "
            f"{'saved' if self.pays else 'lost'}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json; seconds a stress."""
        values = asdict(self)
        values["stresses"] = values.pop("points")
        return {
            **values,
            "times_faster": self.times_faster,
            "pays": self.pays,
            "sentence": self.sentence(),
        }
