"""Whether there are ranks of MPI, seen without loading it, and how rank 0 scatters them tasks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numba

from surrofe2.base.clock import clock
from surrofe2.base.environment import cores
from surrofe2.base.errors import InputError, SimulationError, Surrofe2Error
from surrofe2.base.interruption import exit_code, held
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import RveState

_SIZES = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE")
_RANKS = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK")
_LOCAL_SIZES = ("MPI_LOCALNRANKS", "OMPI_COMM_WORLD_LOCAL_SIZE", "MV2_COMM_WORLD_LOCAL_SIZE")
_WATCH = """read done || printf '%s\\n' "$0" >&2"""
"""Prints its message where its input ends without a line, whoever had the other end."""
_Task = tuple[Callable[..., Any], tuple[Any, ...] | None, list[int]]
"""work(worker, *arguments) of one rank, no arguments where it has nothing to do, and the states to
forget before."""
_Result = tuple[Any, float, str | None]
"""What the task of a rank returned, its seconds, and its error message."""
_drivers = list["Driver"]()


def world_size() -> int:
    """How many ranks were started with this process; 1 without MPI."""
    known = [os.environ[name] for name in _SIZES if name in os.environ]
    if not known and "PMIX_RANK" in os.environ:
        known = [os.environ.get("SLURM_STEP_NUM_TASKS", "1")]
    return int(known[0]) if known and known[0].isdigit() else 1


def is_first() -> bool:
    """Whether this is rank 0, for what must be done before MPI is loaded."""
    return "0" in [os.environ[name] for name in _RANKS if name in os.environ][:1]


def world() -> Any:
    """The communicator of all ranks; None where this process is alone.

    Raises:
        InputError: there are several, and mpi4py is not installed.
    """
    if world_size() < 2:
        return None
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise InputError(
            f"mpiexec: {world_size()} ranks, but mpi4py cannot be loaded ({error}); "
            "install surrofe2[mpi]"
        ) from None
    if MPI.COMM_WORLD.size != world_size():
        raise InputError(
            f"mpiexec: it started {world_size()} ranks, and mpi4py sees {MPI.COMM_WORLD.size}; "
            "mpi4py must be built for the MPI that mpiexec belongs to"
        )
    return MPI.COMM_WORLD


def own_threads() -> int:
    """Cores for each rank: those that it is bound to, or its share of the machine's or quota's."""
    bound, allowed = len(os.sched_getaffinity(0)), cores()
    local = [os.environ[name] for name in _LOCAL_SIZES if name in os.environ]
    is_shared = bound == os.cpu_count() or allowed < bound
    ranks = int(local[0]) if local and is_shared else 1
    return max(1, allowed // ranks)


@contextmanager
def watched(message: str) -> Iterator[None]:
    """Print a message even where this process is killed in the block.

    A launcher that loses one rank kills the others. A shell waits beside this process and prints
    where it ended without a word.
    """
    watcher = subprocess.Popen(
        ["/bin/sh", "-c", _WATCH, message], stdin=subprocess.PIPE, start_new_session=True
    )
    try:
        yield
    finally:
        watcher.communicate(b"done\n")


def leave() -> None:
    """Leave MPI, which takes a rank that ends without leaving for one that was lost."""
    if "mpi4py" in sys.modules:
        from mpi4py import MPI

        MPI.Finalize()


@dataclass(frozen=True, slots=True)
class Worker:
    """What one rank holds, by the numbers that the driver gave: laws, and states of its points."""

    laws: dict[int, RveLaw] = field(default_factory=dict)
    states: dict[int, RveState] = field(default_factory=dict)


class Driver(AbstractContextManager["Driver"]):
    """Sends tasks from rank 0 to all ranks and collects their results.

    An interruption waits while ranks exchange messages, so that they stay in step.

    Attributes:
        ranks: how many there are.
        numbers: of laws and states, each used once.
        dropped: states that all ranks forget with the next task.
        seconds: spent on tasks: "computing" by the slowest rank of each, "messages" the rest.
        tasks: how many there were.
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.ranks = int(comm.size)
        self.tasks, self.seconds = 0, {"computing": 0.0, "messages": 0.0}
        self.numbers, self.dropped = count(), list[int]()
        self._worker = Worker()
        _drivers.append(self)

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """End the workers, all with one exit code: launchers take that of any rank."""
        code = 0 if kind is None else 1 if issubclass(kind, Surrofe2Error) else exit_code()
        _drivers.remove(self)
        with held():
            self._comm.scatter([code] * self.ranks)

    def do(
        self, work: Callable[..., Any], arguments: Sequence[tuple[Any, ...] | None]
    ) -> list[Any]:
        """The results of `work(worker, *arguments[rank])` of all ranks; None without arguments.

        Raises:
            SimulationError: it failed on a rank, which the message names.
        """
        with held():
            dropped, self.dropped = self.dropped, []
            began = clock()
            own = self._comm.scatter([(work, each, dropped) for each in arguments])
            results: list[_Result] = self._comm.gather(_done(self._worker, own))
            elapsed = clock() - began
        slowest = max(seconds for _, seconds, _ in results)
        self.tasks += 1
        self.seconds["computing"] += slowest
        self.seconds["messages"] += max(0.0, elapsed - slowest)
        for rank, (_, _, error) in enumerate(results):
            if error is not None:
                raise SimulationError(f"rank {rank} of {self.ranks} gave up: {error}")
        return [value for value, _, _ in results]

    def report(self) -> dict[str, Any]:
        """Plain values for run.json."""
        threads = numba.get_num_threads()
        return {"ranks": self.ranks, "threads": threads, "tasks": self.tasks, **self.seconds}


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


def _done(worker: Worker, task: _Task) -> _Result:
    work, arguments, dropped = task
    for number in dropped:
        worker.states.pop(number, None)
    began, value, error = clock(), None, None
    try:
        if arguments is not None:
            value = work(worker, *arguments)
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"
    return value, clock() - began, error
