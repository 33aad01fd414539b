"""Laws that watch another law at work, without changing its answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.setting import Array
from surrofe2.base.simd import TILE
from surrofe2.law.stress_law import Acceptance, StressResponse
from surrofe2.rve import RveLaw


@dataclass
class TimedLaw:
    """An RVE law with a clock on each of its two questions and a count of what they renewed.

    Attributes:
        respond_seconds, accept_seconds: spent inside the law.
        solved, accepted: points that were asked for.
        effort: sums of what the answers say they cost.
        renewed: points whose factorisation `accept` renewed.
    """

    law: RveLaw
    respond_seconds: float = 0.0
    accept_seconds: float = 0.0
    solved: int = 0
    accepted: int = 0
    renewed: int = 0
    effort: dict[str, int] = field(default_factory=dict)

    @property
    def density(self) -> float:
        """Of the law."""
        return self.law.density

    @property
    def has_tangents(self) -> bool:
        """Those of the law."""
        return self.law.has_tangents

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """The law's answer, timed."""
        begin = perf_counter()
        answer = self.law.respond(F, F_dot, state, tangents=tangents)
        self.respond_seconds += perf_counter() - begin
        self.solved += len(F)
        for name, value in answer.effort.items():
            self.effort[name] = self.effort.get(name, 0) + value
        return answer

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """The law's acceptance, timed."""
        begin = perf_counter()
        acceptance = self.law.accept(F, F_dot, response)
        self.accept_seconds += perf_counter() - begin
        self.accepted += len(F)
        before, after = response.state.factors, acceptance.state.factors
        tiles = after.address != before.address
        self.renewed += int(np.repeat(tiles, TILE)[: len(F)].sum())
        return acceptance


@dataclass(frozen=True, slots=True)
class Asked:
    """One question of a macro run, and whether the run went on from it."""

    F: Array
    F_dot: Array
    accepted: bool


class RecordingLaw:
    """An RVE law that keeps every (F, Ḟ) it is asked."""

    def __init__(self, law: RveLaw) -> None:
        self.law = law
        self._asked: list[tuple[Array, Array]] = []
        self._accepted: set[int] = set()

    @property
    def density(self) -> float:
        """Of the law."""
        return self.law.density

    @property
    def asked(self) -> list[Asked]:
        """The questions in their order."""
        return [Asked(F, F_dot, k in self._accepted) for k, (F, F_dot) in enumerate(self._asked)]

    @property
    def has_tangents(self) -> bool:
        """Those of the law."""
        return self.law.has_tangents

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """The law's answer; the question is kept."""
        self._asked.append((np.array(F), np.array(F_dot)))
        return self.law.respond(F, F_dot, state, tangents=tangents)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """The law's acceptance; the latest question is marked."""
        self._accepted.add(len(self._asked) - 1)
        return self.law.accept(F, F_dot, response)
