"""What each rank has at hand: the communicator, laws, and the states of its own points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.ranks.dealing import Index
from surrofe2.stress_law import StressLaw

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


class Desk:
    """One rank's.

    Attributes:
        comm: mpi4py's communicator.
        laws, states: by the numbers that rank 0 gave them; a state is that of own points.
    """

    def __init__(self, comm: Any) -> None:
        self.comm = comm
        self.rank, self.ranks = int(comm.rank), int(comm.size)
        self.laws: dict[int, StressLaw] = {}
        self.states: dict[int, Any] = {}

    def own(self, cuts: Index) -> slice:
        """The points of this rank."""
        return slice(int(cuts[self.rank]), int(cuts[self.rank + 1]))

    def scattered(self, cuts: Index, whole: Array | None) -> Array:
        """The rows of this rank of an array (n, 2, 2) that rank 0 has."""
        own, sizes = self.own(cuts), (4 * np.diff(cuts), 4 * cuts[:-1])
        if whole is not None:
            self.comm.Scatterv([whole, sizes, "d"], None)
            return whole[own]
        part = np.empty((own.stop - own.start, 2, 2))
        self.comm.Scatterv(None, [part, "d"])
        return part

    def gathered(self, cuts: Index, part: Array | None, row: tuple[int, ...]) -> Array | None:
        """On rank 0 the rows of all ranks, (n, *row); NaN where a rank has none to give."""
        own, size = self.own(cuts), int(np.prod(row, dtype=np.int64))
        if part is None:
            part = np.full((own.stop - own.start, *row), np.nan)
        if self.rank:
            self.comm.Gatherv([np.ascontiguousarray(part), "d"], None)
            return None
        whole = np.empty((int(cuts[-1]), *row))
        whole[own] = part
        self.comm.Gatherv(None, [whole, (size * np.diff(cuts), size * cuts[:-1]), "d"])
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
        """On rank 0 what all ranks tell."""
        everything: list[Told] | None = self.comm.gather(told)
        return everything


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
