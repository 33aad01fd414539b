"""Rank 0 drives, all ranks work: one task at a time is scattered, and its results are gathered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numba

from surrofe2.base.compilation import clock
from surrofe2.base.errors import SimulationError, Surrofe2Error
from surrofe2.base.interruption import exit_code, held
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import RveState


@dataclass(frozen=True, slots=True)
class Worker:
    """What one rank holds, by the numbers that the driver gave: laws, and states of its points."""

    laws: dict[int, RveLaw] = field(default_factory=dict)
    states: dict[int, RveState] = field(default_factory=dict)


class Task(NamedTuple):
    """A function for one rank: `work(worker, *arguments)`; states `dropped` are forgotten before.

    No arguments (None): this rank has nothing to do.
    """

    work: Callable[..., Any]
    arguments: tuple[Any, ...] | None
    dropped: list[int]


class Result(NamedTuple):
    """What a rank's task returned after so many seconds, or its error message."""

    value: Any
    seconds: float
    error: str | None


class Driver:
    """Sends tasks from rank 0 to all ranks and collects their results.

    An interruption waits while ranks exchange messages, so that they stay in step.

    Attributes:
        ranks: how many there are.
        seconds: spent on tasks: "computing" by the slowest rank of each, "messages" the rest.
        tasks: how many there were.
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.ranks = int(comm.size)
        self.reset_counts()
        self._worker = Worker()
        self._dropped: list[int] = []
        self._numbers = 0
        _drivers.append(self)

    def __enter__(self) -> Driver:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.dismiss()
        else:
            self.dismiss(1 if issubclass(kind, Surrofe2Error) else exit_code())

    def dismiss(self, code: int = 0) -> None:
        """End the workers, each with this exit code: launchers take that of any rank."""
        if self in _drivers:
            _drivers.remove(self)
            with held():
                self._comm.scatter([code] * self.ranks)

    def reset_counts(self) -> None:
        """Set `seconds` and `tasks` to zero."""
        self.seconds = {"computing": 0.0, "messages": 0.0}
        self.tasks = 0

    def new_number(self) -> int:
        """A number for a law or a state."""
        self._numbers += 1
        return self._numbers

    def drop(self, number: int) -> None:
        """Forget this state on all ranks, with the next task."""
        self._dropped.append(number)

    def do(
        self, work: Callable[..., Any], arguments: Sequence[tuple[Any, ...] | None]
    ) -> list[Any]:
        """The results of `work(worker, *arguments[rank])` of all ranks; None without arguments.

        Raises:
            SimulationError: it failed on a rank, which the message names.
        """
        with held():
            dropped, self._dropped = self._dropped, []
            began = clock()
            own = self._comm.scatter([Task(work, each, dropped) for each in arguments])
            results: list[Result] = self._comm.gather(_done(self._worker, own))
            elapsed = clock() - began
        slowest = max(each.seconds for each in results)
        self.tasks += 1
        self.seconds["computing"] += slowest
        self.seconds["messages"] += max(0.0, elapsed - slowest)
        for rank, each in enumerate(results):
            if each.error is not None:
                raise SimulationError(f"rank {rank} of {self.ranks} gave up: {each.error}")
        return [each.value for each in results]

    def report(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {
            "ranks": self.ranks,
            "threads": numba.get_num_threads(),
            "tasks": self.tasks,
            **self.seconds,
        }


def serve(comm: Any) -> int:
    """Work on all ranks but 0: task after task, until the driver ends it with this exit code."""
    worker = Worker()
    with held():  # rank 0 decides when it is over
        while not isinstance(task := comm.scatter(None), int):
            comm.gather(_done(worker, task))
    return task


def driver_at_work() -> Driver | None:
    """The driver of this process, if it is rank 0 of several."""
    return _drivers[-1] if _drivers else None


def _done(worker: Worker, task: Task) -> Result:
    for number in task.dropped:
        worker.states.pop(number, None)
    began, value, error = clock(), None, None
    try:
        if task.arguments is not None:
            value = task.work(worker, *task.arguments)
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"
    return Result(value, clock() - began, error)


_drivers: list[Driver] = []
