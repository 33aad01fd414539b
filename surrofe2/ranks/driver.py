"""The driver of all ranks of MPI: rank 0 scatters tasks to ranks of the same program."""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import numba

from surrofe2.base.clock import clock
from surrofe2.base.environment import cores
from surrofe2.base.errors import InputError, SimulationError, Surrofe2Error, quoted, shortened
from surrofe2.base.interruption import end_by, exit_code, held, pass_on, received, uncaught
from surrofe2.base.launcher import ALONE, HEARD, end_job, pass_on_lines, rank, world_size
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import RveState

log = logging.getLogger(__name__)

# Variables by which MPIs tell how many ranks share the machine.
_LOCAL_SIZES = ("MPI_LOCALNRANKS", "OMPI_COMM_WORLD_LOCAL_SIZE", "MV2_COMM_WORLD_LOCAL_SIZE")
# A shell command that prints its message where its input ends without a line, that is where the
# other end of the pipe is lost.
_WATCH = """read done || printf '%s\\n' "$0" >&2"""
# A task of one rank: a function that is called as work(worker, *arguments), the arguments, None
# where it has nothing to do, and the states to forget before.
_Task = tuple[Callable[..., Any], tuple[Any, ...] | None, list[int]]
# The result of a task on a rank, its seconds, its error message, and the signal that it got or 0.
_Result = tuple[Any, float, str | None, int]
_drivers = list["Driver"]()  # the driver of this process, if it has one
_PACKAGE = Path(__file__).parents[1]


def world() -> Any:
    """Return the communicator of all ranks; None where this process is alone.

    Raises:
        InputError: MPI sees another number of ranks than the launcher started.
    """
    if world_size() < 2:
        return None
    try:
        # Loading it waits for all ranks, and nothing needs to be kept yet.
        with uncaught():
            from mpi4py import MPI
    except (ImportError, RuntimeError, OSError) as error:
        reason = shortened(" ".join(str(error).split()), 150)
        log.error(
            "error: mpiexec: rank %d of %d: mpi4py cannot be loaded (%s); install surrofe2[mpi]",
            rank(),
            world_size(),
            reason,
        )
        end_job()
    if MPI.COMM_WORLD.size != world_size():
        raise InputError(
            f"mpiexec: it started {world_size()} ranks, and mpi4py sees {MPI.COMM_WORLD.size}; "
            "mpi4py must be built for the MPI that mpiexec belongs to"
        )
    return MPI.COMM_WORLD


def own_threads() -> int:
    """Return the cores for each rank: those it is bound to, or its part of all that may be used."""
    bound = len(os.sched_getaffinity(0))
    allowed = cores()
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


def leave(code: int = 0) -> None:
    """Leave MPI with all ranks together, when rank 0 has printed how the command ended.

    MPI takes a rank that ends without leaving for one that was lost. Some launchers end all ranks
    as soon as one has ended with an exit code that is not 0, so such a rank is not the first.

    Args:
        code: exit code of this rank.
    """
    if "mpi4py" not in sys.modules:
        return
    from mpi4py import MPI

    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    barrier = MPI.COMM_WORLD.Ibarrier()
    while not barrier.Test():  # a barrier that waits keeps a core busy, and rank 0 may still work
        time.sleep(0.01)
    if MPI.COMM_WORLD.rank and code:
        time.sleep(HEARD)
    MPI.Finalize()


@dataclass(frozen=True, slots=True)
class Worker:
    """The laws of one rank and the states of its points, by the numbers that the driver gave."""

    laws: dict[int, RveLaw] = field(default_factory=dict)
    states: dict[int, RveState] = field(default_factory=dict)


class Driver(AbstractContextManager["Driver"]):
    """Sends tasks from rank 0 to all ranks and collects their results.

    An interruption waits while ranks exchange messages, so that they stay in step. A signal that
    another rank gets interrupts rank 0.

    Args:
        comm: the communicator of all ranks.
        arguments: of the command; all ranks must have the same.

    Raises:
        InputError: ranks are not of the same sources, versions or arguments; all of them end.

    Attributes:
        ranks: number of ranks.
        numbers: iterator of numbers for laws and states, each used once.
        dropped: numbers of states that all ranks forget with the next task.
        seconds: spent on tasks: "computing" by the slowest rank of each, "messages" the rest.
        tasks: number of tasks so far.
    """

    def __init__(self, comm: Any, arguments: Sequence[str] = ()) -> None:
        self._comm = comm
        end_by(comm.Abort)
        with held():
            try:
                problem = _disagreement(comm.gather(_identity(arguments)))
            except Exception as error:  # another version's identity may be of another kind
                log.error(
                    "error: mpiexec: ranks cannot be compared (%s: %s); install the same version "
                    "of surrofe2 on all machines",
                    type(error).__name__,
                    shortened(str(error)),
                )
                pass_on_lines()
                comm.Abort(1)
                raise
            if problem:
                comm.scatter([1] * int(comm.size))
                raise InputError(f"mpiexec: {problem}")
        self.ranks = int(comm.size)
        self.tasks = 0
        self.seconds = {"computing": 0.0, "messages": 0.0}
        self.numbers = count()
        self.dropped = list[int]()
        self._worker = Worker()
        _drivers.append(self)

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """End the workers, all with one exit code: launchers take that of any rank."""
        if kind is None:
            code = 0
        elif issubclass(kind, Surrofe2Error):
            code = 1
        else:  # an interruption
            code = exit_code()
        _drivers.remove(self)
        with held():
            self._comm.scatter([code] * self.ranks)

    def do(
        self, work: Callable[..., Any], arguments: Sequence[tuple[Any, ...] | None]
    ) -> list[Any]:
        """Let each rank do `work(worker, *arguments[rank])`; nothing where it has no arguments.

        Returns:
            The results of all ranks, None without arguments.

        Raises:
            SimulationError: it failed on a rank, which the message names.
        """
        with held():
            dropped = self.dropped
            self.dropped = []
            began = clock()
            tasks = [(work, arguments_of_rank, dropped) for arguments_of_rank in arguments]
            own_task = self._comm.scatter(tasks)
            results: list[_Result] = self._comm.gather(_done(self._worker, own_task))
            elapsed = clock() - began
        slowest = max(seconds for _, seconds, _, _ in results)
        self.tasks += 1
        self.seconds["computing"] += slowest
        self.seconds["messages"] += max(0.0, elapsed - slowest)
        for number, (_, _, error, _) in enumerate(results):
            if error is not None:
                raise SimulationError(f"rank {number} of {self.ranks} gave up: {error}")
        for number, (_, _, _, signal) in enumerate(results):
            if signal and number:
                pass_on(signal, f"rank {number}")
        return [value for value, _, _, _ in results]

    def report(self) -> dict[str, Any]:
        """Return number of ranks and threads, tasks and seconds, as plain values for run.json."""
        threads = numba.get_num_threads()
        return {"ranks": self.ranks, "threads": threads, "tasks": self.tasks, **self.seconds}


def serve(comm: Any, arguments: Sequence[str] = ()) -> int:
    """Work on a rank other than 0: task after task, until the driver ends it.

    Where this rank fails outside a task, all ranks end, since they would wait for it.

    Args:
        arguments: as of `Driver`.

    Returns:
        The exit code that the driver gave.
    """
    worker = Worker()
    end_by(comm.Abort)
    try:
        with held():  # rank 0 decides when it is over
            comm.gather(_identity(arguments))
            while not isinstance(task := comm.scatter(None), int):
                comm.gather(_done(worker, task))
    except BaseException as error:
        log.error(
            "error: rank %d of %d gave up outside a task: %s: %s",
            comm.rank,
            comm.size,
            type(error).__name__,
            shortened(str(error)),
        )
        pass_on_lines()
        comm.Abort(1)
        raise
    return task


@dataclass(frozen=True, slots=True)
class _Identity:
    """The program of a rank, which must be the same on all of them, and where it is.

    Attributes:
        arguments: of the command.
        sources: SHA-256 of the package's files.
        versions: of Python and the libraries that compute, by name.
        place: host and folder of the package.
    """

    arguments: tuple[str, ...]
    sources: str
    versions: dict[str, str]
    place: str


def _identity(arguments: Sequence[str]) -> _Identity:
    """Return the identity of this rank."""
    versions = {name: version(name) for name in ("surrofe2", "numpy", "numba", "scipy")}
    versions["python"] = platform.python_version()
    place = f"{platform.node()}:{_PACKAGE}"
    return _Identity(tuple(arguments), _sources(), versions, place)


@cache
def _sources() -> str:
    """Return a digest of names and contents of all that the package computes by."""
    sources = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*")):
        if path.suffix in (".py", ".json"):
            content = path.read_bytes()
            sources.update(f"{path.relative_to(_PACKAGE)} {len(content)} ".encode() + content)
    return sources.hexdigest()


def _disagreement(identities: Sequence[_Identity]) -> str:
    """Say what is not the same on all ranks; empty where everything is."""
    first = identities[0]
    for number, other in enumerate(identities):
        if other.arguments != first.arguments:
            pairs = zip((*first.arguments, ""), (*other.arguments, ""), strict=False)
            of_first, of_other = next(pair for pair in pairs if pair[0] != pair[1])
            return (
                f"rank {number} was called with {quoted(of_other)}, rank 0 with "
                f"{quoted(of_first)}; ranks share one run: give all the same arguments, or set "
                f"{ALONE}=1, by which each rank makes a run of its own"
            )
        for name, mine in first.versions.items():
            if other.versions[name] != mine:
                return (
                    f"rank {number} has {name} {other.versions[name]} ({other.place}), rank 0 has "
                    f"{mine} ({first.place}); install the same on all machines"
                )
        if other.sources != first.sources:
            return (
                f"rank {number} has other sources of surrofe2 ({other.place}) than rank 0 "
                f"({first.place}); install the same on all machines"
            )
    return ""


def driver_at_work() -> Driver | None:
    """Return the driver of this process, if it is rank 0 of several."""
    return _drivers[-1] if _drivers else None


def _done(worker: Worker, task: _Task) -> _Result:
    """Do a task on this rank; its error is returned, since the other ranks wait for an answer."""
    work, arguments, dropped = task
    for number in dropped:
        worker.states.pop(number, None)
    began = clock()
    value = None
    error = None
    try:
        if arguments is not None:
            value = work(worker, *arguments)
    except (Exception, SystemExit) as problem:
        error = f"{type(problem).__name__}: {problem}"
    return value, clock() - began, error, received()
