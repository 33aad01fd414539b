"""Everything of a cached law that changes while it is used, and only when a step is kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.audit import Audit, Finding, Question
from surrofe2.cache.cached_state import CachedState
from surrofe2.cache.collapse import CollapseWatch
from surrofe2.cache.cost import Meter, cost_of, time_true_law
from surrofe2.cache.counting import NO_EFFORT, effort_of
from surrofe2.cache.point_set import PointSet, beyond_bifurcation
from surrofe2.cache.protocols import Fallback, Keep, Surrogate
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.trust import Trust

Array = NDArray[np.float64]

FALLBACK, AUDIT = 0, 1


class Bookkeeping:
    """Counts, audits, trust, harvest and learning of a cached law.

    Attributes:
        counts: see `CachedLaw.counts`.
        trust: what lookups are given for a tolerance.
        meter: stopwatch, the one thing that runs while the law responds.
        latest: (F, Ḟ) of the last two kept steps.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        settings: CacheSettings,
        keep: Keep | None,
    ) -> None:
        self._fallback = fallback
        self._settings = settings
        self._keep = keep
        self._surrogate = surrogate
        self._spread = surrogate.stress_spread if surrogate.has_bound else None
        self.counts = {**NO_EFFORT, "in_domain": 0, "steps": 0, "switched": 0}
        allowed = np.inf if self._spread is None else settings.tolerance * float(self._spread)
        self.trust = Trust(allowed)
        self.meter = Meter()
        self.latest: tuple[tuple[Array, Array], tuple[Array, Array]] | None = None
        self._audit = Audit(fallback, settings.audit, settings.seed, allowed)
        self._watch = CollapseWatch(learns=surrogate.learns)
        if self._spread is None and np.isfinite(settings.tolerance):
            self.trust.warn(
                0,
                "the surrogate knows no bound of its error: its range alone decides, whatever "
                "the tolerance",
            )

    def note(self, F: Array, F_dot: Array, stress: Array, state: CachedState) -> None:
        """Everything that changes at a kept step but the branches."""
        self.meter.steps += 1
        counts, held, hits = self.counts, state.held, state.free().nonzero()[0]
        for name, value in effort_of(state.count, held.why).items():
            counts[name] += value
        counts["steps"] += 1
        counts["in_domain"] += len(hits)
        step = counts["steps"]
        if len(held):
            self.hand_on(F, F_dot, stress, held)
        if self.trust.is_off or state.bound is None:
            return
        chosen = self._audit.choose(hits)
        if len(chosen) and self._audit.wait(
            Question(
                np.full(len(chosen), step),
                chosen,
                F[chosen],
                F_dot[chosen],
                stress[chosen],
                state.bound[chosen],
            )
        ):
            self.hold_audit()
        fault = self._watch.look(F, stress, state.bound, hits, held.why, state.tolerance)
        if fault is not None and not self.trust.is_off:
            self.trust.switch_off(step, fault)

    def hand_on(self, F: Array, F_dot: Array, stress: Array, held: PointSet) -> None:
        """Give the fallback's answers to whoever keeps or learns them."""
        held = held.only(~beyond_bifurcation(held.state, len(held)))
        if not len(held):
            return
        at, true = (F[held.points], F_dot[held.points]), stress[held.points]
        if self._keep is not None:
            none = np.zeros(len(held), dtype=np.int8)
            self._keep(*at, true, none, np.full(len(held), FALLBACK, dtype=np.int8))
        self._surrogate.learn(*at, true, held.state)

    def hold_audit(self) -> None:
        """Audit what waits; keep the truth, learn what was wrong, and judge."""
        with self.meter.part("audit"):
            found = self._audit.hold()
        if found is None:
            return
        asked = found.asked
        if self._keep is not None:
            kept = ~beyond_bifurcation(found.state, len(found.error))
            why = np.full(int(kept.sum()), AUDIT, dtype=np.int8)
            self._keep(
                asked.F[kept], asked.F_dot[kept], found.stress[kept], found.status[kept], why
            )
        self._learn_from(found)
        if not self.trust.is_off:
            self.trust.judge(self.counts["steps"], found.broken, found.error, asked.bound)

    def _learn_from(self, found: Finding) -> None:
        left = beyond_bifurcation(found.state, len(found.status))
        wrong = (found.broken & (found.status == 0) & ~left).nonzero()[0]
        if not len(wrong):
            return
        state = None if found.state is None else found.state.take(wrong)
        self._surrogate.learn(
            found.asked.F[wrong], found.asked.F_dot[wrong], found.stress[wrong], state
        )

    def history(self) -> dict[str, Any]:
        """How the cache has done so far, as plain values: what `restore` takes."""
        return {
            "tolerance": {
                "share": self._settings.tolerance,
                "spread": self._spread,
                "absolute": self.trust.allowed,
            },
            "accepted": dict(self.counts),
            "audit": {
                "share": self._settings.audit,
                "seed": self._settings.seed,
                **self._audit.record.to_dict(),
            },
            "trust": self.trust.to_dict(),
            "cost": None,
        }

    def report(self) -> dict[str, Any]:
        """`history` at the end of a run: what still waits is audited, and the true law timed."""
        self.hold_audit()
        cost = None
        if self.latest is not None:
            true = self._seconds_of_true_law(*self.latest)
            cost = cost_of(self.meter, true) if true is not None else None
        return self.history() | {"cost": cost.to_dict() if cost else None}

    def _seconds_of_true_law(
        self, before: tuple[Array, Array], now: tuple[Array, Array]
    ) -> float | None:
        """Seconds a stress; those of the run itself where the true law answered all of it."""
        meter = self.meter
        if not self.counts["hits"] and meter.fallback:
            return meter.fallback / max(meter.asked, 1)
        return time_true_law(self._fallback, before, now, meter.calls / max(meter.steps, 1))

    def restore(self, report: Mapping[str, Any]) -> None:
        """Go on from the counts, audits and trust of an earlier part of the same run."""
        self.counts = {name: report["accepted"].get(name, 0) for name in self.counts}
        self._audit.record.restore(report["audit"])
        self.trust.restore(report["trust"])
