"""`CachedLaw`: the surrogate where it may be trusted, the true law elsewhere, point by point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.branches import (
    NO_POINTS,
    CachedState,
    Indices,
    PointSet,
    accept_known,
    added,
    answer_both,
    check_state,
    choose_branches,
    is_ready,
    look_up,
    part_of,
    tangents_of_both,
    within,
)
from surrofe2.cache.monitor import NO_EFFORT, Monitor, effort_of
from surrofe2.cache.protocols import Fallback, OnTrueAnswer, Surrogate, check_match
from surrofe2.cache.settings import CacheSettings
from surrofe2.stress_law import (
    SURROGATE,
    TABLE,
    Acceptance,
    Sources,
    Status,
    StressResponse,
    check_deformation,
    require_tangents,
)
from surrofe2.views import Viewed

Array = NDArray[np.float64]


class CachedLaw(Viewed):
    """σ(F, Ḟ) from `surrogate` where its bound is within the tolerance, else from `fallback`.

    Within a step a point may move from the surrogate to the fallback, not back; the answer that
    finds one says so (`StressResponse.switched`) and the step is begun anew, see
    `stress_law.SwitchingLaw`. `respond` is pure but for a stopwatch: counts, audits, trust, harvest
    and learning change in `accept`, and only when no point objects, and in `verdict`.

    Args:
        surrogate: e.g. `surrofe2.surrogate.SurrogateLaw`; see `protocols.Surrogate`.
        fallback: the law the surrogate was trained on, e.g. `surrofe2.rve.RveLaw`.
        settings: tolerance and audit.
        on_true_answer: is given every true answer at accepted steps, see `OnTrueAnswer`.

    Raises:
        MismatchError: they are not of the same plant cell and initialisation.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        settings: CacheSettings | None = None,
        on_true_answer: OnTrueAnswer | None = None,
    ) -> None:
        check_match(surrogate, fallback)
        own = self.settings = settings or CacheSettings()
        self.surrogate = surrogate.held_to(own.tolerance, own.relative)
        self.fallback = fallback
        self.density = fallback.density
        self.on_true_answer = on_true_answer
        self.reset_counts()

    def __repr__(self) -> str:
        return f"<CachedLaw: {self.counts['hits']} hits; {self.surrogate}, else {self.fallback}>"

    @property
    def has_tangents(self) -> bool:
        """Whether both parts give tangents."""
        return self.surrogate.has_tangents and self.fallback.has_tangents

    @property
    def counts(self) -> dict[str, int]:
        """Points at ends of kept steps since the last reset: `hits`, `fallbacks` and, of these,
        by reason; `in_domain`, those within the range of the surrogate; `steps`; `switched`,
        solves by which a point began a step on the fallback."""
        return dict(self._monitor.counts)

    def reset_counts(self) -> None:
        """Begin as if nothing had been asked: counts, audits, trust and stopwatch."""
        self._monitor = Monitor(self.surrogate, self.fallback, self.settings, self.on_true_answer)
        self._marked: CachedState | None = None

    def history(self) -> dict[str, Any]:
        """How the cache has done so far, as plain values for run.json."""
        return self._monitor.history()

    def report(self) -> dict[str, Any]:
        """`history` at the end of a run: what still waits is audited, and the cost is stated."""
        return self._monitor.report()

    @property
    def is_audited(self) -> bool:
        """Whether any answer is; see `AuditedLaw`."""
        return self.settings.audit > 0.0

    @property
    def decisions(self) -> list[dict[str, Any]]:
        """On chunks of steps, in order: which stand and which were rolled back, and why."""
        return [dict(each) for each in self._monitor.decisions]

    def mark(self, t: float, state: CachedState) -> None:
        """What was kept up to t stands; what follows may be rolled back to here."""
        self._monitor.begin_chunk(t)
        self._marked = state

    def verdict(self, *, final: bool = False) -> bool | None:
        """Whether the steps since the mark stand; None: not known yet."""
        with self._monitor.meter.part("total"):
            return self._monitor.verdict(final=final)

    def roll_back(self, t: float) -> CachedState:
        """The state at the mark, by the bound as it is now."""
        assert self._marked is not None
        self._monitor.go_back(t)
        return replace(self._marked, tolerance=self._monitor.trust.tolerance)

    def to_arrays(self, state: CachedState) -> dict[str, NDArray]:
        """All that decides what comes next, `state` being what `accept` gave last.

        That is its branches with the fallback's warm start, counts, audits with those that wait,
        trust, the random stream, and what the surrogate has learnt.
        """
        marked = {} if self._marked is None else self._marked.to_arrays()
        return {
            **within("state", state.to_arrays()),
            **within("marked", marked),
            **within("monitor", self._monitor.to_arrays()),
        }

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> CachedState:
        """Go on where a law of the same parts and settings gave these; its state to continue by."""
        self.reset_counts()
        self._monitor.from_arrays(part_of(arrays, "monitor"))
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
        began = perf_counter()
        answer = self._respond(F, F_dot, state, tangents)
        self._monitor.meter.answered(len(F), perf_counter() - began)
        return answer

    def _respond(
        self, F: Array, F_dot: Array, given: CachedState | None, tangents: bool
    ) -> StressResponse:
        count = len(F)
        if given is None:
            state = CachedState(count, tolerance=self._monitor.trust.tolerance)
        else:
            state = check_state(given, count)
        stress, status, bound = look_up(self.surrogate, F, F_dot, state)
        missed = status.nonzero()[0]
        if not len(missed) and not len(state.on_fallback):
            slopes = self.surrogate.tangents(F, F_dot) if tangents else None
            after = CachedState(count, state.on_fallback, state.tolerance, bound, state.before)
            return StressResponse(
                stress,
                status,
                after,
                {**NO_EFFORT, "hits": count},
                slopes,
                sources=partial(self._sources, F, F_dot, after),
            )
        check_deformation(F, F_dot)  # hits are in range, hence finite and det F > 0
        why = status[missed]
        with self._monitor.meter.part("fallback"):
            answer = answer_both(
                self.fallback, F, F_dot, state.on_fallback, missed, tangents=tangents
            )
        known = PointSet(
            np.concatenate([state.on_fallback.points, missed]),
            np.concatenate([state.on_fallback.why, why]),
            answer.state,
        )
        switched = None
        if given is not None and len(missed):
            switched = np.zeros(count, dtype=np.int8)
            switched[missed] = why
        stress[known.points], status[known.points] = answer.stress, answer.status
        bound[missed] = np.inf
        after = replace(state, on_fallback=known, bound=bound)
        return StressResponse(
            stress,
            status,
            after,
            added(effort_of(count, known.why), answer.effort),
            tangents_of_both(self.surrogate, F, F_dot, after, answer.tangents)
            if tangents
            else None,
            switched,
            sources=partial(self._sources, F, F_dot, after),
        )

    def _sources(self, F: Array, F_dot: Array, state: CachedState) -> Sources:
        """Where an answer came from, `state` being the one that it carries."""
        source = np.full(state.count, SURROGATE, dtype=np.int8)
        bound = np.zeros(state.count) if state.bound is None else state.bound.copy()
        free, known = state.free().nonzero()[0], state.on_fallback
        if len(free) and self.surrogate.learns:
            of_table = self.surrogate.is_of_table(F[free], F_dot[free], state.tolerance)
            source[free[of_table]] = TABLE
        source[known.points], bound[known.points] = known.why, 0.0
        return Sources(source, bound)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Let the fallback check what it answered; then count, audit, learn, and choose who is
        answered by which part in the next step."""
        return self.prepare(F, F_dot, response)[1]()

    def prepare(
        self, F: Array, F_dot: Array, response: StressResponse
    ) -> tuple[NDArray[np.int8], Callable[[], Acceptance]]:
        """As of `LearningLaw`: the fallback's check, and the rest."""
        with self._monitor.meter.part("total"):
            state, accepted = accept_known(
                self.fallback, F, F_dot, response, self._monitor.meter.part("fallback")
            )
        if accepted.status.any():
            return accepted.status, lambda: Acceptance(accepted.status, state)
        return accepted.status, partial(self._learn, F, F_dot, response, state, accepted)

    def _learn(
        self,
        F: Array,
        F_dot: Array,
        response: StressResponse,
        state: CachedState,
        accepted: Acceptance,
    ) -> Acceptance:
        """What follows on the fallback having `accepted`, which left `state`."""
        before: CachedState = response.state
        with self._monitor.meter.part("total"):
            if accepted.stress is not None:
                response = replace(response, stress=accepted.stress)
            self._monitor.note(F, F_dot, response.stress, state)
            chosen = self._choose_branches(F, F_dot, response, state)
        self._monitor.meter.sample(self.fallback, before.before, (F, F_dot))
        if accepted.stress is None:
            return chosen
        return replace(
            chosen,
            stress=response.stress if chosen.stress is None else chosen.stress,
            left_bifurcation=accepted.left_bifurcation,
        )

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> Acceptance:
        """The start of a step with the points `switched` on the fallback; see `SwitchingLaw`."""
        with self._monitor.meter.part("total"):
            state: CachedState = response.state
            new = (state.free() & (switched != 0)).nonzero()[0]
            answer = self._solve_cold(F, F_dot, new)
            stress, status = response.stress.copy(), response.status.copy()
            stress[new], status[new] = answer.stress, answer.status
            known = state.on_fallback.and_also(new, switched[new], answer.state)
            return Acceptance(status, replace(state, on_fallback=known), stress)

    def _choose_branches(
        self, F: Array, F_dot: Array, response: StressResponse, state: CachedState
    ) -> Acceptance:
        """Choose the branches of the next step, looking ahead to where it will end."""
        tolerance, known = self._monitor.trust.tolerance, state.on_fallback
        stress = response.stress
        if self._monitor.trust.is_off:
            leaving = np.where(state.free(), np.int8(Status.NOT_TRUSTED), np.int8(0))
            stay = np.ones(len(known), dtype=bool)
        else:
            leaving, of_surrogate, status, returning = choose_branches(
                self.surrogate, F, F_dot, state, tolerance
            )
            self._monitor.counts["in_domain"] += int((status != Status.OUT_OF_RANGE).sum())
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
            self._monitor.counts["switched"] += len(new)
            if len(fresh):
                self._monitor.distribute(F, F_dot, stress, fresh)
                after = after.and_also(fresh.points, fresh.why, fresh.state)
        return Acceptance(
            response.status,
            CachedState(state.count, after, tolerance, None, (F, F_dot)),
            None if stress is response.stress else stress,
        )

    def _solve_cold(self, F: Array, F_dot: Array, points: Indices) -> StressResponse:
        """The fallback's checked answer at points it does not know yet."""
        with self._monitor.meter.part("fallback"):
            at = F[points], F_dot[points]
            answer = answer_both(self.fallback, F, F_dot, NO_POINTS, points)
            accepted = self.fallback.accept(*at, answer)
        stress = answer.stress if accepted.stress is None else accepted.stress
        return replace(answer, stress=stress, status=accepted.status, state=accepted.state)
