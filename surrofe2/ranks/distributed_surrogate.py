"""A surrogate that all ranks look up, each at its block of the points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import tiles_for
from surrofe2.ranks.crew import Crew
from surrofe2.ranks.crew_law import CrewLaw
from surrofe2.ranks.dealing import Index, deal, is_uneven, redeal
from surrofe2.ranks.desk import dense
from surrofe2.ranks.tasks import Answered, LookUp, Slopes
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressResponse,
    Tangents,
    check_deformation,
)
from surrofe2.surrogate.surrogate_law import SurrogateLaw

Array = NDArray[np.float64]

LEAST = 32
"""Points a rank from which on it pays to send them."""
_CALLS = 64
"""Lookups after which points may be dealt anew."""
_BYTES = {"lookup": 104, "test": 72, "tangents": 320}
"""A point that came and went."""


class DistributedSurrogate(CrewLaw[SurrogateLaw]):
    """A `SurrogateLaw` that the ranks of a crew look up; see `StressLaw` and `cache.Surrogate`.

    It keeps no state, so points are dealt at every call, by how long the ranks took for theirs.
    Rank 0 answers alone where there are few points.
    """

    has_tangents, has_bound, learns = True, True, False

    def __init__(self, law: SurrogateLaw, crew: Crew) -> None:
        super().__init__(law, crew)
        self._cuts: dict[int, Index] = {}
        self._seconds, self._calls = np.zeros(crew.ranks), 0

    @property
    def range(self) -> SamplingRange:
        """Bounds of the data."""
        return self.law.range

    @property
    def stress_spread(self) -> float:
        """Spread of the stress, µN/µm."""
        return self.law.stress_spread

    @property
    def is_calibrated(self) -> bool:
        """Whether the bound of its error is known."""
        return self.law.is_calibrated

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """As of `SurrogateLaw`."""
        cuts = self._dealt(len(F))
        if cuts is None:
            return self.law.lookup(F, F_dot, tolerance)
        answer = self._ask(LookUp(self._number, cuts, tolerance, True), F, F_dot, "lookup")
        assert answer.stress is not None
        assert answer.bound is not None
        status = dense(len(F), [each.status for each in answer.told], np.int8)
        return answer.stress, status, answer.bound

    def status_and_bound(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """As of `SurrogateLaw`."""
        cuts = self._dealt(len(F))
        if cuts is None:
            return self.law.status_and_bound(F, F_dot, tolerance)
        answer = self._ask(LookUp(self._number, cuts, tolerance, False), F, F_dot, "test")
        assert answer.bound is not None
        return dense(len(F), [each.status for each in answer.told], np.int8), answer.bound

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """As of `SurrogateLaw`."""
        cuts = self._dealt(len(F))
        if cuts is None:
            return self.law.tangents(F, F_dot)
        slopes = self._ask(Slopes(self._number, cuts), F, F_dot, "tangents").tangents
        assert slopes is not None
        return slopes

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """As of `SurrogateLaw`."""
        F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.lookup(F, F_dot)
        slopes = self.tangents(F, F_dot) if tangents else None
        lost = status != Status.OK
        reasons: Mapping[int, str] = {}
        if lost.any():
            first = int(lost.argmax())
            alone = self.law.respond(F[[first]], F_dot[[first]])
            reasons = dict.fromkeys([first] if alone.reasons else [], alone.reasons.get(0, ""))
            for values in () if slopes is None else (slopes.P_by_F, slopes.P_by_F_dot):
                values[lost] = np.nan
        effort = {"surrogate_points": len(F)}
        return StressResponse(stress, status, state, effort, slopes, reasons=reasons)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Nothing is left to check or to commit."""
        return Acceptance(response.status, response.state)

    def learn(self, F: Array, F_dot: Array, stress: Array, state: Any = None) -> None:
        """Nothing is learnt."""

    def to_arrays(self) -> dict[str, NDArray]:
        """Nothing that a run could have changed."""
        return {}

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> None:
        """Nothing."""

    def is_of_table(self, F: Array, F_dot: Array, tolerance: float) -> NDArray[np.bool_]:
        """Nowhere."""
        return np.zeros(len(F), dtype=np.bool_)

    def _dealt(self, points: int) -> Index | None:
        """Whose points are whose; None where rank 0 had better answer alone."""
        if points < LEAST * self.crew.ranks:
            return None
        if points not in self._cuts:
            if len(self._cuts) > 100:
                self._cuts.clear()
            self._cuts[points] = deal(points, self.crew.ranks)
        return self._cuts[points]

    def _ask(self, task: LookUp | Slopes, F: Array, F_dot: Array, what: str) -> Answered:
        answer: Answered = self.crew.do(task, np.ascontiguousarray(F), np.ascontiguousarray(F_dot))
        away = len(F) - int(task.cuts[1])
        self._seconds += self.crew.count(answer.told, _BYTES[what] * away)
        self._calls += 1
        if self._calls == _CALLS:
            if is_uneven(self._seconds) and tiles_for(len(F)) > 4 * self.crew.ranks:
                self._cuts[len(F)] = redeal(task.cuts, self._seconds)
            self._seconds, self._calls = np.zeros(self.crew.ranks), 0
        return answer
