"""Warm starts of RVEs that stay on their ranks, and what stands for them on rank 0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import tiles_for
from surrofe2.ranks.crew import Crew
from surrofe2.ranks.dealing import Index, deal
from surrofe2.ranks.desk import Desk
from surrofe2.rve.rve_state import MANY_BYTES, RveState, cut_arrays, joined_arrays

Array = NDArray[np.float64]
Places = NDArray[np.intp]

LEAST = 16
"""Tiles of a block: fewer RVEs are solved sooner than they are sent, as those of an audit are."""


class RankState:
    """State of n points of which each rank has its own; `PointStates` as any other.

    Attributes:
        number: by which ranks know it.
        cuts: (ranks + 1,) which points are whose.
        seconds: (ranks,) that ranks have lately taken to answer for it, for dealing anew.
        steps: since it was dealt.
    """

    def __init__(
        self,
        crew: Crew,
        law: int,
        cuts: Index,
        left: NDArray[np.bool_],
        seconds: Array | None = None,
        steps: int = 0,
    ) -> None:
        self.crew, self.law, self.cuts = crew, law, cuts
        self.number = crew.new_number()
        self.left_points = left
        self.seconds = np.zeros(crew.ranks) if seconds is None else seconds
        self.steps = steps

    def __del__(self) -> None:
        self.crew.drop(self.number)

    @property
    def points(self) -> int:
        """n."""
        return int(self.cuts[-1])

    @property
    def is_shared(self) -> bool:
        """Whether there are enough points for all ranks."""
        return tiles_for(self.points) >= LEAST * self.crew.ranks

    def take(self, index: Places) -> RankState:
        """The state of these points, in this order; a point may be taken twice."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self
        return self._arranged(deal(len(index), self.crew.ranks, LEAST), index)

    def put(self, index: Places, part: RankState) -> RankState:
        """This state with that of these points replaced."""
        source, place = np.zeros(self.points, dtype=np.int8), np.arange(self.points)
        source[index], place[index] = 1, np.arange(len(index))
        return self._arranged(self.cuts, place, part, source)

    def dealt(self, cuts: Index) -> RankState:
        """The same state with its points dealt otherwise."""
        return self._arranged(cuts, np.arange(self.points))

    def to_arrays(self) -> dict[str, NDArray]:
        """All of it, as one `RveState` of all points would give it."""
        arrays: dict[str, NDArray] = self.crew.do(Collect(self.number, self.law))
        return arrays

    def _arranged(
        self,
        cuts: Index,
        place: Places,
        other: RankState | None = None,
        source: NDArray[np.int8] | None = None,
    ) -> RankState:
        left = self.left_points[place] if source is None else None
        if other is not None and left is None and source is not None:
            left = np.empty(len(place), dtype=np.bool_)
            left[source == 0] = self.left_points[place[source == 0]]
            left[source == 1] = other.left_points[place[source == 1]]
        assert left is not None
        new = RankState(self.crew, self.law, cuts, left)
        sources = [(self.number, self.cuts)]
        if other is not None:
            sources.append((other.number, other.cuts))
        self.crew.do(Arrange(self.law, new.number, cuts, sources, place, source))
        return new


@dataclass(frozen=True, slots=True)
class Arrange:
    """A new state of points of one or two others, each sent to the rank that is to have it.

    Attributes:
        cuts: of the new state.
        sources: numbers and cuts of the others.
        place: (n,) number of each new point in its source; source: (n,) which; None: the first.
    """

    law: int
    number: int
    cuts: Index
    sources: list[tuple[int, Index]]
    place: Places
    source: NDArray[np.int8] | None

    def run(self, desk: Desk, given: tuple[Any, ...] | None) -> None:
        """Send what others are to have, receive what is to be had here, and put it together."""
        source = np.zeros(len(self.place), dtype=np.int8) if self.source is None else self.source
        owner = np.empty(len(self.place), dtype=np.int64)
        for k, (_, cuts) in enumerate(self.sources):
            of = source == k
            owner[of] = np.searchsorted(cuts, self.place[of], side="right") - 1
        to = np.searchsorted(self.cuts, np.arange(len(self.place)), side="right") - 1
        mine = owner == desk.rank
        sent = []
        for rank in np.unique(to[mine & (to != desk.rank)]).tolist():
            pieces = self._pieces(desk, source, mine & (to == rank))
            sent.append(desk.comm.isend([(at, s.to_arrays()) for at, s in pieces], rank))
        here = self._pieces(desk, source, mine & (to == desk.rank))
        law: Any = desk.laws[self.law]
        for rank in np.unique(owner[(to == desk.rank) & ~mine]).tolist():
            received = desk.comm.recv(source=rank)
            here += [(at, law.state_from_arrays(arrays)) for at, arrays in received]
        for each in sent:
            each.wait()
        is_checked = self._is_checked(desk)
        if here:
            state = _together(here, desk.own(self.cuts))
            desk.states[self.number] = replace(state, is_checked=is_checked)

    def _pieces(
        self, desk: Desk, source: NDArray[np.int8], wanted: NDArray[np.bool_]
    ) -> list[tuple[Places, RveState]]:
        """Of each source with points `wanted` (n,) of this rank: their new numbers and state."""
        pieces = []
        for k, (number, cuts) in enumerate(self.sources):
            points = (wanted & (source == k)).nonzero()[0]
            if len(points):
                own = self.place[points] - desk.own(cuts).start
                pieces.append((points, desk.states[number].take(own)))
        return pieces

    def _is_checked(self, desk: Desk) -> bool:
        """Whether all points of all sources are, on all ranks."""
        known = [desk.states[number] for number, _ in self.sources if number in desk.states]
        here = all(state.is_checked for state in known)
        return here if len(self.sources) == 1 else all(desk.comm.allgather(here))


def _together(pieces: list[tuple[Places, RveState]], own: slice) -> RveState:
    """The state of a rank's own points from pieces with the numbers of theirs."""
    (points, state), *others = pieces
    if others:
        first = np.zeros(own.stop - own.start, dtype=np.intp)
        first[points - own.start] = np.arange(len(points))
        state = state.take(first)
    for points, part in others:
        state = state.put(points - own.start, part)
    return state


@dataclass(frozen=True, slots=True)
class Collect:
    """The arrays of the whole state, for a checkpoint that any number of ranks can go on from."""

    number: int
    law: int

    def run(self, desk: Desk, given: tuple[Any, ...] | None) -> dict[str, NDArray] | None:
        """On rank 0."""
        state = desk.states.get(self.number)
        size = sum(desk.comm.allgather(0 if state is None else state.factors.nbytes))
        own = None if state is None else state.to_arrays(factors=size < MANY_BYTES)
        if desk.rank:
            desk.comm.send(own, 0)
            return None
        parts = [own, *(desk.comm.recv(source=rank) for rank in range(1, desk.ranks))]
        return joined_arrays([part for part in parts if part is not None])


@dataclass(frozen=True, slots=True)
class Place:
    """Each rank's part of a state whose arrays rank 0 has."""

    number: int
    law: int
    cuts: Index

    def run(self, desk: Desk, given: tuple[Mapping[str, NDArray]] | None) -> None:
        """given: the arrays."""
        law: Any = desk.laws[self.law]
        if given is None:
            arrays = desk.comm.recv(source=0)
        else:
            for rank in range(desk.ranks - 1, -1, -1):
                points = slice(int(self.cuts[rank]), int(self.cuts[rank + 1]))
                arrays = cut_arrays(given[0], points) if points.stop > points.start else None
                if rank:
                    desk.comm.send(arrays, rank)
        if arrays is not None:
            desk.states[self.number] = law.state_from_arrays(arrays)
