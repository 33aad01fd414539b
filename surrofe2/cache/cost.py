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

FEW, MANY = 16, 256
"""Points by which the true law is timed: few where it is dear."""
_DEAR = 0.02  # s
_REPEATS = 5


@dataclass
class Meter:
    """Seconds spent in the law, in total and by part, and the points it was asked for."""

    total: float = 0.0
    fallback: float = 0.0
    audit: float = 0.0
    asked: int = 0
    calls: int = 0
    steps: int = 0
    _open: list[str] = field(default_factory=list)

    def answered(self, points: int, seconds: float) -> None:
        """Count an answer for so many points."""
        self.total += seconds
        self.asked += points
        self.calls += 1

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time within for `name`; what is fallback within an audit is the audit's."""
        if name == "fallback" and "audit" in self._open:
            yield
            return
        self._open.append(name)
        began = perf_counter()
        try:
            yield
        finally:
            self._open.pop()
            setattr(self, name, getattr(self, name) + perf_counter() - began)


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds a stress of the cached law and of the true one, measured within one run.

    Attributes:
        cached: total; lookup: looking up and switching; fallback, audit: RVEs for either.
        true: the true law, warm, as a run without the cache would ask it.
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
        return {
            "cached": self.cached,
            "lookup": self.lookup,
            "fallback": self.fallback,
            "audit": self.audit,
            "true": self.true,
            "stresses": self.points,
            "times_faster": self.times_faster,
            "pays": self.pays,
            "sentence": self.sentence(),
        }


def cost_of(meter: Meter, true: float) -> Cost | None:
    """The cost a stress; None where nothing was asked."""
    if not meter.asked:
        return None
    share = 1.0 / meter.asked
    return Cost(
        cached=meter.total * share,
        lookup=(meter.total - meter.fallback - meter.audit) * share,
        fallback=meter.fallback * share,
        audit=meter.audit * share,
        true=true,
        points=meter.asked,
    )


def time_true_law(
    law: Fallback, before: tuple[Array, Array], now: tuple[Array, Array], calls_a_step: float
) -> float | None:
    """Seconds a stress of the true law where a run has just been, warm from a step before.

    A step is one acceptance and so many calls. None where the law has no answer there.
    """
    seconds = None
    for many in (FEW, MANY):
        (F_old, F_dot_old), (F, F_dot) = ((a[:many], b[:many]) for a, b in (before, now))
        cold = law.respond(F_old, F_dot_old, None)
        if cold.status.any():
            return seconds
        state = law.accept(F_old, F_dot_old, cold).state
        taken = [_time_step(law, F, F_dot, state, calls_a_step) for _ in range(_REPEATS)]
        seconds = float(np.median(taken)) / len(F)
        if min(taken) > _DEAR or len(now[0]) <= FEW:
            return seconds
    return seconds


def _time_step(law: Fallback, F: Array, F_dot: Array, state: Any, calls: float) -> float:
    began = perf_counter()
    answer = law.respond(F, F_dot, state)
    asked = perf_counter()
    law.accept(F, F_dot, answer)
    return asked - began + (perf_counter() - asked) / max(calls, 1.0)
