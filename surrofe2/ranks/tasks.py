"""What all ranks do together for a law: answer, accept, look up, give slopes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.ranks.dealing import Index
from surrofe2.ranks.desk import Desk, Told, sparse
from surrofe2.stress_law import StressResponse, Tangents

Array = NDArray[np.float64]
_SLOPES = (2, 2, 2, 2)


class Answered(NamedTuple):
    """Rank 0's from all ranks: what they tell, and arrays over all points."""

    told: list[Told]
    values: Array | None = None
    bound: Array | None = None
    tangents: Tangents | None = None


@dataclass(frozen=True, slots=True)
class Respond:
    """`StressLaw.respond` at the points of `cuts`, from the state `before` (None: cold).

    The state of the answer is kept as `after`.
    """

    law: int
    before: int | None
    after: int
    cuts: Index
    tangents: bool

    def run(self, desk: Desk, given: tuple[Array, Array] | None) -> Answered | None:
        """given: F and Ḟ."""
        F, F_dot = (desk.scattered(self.cuts, each) for each in given or (None, None))
        law, state = desk.laws[self.law], desk.states.get(self.before or 0)
        told, first = Told(), desk.own(self.cuts).start
        answer = None
        if len(F):
            answer = desk.worked(told, lambda: law.respond(F, F_dot, state, tangents=self.tangents))
        if answer is not None:
            desk.states[self.after] = answer.state
            _tell_state(told, answer.state, first)
            told.status = sparse(answer.status, first)
            told.effort = dict(answer.effort)
            told.reasons = {first + k: why for k, why in answer.reasons.items()}
            if answer.left_bifurcation is not None:
                told.newly_left = answer.left_bifurcation.nonzero()[0] + first
        everything = desk.tell(told)
        stress = desk.gathered(self.cuts, answer and answer.stress, (2, 2))
        slopes = _gathered_slopes(desk, self.cuts, answer and answer.tangents, self.tangents)
        return None if everything is None else Answered(everything, stress, tangents=slopes)


@dataclass(frozen=True, slots=True)
class Accept:
    """`StressLaw.accept` of an answer whose state is `before`; the new one is kept as `after`."""

    law: int
    before: int
    after: int
    cuts: Index

    def run(self, desk: Desk, given: tuple[Array, Array, Array, Array] | None) -> Answered | None:
        """given: F, Ḟ, stress and, as numbers, status."""
        F, F_dot, stress = (desk.scattered(self.cuts, each) for each in (given or (None,) * 4)[:3])
        status = desk.comm.bcast(sparse(given[3], 0) if given is not None else None)
        law, told, own = desk.laws[self.law], Told(), desk.own(self.cuts)
        codes = np.zeros(int(self.cuts[-1]), dtype=np.int8)
        if status is not None:
            codes[status[0]] = status[1]
        said = None
        if len(F):
            response = StressResponse(stress, codes[own], desk.states.get(self.before))
            said = desk.worked(told, lambda: law.accept(F, F_dot, response))
        if said is not None:
            desk.states[self.after] = said.state
            _tell_state(told, said.state, own.start)
            told.status = sparse(said.status, own.start)
            if said.stress is not None:
                changed = (said.stress != stress).any(axis=(1, 2)).nonzero()[0]
                told.stress = changed + own.start, said.stress[changed]
            if said.left_bifurcation is not None:
                told.newly_left = said.left_bifurcation.nonzero()[0] + own.start
        everything = desk.tell(told)
        return None if everything is None else Answered(everything)


@dataclass(frozen=True, slots=True)
class LookUp:
    """`Surrogate.lookup`, or `status_and_bound` where no stress is wanted."""

    law: int
    cuts: Index
    tolerance: float
    stress: bool

    def run(self, desk: Desk, given: tuple[Array, Array] | None) -> Answered | None:
        """given: F and Ḟ."""
        F, F_dot = (desk.scattered(self.cuts, each) for each in given or (None, None))
        law: Any = desk.laws[self.law]
        look = law.lookup if self.stress else law.status_and_bound
        told = Told()
        found = desk.worked(told, lambda: look(F, F_dot, self.tolerance))
        if found is not None:
            told.status = sparse(found[-2], desk.own(self.cuts).start)
        everything = desk.tell(told)
        whole = desk.gathered(self.cuts, found and found[0], (2, 2)) if self.stress else None
        bound = desk.gathered(self.cuts, found and found[-1], ())
        return None if everything is None else Answered(everything, whole, bound)


@dataclass(frozen=True, slots=True)
class Slopes:
    """`Surrogate.tangents`."""

    law: int
    cuts: Index

    def run(self, desk: Desk, given: tuple[Array, Array] | None) -> Answered | None:
        """given: F and Ḟ."""
        F, F_dot = (desk.scattered(self.cuts, each) for each in given or (None, None))
        law: Any = desk.laws[self.law]
        told = Told()
        found = desk.worked(told, lambda: law.tangents(F, F_dot))
        everything = desk.tell(told)
        slopes = _gathered_slopes(desk, self.cuts, found, wanted=True)
        return None if everything is None else Answered(everything, tangents=slopes)


def _tell_state(told: Told, state: Any, first: int) -> None:
    told.has_state = state is not None
    if state is not None:
        told.left = state.left_points.nonzero()[0] + first


def _gathered_slopes(
    desk: Desk, cuts: Index, own: Tangents | None, wanted: bool
) -> Tangents | None:
    if not wanted:
        return None
    by_F = desk.gathered(cuts, None if own is None else own.P_by_F, _SLOPES)
    by_F_dot = desk.gathered(cuts, None if own is None else own.P_by_F_dot, _SLOPES)
    return None if by_F is None or by_F_dot is None else Tangents(by_F, by_F_dot)
