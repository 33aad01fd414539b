"""`DistributedLaw`: RVEs on many ranks, a stress law as any other on rank 0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE
from surrofe2.cache.cached_law import CachedLaw
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import (
    Acceptance,
    StressLaw,
    StressResponse,
    Tangents,
    check_deformation,
    require_tangents,
)
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import tiles_for
from surrofe2.ranks.driver import Driver, Worker, driver_at_work
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import RveState
from surrofe2.surrogate.surrogate_law import SurrogateLaw

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Shares = list[Index]
"""For each rank the numbers of its points."""

LEAST = 16
"""Tiles of a rank: fewer RVEs are solved sooner than they are sent, as those of an audit are."""
_PLACE = [("owner", np.intp), ("number", np.intp), ("row", np.intp), ("left", np.bool_)]


class RankState:
    """Warm start of n points that stays on the ranks which own them; see `cache.PointStates`.

    Rank 0 knows only the places. `take` and `put` rearrange these and send nothing: a point never
    moves to another rank.

    Attributes:
        law: whose state it is.
        places: (n,) records of the rank that owns the point, the number of that rank's state which
            has it, the row there, and whether the point left its branch at a bifurcation.
    """

    def __init__(self, law: DistributedLaw, places: NDArray[Any], kept: Mapping[int, _Kept]):
        self.law, self.places = law, places
        self._kept = {each: kept[each] for each in np.unique(places["number"]).tolist()}

    @property
    def points(self) -> int:
        """n."""
        return len(self.places)

    @property
    def left_points(self) -> NDArray[np.bool_]:
        """(n,) where the stress is one of several."""
        left: NDArray[np.bool_] = self.places["left"]
        return left

    def shares(self) -> Shares:
        """The points of each rank, in ascending order."""
        owner = self.places["owner"]
        counts = np.bincount(owner, minlength=self.law.driver.ranks)
        return np.split(np.argsort(owner, kind="stable"), np.cumsum(counts)[:-1])

    def take(self, index: Index) -> RankState:
        """The state of these points, in this order; a point may be taken twice."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self
        return RankState(self.law, self.places[index], self._kept)

    def put(self, index: Index, part: RankState) -> RankState:
        """This state with that of these points replaced."""
        places = self.places.copy()
        places[index] = part.places
        return RankState(self.law, places, {**self._kept, **part._kept})

    def to_arrays(self) -> dict[str, NDArray]:
        """All of it, as one `RveState` of all points would give it."""
        number, shares = self.joined(), self.shares()
        found = self.law.driver.do(_to_arrays, [(number,) if len(own) else None for own in shares])
        names = next(each for each in found if each is not None)
        return {name: _gathered(shares, found, itemgetter(name)) for name in names}

    def joined(self) -> int:
        """The number by which every rank has its points, in ascending order, in one state."""
        (number, *others), shares = self._kept, self.shares()
        rows = self.places["row"]
        if others or not all((rows[own] == np.arange(len(own))).all() for own in shares):
            kept = _Kept(self.law.driver)
            number, parts = kept.number, [self.places[own] for own in shares]
            tasks = [(number, part["number"], part["row"]) if len(part) else None for part in parts]
            self.law.driver.do(_join, tasks)
            for own in shares:  # so that the next answer from here finds them joined
                self.places["row"][own] = np.arange(len(own))
            self.places["number"], self._kept = number, {number: kept}
        return number


class _Kept:
    """Ranks keep the state of this number as long as any `RankState` refers to it."""

    def __init__(self, driver: Driver) -> None:
        self._driver, self.number = driver, driver.new_number()

    def __del__(self) -> None:
        self._driver.drop(self.number)


class DistributedLaw:
    """σ(F, Ḟ) of RVEs that live on the ranks of a driver; see `StressLaw` and `cache.Fallback`.

    Points without a state are dealt to ranks in equal blocks of whole tiles, few points to one
    rank, each time to the next one. RVE states, with their factors, stay there: on rank 0 a
    `RankState` stands for them. (F, Ḟ) are scattered and stresses gathered.

    Attributes:
        law: that of rank 0; every rank has the same.
        driver: of this very process.
    """

    def __init__(self, law: RveLaw, driver: Driver) -> None:
        self.law, self.driver = law, driver
        self._number, self._next = driver.new_number(), 0
        driver.do(_have, [(self._number, law)] * driver.ranks)

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""
        return self.law.cell

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""
        return self.law.initialisation

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.law.density

    @property
    def has_tangents(self) -> bool:
        """Whether `respond` gives tangents when asked."""
        return self.law.has_tangents

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> RankState:
        """The state whose `to_arrays`, or that of an `RveState`, gave these arrays."""
        state, number = self._new_state(self._dealt(len(arrays["z"])), arrays["left"])
        parts = [{name: each[own] for name, each in arrays.items()} for own in state.shares()]
        tasks = [(self._number, number, part) if len(part["z"]) else None for part in parts]
        self.driver.do(_from_arrays, tasks)
        return state

    def respond(
        self, F: Array, F_dot: Array, state: RankState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        F, F_dot = check_deformation(F, F_dot)
        if tangents:
            require_tangents(self)
        if not len(F):
            return StressResponse(np.empty((0, 2, 2)), np.empty(0, np.int8), state, {})
        before = None if state is None else self._checked(state, len(F)).joined()
        owner = self._dealt(len(F)) if state is None else state.places["owner"]
        after, number = self._new_state(owner, np.zeros(len(F), dtype=np.bool_))
        shares = after.shares()
        given = self._number, before, number, tangents
        tasks = [(*given, F[own], F_dot[own]) if len(own) else None for own in shares]
        answers: list[StressResponse | None] = self.driver.do(_respond, tasks)
        after.places["left"] = _gathered(shares, answers, lambda each: each.state)
        effort: Counter[str] = Counter()
        for each in answers:
            effort.update({} if each is None else each.effort)
        slopes = None
        if tangents:
            slopes = Tangents(
                _gathered(shares, answers, lambda each: each.tangents.P_by_F),
                _gathered(shares, answers, lambda each: each.tangents.P_by_F_dot),
            )
        left = after.left_points
        return StressResponse(
            _gathered(shares, answers, lambda each: each.stress),
            _gathered(shares, answers, lambda each: each.status),
            after,
            dict(effort),
            slopes,
            left_bifurcation=left if left.any() else None,
        )

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        if not len(F):
            return Acceptance(response.status, response.state)
        F, F_dot = check_deformation(F, F_dot)
        state = self._checked(response.state, len(F))
        before, shares = state.joined(), state.shares()
        after, number = self._new_state(state.places["owner"], state.left_points)
        answered = F, F_dot, response.stress, response.status
        given = self._number, before, number
        tasks = [(*given, *(a[own] for a in answered)) if len(own) else None for own in shares]
        said = self.driver.do(_accept, tasks)
        after.places["left"] = _gathered(shares, said, lambda each: each.state)
        left = _gathered(shares, said, lambda each: each.left_bifurcation)
        return Acceptance(
            _gathered(shares, said, lambda each: each.status),
            after,
            _gathered(shares, said, lambda each: each.stress) if left.any() else None,
            left if left.any() else None,
        )

    def _dealt(self, points: int) -> Index:
        """(points,) owners of points without a state."""
        ranks, tiles = self.driver.ranks, tiles_for(points)
        sharing = min(ranks, max(1, tiles // LEAST))
        owner = np.repeat(np.arange(tiles) * sharing // tiles, TILE)[:points]
        if sharing < ranks:  # few points each time, as of a cache, shall not pile up on rank 0
            owner, self._next = (owner + self._next) % ranks, self._next + sharing
        return owner

    def _new_state(self, owner: Index, left: NDArray[np.bool_]) -> tuple[RankState, int]:
        """A state that ranks are to have by this number."""
        kept = _Kept(self.driver)
        places = np.empty(len(owner), dtype=_PLACE)
        places["owner"], places["number"], places["left"] = owner, kept.number, left
        state = RankState(self, places, {kept.number: kept})
        for own in state.shares():
            places["row"][own] = np.arange(len(own))
        return state, kept.number

    def _checked(self, state: Any, points: int) -> RankState:
        if isinstance(state, RankState) and state.points == points and state.law is self:
            return state
        raise InputError(
            f"state: not a state of this DistributedLaw for {points} points; pass what an earlier "
            "answer for the same points carried, or None"
        )


def _gathered(shares: Shares, parts: Sequence[Any], values_of: Callable[[Any], Any]) -> NDArray:
    """(n, …) the values of all ranks, None from ranks without points."""
    found = [(own, values_of(part)) for own, part in zip(shares, parts, strict=True) if len(own)]
    whole = np.empty((sum(map(len, shares)), *found[0][1].shape[1:]), found[0][1].dtype)
    for own, values in found:
        whole[own] = values
    return whole


# Tasks: what each rank does, rank 0 too, with its `Worker` and the arguments scattered to it.


def _have(worker: Worker, number: int, law: RveLaw) -> None:
    worker.laws[number] = law


def _join(worker: Worker, after: int, numbers: Index, rows: Index) -> None:
    """Bring points of several states, row by row, into one."""
    first, *others = np.unique(numbers).tolist()
    state = worker.states[first].take(np.where(numbers == first, rows, 0))
    for number in others:
        at = np.flatnonzero(numbers == number)
        state = state.put(at, worker.states[number].take(rows[at]))
    worker.states[after] = state


def _respond(
    worker: Worker,
    law: int,
    before: int | None,
    after: int,
    tangents: bool,
    F: Array,
    F_dot: Array,
) -> StressResponse:
    """The answer; the place of its state, which stays here, is taken by `left_points`."""
    state = None if before is None else worker.states[before]
    answer = worker.laws[law].respond(F, F_dot, state, tangents=tangents)
    worker.states[after] = answer.state
    return replace(answer, state=answer.state.left_points)


def _accept(
    worker: Worker,
    law: int,
    before: int,
    after: int,
    F: Array,
    F_dot: Array,
    stress: Array,
    status: NDArray[np.int8],
) -> Acceptance:
    """As of `_respond`, with stress and marks of a bifurcation filled in where there are none."""
    said = worker.laws[law].accept(F, F_dot, StressResponse(stress, status, worker.states[before]))
    state: RveState = said.state
    worker.states[after] = state
    left = np.zeros(len(F), np.bool_) if said.left_bifurcation is None else said.left_bifurcation
    stress = stress if said.stress is None else said.stress
    return Acceptance(said.status, state.left_points, stress, left)


def _to_arrays(worker: Worker, number: int) -> dict[str, NDArray]:
    return worker.states[number].to_arrays()


def _from_arrays(worker: Worker, law: int, number: int, arrays: Mapping[str, NDArray]) -> None:
    worker.states[number] = worker.laws[law].state_from_arrays(arrays)


def distributed(law: StressLaw, driver: Driver) -> Any:
    """The same law with its RVEs on all ranks.

    A surrogate, a table, and what a cached law decides and counts stay on rank 0.

    Raises:
        InputError: it is none of ours.
    """
    match law:
        case RveLaw():
            return DistributedLaw(law, driver)
        case SurrogateLaw():
            return law
        case CachedLaw(fallback=RveLaw() as fallback):
            rves = DistributedLaw(fallback, driver)
            return CachedLaw(law.surrogate, rves, law.settings, law.on_true_answer)
        case RegionalLaw():
            laws = {name: distributed(each, driver) for name, each in law.laws.items()}
            return RegionalLaw(laws, law.points)
    raise InputError(
        f"law: {type(law).__name__}; it must be an RveLaw, a SurrogateLaw, a CachedLaw with RVEs "
        "or a RegionalLaw of these"
    )


def shared(law: RveLaw) -> Any:
    """The law with its RVEs on all ranks where this process drives several; else itself."""
    driver = driver_at_work()
    return law if driver is None else DistributedLaw(law, driver)


def own_part(law: Any) -> Any:
    """The law of rank 0 behind a distributed one; else itself."""
    return law.law if isinstance(law, DistributedLaw) else law
