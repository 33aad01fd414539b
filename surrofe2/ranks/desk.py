"""What each rank has at hand: the communicator, laws, and the states of its own points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.ranks.dealing import Index

Array = NDArray[np.float64]
Sparse = tuple[NDArray[np.intp], NDArray[Any]]
"""Numbers of points and their values."""


@dataclass(slots=True)
class Told:
    """What a rank says of its part of a task, beside arrays over all its points.

    Attributes:
        seconds: that it took to compute.
        error: the sentence of what went wrong; then nothing else holds.
        has_state: whether there is a state of its points.
        status: numbers and codes of points without stress.
        left: numbers of the points that its state has beyond a bifurcation.
        newly_left, stress: numbers of points that left their branch, and stresses that changed.
        effort, reasons: as of `StressResponse`, points numbered as of all ranks.
    """

    seconds: float = 0.0
    error: str | None = None
    has_state: bool = False
    status: Sparse | None = None
    left: NDArray[np.intp] | None = None
    newly_left: NDArray[np.intp] | None = None
    stress: Sparse | None = None
    effort: dict[str, int] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)

    @property
    def has_more(self) -> bool:
        """Whether it says more than how long it took."""
        told = (self.error, self.status, self.left, self.newly_left, self.stress)
        is_said = any(each is not None for each in told)
        return is_said or self.has_state or bool(self.effort) or bool(self.reasons)


class Desk:
    """One rank's.

    Attributes:
        comm: mpi4py's communicator.
        laws, states: by the numbers that rank 0 gave them; a state is that of own points.
    """

    def __init__(self, comm: Any) -> None:
        self.comm = comm
        self.rank, self.ranks = int(comm.rank), int(comm.size)
        self.laws: dict[int, Any] = {}
        self.states: dict[int, Any] = {}
        self._last: Any = None

    def order(self, task: Any = None, dropped: Sequence[int] = ()) -> Any:
        """The task that rank 0 orders, on all ranks, and without the states that are dropped.

        The very task of the last time is not sent again.
        """
        is_new = task is not self._last or len(dropped) > 0
        sent = self.comm.bcast((task, dropped) if is_new else None)
        if sent is not None:
            self._last, dropped = sent if self.rank else (task, dropped)
            for number in dropped:
                self.states.pop(number, None)
        return self._last

    def own(self, cuts: Index) -> slice:
        """The points of this rank."""
        return slice(int(cuts[self.rank]), int(cuts[self.rank + 1]))

    def scattered(self, cuts: Index, whole: Array | None) -> Array:
        """The rows of this rank of an array (n, 2, 2) that rank 0 has."""
        own = self.own(cuts)
        if whole is None:
            part = np.empty((own.stop - own.start, 2, 2))
            if part.size:
                self.comm.Recv(part, 0)
            return part
        parts = [
            (rank, whole[int(cuts[rank]) : int(cuts[rank + 1])]) for rank in self._others(cuts)
        ]
        for each in [self.comm.Isend(np.ascontiguousarray(part), rank) for rank, part in parts]:
            each.Wait()  # before this rank computes: a send may need its hand
        return whole[own]

    def gathered(self, cuts: Index, part: Array | None, row: tuple[int, ...]) -> Array | None:
        """On rank 0 the rows of all ranks, (n, *row); NaN where a rank has none to give."""
        own = self.own(cuts)
        if part is None:
            part = np.full((own.stop - own.start, *row), np.nan)
        if self.rank:
            if part.size:
                self.comm.Send(np.ascontiguousarray(part), 0)
            return None
        whole = np.empty((int(cuts[-1]), *row))
        whole[own] = part
        for rank in self._others(cuts):
            self.comm.Recv(whole[int(cuts[rank]) : int(cuts[rank + 1])], rank)
        return whole

    def worked(self, told: Told, work: Callable[[], Any]) -> Any:
        """What the work gives, timed; None where it fails, with the reason told."""
        began = perf_counter()
        try:
            return work()
        except Exception as error:
            told.error = f"{type(error).__name__}: {error}"
            return None
        finally:
            told.seconds = perf_counter() - began

    def tell(self, told: Told) -> list[Told] | None:
        """On rank 0 what all ranks tell; most tell but how long they took."""
        said = np.array([told.seconds, float(told.has_more)])
        if self.rank:
            self.comm.Gather(said, None)
            if told.has_more:
                self.comm.send(told, 0)
            return None
        of_all = np.empty((self.ranks, 2))
        self.comm.Gather(said, of_all)
        others = enumerate(of_all[1:].tolist(), start=1)
        return [
            told,
            *(self.comm.recv(source=k) if more else Told(seconds) for k, (seconds, more) in others),
        ]

    def _others(self, cuts: Index) -> list[int]:
        """Ranks but 0 that have points."""
        return [rank for rank in range(1, self.ranks) if cuts[rank + 1] > cuts[rank]]


def sparse(values: NDArray[Any], first: int) -> Sparse | None:
    """Numbers, beginning with `first`, of the values that are not 0, and these; None: all are."""
    places = values.nonzero()[0]
    return (places + first, values[places]) if len(places) else None


def dense(count: int, parts: Sequence[Sparse | None], kind: Any) -> NDArray[Any]:
    """(count,) those values, and 0 elsewhere."""
    values = np.zeros(count, dtype=kind)
    for part in parts:
        if part is not None:
            values[part[0]] = part[1]
    return values
