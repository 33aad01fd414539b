"""Counts, audits, trust and cost of a cached law: all that changes when a step is kept."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.audit import Audit, Question
from surrofe2.cache.branches import CachedState, PointSet, beyond_bifurcation, part_of, within
from surrofe2.cache.chunk import Chunk
from surrofe2.cache.cost import Meter
from surrofe2.cache.protocols import Fallback, OnTrueAnswer, Surrogate
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.trust import FaultDetector, Trust
from surrofe2.sampling import QUANTITIES, farthest_out
from surrofe2.stress_law import Status

Array = NDArray[np.float64]

FALLBACK, AUDIT = 0, 1
_REASONS = {
    Status.OUT_OF_RANGE: "out_of_range",
    Status.NOT_FINITE: "not_finite",
    Status.NOT_TRUSTED: "not_trusted",
}


def effort_of(count: int, why: NDArray[np.int8]) -> dict[str, int]:
    """Of `count` points, hits and fallbacks, the latter also by the surrogate's reason (k,)."""
    counts = np.bincount(why, minlength=len(Status)).tolist()
    by_reason = {f"fallbacks_{name}": counts[code] for code, name in _REASONS.items()}
    return {"hits": count - len(why), "fallbacks": len(why), **by_reason}


NO_EFFORT = effort_of(0, np.empty(0, dtype=np.int8))


class Monitor:
    """What a cached law has done so far, and how well.

    Attributes:
        counts: see `CachedLaw.counts`.
        trust: what lookups are given for a tolerance.
        meter: stopwatch, the one thing that runs while the law responds.
        chunk: the steps that go back if they do not stand; None where none can.
        decisions: on all chunks so far, and those that went back; lines of the event log.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        settings: CacheSettings,
        on_true_answer: OnTrueAnswer | None,
    ) -> None:
        self._surrogate = surrogate
        self._settings = settings
        self._on_true_answer = on_true_answer
        self._spread = surrogate.stress_spread if surrogate.has_bound else None
        self.counts = {**NO_EFFORT, "in_domain": 0, "steps": 0, "switched": 0}
        allowed = np.inf if self._spread is None else settings.tolerance * float(self._spread)
        self.trust = Trust(allowed)
        self.meter = Meter()
        self.chunk: Chunk | None = None
        self.decisions: list[dict[str, Any]] = []
        self._left: dict[str, dict[str, float]] = {}
        self._audit = Audit(fallback, settings.audit, settings.seed, allowed)
        self._faults = FaultDetector(learns=surrogate.learns)
        if self._spread is None and np.isfinite(settings.tolerance):
            self.trust.warn(
                0,
                "the surrogate knows no bound of its error: its range alone decides, whatever "
                "the tolerance",
            )
        if surrogate.has_bound and not surrogate.is_calibrated and np.isfinite(allowed):
            self.trust.warn(
                0,
                "the surrogate's error was not calibrated, its bound is infinite and RVEs answer "
                "in its place: calibrate it after training (surrofe2 train does, from Python "
                "surrofe2.calibrate), or allow the tolerance inf",
            )

    def note(self, F: Array, F_dot: Array, stress: Array, state: CachedState) -> None:
        """Everything that changes at a kept step but the branches."""
        self.meter.steps += 1
        counts, known, hits = self.counts, state.on_fallback, state.free().nonzero()[0]
        for name, value in effort_of(state.count, known.why).items():
            counts[name] += value
        counts["steps"] += 1
        counts["in_domain"] += len(hits)
        step = counts["steps"]
        if len(known):
            out = known.points[known.why == Status.OUT_OF_RANGE]
            self._note_what_left(F[out], F_dot[out])
            self.distribute(F, F_dot, stress, known)
        if self.trust.is_off or state.bound is None:
            return
        chosen = self._audit.choose(hits)
        if len(chosen):
            at = F[chosen], F_dot[chosen]
            steps, weight = np.full(len(chosen), step), self._surrogate.weight(*at, state.tolerance)
            asked = Question(steps, chosen, *at, stress[chosen], state.bound[chosen], weight)
            if self._audit.wait(asked):
                self.run_audit(whole=False)
        fault = self._faults.check(F, stress, state.bound, hits, known.why, state.tolerance)
        if fault is not None and not self.trust.is_off:
            self.trust.switch_off(step, fault)
            if self.chunk is not None:
                self.chunk.is_wrong = self._faults.has_hit

    def _note_what_left(self, F: Array, F_dot: Array) -> None:
        """Count by quantity the points beyond the range, and keep the farthest value of each."""
        if self._surrogate.range is None:
            return
        found = zip(*farthest_out(self._surrogate.range, F, F_dot), strict=True)
        for which, value, bound in found:
            if which < 0:
                continue
            new = {"points": 0, "farthest": float(value), "bound": float(bound)}
            left = self._left.setdefault(QUANTITIES[which], new)
            left["points"] += 1
            if abs(value - bound) > abs(left["farthest"] - left["bound"]):
                left["farthest"], left["bound"] = float(value), float(bound)

    def distribute(self, F: Array, F_dot: Array, stress: Array, known: PointSet) -> None:
        """Give the fallback's answers to whoever keeps or learns them."""
        known = known.only(~beyond_bifurcation(known.state, len(known)))
        if not len(known):
            return
        at, true = (F[known.points], F_dot[known.points]), stress[known.points]
        if self._on_true_answer is not None:
            none = np.zeros(len(known), dtype=np.int8)
            self._on_true_answer(*at, true, none, np.full(len(known), FALLBACK, dtype=np.int8))
        self._surrogate.learn(*at, true, known.state)

    def run_audit(self, *, whole: bool = True) -> None:
        """Audit what waits, or full tiles of it; distribute the truth, learn from what was wrong,
        and judge."""
        with self.meter.part("audit"):
            found = self._audit.run(whole=whole)
        if found is None:
            return
        asked, is_one_of_several = found.asked, beyond_bifurcation(found.state, len(found.error))
        if self._on_true_answer is not None:
            kept = ~is_one_of_several
            why = np.full(int(kept.sum()), AUDIT, dtype=np.int8)
            self._on_true_answer(
                asked.F[kept], asked.F_dot[kept], found.stress[kept], found.status[kept], why
            )
        wrong = (found.broken & (found.status == 0) & ~is_one_of_several).nonzero()[0]
        if len(wrong):
            state = None if found.state is None else found.state.take(wrong)
            self._surrogate.learn(asked.F[wrong], asked.F_dot[wrong], found.stress[wrong], state)
        alarm = not self.trust.is_off and self.trust.judge(
            self.counts["steps"], found.broken, found.error, asked.bound
        )
        if self.chunk is not None:
            self.chunk.add(found)
            self.chunk.is_wrong |= alarm

    def begin_chunk(self, t: float) -> None:
        """What was kept up to t stands; what follows may go back to here."""
        if self.chunk is not None and t > self.chunk.begin:
            self._decide(t, self.chunk, "stands")
        before = {
            "counts": dict(self.counts),
            "left": {name: dict(left) for name, left in self._left.items()},
            "faults": asdict(self._faults),
            "record": self._audit.record.to_values(),
        }
        self.chunk = Chunk(t, self.counts["steps"], self.trust.tolerance, before)

    def verdict(self, *, final: bool) -> bool | None:
        """Whether the chunk stands; None: not known yet. `final`: its end is that of the run."""
        chunk, step = self.chunk, self.counts["steps"]
        if chunk is None:
            return None
        over = final or chunk.is_due(step)
        if over:
            self.run_audit()
        if not chunk.is_wrong and chunk.breaks(over=over) and not self.trust.is_off:
            self.trust.tighten(step, chunk.violations, chunk.audits)
            chunk.is_wrong = True
        return False if chunk.is_wrong else (True if over else None)

    def go_back(self, t: float) -> None:
        """Know what was known when the chunk began, but for what was learnt since, and that the
        bound was too low; t is where it was found wrong."""
        assert self.chunk is not None
        self._decide(t, self.chunk, "rolled back")
        before = self.chunk.before
        self.counts, self._left = dict(before["counts"]), dict(before["left"])
        self._faults = FaultDetector(**before["faults"])
        self._audit.go_back(self.chunk.step, before["record"])
        self.chunk = Chunk(self.chunk.begin, self.chunk.step, self.trust.tolerance, before)

    def _decide(self, t: float, chunk: Chunk, decision: str) -> None:
        line = chunk.decision(t, self.counts["steps"], self.trust.tolerance, decision)
        self.decisions.append(line)

    def history(self) -> dict[str, Any]:
        """How the cache has done so far, as plain values for run.json."""
        return {
            "tolerance": {
                "share": self._settings.tolerance,
                "relative": self._settings.relative,
                "spread": self._spread,
                "absolute": self.trust.allowed,
            },
            "accepted": dict(self.counts),
            "left_range": {name: dict(left) for name, left in self._left.items()},
            "audit": {
                "share": self._settings.audit,
                "seed": self._settings.seed,
                **self._audit.record.to_dict(),
            },
            "trust": self.trust.to_dict(),
            "cost": None,
        }

    def report(self) -> dict[str, Any]:
        """`history` at the end of a run: what still waits is audited, and the cost is stated."""
        self.run_audit()
        return self.history() | {"cost": self.meter.report(all_true=not self.counts["hits"])}

    def to_arrays(self) -> dict[str, NDArray]:
        """All that it knows, and what the surrogate has learnt, for `from_arrays`."""
        values = {
            "counts": self.counts,
            "left_range": self._left,
            "trust": asdict(self.trust),
            "faults": asdict(self._faults),
            "audit": self._audit.to_values(),
            "meter": asdict(self.meter),
            "chunk": None if self.chunk is None else asdict(self.chunk),
            "decisions": self.decisions,
        }
        return {
            "values": np.frombuffer(json.dumps(values).encode(), dtype=np.uint8),
            **within("audit", self._audit.to_arrays()),
            **within("surrogate", self._surrogate.to_arrays()),
        }

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> None:
        """Know what the monitor of the same law and settings knew at its `to_arrays`."""
        values = json.loads(arrays["values"].tobytes())
        self.counts = dict(values["counts"])
        self._left = dict(values["left_range"])
        self.trust = Trust(**values["trust"])
        self._faults = FaultDetector(**values["faults"])
        self._audit.restore(part_of(arrays, "audit"), values["audit"])
        self.meter = Meter(**values["meter"])
        self.chunk = None if values["chunk"] is None else Chunk(**values["chunk"])
        self.decisions = list(values["decisions"])
        self._surrogate.from_arrays(part_of(arrays, "surrogate"))
