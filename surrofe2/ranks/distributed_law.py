"""`DistributedLaw`: RVEs on many ranks, a stress law as any other on rank 0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, tiles_for
from surrofe2.law.stress_law import (
    StressResponse,
    check_deformation,
    joined,
    joined_values,
    require_tangents,
)
from surrofe2.ranks.driver import Driver, Worker, driver_at_work
from surrofe2.rve.rve_law import RveLaw

# Tiles of a rank: fewer RVEs are solved sooner than they are sent, as those of an audit are.
LEAST = 16
# Points whose states rank 0 gets from a rank at once, so that no message holds a checkpoint.
PIECE = 4096


class RankState:
    """The warm start of n points, which stays on the ranks that own them; see `cache.Fallback`.

    The states themselves travel only for a checkpoint: a point stays on its rank.

    Attributes:
        law: whose state it is.
        owner: (n,) rank of each point; a rank has its points in ascending order.
        left_points: (n,) where the stress is one of several.
        number: by which ranks know it, as long as this object lives.
    """

    def __init__(self, law: DistributedLaw, owner: Index, left_points: Flags) -> None:
        self.law = law
        self.owner = owner
        self.left_points = left_points
        self.number = next(law.driver.numbers)

    def __del__(self) -> None:
        """Let all ranks forget the state with the next task."""
        self.law.driver.dropped.append(self.number)

    def shares(self) -> list[Index]:
        """Return the points of each rank, in ascending order."""
        counts = np.bincount(self.owner, minlength=self.law.driver.ranks)
        return np.split(np.argsort(self.owner, kind="stable"), np.cumsum(counts)[:-1])

    def rows(self) -> Index:
        """Return (n,) the number of each point among those of its rank."""
        order = np.concatenate(self.shares())
        rows: Index = np.argsort(order) - np.searchsorted(self.owner[order], self.owner)
        return rows

    def take(self, index: Index) -> RankState:
        """Return the state of these points, in this order; a point may be taken twice."""
        if np.array_equal(index, np.arange(len(self.owner))):
            return self
        number = np.full(len(index), self.number)
        return self._joined(self.owner[index], self.left_points[index], number, self.rows()[index])

    def put(self, index: Index, part: RankState) -> RankState:
        """Return this state with that of these points replaced."""
        owner = self.owner.copy()
        left_points = self.left_points.copy()
        row = self.rows()
        number = np.full(len(owner), self.number)
        owner[index] = part.owner
        left_points[index] = part.left_points
        number[index] = part.number
        row[index] = part.rows()
        return self._joined(owner, left_points, number, row)

    def _joined(self, owner: Index, left_points: Flags, number: Index, row: Index) -> RankState:
        """Make the state of these rows of the states of these numbers, on their ranks."""
        after = RankState(self.law, owner, left_points)
        tasks: list[tuple[Any, ...] | None] = []
        for points in after.shares():
            task = (after.number, number[points], row[points])
            tasks.append(task if len(points) else None)
        self.law.driver.do(_join, tasks)
        return after


class DistributedLaw:
    """The stress σ(F, Ḟ) of RVEs that live on the ranks of a driver; see `StressLaw`.

    Points without a state are given to ranks in equal blocks of whole tiles, few points to one
    rank, which their deformation decides. RVE states stay there. (F, Ḟ) are scattered, stresses
    gathered.

    Args:
        law: that of rank 0; every rank gets the same.
        driver: of this very process.
    """

    def __init__(self, law: RveLaw, driver: Driver) -> None:
        self.law = law
        self.driver = driver
        self._number = next(driver.numbers)
        self.cell = law.cell
        self.initialisation = law.initialisation
        self.density = law.density
        self.has_tangents = law.has_tangents
        driver.do(_have, [(self._number, law)] * driver.ranks)

    def beyond_bifurcation(self, state: RankState) -> Flags:
        """Return (n,) whether the RVE of each point left its branch at a bifurcation on its way."""
        return state.left_points

    def state_to_arrays(self, state: RankState) -> dict[str, NDArray]:
        """Return a state as one `RveState` of all points would, got from the ranks piece by piece.

        ``owner`` and ``ranks`` say which rank has each point, and how many ranks there are.
        """
        whole = dict[str, NDArray]()
        shares = state.shares()
        for begin in range(0, max(map(len, shares)), PIECE):
            pieces = [points[begin : begin + PIECE] for points in shares]
            tasks: list[tuple[Any, ...] | None] = []
            for points in pieces:
                task = (self._number, state.number, begin, len(points))
                tasks.append(task if len(points) else None)
            for points, part in zip(pieces, self.driver.do(_to_arrays, tasks), strict=True):
                for name, values in (part or {}).items():
                    room = np.empty((len(state.owner), *values.shape[1:]), values.dtype)
                    whole.setdefault(name, room)[points] = values
        return {**whole, "owner": state.owner, "ranks": np.array(self.driver.ranks)}

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> RankState:
        """Return the state of which `state_to_arrays`, of any number of ranks or none, gave these
        arrays.

        As many ranks get the points that they had, so that what follows has the same bits.
        """
        arrays = dict(arrays)
        owner = arrays.pop("owner", None)
        ranks = arrays.pop("ranks", 0)
        if owner is None or ranks != self.driver.ranks:
            owner = self._dealt(arrays["z"])
        else:
            owner = owner.astype(np.intp)
        state = RankState(self, owner, arrays["has_left"])
        tasks: list[tuple[Any, ...] | None] = []
        for points in state.shares():
            part = {name: values[points] for name, values in arrays.items()}
            tasks.append((self._number, state.number, part) if len(points) else None)
        self.driver.do(_from_arrays, tasks)
        return state

    def respond(
        self, F: Array, F_dot: Array, state: RankState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at n points on their ranks; see `StressLaw`."""
        F, F_dot = check_deformation(F, F_dot)
        if tangents:
            require_tangents(self)
        if not len(F):
            return StressResponse(np.empty((0, 2, 2)), np.empty(0, np.int8), state, {})
        before = None if state is None else self._checked(state, len(F)).number
        owner = self._dealt(F) if state is None else state.owner
        return self._by_ranks(_respond, owner, (before, tangents), (F, F_dot))

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Commit a response on the ranks of its points; see `StressLaw`."""
        if not len(F):
            return response
        F, F_dot = check_deformation(F, F_dot)
        before = self._checked(response.state, len(F))
        answered = (F, F_dot, response.stress, response.status)
        accepted = self._by_ranks(_accept, before.owner, (before.number,), answered)
        has_left = accepted.left_bifurcation
        state = accepted.state
        stress = response.stress if has_left is None else accepted.stress
        return replace(
            response, stress=stress, status=accepted.status, state=state, left_bifurcation=has_left
        )

    def _by_ranks(
        self, work: Any, owner: Index, entries: tuple[Any, ...], arrays: Sequence[NDArray]
    ) -> StressResponse:
        """Let each rank work on arrays (n, …) at the points that it owns, and join the responses.

        Args:
            work: a task of this file that returns a response.
            owner: (n,) rank of each point.
            entries: arguments that are the same for all ranks.
        """
        after = RankState(self, owner, np.zeros(len(owner), dtype=np.bool_))
        shares = after.shares()
        of_all = (self._number, *entries, after.number)
        tasks: list[tuple[Any, ...] | None] = []
        for points in shares:
            task = (*of_all, *(values[points] for values in arrays))
            tasks.append(task if len(points) else None)
        results = self.driver.do(work, tasks)
        parts = [
            (points, part) for points, part in zip(shares, results, strict=True) if len(points)
        ]
        after.left_points = joined_values([(points, part.state) for points, part in parts])
        return joined(parts, after)

    def _dealt(self, values: Array) -> Index:
        """Choose owners (n,) of points without a state, which have these values (n, …).

        A cache asks for few points each time, and they must not pile up on rank 0. The rank that
        gets them follows from their values alone: `respond` is pure, and a run that resumes deals
        as an uninterrupted one does.
        """
        ranks = self.driver.ranks
        tiles = tiles_for(len(values))
        sharing = min(ranks, max(1, tiles // LEAST))
        owner = np.repeat(np.arange(tiles) * sharing // tiles, TILE)[: len(values)]
        if sharing < ranks:
            owner = (owner + crc32(values.tobytes())) % ranks
        return owner

    def _checked(self, state: Any, points: int) -> RankState:
        """Return a state of this law for so many points; another one is an `InputError`."""
        if isinstance(state, RankState) and len(state.owner) == points and state.law is self:
            return state
        raise InputError(f"state: not one of this DistributedLaw for {points} points; pass None")


# Tasks that each rank does, rank 0 too, with its `Worker` and the arguments scattered to it.


def _have(worker: Worker, number: int, law: RveLaw) -> None:
    """Keep a law by its number."""
    worker.laws[number] = law


def _join(worker: Worker, after: int, numbers: Index, rows: Index) -> None:
    """Bring points of several states, row by row, into one."""
    first, *others = np.unique(numbers).tolist()
    state = worker.states[first].take(np.where(numbers == first, rows, 0))
    for number in others:
        of_number = np.flatnonzero(numbers == number)
        state = state.put(of_number, worker.states[number].take(rows[of_number]))
    worker.states[after] = state


def _respond(
    worker: Worker,
    law: int,
    before: int | None,
    tangents: bool,
    after: int,
    F: Array,
    F_dot: Array,
) -> StressResponse:
    """Return the response, whose state stays here; it carries (k,) `left_points` instead."""
    state = None if before is None else worker.states[before]
    answer = worker.laws[law].respond(F, F_dot, state, tangents=tangents)
    worker.states[after] = answer.state
    return replace(answer, state=answer.state.left_points)


def _accept(worker: Worker, law: int, before: int, after: int, *answered: Any) -> StressResponse:
    """Return the accepted response; its state stays here, it carries (k,) `left_points`."""
    F, F_dot, stress, status = answered
    answer = StressResponse(stress, status, worker.states[before])
    accepted = worker.laws[law].accept(F, F_dot, answer)
    worker.states[after] = accepted.state
    return replace(accepted, state=accepted.state.left_points)


def _to_arrays(
    worker: Worker, law: int, number: int, begin: int, points: int
) -> dict[str, NDArray]:
    """Return the arrays of some points of a state."""
    part = worker.states[number].take(np.arange(begin, begin + points))
    return worker.laws[law].state_to_arrays(part)


def _from_arrays(worker: Worker, law: int, number: int, arrays: Mapping[str, NDArray]) -> None:
    """Keep the state that these arrays make."""
    worker.states[number] = worker.laws[law].state_from_arrays(arrays)


def shared(law: RveLaw) -> Any:
    """Return the law with its RVEs on all ranks where this process drives several; else itself."""
    driver = driver_at_work()
    return law if driver is None else DistributedLaw(law, driver)


def own_part(law: Any) -> Any:
    """Return the law of rank 0 behind a distributed one; else itself."""
    return law.law if isinstance(law, DistributedLaw) else law
