"""`CachedLaw`: the surrogate where it may be trusted, RVEs elsewhere, point by point."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import QUANTITIES, farthest_out
from surrofe2.base.simd import TILE
from surrofe2.base.tensors import to_inputs
from surrofe2.cache.audit import Audit
from surrofe2.cache.branches import (
    NO_POINTS,
    CachedState,
    PointSet,
    are_unique,
    choose_branches,
    look_up,
    look_up_free,
)
from surrofe2.cache.closing_audit import ClosingAudit, Solved
from surrofe2.cache.protocols import Fallback, OnTrueAnswer, Surrogate, check_parts
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.table.stress_table import StressTable
from surrofe2.cache.trust import AUDITS, Trust, Window, audits_of
from surrofe2.law.bifurcation import beyond_bifurcation, is_branching
from surrofe2.law.stress_law import (
    SURROGATE,
    TABLE,
    Sources,
    Status,
    StressResponse,
    check_deformation,
    joined_values,
    require_tangents,
)
from surrofe2.run.journal import part_of, within
from surrofe2.run.views import Facts, Viewed

# Codes of why an RVE was solved, see `OnTrueAnswer`.
FALLBACK = 0
AUDIT = 1
# How counts name the reasons for which the surrogate did not answer.
_REASONS = {
    Status.OUT_OF_RANGE: "out_of_range",
    Status.NOT_FINITE: "not_finite",
    Status.NOT_TRUSTED: "not_trusted",
}


def effort_of(count: int, why: NDArray[np.int8]) -> dict[str, int]:
    """Count hits and fallbacks among `count` points.

    Args:
        why: (k,) `Status` of each fallback, for which the surrogate did not answer it.

    Returns:
        `hits`, `fallbacks`, and the latter by reason, `fallbacks_…`.
    """
    counts = np.bincount(why, minlength=max(Status) + 1).tolist()
    by_reason = {f"fallbacks_{name}": counts[code] for code, name in _REASONS.items()}
    return {"hits": count - len(why), "fallbacks": len(why), **by_reason}


NO_EFFORT = effort_of(0, np.empty(0, dtype=np.int8))


class CachedLaw(Viewed):
    """The stress σ(F, Ḟ) from `surrogate` where its risk is within the limit, else from `fallback`.

    Within a step a point may move from the surrogate to the fallback, not back. The answer in which
    one does marks it in `StressResponse.switched`, and the step begins again, see
    `stress_law.SwitchingLaw`. `respond` is pure: counts, audits, trust, harvest and learning change
    in `accept`, and only when the check rejects no point, and in `verdict`.

    Audits are judged in windows of steps (`trust`). A time loop that marks where a window begins
    can go back to it; without marks a window that failed only makes the next steps more cautious.

    Args:
        surrogate: e.g. `surrofe2.surrogate.SurrogateLaw`; see `protocols.Surrogate`.
        fallback: the law the surrogate was trained on, e.g. `surrofe2.rve.RveLaw`.
        settings: tolerance and audits.
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
        check_parts(surrogate, fallback)
        self.settings = settings or CacheSettings()
        self.surrogate = surrogate.with_tolerance(self.settings.tolerance, self.settings.relative)
        self.table = self.surrogate if isinstance(self.surrogate, StressTable) else None
        self.fallback = fallback
        self.density = fallback.density
        self.on_true_answer = on_true_answer
        # what `state_from_arrays` returned, until `begin_run` compares its state with it
        self._restored: CachedState | None = None
        self.reset_counts()

    def facts(self) -> Facts:
        """Return what a notebook shows of the law."""
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
        """True if surrogate and fallback both give tangents."""
        return self.surrogate.has_tangents and self.fallback.has_tangents

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of points at ends of accepted steps since the last reset.

        `hits` are those that the surrogate answered, `fallbacks` those that an RVE answered, also
        by reason; `in_domain` those within the range of the surrogate. `steps` counts the accepted
        steps, `switched` the points that an RVE began to answer between two steps.
        """
        return dict(self._counts)

    def reset_counts(self) -> None:
        """Reset counts, audits and trust, as if nothing had been asked."""
        self._begin(Trust())

    def begin_run(self, state: CachedState | None, t: float = 0.0) -> bool:
        """Begin a run, or continue one; see `AuditedLaw`.

        Counts and audits begin at zero, from t (µs) on; the trust that earlier runs left stays. But
        where `state` is the one that `state_from_arrays` returned last, everything continues.

        Returns:
            Whether it continues.
        """
        resumes = state is not None and state is self._restored
        self._restored = None
        if not resumes:
            self._begin(self._trust.of_next_run(), t)
        return resumes

    def _begin(self, trust: Trust, since: float = 0.0) -> None:
        """Set counts and audits to zero.

        Args:
            trust: how far the surrogate is trusted from here on.
            since: time from which on answers are counted, µs.
        """
        surrogate = self.surrogate
        settings = self.settings
        allowed = settings.tolerance * surrogate.stress_spread
        self._counts = Counter({**NO_EFFORT, "in_domain": 0, "steps": 0, "switched": 0})
        self._left_range: dict[str, dict[str, float]] = {}
        self._audit = Audit(surrogate, self.fallback, settings.audit, settings.seed, allowed)
        self._closing = ClosingAudit(
            surrogate, self.fallback, settings.seed, allowed, is_wanted=settings.audit > 0.0
        )
        self._trust = trust
        self._since = since
        self._window = Window(since, 0, self._trust.limit)
        self._decisions: list[dict[str, Any]] = []
        # the state at the last mark; None also where a run resumed cold there
        self._marked: CachedState | None = None
        self._points = 0  # number of points of the last step
        if not surrogate.is_calibrated and np.isfinite(allowed):
            self._trust.warn(
                0,
                "the surrogate's error was not calibrated, its bound is infinite and RVEs answer "
                "instead: calibrate it after training (surrofe2 train does, from Python "
                "surrofe2.calibrate), or allow the tolerance inf",
            )

    def history(self) -> dict[str, Any]:
        """Return how the cache has done so far, as plain values for run.json."""
        settings = self.settings
        record = self._audit.record
        return {
            "since": self._since,
            "tolerance": {
                "share": settings.tolerance,
                "relative": settings.relative,
                "spread": self.surrogate.stress_spread,
                "absolute": record.tolerance,
            },
            "accepted": dict(self._counts),
            "left_range": deepcopy(self._left_range),
            "audit": {"share": settings.audit, "seed": settings.seed, **record.to_dict()},
            "closing_audit": self._closing.to_dict(),
            "trust": self._trust.to_dict(),
        }

    def report(self) -> dict[str, Any]:
        """Complete the audits, then the closing one, and return `history` at the end of a run."""
        self._audit.end(self._wanted())
        self._run_audit()
        while (solved := self.next_closing()) is not None:
            self.commit_closing(solved)
        if self._audit.record.says_little:
            self._trust.warn(
                self._counts["steps"],
                "audits say little: stresses where they looked are no larger than the tolerance; "
                "allow a smaller one",
            )
        return self.history()

    @property
    def closing_progress(self) -> tuple[int, int]:
        """Two numbers: answers of the closing audit that are solved, and all that it takes."""
        return self._closing.progress

    def next_closing(self) -> Solved | None:
        """Solve the next batch of the closing audit by RVEs; None where it is complete. Pure."""
        return self._closing.next_batch()

    def commit_closing(self, solved: Solved) -> None:
        """Record a batch of the closing audit, keep the RVEs' answers and learn what was wrong."""
        asked = solved.asked
        is_wrong = self._closing.commit(solved)
        self._keep(asked.F, asked.F_dot, solved.truth, AUDIT, is_wrong)

    @property
    def is_audited(self) -> bool:
        """True if a part of the answers is audited; see `AuditedLaw`."""
        return self.settings.audit > 0.0

    @property
    def decisions(self) -> list[dict[str, Any]]:
        """The decisions on windows of steps, in order: which stand, which do not, and why."""
        return [dict(decision) for decision in self._decisions]

    def mark(self, t: float, state: CachedState | None) -> None:
        """Let the steps up to t (µs) stand, and begin a window, to which `roll_back` goes back.

        A window that ends before it has all its audits was not judged. The next one carries on its
        audits and its try, so that the acceptance plan holds for each.
        """
        window = self._window
        if window.before is not None and t > window.begin:
            self._decide(t, "stands")
        if window.is_full and not window.failed:
            self._trust.stand()
        was_judged = window.is_full or window.failed
        carried = [] if was_judged else window.audits
        before = {"carried": carried, **self._counted()}
        tries = window.tries if carried else 1
        step = self._counts["steps"]
        limit = self._trust.limit
        self._window = Window(t, step, limit, before, list(carried), tries=tries)
        self._audit.begin()
        self._closing.mark()
        self._marked = state

    def verdict(self, *, final: bool = False) -> bool | None:
        """Return whether the steps since the mark stand; None: not known yet."""
        window = self._window
        trust = self._trust
        if final:
            self._audit.end(self._wanted())
        is_over = final or window.is_full
        if is_over:
            self._run_audit()
        if not (window.stands or window.failed or trust.is_off):
            trust.fail(self._counts["steps"], window)
        if window.failed:
            return False
        return True if is_over else None

    def _wanted(self) -> int:
        """Return how many audits are missing.

        A window that is tried again needs as many as its try asks for, another one as many as every
        run.
        """
        window = self._window
        if window.tries > 1:
            return audits_of(window.tries) - len(window.audits)
        return AUDITS - self._audit.record.audited

    def roll_back(self, t: float) -> CachedState:
        """Return the state at the mark with the trust of now, which is less if the audits failed.

        Counts and audits since the mark are forgotten. Where the run resumed cold at the mark, no
        point is on the fallback yet.
        """
        window = self._window
        before = window.before
        assert before is not None
        self._decide(t, "rolled back")
        self._counts = Counter(before["counts"])
        self._left_range = deepcopy(before["left_range"])
        self._audit.go_back(window.step, before["record"])
        self._closing.go_back()
        if window.failed:
            before["carried"] = []  # under another factor it says nothing
        self._window = Window(
            window.begin,
            window.step,
            self._trust.limit,
            before,
            list(before["carried"]),
            tries=window.tries + int(window.failed),
        )
        limit = self._trust.limit
        reach = np.array(self._trust.reach)
        if self._marked is None:
            return CachedState(self._points, NO_POINTS, limit, reach)
        return replace(self._marked, limit=limit, reach=reach)

    def _counted(self) -> dict[str, Any]:
        """Return a copy of what is counted of accepted steps, as plain values."""
        record = asdict(self._audit.record)
        left_range = deepcopy(self._left_range)
        return {"counts": dict(self._counts), "left_range": left_range, "record": record}

    def _decide(self, t: float, decision: str) -> None:
        """Record a decision on the window, at t (µs)."""
        step = self._counts["steps"]
        limit = self._trust.limit
        self._decisions.append(self._window.decision(t, step, limit, decision))

    def beyond_bifurcation(self, state: CachedState) -> Flags | None:
        """Return (n,) which points of the fallback are beyond a bifurcation.

        None of the others is, since a surrogate learns the stress of one branch alone. None: the
        fallback does not know.
        """
        if not is_branching(self.fallback):
            return None
        known = state.on_fallback
        flags = np.zeros(state.count, dtype=np.bool_)
        at_known = beyond_bifurcation(self.fallback, known.state)
        if at_known is not None:
            flags[known.points] = at_known
        return flags

    def state_to_arrays(self, state: CachedState) -> dict[str, NDArray]:
        """Return all that decides what comes next, where `accept` gave `state` last."""
        values = {
            **self._counted(),
            "since": self._since,
            "trust": asdict(self._trust),
            "audit": self._audit.to_values(),
            "closing": self._closing.to_values(),
            "window": asdict(self._window),
            "decisions": self._decisions,
        }
        marked = {} if self._marked is None else self._marked.to_arrays(self.fallback)
        return {
            "values": np.frombuffer(json.dumps(values).encode(), dtype=np.uint8),
            **within("state", state.to_arrays(self.fallback)),
            **within("marked", marked),
            **within("audit", self._audit.to_arrays()),
            **within("closing", self._closing.to_arrays()),
            **within("table", {} if self.table is None else self.table.to_arrays()),
        }

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> CachedState:
        """Continue from arrays of a law of the same parts and settings; return its state."""
        values = json.loads(arrays["values"].tobytes())
        self._counts = Counter(values["counts"])
        self._left_range = values["left_range"]
        self._since = float(values["since"])
        self._trust = Trust(**values["trust"])
        self._window = Window(**values["window"])
        self._decisions = values["decisions"]
        self._audit.restore(part_of(arrays, "audit"), values["audit"], values["record"])
        self._closing.restore(part_of(arrays, "closing"), values["closing"])
        if self.table is not None:
            self.table.from_arrays(part_of(arrays, "table"))
        marked = part_of(arrays, "marked")
        self._marked = CachedState.from_arrays(marked, self.fallback) if marked else None
        state = CachedState.from_arrays(part_of(arrays, "state"), self.fallback)
        self._points = state.count
        self._restored = state
        return state

    def respond(
        self, F: Array, F_dot: Array, state: CachedState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at n points, each by the surrogate or by an RVE.

        A point for which neither has a stress has the fallback's status.

        Raises:
            InputError: tangents are asked for, and surrogate or fallback have none.
        """
        # the whole check costs as much as a lookup, so it is left out where lookups need none
        if not (_is_ready(F) and _is_ready(F_dot) and F.shape == F_dot.shape):
            F, F_dot = check_deformation(F, F_dot)
        if tangents:
            require_tangents(self)
        count = len(F)
        is_first = state is None
        if state is None:
            state = CachedState(count, NO_POINTS, self._trust.limit, np.array(self._trust.reach))
        _check_state(state, count)
        stress, status, risk = look_up_free(self.surrogate, F, F_dot, state)
        missed = status.nonzero()[0]
        known = state.on_fallback
        effort = {**NO_EFFORT, "hits": count}
        slopes = []
        switched = None
        if len(missed) or len(known):
            check_deformation(F, F_dot)  # hits are in range, hence finite and det F > 0
            new = PointSet(missed, status[missed])
            known = NO_POINTS
            if len(missed) and not is_first:
                switched = np.zeros(count, dtype=np.int8)
                switched[missed] = new.why
            risk[missed] = np.inf
            effort = Counter(effort_of(count, np.concatenate([state.on_fallback.why, new.why])))
            for part in (state.on_fallback, new):
                if not len(part):
                    continue
                answer = self.fallback.respond(
                    F[part.points], F_dot[part.points], part.state, tangents=tangents
                )
                stress[part.points] = answer.stress
                status[part.points] = answer.status
                slopes.append((part.points, answer.tangents))
                effort.update(answer.effort)
                known = known.and_also(replace(part, state=answer.state))
        after = replace(state, on_fallback=known, risk=risk)
        all_tangents = None
        if tangents:
            free = after.free()
            all_tangents = self.surrogate.tangents(F[free], F_dot[free])
            if slopes:
                all_tangents = joined_values([(free.nonzero()[0], all_tangents), *slopes])
        sources = partial(self._sources, after)
        return StressResponse(
            stress, status, after, effort, all_tangents, switched, sources=sources
        )

    def leaving(self, F: Array, F_dot: Array, state: CachedState) -> NDArray[np.int8] | None:
        """Return which points the surrogate does not answer any more; see `ForesightLaw`."""
        if state is None:
            return None
        _check_state(state, len(F))
        _, switched, _ = look_up_free(self.surrogate, F, F_dot, state)
        return switched if switched.any() else None

    def _sources(self, state: CachedState) -> Sources:
        """Return where an answer came from, by the state that it carries."""
        source = np.full(state.count, SURROGATE if self.table is None else TABLE, dtype=np.int8)
        risk = np.zeros(state.count) if state.risk is None else state.risk.copy()
        known = state.on_fallback
        source[known.points] = known.why
        risk[known.points] = 0.0
        return Sources(source, risk)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Let the fallback check its answers; then count, audit and learn.

        The branches of the next step are chosen, too: which points the surrogate answers then.
        """
        checked = self.check(F, F_dot, response)
        return checked if checked.status.any() else self.commit(F, F_dot, checked)

    def check(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Let the fallback accept its points, and return the response with what it changes there.

        See `LearningLaw`.
        """
        state: CachedState = response.state
        known = state.on_fallback
        if not len(known):
            return response
        points = known.points
        answer = StressResponse(response.stress[points], response.status[points], known.state)
        accepted = self.fallback.accept(F[points], F_dot[points], answer)
        status = response.status.copy()
        stress = response.stress
        has_left = None
        status[points] = accepted.status
        if accepted.left_bifurcation is not None:
            stress = stress.copy()
            has_left = np.zeros(len(status), dtype=np.bool_)
            stress[points] = accepted.stress
            has_left[points] = accepted.left_bifurcation
        state = replace(state, on_fallback=replace(known, state=accepted.state))
        return replace(
            response, stress=stress, status=status, state=state, left_bifurcation=has_left
        )

    def commit(self, F: Array, F_dot: Array, checked: StressResponse) -> StressResponse:
        """Count, audit and learn, and choose the branches of the next step."""
        counts = self._counts
        state = checked.state
        self._points = state.count
        known = state.on_fallback
        hits = state.free().nonzero()[0]
        counts.update(effort_of(state.count, known.why), steps=1, in_domain=len(hits))
        if len(known):
            out = known.points[known.why == Status.OUT_OF_RANGE]
            self._note_what_left(F[out], F_dot[out])
            self._distribute(F, F_dot, checked.stress, known)
        if not self._trust.is_off and state.risk is not None:
            answers = (counts["steps"], hits, F, F_dot, checked.stress, state.risk)
            self._closing.take(*answers)
            more = self._trust.more_audits
            if self._audit.choose(*answers, wanted=self._wanted(), more=more):
                self._run_audit(whole=False)
        return self._choose_branches(F, F_dot, checked)

    def _note_what_left(self, F: Array, F_dot: Array) -> None:
        """Count points beyond the range by the quantity that left it; keep its farthest value."""
        if self.surrogate.range is None:
            return
        for which, value, bound in zip(*farthest_out(self.surrogate.range, F, F_dot), strict=True):
            if which >= 0:
                new = {"points": 0, "farthest": float(value), "bound": float(bound)}
                beyond = self._left_range.setdefault(QUANTITIES[which], new)
                beyond["points"] += 1
                if abs(value - bound) > abs(beyond["farthest"] - beyond["bound"]):
                    beyond["farthest"] = float(value)
                    beyond["bound"] = float(bound)

    def _distribute(self, F: Array, F_dot: Array, stress: Array, known: PointSet) -> None:
        """Give the fallback's answers at known points to everything that keeps or learns them."""
        points = known.points
        answer = StressResponse(stress[points], np.zeros(len(points), dtype=np.int8), known.state)
        self._keep(F[points], F_dot[points], answer, FALLBACK, np.ones(len(points), dtype=np.bool_))

    def _keep(
        self, F: Array, F_dot: Array, answer: StressResponse, why: int, is_news: Flags
    ) -> Flags:
        """Give RVE answers to the harvest, and those that are news to the table.

        Args:
            answer: stress, status and state of the RVEs.
            why: `FALLBACK` or `AUDIT`.
            is_news: (n,) where the table is to learn.

        Returns:
            (n,) where the table has learnt.
        """
        unique = are_unique(answer.state, len(F))
        status = answer.status
        kept = unique.nonzero()[0]
        if self.on_true_answer is not None and len(kept):
            reasons = np.full(len(kept), why, dtype=np.int8)
            self.on_true_answer(F[kept], F_dot[kept], answer.stress[kept], status[kept], reasons)
        if self.table is None:
            return np.zeros(len(F), dtype=np.bool_)
        is_learnt: Flags = unique & is_news & (status == 0)
        new = is_learnt.nonzero()[0]
        if len(new):
            state = None if answer.state is None else answer.state.take(new)
            self.table.learn(F[new], F_dot[new], answer.stress[new], state)
        return is_learnt

    def _run_audit(self, *, whole: bool = True) -> None:
        """Audit the answers that wait, or full tiles of them, and learn where they were wrong.

        A window of steps that nobody has marked is judged here: nobody can go back to its begin.
        """
        result = self._audit.run(whole=whole)
        if result is None:
            return
        asked = result.asked
        is_learnt = self._keep(asked.F, asked.F_dot, result.truth, AUDIT, result.broken)
        x, _ = to_inputs(asked.F, asked.F_dot)
        # the columns of `Window.audits`
        audits = (asked.points, result.broken, result.error, is_learnt, asked.risk, np.abs(x))
        window = self._window
        trust = self._trust
        window.audits += np.column_stack(audits).tolist()
        if window.before is not None or trust.is_off or (window.stands and not window.is_full):
            return  # `verdict` judges a window that was marked; or it is not over
        if window.stands:
            trust.stand()
        else:
            trust.fail(self._counts["steps"], window)
        self._window = Window(0.0, self._counts["steps"], trust.limit)

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """Return the start of a step with points `switched` to the fallback; see `SwitchingLaw`."""
        state: CachedState = response.state
        points = (state.free() & (switched != 0)).nonzero()[0]
        new, answer = self._solve_cold(F, F_dot, PointSet(points, switched[points]))
        stress = response.stress.copy()
        status = response.status.copy()
        stress[points] = answer.stress
        status[points] = answer.status
        state = replace(state, on_fallback=state.on_fallback.and_also(new))
        return replace(response, stress=stress, status=status, state=state)

    def learn_ahead(self, F: Array, F_dot: Array, switched: NDArray[np.int8]) -> NDArray[np.int8]:
        """Let a table learn at points that it does not answer; see `ForesightLaw`.

        It learns from RVEs at points that lie apart, a tile at a time, as long as their stresses
        answer further points.

        Returns:
            (n,) `switched` where the table still has no answer, else 0.
        """
        table = self.table
        limit = self._trust.limit
        reach = np.array(self._trust.reach)
        unanswered = switched.copy()
        if table is None or limit < 0.0:
            return unanswered
        hopeless = np.zeros(len(unanswered), dtype=np.bool_)
        while table.size < table.most_records:
            points = np.flatnonzero((unanswered != 0) & ~hopeless)
            if not len(points):
                break
            chosen = points[table.apart(F[points], F_dot[points], TILE)]
            hopeless[chosen] = True  # each is asked once, whatever comes of it
            F_chosen = F[chosen]
            F_dot_chosen = F_dot[chosen]
            answer = self._accepted_answer(F_chosen, F_dot_chosen)
            table.counts["table_rve_solves"] += len(chosen)
            learnt = (are_unique(answer.state, len(chosen)) & (answer.status == 0)).nonzero()[0]
            if len(learnt):
                state = None if answer.state is None else answer.state.take(learnt)
                table.learn(F_chosen[learnt], F_dot_chosen[learnt], answer.stress[learnt], state)
            open_points = np.flatnonzero(unanswered)
            _, status, _ = look_up(self.surrogate, F[open_points], F_dot[open_points], limit, reach)
            unanswered[open_points[status == 0]] = 0
        return unanswered

    def _choose_branches(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Choose the branches of the next step, looking ahead to where it will end."""
        state: CachedState = response.state
        limit = self._trust.limit
        reach = np.array(self._trust.reach)
        known = state.on_fallback
        stress = response.stress
        # At rest a table learns within the step where it is needed (`learn_ahead`), so points do
        # not leave it for where they may go: without a step before nothing is extrapolated.
        is_learning = self.table is not None and not F_dot.any()
        seen = replace(state, before=None) if is_learning else state
        leaving, of_surrogate, status, returning = choose_branches(
            self.surrogate, F, F_dot, seen, limit, reach
        )
        self._counts["in_domain"] += int((status != Status.OUT_OF_RANGE).sum())
        if returning.any():
            stress = stress.copy()
            stress[known.points[returning]] = of_surrogate[returning]
            known = known.only(~returning)
        points = leaving.nonzero()[0]
        if len(points):
            new, answer = self._solve_cold(F, F_dot, PointSet(points, leaving[points]))
            self._counts["switched"] += len(points)
            solved = answer.status == 0
            new = new.only(solved)
            stress = stress.copy()
            stress[new.points] = answer.stress[solved]
            self._distribute(F, F_dot, stress, new)
            known = known.and_also(new)
        state = CachedState(state.count, known, limit, reach, None, (F, F_dot))
        return replace(response, stress=stress, state=state)

    def _solve_cold(self, F: Array, F_dot: Array, new: PointSet) -> tuple[PointSet, StressResponse]:
        """Solve RVEs at points that the fallback does not know yet.

        Returns:
            The points with the fallback's state, and its checked answer.
        """
        answer = self._accepted_answer(F[new.points], F_dot[new.points])
        return replace(new, state=answer.state), answer

    def _accepted_answer(self, F: Array, F_dot: Array) -> StressResponse:
        """Return the fallback's answer from a cold start, accepted as that of a step."""
        return self.fallback.accept(F, F_dot, self.fallback.respond(F, F_dot))


def _check_state(state: Any, count: int) -> None:
    """Refuse what is no state of a CachedLaw for so many points."""
    if not isinstance(state, CachedState) or state.count != count:
        raise InputError(
            f"state: not a state of a CachedLaw for {count} points; pass what an earlier "
            "answer for the same points carried, or None"
        )


def _is_ready(tensors: Any) -> bool:
    """Return whether tensors are a contiguous float64 array (n, 2, 2), as lookups need them."""
    return (
        isinstance(tensors, np.ndarray)
        and tensors.dtype == np.float64
        and tensors.shape[1:] == (2, 2)
        and tensors.flags.c_contiguous
    )
