"""How rank 0 and the others work on one task at a time: it says what, all of them do it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import SimulationError, Surrofe2Error
from surrofe2.interruption import exit_code, held
from surrofe2.ranks.desk import Desk, Told
from surrofe2.stress_law import StressLaw

Array = NDArray[np.float64]
_FORGET = 0.1
"""Weight of the latest measurement of how fast a rank is."""


class Task(Protocol):
    """Something that all ranks do together."""

    def run(self, desk: Desk, given: tuple[Any, ...] | None) -> Any:
        """This rank's part; `given` are the arrays that rank 0 has, and what it gives is theirs."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The end of a crew, and with which exit code: launchers take that of any rank."""

    code: int = 0


class Crew:
    """Rank 0's hand on all ranks.

    An interruption waits while ranks exchange messages: they stay in step.

    Attributes:
        ranks: how many there are.
        seconds: spent on tasks: "computing" by the slowest rank of each, "messages" the rest;
            "idle" is what a rank waited for the slowest one, in the mean.
        sent: bytes of (F, Ḟ), stresses and bounds that came and went.
        tasks: how many there were.
    """

    def __init__(self, comm: Any) -> None:
        self.desk = Desk(comm)
        self.ranks = self.desk.ranks
        self.reset_counts()
        self._dropped: list[int] = []
        self._numbers = 0
        _at_work.append(self)

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.dismiss()
        else:
            self.dismiss(1 if issubclass(kind, Surrofe2Error) else exit_code())

    def dismiss(self, code: int = 0) -> None:
        """Let the others go, to end with this exit code."""
        if self in _at_work:
            _at_work.remove(self)
            with held():
                self.desk.order(Stop(code))

    def reset_counts(self) -> None:
        """Count from here on."""
        self.seconds = {"computing": 0.0, "messages": 0.0, "idle": 0.0}
        self.sent = self.tasks = 0

    def new_number(self) -> int:
        """For a law or a state."""
        self._numbers += 1
        return self._numbers

    def drop(self, number: int) -> None:
        """Nobody refers to that state any more."""
        self._dropped.append(number)

    def adopt(self, law: StressLaw) -> int:
        """The number of a law that all ranks have from now on."""
        number = self.new_number()
        self.do(Adopt(number, law))
        return number

    def everywhere(self, law: int, call: Callable[[Any], Any]) -> None:
        """Call a function of the law on rank 0, then on all others: they find what it compiled."""
        call(self.desk.laws[law])
        check(self.do(Call(law, call)))

    def do(self, task: Task, *given: Any) -> Any:
        """What a task gives on rank 0."""
        with held():
            dropped, self._dropped = self._dropped, []
            began = perf_counter()
            self.desk.order(task, dropped)
            found = task.run(self.desk, given)
            self._elapsed = perf_counter() - began
        self.tasks += 1
        return found

    def count(self, told: list[Told], sent: int = 0) -> Array:
        """(ranks,) seconds of all ranks for the last task, which are counted; errors are raised."""
        check(told)
        seconds = np.array([each.seconds for each in told])
        slowest = float(seconds.max())
        self.seconds["computing"] += slowest
        self.seconds["messages"] += max(0.0, self._elapsed - slowest)
        self.seconds["idle"] += slowest - float(seconds.mean())
        self.sent += sent
        return seconds

    def report(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {
            "ranks": self.ranks,
            "threads": numba.get_num_threads(),
            "tasks": self.tasks,
            "bytes": self.sent,
            **self.seconds,
        }


class Adopt:
    """A law that all ranks are to have."""

    def __init__(self, number: int, law: StressLaw) -> None:
        self.number, self.law = number, law

    def run(self, desk: Desk, given: tuple[Any, ...] | None) -> None:
        """Have it."""
        desk.laws[self.number] = self.law


class Call:
    """A function of a law, for all ranks but 0."""

    def __init__(self, law: int, call: Callable[[Any], Any]) -> None:
        self.law, self.call = law, call

    def run(self, desk: Desk, given: tuple[Any, ...] | None) -> list[Told] | None:
        """Call it."""
        told = Told()
        if given is None:
            desk.worked(told, partial(self.call, desk.laws[self.law]))
        return desk.tell(told)


_at_work: list[Crew] = []


def crew_at_work() -> Crew | None:
    """The crew whose rank 0 this process is, if it is one's."""
    return _at_work[-1] if _at_work else None


def serve(comm: Any) -> int:
    """What every rank but 0 does: task after task, until rank 0 dismisses its crew; exit code."""
    desk = Desk(comm)
    with held():  # rank 0 says when it is over
        while True:
            task = desk.order()
            if isinstance(task, Stop):
                return task.code
            task.run(desk, None)


def check(told: list[Told]) -> None:
    """Raise what went wrong on a rank.

    Raises:
        SimulationError: something did.
    """
    for rank, each in enumerate(told):
        if each.error is not None:
            raise SimulationError(f"rank {rank} of {len(told)} gave up: {each.error}")
