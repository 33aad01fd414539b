"""`CachedLaw`: the surrogate where it may be trusted, the true law elsewhere, point by point."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.audit import Audit, Finding, Question
from surrofe2.cache.cached_state import (
    CachedState,
    check_state,
    leaving_and_returning,
    look_up,
    put_together,
    surrogate_has_tangents,
    surrogate_tangents,
)
from surrofe2.cache.collapse import CollapseWatch
from surrofe2.cache.cost import Meter, cost_of, time_true_law
from surrofe2.cache.counting import NO_EFFORT, effort_of
from surrofe2.cache.parts import Fallback, Keep, Surrogate
from surrofe2.cache.point_set import NOBODY, Indices, PointSet, added, answer_both
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.trust import Trust
from surrofe2.errors import InputError, MismatchError
from surrofe2.stress_law import Acceptance, Status, StressResponse, Tangents, check_deformation

Array = NDArray[np.float64]

FALLBACK, AUDIT = 0, 1


class CachedLaw:
    """σ(F, Ḟ) from `surrogate` where its bound is within the tolerance, else from `fallback`.

    Within a step a point may move from the surrogate to the fallback, not back; the answer that
    finds one says so (`StressResponse.moved`) and the step is begun anew, see
    `stress_law.Switching`. `respond` is pure but for a stopwatch: counts, audits, trust, harvest
    and learning change in `accept` alone, and only when no point objects.

    Args:
        surrogate: e.g. `surrofe2.surrogate.SurrogateLaw`; see `parts.Surrogate`.
        fallback: the law the surrogate was trained on, e.g. `surrofe2.rve.RveLaw`.
        settings: tolerance and audit.
        keep: is given every true answer at accepted steps, see `parts.Keep`.

    Raises:
        MismatchError: they are not of the same plant cell and initialisation.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        fallback: Fallback,
        settings: CacheSettings | None = None,
        keep: Keep | None = None,
    ) -> None:
        _check_match(surrogate, fallback)
        self.surrogate = surrogate
        self.fallback = fallback
        self.settings = settings or CacheSettings()
        self._keep = keep
        self._learn = getattr(surrogate, "learn", None)
        self.reset_counts()

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.fallback.density

    @property
    def tolerance(self) -> float:
        """Allowed error of a stress, µN/µm; inf where the surrogate knows no bound."""
        spread = getattr(self.surrogate, "stress_spread", None)
        return np.inf if spread is None else self.settings.tolerance * float(spread)

    @property
    def has_tangents(self) -> bool:
        """Whether both parts give tangents."""
        return surrogate_has_tangents(self.surrogate) and (
            "tangents" in signature(self.fallback.respond).parameters
        )

    @property
    def counts(self) -> dict[str, int]:
        """Points at ends of kept steps since the last reset: `hits`, `fallbacks` and, of these,
        by reason; `in_domain`, those within the range of the surrogate; `steps`; `switched`,
        solves by which a point began a step on the other branch."""
        return dict(self._counts)

    @property
    def is_off(self) -> bool:
        """Whether the cache was switched off."""
        return self._trust.is_off

    def reset_counts(self) -> None:
        """Begin as if nothing had been asked: counts, audits, trust and stopwatch."""
        allowed = self.tolerance
        self._counts = {**NO_EFFORT, "in_domain": 0, "steps": 0, "switched": 0}
        self._trust = Trust(allowed)
        self._audit = Audit(self.fallback, self.settings.audit, self.settings.seed, allowed)
        self._watch = CollapseWatch(learns=self._learn is not None)
        self._meter = Meter()
        self._latest: tuple[tuple[Array, Array], tuple[Array, Array]] | None = None
        if np.isinf(allowed) and np.isfinite(self.settings.tolerance):
            self._trust.warn(
                0, "the surrogate knows no bound of its error: its range alone decides, whatever "
                "the tolerance",
            )  # fmt: skip

    def respond(
        self, F: Array, F_dot: Array, state: CachedState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """Stress at n points; a point that neither part can answer has the fallback's status."""
        if not (_is_ready(F) and _is_ready(F_dot) and F.shape == F_dot.shape):
            F, F_dot = check_deformation(F, F_dot)
        if tangents and not self.has_tangents:
            raise InputError("tangents: the surrogate or its fallback has none; use true RVEs")
        with self._meter.part("total"):
            answer = self._respond(F, F_dot, state, tangents)
        self._meter.asked += len(F)
        self._meter.calls += 1
        return answer

    def _respond(
        self, F: Array, F_dot: Array, given: CachedState | None, tangents: bool
    ) -> StressResponse:
        count = len(F)
        if given is None:
            state = CachedState(count, tolerance=self._trust.tolerance)
        else:
            state = check_state(given, count)
        stress, status, bound = look_up(self.surrogate, F, F_dot, state)
        missed = status.nonzero()[0]
        if not len(missed) and not len(state.held):
            slopes = surrogate_tangents(self.surrogate, F, F_dot) if tangents else None
            after = replace(state, bound=bound)
            return StressResponse(stress, status, after, {**NO_EFFORT, "hits": count}, slopes)
        check_deformation(F, F_dot)  # hits are in range, hence finite and det F > 0
        why = status[missed]
        wish = {"tangents": True} if tangents else {}
        with self._meter.part("fallback"):
            answer = answer_both(self.fallback, F, F_dot, state.held, missed, **wish)
        held = PointSet(
            np.concatenate([state.held.points, missed]),
            np.concatenate([state.held.why, why]),
            answer.state,
        )
        moved = None
        if given is not None and len(missed):
            moved = np.zeros(count, dtype=np.int8)
            moved[missed] = why
        stress[held.points], status[held.points] = answer.stress, answer.status
        bound[missed] = np.inf
        after = replace(state, held=held, bound=bound)
        return StressResponse(
            stress,
            status,
            after,
            added(effort_of(count, held.why), answer.effort),
            self._tangents(F, F_dot, after, answer.tangents) if tangents else None,
            moved,
        )

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Let the fallback check what it answered; then count, audit, learn, and choose who is
        answered by which part in the next step."""
        with self._meter.part("total"):
            state: CachedState = response.state
            state, status = self._accept_held(F, F_dot, response, state)
            if status.any():
                return Acceptance(status, state)
            self._note(F, F_dot, response.stress, state)
            return self._turn(F, F_dot, response, state)

    def begin_anew(
        self, F: Array, F_dot: Array, response: StressResponse, moved: NDArray[np.int8]
    ) -> Acceptance:
        """The start of a step with the points `moved` on the fallback; see `Switching`."""
        with self._meter.part("total"):
            state: CachedState = response.state
            new = (state.free() & (moved != 0)).nonzero()[0]
            answer = self._solve_cold(F, F_dot, new)
            stress, status = response.stress.copy(), response.status.copy()
            stress[new], status[new] = answer.stress, answer.status
            held = state.held.and_also(new, moved[new], answer.state)
            return Acceptance(status, replace(state, held=held), stress)

    def report(self) -> dict[str, Any]:
        """Audit what still waits, time the true law, and say how the cache did: plain values."""
        self._hold_audit()
        cost = None
        if self._latest is not None:
            calls = self._meter.calls / max(self._meter.steps, 1)
            true = time_true_law(self.fallback, *self._latest, calls)
            cost = cost_of(self._meter, true) if true is not None else None
        return {
            "tolerance": {
                "share": self.settings.tolerance,
                "spread": getattr(self.surrogate, "stress_spread", None),
                "absolute": self._trust.allowed,
            },
            "accepted": self.counts,
            "audit": {
                "share": self.settings.audit,
                "seed": self.settings.seed,
                **self._audit.record.to_dict(),
            },
            "trust": self._trust.to_dict(),
            "cost": cost.to_dict() if cost else None,
        }

    def restore(self, report: dict[str, Any]) -> None:
        """Go on from the counts, audits and trust of an earlier `report` of the same run."""
        self._counts = {name: report["accepted"].get(name, 0) for name in self._counts}
        self._audit.record.restore(report["audit"])
        self._trust.restore(report["trust"])

    def _accept_held(
        self, F: Array, F_dot: Array, response: StressResponse, state: CachedState
    ) -> tuple[CachedState, NDArray[np.int8]]:
        points = state.held.points
        if not len(points):
            return state, response.status
        answer = StressResponse(response.stress[points], response.status[points], state.held.state)
        with self._meter.part("fallback"):
            accepted = self.fallback.accept(F[points], F_dot[points], answer)
        status = response.status.copy()
        status[points] = accepted.status
        return replace(state, held=replace(state.held, state=accepted.state)), status

    def _note(self, F: Array, F_dot: Array, stress: Array, state: CachedState) -> None:
        """Everything that changes at a kept step but the branches."""
        self._meter.steps += 1
        counts, held, hits = self._counts, state.held, state.free().nonzero()[0]
        for name, value in effort_of(state.count, held.why).items():
            counts[name] += value
        counts["steps"] += 1
        counts["in_domain"] += len(hits)
        step = counts["steps"]
        if len(held):
            self._hand_on(F, F_dot, stress, held)
        if self._trust.is_off or state.bound is None:
            return
        chosen = self._audit.choose(hits)
        due = self._audit.wait(
            Question(
                np.full(len(chosen), step),
                chosen,
                F[chosen],
                F_dot[chosen],
                stress[chosen],
                state.bound[chosen],
            )
        )
        if due:
            self._hold_audit()
        fault = self._watch.look(F, stress, state.bound, hits, held.why, state.tolerance)
        if fault is not None and not self._trust.is_off:
            self._trust.switch_off(step, fault)

    def _hand_on(self, F: Array, F_dot: Array, stress: Array, held: PointSet) -> None:
        """Give the fallback's answers to whoever keeps or learns them."""
        at, true = (F[held.points], F_dot[held.points]), stress[held.points]
        if self._keep is not None:
            none = np.zeros(len(held), dtype=np.int8)
            self._keep(*at, true, none, np.full(len(held), FALLBACK, dtype=np.int8))
        if self._learn is not None:
            self._learn(*at, true, held.state)

    def _hold_audit(self) -> None:
        with self._meter.part("audit"):
            found = self._audit.hold()
        if found is None:
            return
        asked = found.asked
        if self._keep is not None:
            why = np.full(len(found.error), AUDIT, dtype=np.int8)
            self._keep(asked.F, asked.F_dot, found.stress, found.status, why)
        if self._learn is not None:
            self._learn_from(found)
        if not self._trust.is_off:
            self._trust.judge(self._counts["steps"], found.broken, found.error, asked.bound)

    def _learn_from(self, found: Finding) -> None:
        wrong = (found.broken & (found.status == 0)).nonzero()[0]
        if self._learn is None or not len(wrong):
            return
        state = None if found.state is None else found.state.take(wrong)
        self._learn(found.asked.F[wrong], found.asked.F_dot[wrong], found.stress[wrong], state)

    def _turn(
        self, F: Array, F_dot: Array, response: StressResponse, state: CachedState
    ) -> Acceptance:
        """Choose the branches of the next step, looking as far ahead as it will go."""
        tolerance, held = self._trust.tolerance, state.held
        stress = response.stress
        leaving = np.where(state.free(), np.int8(Status.NOT_TRUSTED), np.int8(0))
        stay = np.ones(len(held), dtype=bool)
        if not self._trust.is_off:
            leaving, known, status, returning = leaving_and_returning(
                self.surrogate, F, F_dot, state, tolerance
            )
            self._counts["in_domain"] += int((status != Status.OUT_OF_RANGE).sum())
            stay = ~returning
            if returning.any():
                stress = stress.copy()
                stress[held.points[returning]] = known[returning]
        after, new = held.only(stay), leaving.nonzero()[0]
        if len(new):
            answer = self._solve_cold(F, F_dot, new)
            solved = answer.status == 0
            fresh = PointSet(new, leaving[new], answer.state).only(solved)
            stress = stress.copy()
            stress[fresh.points] = answer.stress[solved]
            self._counts["switched"] += len(new)
            if len(fresh):
                self._hand_on(F, F_dot, stress, fresh)
                after = after.and_also(fresh.points, fresh.why, fresh.state)
        before = (F, F_dot) if state.before is None else state.before
        self._latest = (before, (F, F_dot))
        return Acceptance(
            response.status,
            CachedState(state.count, after, tolerance, None, (F, F_dot)),
            None if stress is response.stress else stress,
        )

    def _solve_cold(self, F: Array, F_dot: Array, points: Indices) -> StressResponse:
        """The fallback's checked answer at points it does not know yet."""
        with self._meter.part("fallback"):
            at = F[points], F_dot[points]
            answer = answer_both(self.fallback, F, F_dot, NOBODY, points)
            accepted = self.fallback.accept(*at, answer)
        return replace(answer, status=accepted.status, state=accepted.state)

    def _tangents(
        self, F: Array, F_dot: Array, state: CachedState, of_held: Tangents | None
    ) -> Tangents:
        free = state.free().nonzero()[0]
        of_free = surrogate_tangents(self.surrogate, F[free], F_dot[free])
        return put_together(state.count, free, of_free, state.held.points, of_held)


def _check_match(surrogate: Surrogate, fallback: Fallback) -> None:
    here, there = surrogate.cell.fingerprint, fallback.cell.fingerprint
    if here != there:
        raise MismatchError(
            f"cache: the surrogate is of cell parameters {here}, the fallback of {there}; "
            "train a surrogate for these parameters"
        )
    if surrogate.initialisation != fallback.initialisation:
        raise MismatchError(
            f"cache: the surrogate is of initialisation {surrogate.initialisation}, the fallback "
            f"of {fallback.initialisation}; train a surrogate for this initialisation"
        )


def _is_ready(tensors: Any) -> bool:
    """Whether `lookup` can read the array as it is."""
    return (
        isinstance(tensors, np.ndarray)
        and tensors.dtype == np.float64
        and tensors.shape[1:] == (2, 2)
        and tensors.flags.c_contiguous
    )
