"""A stress law for tissue of several plant cells: the law of its region computes each point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.law.ahead import ForesightLaw
from surrofe2.law.bifurcation import beyond_bifurcation
from surrofe2.law.stress_law import (
    AuditedLaw,
    LearningLaw,
    StressLaw,
    StressResponse,
    SwitchingLaw,
    joined,
    state_arrays,
    state_of,
)
from surrofe2.run.journal import part_of, within
from surrofe2.run.views import Facts, Viewed


class RegionalLaw(Viewed):
    """Laws by region, each called for its own points all at once.

    The state is a tuple of the states of the laws. Efforts are summed. A law counts and learns only
    from steps in which no law rejects a point.

    Args:
        laws: the law of each region, by its name.
        points: (k,) numbers of the points of each region, by its name; together 0 … n − 1, each
            once.

    Attributes:
        laws, points: laws and points of the regions that have points.
        density: (n,) mass per reference area at each point, ng/µm².

    Raises:
        InputError: a region has no law, or a point belongs to no region or to two.
    """

    def __init__(self, laws: Mapping[str, StressLaw], points: Mapping[str, Index]) -> None:
        """Check that each point is of one region that has a law."""
        for name in points:
            if name not in laws:
                raise InputError(f"laws: none for region {name}; there are {', '.join(laws)}")
        all_points = np.sort(np.concatenate([*points.values()]))
        # with n numbers in all, one that is there twice leaves out another one
        missing = np.setdiff1d(np.arange(all_points.size), all_points)
        if missing.size:
            raise InputError(
                f"points: point {missing[0]} is in no region or another one in two; "
                "every point belongs to one region"
            )
        self.laws = {name: laws[name] for name in points}
        self.points = dict(points)
        self._audited = [law for law in self.laws.values() if isinstance(law, AuditedLaw)]
        self._learning = [isinstance(law, LearningLaw) for law in self.laws.values()]
        self._parts = [(law, self.points[name]) for name, law in self.laws.items()]
        self.density = np.empty(all_points.size)
        for law, numbers in self._parts:
            self.density[numbers] = law.density

    def facts(self) -> Facts:
        """Return what a notebook shows: the laws."""
        return self.laws

    @property
    def has_tangents(self) -> bool:
        """True if the laws of all regions have tangents."""
        return all(law.has_tangents for law in self.laws.values())

    def at(self, points: Index) -> RegionalLaw:
        """Return the law of some points alone, (k,) numbers, made of the same laws."""
        numbers = {}
        for name, points_of_region in self.points.items():
            chosen = np.flatnonzero(np.isin(points, points_of_region))
            if len(chosen):
                numbers[name] = chosen
        return RegionalLaw(self.laws, numbers)

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at all n points; see `StressLaw`."""
        if len(F) != self.density.size:
            raise InputError(f"F: {len(F)} points; the regions have {self.density.size}")
        return self._joined(
            law.respond(F[points], F_dot[points], part, tangents=tangents)
            for (law, points), part in zip(self._parts, self._states(state), strict=True)
        )

    def _states(self, state: Any) -> tuple[Any, ...]:
        """Return the states of the laws in a state of this law, all None of None."""
        states = (None,) * len(self._parts) if state is None else state
        if not isinstance(states, tuple) or len(states) != len(self.laws):
            raise InputError("state: not of a law of these regions; pass one of it, or None")
        return states

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Let all laws check their points; if none rejects one, let them commit.

        A law that is no `LearningLaw` checks and commits in one, since it changes nothing but its
        state.
        """
        parts = self._parts_of(response)
        checked = []
        for (law, points), learns, part in zip(self._parts, self._learning, parts, strict=True):
            check = cast(LearningLaw, law).check if learns else law.accept
            checked.append(check(F[points], F_dot[points], part))
        if any(answer.status.any() for answer in checked):
            return self._together(response, checked, parts)
        committed = []
        for (law, points), learns, answer in zip(self._parts, self._learning, checked, strict=True):
            if learns:
                commit = cast(LearningLaw, law).commit
                committed.append(commit(F[points], F_dot[points], answer))
            else:
                committed.append(answer)
        return self._together(response, committed, parts)

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """Return the start of a step with points `switched` to a new branch; see `SwitchingLaw`.

        A law none of whose points switched is not called.
        """
        parts = self._parts_of(response)
        answers = []
        for (law, points), part in zip(self._parts, parts, strict=True):
            answer = part
            if switched[points].any():
                switching = cast(SwitchingLaw, law)
                answer = switching.restart_step(F[points], F_dot[points], part, switched[points])
            answers.append(answer)
        return self._together(response, answers, parts)

    def leaving(self, F: Array, F_dot: Array, state: Any) -> NDArray[np.int8] | None:
        """Return which points will leave the laws that know it beforehand; see `ForesightLaw`."""
        switched = np.zeros(len(F), dtype=np.int8)
        for (law, points), part in zip(self._parts, self._states(state), strict=True):
            if isinstance(law, ForesightLaw):
                codes = law.leaving(F[points], F_dot[points], part)
                switched[points] = 0 if codes is None else codes
        return switched if switched.any() else None

    def learn_ahead(self, F: Array, F_dot: Array, switched: NDArray[np.int8]) -> NDArray[np.int8]:
        """Let the laws that can learn at points that need it; see `ForesightLaw`."""
        unanswered = switched.copy()
        for law, points in self._parts:
            if switched[points].any() and isinstance(law, ForesightLaw):
                unanswered[points] = law.learn_ahead(F[points], F_dot[points], switched[points])
        return unanswered

    @property
    def is_audited(self) -> bool:
        """True if the laws of all regions are audited."""
        return len(self._audited) == len(self.laws) and all(law.is_audited for law in self._audited)

    def begin_run(self, state: Any, t: float = 0.0) -> bool:
        """Begin a run of all laws; see `AuditedLaw`.

        Returns:
            Whether all laws know the state and continue from it.
        """
        states = (None,) * len(self.laws) if state is None else state
        pairs = zip(self.laws.values(), states, strict=True)
        known = [law.begin_run(part, t) for law, part in pairs if isinstance(law, AuditedLaw)]
        return all(known)

    def mark(self, t: float, state: Any) -> None:
        """Let the steps up to t (µs) stand, for all laws."""
        # only asked where all laws are audited, see `is_audited`: one state for each of them
        states = (None,) * len(self._audited) if state is None else state
        for law, part in zip(self._audited, states, strict=True):
            law.mark(t, part)

    def verdict(self, *, final: bool = False) -> bool | None:
        """Return whether the steps since the mark stand; None: not known yet.

        All laws have one window: where one of them has its verdict, the others must give theirs.
        """
        verdicts = [law.verdict(final=final) for law in self._audited]
        if True in verdicts and not final:
            verdicts = [law.verdict(final=True) for law in self._audited]
        if False in verdicts:
            return False
        return None if None in verdicts else True

    def roll_back(self, t: float) -> Any:
        """Return the states of all laws at the mark; those that failed are more cautious then."""
        return tuple(law.roll_back(t) for law in self._audited)

    @property
    def closing_progress(self) -> tuple[int, int]:
        """Answers of all closing audits that are solved, and the number of all."""
        parts = [law.closing_progress for law in self._audited]
        return sum(done for done, _ in parts), sum(count for _, count in parts)

    def next_closing(self) -> list[Any] | None:
        """Solve a batch of each law's closing audit.

        Returns:
            A batch for each law, None for one whose audit is complete; None where all are complete,
            or where a law is not audited, since then nothing is reported.
        """
        if len(self._audited) < len(self.laws):
            return None
        solved = [law.next_closing() for law in self._audited]
        return None if all(batch is None for batch in solved) else solved

    def commit_closing(self, solved: Sequence[Any]) -> None:
        """Record the batches that `next_closing` returned."""
        for law, batch in zip(self._audited, solved, strict=True):
            if batch is not None:
                law.commit_closing(batch)

    def beyond_bifurcation(self, state: Any) -> Flags | None:
        """Return (n,) which points are beyond a bifurcation; None where a law does not know."""
        flags = np.zeros(self.density.size, dtype=np.bool_)
        for (law, points), part in zip(self._parts, state, strict=True):
            in_region = beyond_bifurcation(law, part)
            if in_region is None:
                return None
            flags[points] = in_region
        return flags

    def state_to_arrays(self, state: Any) -> dict[str, NDArray]:
        """Return the arrays of all laws, each under the name of its region."""
        arrays: dict[str, NDArray] = {}
        for (name, law), part in zip(self.laws.items(), state, strict=True):
            arrays |= within(name, state_arrays(law, part))
        return arrays

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> Any:
        """Return the states that `state_to_arrays` stored; None where no law has one."""
        states = [state_of(law, part_of(arrays, name)) for name, law in self.laws.items()]
        return None if all(state is None for state in states) else tuple(states)

    def history(self) -> dict[str, Any] | None:
        """Return the reports of all laws so far; see `AuditedLaw`."""
        return self._reported([law.history() for law in self._audited])

    def report(self) -> dict[str, Any] | None:
        """Complete all audits, and return the reports at the end of a run; see `AuditedLaw`."""
        return self._reported([law.report() for law in self._audited])

    def _reported(self, reports: Sequence[Any]) -> dict[str, Any] | None:
        """Join the reports of all laws by name of the region; None where a law has none."""
        if len(reports) < len(self.laws):
            return None
        return {"cells": dict(zip(self.laws, reports, strict=True))}

    @property
    def decisions(self) -> list[dict[str, Any]] | None:
        """The decisions of all laws, each with the name of its region, in the order of time."""
        if not self.is_audited:
            return None
        decisions = []
        for name, law in zip(self.laws, self._audited, strict=True):
            for decision in law.decisions or ():
                decisions.append({"cell": name, **decision})
        return sorted(decisions, key=lambda decision: float(decision["t"]))

    def _parts_of(self, response: StressResponse) -> list[StressResponse]:
        """Split a response: stress, status and state of each law's points."""
        return [
            StressResponse(response.stress[points], response.status[points], state)
            for points, state in zip(self.points.values(), response.state, strict=True)
        ]

    def _together(
        self,
        response: StressResponse,
        answers: Sequence[StressResponse],
        parts: Sequence[StressResponse],
    ) -> StressResponse:
        """Join the laws' answers to their `parts` of a response.

        The stress stays the same array where no law changed it, by which callers see that.
        """
        whole = self._joined(answers)
        pairs = zip(answers, parts, strict=True)
        if any(answer.stress is not part.stress for answer, part in pairs):
            return whole
        return replace(whole, stress=response.stress)

    def _joined(self, answers: Iterable[StressResponse]) -> StressResponse:
        """Join the responses of all laws, in their order, into one."""
        answers = tuple(answers)
        parts = [*zip(self.points.values(), answers, strict=True)]
        return joined(parts, tuple(answer.state for answer in answers))
