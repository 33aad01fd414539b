"""One stress law for tissue of several cell types: each point asks the law of its region."""

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
    """Laws by region, each asked for its own points all at once.

    The state is a tuple of the states of the laws. An answer costs what the laws' answers cost. A
    law counts and learns only from steps to which no other objects.

    Attributes:
        laws: by name of the region.
        points: by name, (k,) numbers of the region's points.
        density: (n,) mass per reference area at each point, ng/µm².
    """

    def __init__(self, laws: Mapping[str, StressLaw], points: Mapping[str, Index]) -> None:
        """A law of `laws` for each entry of `points`, which together number 0 … n − 1 once. Raises
        `InputError` where a region has no law, or a point belongs to no region or to two.
        """
        for name in points:
            if name not in laws:
                raise InputError(f"laws: none for region {name}; there are {', '.join(laws)}")
        everyone = np.sort(np.concatenate([*points.values()]))
        missing = np.setdiff1d(np.arange(everyone.size), everyone)
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
        self.density = np.empty(everyone.size)
        for law, numbers in self._parts:
            self.density[numbers] = law.density

    def facts(self) -> Facts:
        return self.laws

    @property
    def has_tangents(self) -> bool:
        """Whether all laws have them."""
        return all(law.has_tangents for law in self.laws.values())

    def at(self, points: Index) -> RegionalLaw:
        """The law of these points alone, (k,) numbers, by laws that are the same."""
        numbers = {
            name: np.flatnonzero(np.isin(points, all_of)) for name, all_of in self.points.items()
        }
        return RegionalLaw(self.laws, {name: part for name, part in numbers.items() if len(part)})

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """As of `StressLaw`, for all n points."""
        if len(F) != self.density.size:
            raise InputError(f"F: {len(F)} points; the regions have {self.density.size}")
        states = (None,) * len(self._parts) if state is None else state
        if not isinstance(states, tuple) or len(states) != len(self.laws):
            raise InputError("state: not of a law of these regions; pass one of it, or None")
        return self._joined(
            law.respond(F[points], F_dot[points], part, tangents=tangents)
            for (law, points), part in zip(self._parts, states, strict=True)
        )

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        parts = self._parts_of(response)
        checked = [
            (cast(LearningLaw, law).check if learns else law.accept)(F[own], F_dot[own], part)
            for (law, own), learns, part in zip(self._parts, self._learning, parts, strict=True)
        ]
        if not any(each.status.any() for each in checked):
            checked = [
                cast(LearningLaw, law).commit(F[own], F_dot[own], each) if learns else each
                for (law, own), learns, each in zip(
                    self._parts, self._learning, checked, strict=True
                )
            ]
        return self._together(response, checked, parts)

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """As of `SwitchingLaw`; a law none of whose points switched stays as it is."""
        parts = self._parts_of(response)
        answers = [
            cast(SwitchingLaw, law).restart_step(F[points], F_dot[points], part, switched[points])
            if switched[points].any()
            else part
            for (law, points), part in zip(self._parts, parts, strict=True)
        ]
        return self._together(response, answers, parts)

    def learn_ahead(self, F: Array, F_dot: Array, switched: NDArray[np.int8]) -> NDArray[np.int8]:
        """As of `ForesightLaw`, of the laws that can."""
        unanswered = switched.copy()
        for law, points in self._parts:
            if switched[points].any() and isinstance(law, ForesightLaw):
                unanswered[points] = law.learn_ahead(F[points], F_dot[points], switched[points])
        return unanswered

    @property
    def is_audited(self) -> bool:
        """Whether all laws are."""
        return len(self._audited) == len(self.laws) and all(law.is_audited for law in self._audited)

    def begin_run(self, state: Any, t: float = 0.0) -> bool:
        """As of `AuditedLaw`; whether all laws know the state that they go on from."""
        states = (None,) * len(self.laws) if state is None else state
        pairs = zip(self.laws.values(), states, strict=True)
        known = [law.begin_run(part, t) for law, part in pairs if isinstance(law, AuditedLaw)]
        return all(known)

    def mark(self, t: float, state: Any) -> None:
        states = (None,) * len(self._audited) if state is None else state
        for law, part in zip(self._audited, states, strict=True):
            law.mark(t, part)

    def verdict(self, *, final: bool = False) -> bool | None:
        """As of `AuditedLaw`; where one law has come to its own, all do."""
        verdicts = [law.verdict(final=final) for law in self._audited]
        if True in verdicts and not final:
            verdicts = [law.verdict(final=True) for law in self._audited]
        return False if False in verdicts else (None if None in verdicts else True)

    def roll_back(self, t: float) -> Any:
        """As of `AuditedLaw`, of all laws; only those that failed are then more cautious."""
        return tuple(law.roll_back(t) for law in self._audited)

    @property
    def closing_progress(self) -> tuple[int, int]:
        """As of `AuditedLaw`, of all laws together."""
        parts = [law.closing_progress for law in self._audited]
        return sum(done for done, _ in parts), sum(count for _, count in parts)

    def next_closing(self) -> list[Any] | None:
        """A batch of each law, None of one whose closing audit is complete; None where all are."""
        if len(self._audited) < len(self.laws):
            return None  # nothing would be reported
        solved = [law.next_closing() for law in self._audited]
        return None if all(each is None for each in solved) else solved

    def commit_closing(self, solved: Sequence[Any]) -> None:
        for law, each in zip(self._audited, solved, strict=True):
            if each is not None:
                law.commit_closing(each)

    def beyond_bifurcation(self, state: Any) -> Flags | None:
        """(n,) as of the laws; None where one of them cannot tell."""
        flags = np.zeros(self.density.size, dtype=np.bool_)
        for (law, points), part in zip(self._parts, state, strict=True):
            at_own = beyond_bifurcation(law, part)
            if at_own is None:
                return None
            flags[points] = at_own
        return flags

    def state_to_arrays(self, state: Any) -> dict[str, NDArray]:
        arrays: dict[str, NDArray] = {}
        for (name, law), part in zip(self.laws.items(), state, strict=True):
            arrays |= within(name, state_arrays(law, part))
        return arrays

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> Any:
        states = [state_of(law, part_of(arrays, name)) for name, law in self.laws.items()]
        return None if all(state is None for state in states) else tuple(states)

    def history(self) -> dict[str, Any] | None:
        return self._reported([law.history() for law in self._audited])

    def report(self) -> dict[str, Any] | None:
        return self._reported([law.report() for law in self._audited])

    def _reported(self, reports: Sequence[Any]) -> dict[str, Any] | None:
        """What all laws report, each under the name of its region; None where one does not."""
        if len(reports) < len(self.laws):
            return None
        return {"cells": dict(zip(self.laws, reports, strict=True))}

    @property
    def decisions(self) -> list[dict[str, Any]] | None:
        """Those of all laws, each with the name of its region."""
        if not self.is_audited:
            return None
        pairs = zip(self.laws, self._audited, strict=True)
        decisions = [{"cell": name, **line} for name, law in pairs for line in law.decisions or ()]
        return sorted(decisions, key=lambda line: float(line["t"]))

    def _parts_of(self, response: StressResponse) -> list[StressResponse]:
        """Stress, status and state of each law's points."""
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
        """What all laws make of their `parts` of a response; its own stress if none changed."""
        whole = self._joined(answers)
        changed = any(a.stress is not part.stress for a, part in zip(answers, parts, strict=True))
        return whole if changed else replace(whole, stress=response.stress)

    def _joined(self, answers: Iterable[StressResponse]) -> StressResponse:
        """The responses of all laws as one."""
        answers = tuple(answers)
        parts = [*zip(self.points.values(), answers, strict=True)]
        return joined(parts, tuple(answer.state for answer in answers))
