"""One stress law for tissue of several cell types: each point asks the law of its region."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import (
    AuditedLaw,
    LearningLaw,
    Sources,
    StressLaw,
    StressResponse,
    SwitchingLaw,
    Tangents,
    state_arrays,
    state_of,
)
from surrofe2.run.journal import part_of, within
from surrofe2.run.views import Facts, Viewed

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ARRAYS = ("stress", "status", "tangents", "switched", "left_bifurcation")
"""What a response has of each point."""


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
        self._parts = [(law, self.points[name]) for name, law in self.laws.items()]
        found = self.laws.values()
        self._audited = [law for law in found if isinstance(law, AuditedLaw) and law.is_audited]
        self.density = np.empty(everyone.size)
        for law, own in self._parts:
            self.density[own] = law.density

    def facts(self) -> Facts:
        return self.laws

    @property
    def has_tangents(self) -> bool:
        """Whether all laws have them."""
        return all(law.has_tangents for law in self.laws.values())

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """As of `StressLaw`, for all n points."""
        if len(F) != self.density.size:
            raise InputError(f"F: {len(F)} points; the regions have {self.density.size}")
        states = (None,) * len(self._parts) if state is None else state
        if not isinstance(states, tuple) or len(states) != len(self._parts):
            raise InputError("state: not of a law of these regions; pass one of it, or None")
        answers = [
            law.respond(F[own], F_dot[own], part, tangents=tangents)
            for (law, own), part in zip(self._parts, states, strict=True)
        ]

        return self._joined(answers)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        parts = self._parts_of(response)
        prepared = [
            law.prepare(F[own], F_dot[own], part) if isinstance(law, LearningLaw) else None
            for (law, own), part in zip(self._parts, parts, strict=True)
        ]
        answers = [
            replace(part, status=ready[0]) if ready else law.accept(F[own], F_dot[own], part)
            for (law, own), part, ready in zip(self._parts, parts, prepared, strict=True)
        ]
        if not any(answer.status.any() for answer in answers):
            pairs = zip(answers, prepared, strict=True)
            answers = [answer if ready is None else ready[1]() for answer, ready in pairs]
        return self._together(response, answers, parts)

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """As of `SwitchingLaw`; a law none of whose points switched stays as it is."""
        parts, answers = self._parts_of(response), list[StressResponse]()
        for (law, own), part in zip(self._parts, parts, strict=True):
            if switched[own].any():
                law = cast(SwitchingLaw, law)
                answers.append(law.restart_step(F[own], F_dot[own], part, switched[own]))
            else:
                answers.append(part)
        return self._together(response, answers, parts)

    @property
    def is_audited(self) -> bool:
        """Whether all laws are."""
        return len(self._audited) == len(self.laws)

    def mark(self, t: float, state: Any) -> None:
        for law, part in zip(self._audited, state, strict=True):
            law.mark(t, part)

    def verdict(self, *, final: bool = False) -> bool | None:
        """As of `AuditedLaw`; where one law has come to its own, all do."""
        found = [law.verdict(final=final) for law in self._audited]
        if True in found and not final:
            found = [law.verdict(final=True) for law in self._audited]
        return False if False in found else (None if None in found else True)

    def roll_back(self, t: float) -> Any:
        """As of `AuditedLaw`, of all laws; only those that failed are then more cautious."""
        return tuple(law.roll_back(t) for law in self._audited)

    def state_to_arrays(self, state: Any) -> dict[str, NDArray]:
        arrays: dict[str, NDArray] = {}
        for (name, law), part in zip(self.laws.items(), state, strict=True):
            arrays |= within(name, state_arrays(law, part))
        return arrays

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> Any:
        states = [state_of(law, part_of(arrays, name)) for name, law in self.laws.items()]
        return None if all(state is None for state in states) else tuple(states)

    def history(self) -> dict[str, Any] | None:
        return self._reported(lambda law: law.history())

    def report(self) -> dict[str, Any] | None:
        return self._reported(lambda law: law.report())

    def _reported(self, of: Callable[[AuditedLaw], Any]) -> dict[str, Any] | None:
        """What all laws report, each under the name of its region; None where one does not."""
        laws = self.laws.items()
        found = {name: of(law) for name, law in laws if isinstance(law, AuditedLaw)}
        return {"cells": found} if len(found) == len(laws) else None

    @property
    def decisions(self) -> list[dict[str, Any]] | None:
        """Those of all laws, each with the name of its region."""
        if not self.is_audited:
            return None
        found = [
            {"cell": name, **line}
            for name, law in self.laws.items()
            if isinstance(law, AuditedLaw)
            for line in law.decisions or ()
        ]
        return sorted(found, key=lambda line: float(line["t"]))

    def _parts_of(self, response: StressResponse) -> list[StressResponse]:
        """Stress, status and state of each law's points."""
        return [
            StressResponse(response.stress[own], response.status[own], state)
            for (_, own), state in zip(self._parts, response.state, strict=True)
        ]

    def _together(
        self,
        response: StressResponse,
        answers: Sequence[StressResponse],
        parts: Sequence[StressResponse],
    ) -> StressResponse:
        """What all laws make of their `parts` of a response; its own stress if none changed."""
        joined = self._joined(answers)
        changed = any(a.stress is not part.stress for a, part in zip(answers, parts, strict=True))
        return joined if changed else replace(joined, stress=response.stress)

    def _joined(self, answers: Sequence[StressResponse]) -> StressResponse:
        """The responses of all laws as one."""
        effort, reasons = Counter[str](), dict[int, str]()
        for answer, (_, own) in zip(answers, self._parts, strict=True):
            reasons |= {int(own[k]): reason for k, reason in answer.reasons.items()}
            effort.update(answer.effort)
        sources: list[Any] = [answer.sources for answer in answers]
        return StressResponse(
            state=tuple(answer.state for answer in answers),
            effort=effort,
            reasons=reasons,
            sources=None if None in sources else lambda: self._whole([tell() for tell in sources]),
            **{name: self._whole([getattr(each, name) for each in answers]) for name in _ARRAYS},
        )

    def _whole(self, values: Sequence[Any]) -> Any:
        """Values of all points from those of each law's points: arrays (k, …), 0 where a law gave
        none, or tangents or sources of such arrays; None if no law gave any.
        """
        given: Any = next((value for value in values if value is not None), None)
        if given is None:
            return None
        if isinstance(given, Tangents | Sources):
            columns = ([getattr(v, item.name) for v in values] for item in fields(given))
            return type(given)(*map(self._whole, columns))
        whole = np.zeros((self.density.size, *given.shape[1:]), given.dtype)
        for (_, own), value in zip(self._parts, values, strict=True):
            if value is not None:
                whole[own] = value
        return whole
