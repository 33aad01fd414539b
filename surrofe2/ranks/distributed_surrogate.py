"""A surrogate that all ranks look up, each at its block of the points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.ranks.crew import Crew
from surrofe2.ranks.crew_law import CrewLaw
from surrofe2.ranks.dealing import Blocks
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
        self._blocks: dict[tuple[str, int], Blocks] = {}

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

    def with_tolerance(self, tolerance: float, relative: float) -> DistributedSurrogate:
        """As of `SurrogateLaw`; every rank has it besides this one."""
        law = self.law.with_tolerance(tolerance, relative)
        return self if law is self.law else DistributedSurrogate(law, self.crew)

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """As of `SurrogateLaw`."""
        return self.law.local_tolerance(F, F_dot)

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """As of `SurrogateLaw`."""
        blocks = self._dealt("points", len(F))
        if blocks is None:
            return self.law.lookup(F, F_dot, tolerance)
        answer = self._ask(LookUp(self._number, blocks.cuts, tolerance, True), F, F_dot, "lookup")
        assert answer.values is not None
        assert answer.bound is not None
        status = dense(len(F), [each.status for each in answer.told], np.int8)
        return answer.values, status, answer.bound

    def status_and_bound(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """As of `SurrogateLaw`."""
        blocks = self._dealt("points", len(F))
        if blocks is None:
            return self.law.status_and_bound(F, F_dot, tolerance)
        answer = self._ask(LookUp(self._number, blocks.cuts, tolerance, False), F, F_dot, "test")
        assert answer.bound is not None
        return dense(len(F), [each.status for each in answer.told], np.int8), answer.bound

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """As of `SurrogateLaw`."""
        blocks = self._dealt("points", len(F))
        if blocks is None:
            return self.law.tangents(F, F_dot)
        slopes = self._ask(Slopes(self._number, blocks.cuts), F, F_dot, "tangents").tangents
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

    def _dealt(self, what: str, count: int) -> Blocks | None:
        """Who has what of so many points or elements; None where rank 0 had better have all."""
        if count < LEAST * self.crew.ranks:
            return None
        if (what, count) not in self._blocks:
            if len(self._blocks) > 100:  # of points that change in number, on the fallback
                self._blocks = {key: each for key, each in self._blocks.items() if key[0] != what}
            self._blocks[what, count] = Blocks(count, self.crew.ranks)
        return self._blocks[what, count]

    def _ask(self, task: LookUp | Slopes, F: Array, F_dot: Array, what: str) -> Answered:
        answer: Answered = self.crew.do(task, np.ascontiguousarray(F), np.ascontiguousarray(F_dot))
        away = len(F) - int(task.cuts[1])
        self._took("points", len(F), self.crew.count(answer.told, _BYTES[what] * away))
        return answer

    def _took(self, what: str, count: int, seconds: Array) -> None:
        blocks = self._dealt(what, count)
        if blocks is not None:
            blocks.took(seconds)
