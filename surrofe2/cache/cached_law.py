"""`CachedLaw`: the surrogate where it may be trusted, RVEs elsewhere, point by point."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.sampling import QUANTITIES, farthest_out
from surrofe2.base.tensors import to_inputs
from surrofe2.cache.audit import Audit
from surrofe2.cache.branches import (
    NO_POINTS,
    CachedState,
    Indices,
    PointSet,
    accept_known,
    added,
    answer_both,
    beyond_bifurcation,
    check_state,
    choose_branches,
    is_ready,
    look_up,
    tangents_of_both,
)
from surrofe2.cache.protocols import (
    Fallback,
    OnTrueAnswer,
    Surrogate,
    check_match,
    check_scale,
)
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.trust import Trust, Window
from surrofe2.law.stress_law import (
    SURROGATE,
    TABLE,
    Sources,
    Status,
    StressResponse,
    check_deformation,
    require_tangents,
)
from surrofe2.run.journal import part_of, within
from surrofe2.run.views import Facts, Viewed

Array = NDArray[np.float64]

FALLBACK, AUDIT = 0, 1
"""Why an RVE answered, see `OnTrueAnswer`."""
_REASONS = {
    Status.OUT_OF_RANGE: "out_of_range",
    Status.NOT_FINITE: "not_finite",
    Status.NOT_TRUSTED: "not_trusted",
}


def effort_of(count: int, why: NDArray[np.int8]) -> dict[str, int]:
    """Of `count` points, hits and fallbacks, the latter also by the surrogate's reason (k,)."""
    counts = np.bincount(why, minlength=max(Status) + 1).tolist()
    by_reason = {f"fallbacks_{name}": counts[code] for code, name in _REASONS.items()}
    return {"hits": count - len(why), "fallbacks": len(why), **by_reason}


NO_EFFORT = effort_of(0, np.empty(0, dtype=np.int8))


class CachedLaw(Viewed):
    """σ(F, Ḟ) from `surrogate` where its risk is within the limit, else from `fallback`.

    Within a step a point may move from the surrogate to the fallback, not back; the answer that
    finds one says so (`StressResponse.switched`) and the step begins again, see
    `stress_law.SwitchingLaw`. `respond` is pure: counts, audits, trust, harvest and learning change
    in `accept`, and only when no point objects, and in `verdict`.

    Audits are judged in windows of steps (`trust`). Whoever marks where a window begins can go back
    to it; for others a window that failed only makes the next steps more cautious.

    Args:
        surrogate: e.g. `surrofe2.surrogate.SurrogateLaw`; see `protocols.Surrogate`.
        fallback: the law the surrogate was trained on, e.g. `surrofe2.rve.RveLaw`.
        on_true_answer: is given every RVE answer at accepted steps, see `OnTrueAnswer`.

    Raises:
        MismatchError: they are not of the same plant cell and initialisation, or the surrogate's
            scale of stress is not that of the fallback.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        settings: CacheSettings | None = None,
        on_true_answer: OnTrueAnswer | None = None,
    ) -> None:
        check_match(surrogate, fallback)
        check_scale(surrogate, fallback)
        own = self.settings = settings or CacheSettings()
        self.surrogate = surrogate.with_tolerance(own.tolerance, own.relative)
        self.fallback = fallback
        self.density = fallback.density
        self.on_true_answer = on_true_answer
        self.reset_counts()

    def facts(self) -> Facts:
        counts = self.counts
        return {
            "surrogate": self.surrogate,
            "fallback": self.fallback,
            "tolerance": f"{self.settings.tolerance:g} of the spread of stress",
            "answered by the surrogate": f"{counts['hits']:,}",
            "by the fallback": f"{counts['fallbacks']:,}",
        }

    @property
    def has_tangents(self) -> bool:
        """Whether both parts give tangents."""
        return self.surrogate.has_tangents and self.fallback.has_tangents

    @property
    def counts(self) -> dict[str, int]:
        """Points at ends of kept steps since the last reset: `hits`, `fallbacks` and, of these, by
        reason; `in_domain`, those within the range of the surrogate; `steps`; `switched`, solves by
        which a point began a step on the fallback."""
        return dict(self._counts)

    def reset_counts(self) -> None:
        """Begin as if nothing had been asked: counts, audits and trust."""
        surrogate, own = self.surrogate, self.settings
        allowed = own.tolerance * surrogate.stress_spread
        self._counts = {**NO_EFFORT, "in_domain": 0, "steps": 0, "switched": 0}
        self._left_range: dict[str, dict[str, float]] = {}
        self._audit = Audit(surrogate, self.fallback, own.audit, own.seed, allowed)
        self._trust = Trust()
        self._window = Window(0.0, 0, self._trust.limit)
        self._decisions: list[dict[str, Any]] = []
        self._marked: CachedState | None = None
        if not surrogate.is_calibrated and np.isfinite(allowed):
            self._trust.warn(
                0,
                "the surrogate's error was not calibrated, its bound is infinite and RVEs answer "
                "instead: calibrate it after training (surrofe2 train does, from Python "
                "surrofe2.calibrate), or allow the tolerance inf",
            )

    def history(self) -> dict[str, Any]:
        """How the cache has done so far, as plain values for run.json."""
        own, record = self.settings, self._audit.record
        return {
            "tolerance": {
                "share": own.tolerance,
                "relative": own.relative,
                "spread": self.surrogate.stress_spread,
                "absolute": record.tolerance,
            },
            "accepted": dict(self._counts),
            "left_range": {name: dict(left) for name, left in self._left_range.items()},
            "audit": {"share": own.audit, "seed": own.seed, **record.to_dict()},
            "trust": self._trust.to_dict(),
        }

    def report(self) -> dict[str, Any]:
        """`history` at the end of a run: what still waits is audited."""
        self._audit.end()
        self._run_audit()
        if self._audit.record.says_little:
            self._trust.warn(
                self._counts["steps"],
                "audits say little: stresses where they looked are no larger than the tolerance; "
                "allow a smaller one",
            )
        return self.history()

    @property
    def is_audited(self) -> bool:
        """Whether any answer is; see `AuditedLaw`."""
        return self.settings.audit > 0.0

    @property
    def decisions(self) -> list[dict[str, Any]]:
        """On windows of steps, in order: which stand and which were rolled back, and why."""
        return [dict(each) for each in self._decisions]

    def mark(self, t: float, state: CachedState) -> None:
        """What was kept up to t stands; what follows may be rolled back to here. Where a window
        ends before it is full, the next one carries on its audits, so that the plan holds for each.
        """
        window = self._window
        if window.before is not None and t > window.begin:
            self._decide(t, "stands")
        if window.is_full and not window.failed:
            self._trust.stand()
        carried = [] if window.is_full or window.failed else window.audits
        before = {
            "carried": carried,
            "counts": dict(self._counts),
            "left_range": {name: dict(left) for name, left in self._left_range.items()},
            "record": self._audit.record.to_values(),
        }
        self._window = Window(t, self._counts["steps"], self._trust.limit, before, list(carried))
        self._audit.begin()
        self._marked = state

    def verdict(self, *, final: bool = False) -> bool | None:
        """Whether the steps since the mark stand; None: not known yet."""
        window, trust = self._window, self._trust
        if final:
            self._audit.end()
        is_over = final or window.is_full
        if is_over:
            self._run_audit()
        if not (window.stands or window.failed or trust.is_off):
            trust.fail(self._counts["steps"], window)
        return False if window.failed else (True if is_over else None)

    def roll_back(self, t: float) -> CachedState:
        """The state at the mark, with the trust of now: if these answers failed, with less."""
        window, before = self._window, self._window.before
        assert before is not None
        assert self._marked is not None
        self._decide(t, "rolled back")
        self._counts = dict(before["counts"])
        self._left_range = {name: dict(left) for name, left in before["left_range"].items()}
        self._audit.go_back(window.step, before["record"])
        if window.failed:
            before["carried"] = []  # under another factor it says nothing
        at = window.begin, window.step, self._trust.limit
        self._window = Window(*at, before, list(before["carried"]))
        return replace(self._marked, limit=self._trust.limit, reach=self._trust.reaches)

    def _decide(self, t: float, decision: str) -> None:
        step, limit = self._counts["steps"], self._trust.limit
        self._decisions.append(self._window.decision(t, step, limit, decision))

    def state_to_arrays(self, state: CachedState) -> dict[str, NDArray]:
        """All that decides what comes next, `state` being what `accept` gave last."""
        values = {
            "counts": self._counts,
            "left_range": self._left_range,
            "trust": asdict(self._trust),
            "audit": self._audit.to_values(),
            "window": asdict(self._window),
            "decisions": self._decisions,
        }
        return {
            "values": np.frombuffer(json.dumps(values).encode(), dtype=np.uint8),
            **within("state", state.to_arrays()),
            **within("marked", {} if self._marked is None else self._marked.to_arrays()),
            **within("audit", self._audit.to_arrays()),
            **within("surrogate", self.surrogate.to_arrays()),
        }

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> CachedState:
        """Continue where a law of the same parts and settings gave these; the state to do so by."""
        self.reset_counts()
        values = json.loads(arrays["values"].tobytes())
        self._counts = dict(values["counts"])
        self._left_range = dict(values["left_range"])
        self._trust = Trust(**values["trust"])
        self._window = Window(**values["window"])
        self._decisions = list(values["decisions"])
        self._audit.restore(part_of(arrays, "audit"), values["audit"])
        self.surrogate.from_arrays(part_of(arrays, "surrogate"))
        marked = part_of(arrays, "marked")
        self._marked = CachedState.from_arrays(marked, self.fallback) if marked else None
        return CachedState.from_arrays(part_of(arrays, "state"), self.fallback)

    def respond(
        self, F: Array, F_dot: Array, state: CachedState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """Stress at n points; a point that neither part can answer has the fallback's status.

        Raises:
            InputError: tangents are asked for, and surrogate or fallback have none.
        """
        if not (is_ready(F) and is_ready(F_dot) and F.shape == F_dot.shape):
            F, F_dot = check_deformation(F, F_dot)
        if tangents:
            require_tangents(self)
        count, is_first = len(F), state is None
        if state is None:
            state = CachedState(count, limit=self._trust.limit, reach=self._trust.reaches)
        state = check_state(state, count)
        stress, status, risk = look_up(self.surrogate, F, F_dot, state)
        missed, known = status.nonzero()[0], state.on_fallback
        effort, slopes, switched = {**NO_EFFORT, "hits": count}, None, None
        if len(missed) or len(known):
            check_deformation(F, F_dot)  # hits are in range, hence finite and det F > 0
            why = status[missed]
            answer = answer_both(self.fallback, F, F_dot, known, missed, tangents=tangents)
            known = PointSet(
                np.concatenate([known.points, missed]),
                np.concatenate([known.why, why]),
                answer.state,
            )
            if len(missed) and not is_first:
                switched = np.zeros(count, dtype=np.int8)
                switched[missed] = why
            stress[known.points], status[known.points] = answer.stress, answer.status
            risk[missed] = np.inf
            effort, slopes = added(effort_of(count, known.why), answer.effort), answer.tangents
        after = replace(state, on_fallback=known, risk=risk)
        if tangents:
            slopes = tangents_of_both(self.surrogate, F, F_dot, after, slopes)
        sources = partial(self._sources, after)
        return StressResponse(stress, status, after, effort, slopes, switched, sources=sources)

    def _sources(self, state: CachedState) -> Sources:
        """Where an answer came from, `state` being the one that it carries."""
        source = np.full(state.count, TABLE if self.surrogate.learns else SURROGATE, dtype=np.int8)
        risk = np.zeros(state.count) if state.risk is None else state.risk.copy()
        known = state.on_fallback
        source[known.points], risk[known.points] = known.why, 0.0
        return Sources(source, risk)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Let the fallback check what it answered; then count, audit, learn, and choose who is
        answered by which part in the next step."""
        return self.prepare(F, F_dot, response)[1]()

    def prepare(
        self, F: Array, F_dot: Array, response: StressResponse
    ) -> tuple[NDArray[np.int8], Callable[[], StressResponse]]:
        """As of `LearningLaw`: the fallback's check, and the rest."""
        accepted = accept_known(self.fallback, F, F_dot, response)
        if accepted.status.any():
            return accepted.status, lambda: accepted
        return accepted.status, partial(self._learn, F, F_dot, accepted)

    def _learn(self, F: Array, F_dot: Array, accepted: StressResponse) -> StressResponse:
        """What follows on what the fallback has accepted."""
        self._note(F, F_dot, accepted.stress, accepted.state)
        return self._choose_branches(F, F_dot, accepted)

    def _note(self, F: Array, F_dot: Array, stress: Array, state: CachedState) -> None:
        """Everything that changes at a kept step but the branches."""
        counts, known, hits = self._counts, state.on_fallback, state.free().nonzero()[0]
        for name, value in effort_of(state.count, known.why).items():
            counts[name] += value
        counts["steps"] += 1
        counts["in_domain"] += len(hits)
        if len(known):
            out = known.points[known.why == Status.OUT_OF_RANGE]
            self._note_what_left(F[out], F_dot[out])
            self._distribute(F, F_dot, stress, known)
        if self._trust.is_off or state.risk is None:
            return
        more = self._trust.more_audits
        if self._audit.choose(counts["steps"], hits, F, F_dot, stress, state.risk, more):
            self._run_audit(whole=False)

    def _note_what_left(self, F: Array, F_dot: Array) -> None:
        """Count points beyond the range by quantity, and keep the farthest value of each."""
        if self.surrogate.range is None:
            return
        for which, value, bound in zip(*farthest_out(self.surrogate.range, F, F_dot), strict=True):
            if which >= 0:
                new = {"points": 0, "farthest": float(value), "bound": float(bound)}
                left = self._left_range.setdefault(QUANTITIES[which], new)
                left["points"] += 1
                if abs(value - bound) > abs(left["farthest"] - left["bound"]):
                    left["farthest"], left["bound"] = float(value), float(bound)

    def _distribute(self, F: Array, F_dot: Array, stress: Array, known: PointSet) -> None:
        """Give the fallback's answers to whoever keeps or learns them."""
        known = known.only(~beyond_bifurcation(known.state, len(known)))
        if not len(known):
            return
        at, exact = (F[known.points], F_dot[known.points]), stress[known.points]
        if self.on_true_answer is not None:
            none = np.zeros(len(known), dtype=np.int8)
            self.on_true_answer(*at, exact, none, np.full(len(known), FALLBACK, dtype=np.int8))
        self.surrogate.learn(*at, exact, known.state)

    def _run_audit(self, *, whole: bool = True) -> None:
        """Audit what waits, or full tiles of it; distribute the RVEs' answers, learn from what was
        wrong, and judge."""
        result = self._audit.run(whole=whole)
        if result is None:
            return
        asked, is_unique = result.asked, ~beyond_bifurcation(result.state, len(result.error))
        if self.on_true_answer is not None:
            kept = asked.F[is_unique], asked.F_dot[is_unique], result.stress[is_unique]
            why = np.full(int(is_unique.sum()), AUDIT, dtype=np.int8)
            self.on_true_answer(*kept, result.status[is_unique], why)
        wrong = (result.broken & (result.status == 0) & is_unique).nonzero()[0]
        if len(wrong):
            state = None if result.state is None else result.state.take(wrong)
            self.surrogate.learn(asked.F[wrong], asked.F_dot[wrong], result.stress[wrong], state)
        x, _ = to_inputs(asked.F, asked.F_dot)
        self._window.add(asked.points, result.broken, result.error, asked.risk, x)
        if self._window.before is None:
            self._judge_alone()

    def _judge_alone(self) -> None:
        """Judge a window of steps that nobody marked, to which nobody goes back."""
        window, trust = self._window, self._trust
        if trust.is_off or (window.stands and not window.is_full):
            return
        if window.stands:
            trust.stand()
        else:
            trust.fail(self._counts["steps"], window)
        self._window = Window(0.0, self._counts["steps"], trust.limit)

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """The start of a step with the points `switched` on the fallback; see `SwitchingLaw`."""
        state: CachedState = response.state
        new = (state.free() & (switched != 0)).nonzero()[0]
        answer = self._solve_cold(F, F_dot, new)
        stress, status = response.stress.copy(), response.status.copy()
        stress[new], status[new] = answer.stress, answer.status
        known = state.on_fallback.and_also(new, switched[new], answer.state)
        state = replace(state, on_fallback=known)
        return replace(response, stress=stress, status=status, state=state)

    def _choose_branches(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Choose the branches of the next step, looking ahead to where it will end."""
        state: CachedState = response.state
        limit, known, stress = self._trust.limit, state.on_fallback, response.stress
        if self._trust.is_off:
            leaving = np.where(state.free(), np.int8(Status.NOT_TRUSTED), np.int8(0))
            stay = np.ones(len(known), dtype=bool)
        else:
            leaving, of_surrogate, status, returning = choose_branches(
                self.surrogate, F, F_dot, state, limit, self._trust.reaches
            )
            self._counts["in_domain"] += int((status != Status.OUT_OF_RANGE).sum())
            stay = ~returning
            if returning.any():
                stress = stress.copy()
                stress[known.points[returning]] = of_surrogate[returning]
        after, new = known.only(stay), leaving.nonzero()[0]
        if len(new):
            answer = self._solve_cold(F, F_dot, new)
            solved = answer.status == 0
            fresh = PointSet(new, leaving[new], answer.state).only(solved)
            stress = stress.copy()
            stress[fresh.points] = answer.stress[solved]
            self._counts["switched"] += len(new)
            if len(fresh):
                self._distribute(F, F_dot, stress, fresh)
                after = after.and_also(fresh.points, fresh.why, fresh.state)
        state = CachedState(state.count, after, limit, self._trust.reaches, None, (F, F_dot))
        return replace(response, stress=stress, state=state)

    def _solve_cold(self, F: Array, F_dot: Array, points: Indices) -> StressResponse:
        """The fallback's checked answer at points it does not know yet."""
        answer = answer_both(self.fallback, F, F_dot, NO_POINTS, points)
        return self.fallback.accept(F[points], F_dot[points], answer)
