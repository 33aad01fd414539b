"""Pieces of work by this process, by several, or by whatever executor a user brings.

A piece is a pure function of where it begins and how much it takes, so a piece whose process is
lost is done again, and results do not depend on which process did what. Executors are those of
`concurrent.futures`, as also mpi4py.futures, executorlib, Parsl and dask.distributed offer them.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Thread, local
from typing import Any

import numba

from surrofe2.base.environment import take_process
from surrofe2.base.errors import InputError, SimulationError

log = logging.getLogger(__name__)

# Least seconds of work of a piece that is sent to a worker.
PIECE = 1.0
# Pieces that wait for workers at once.
MANY = 128
# Seconds until a scheduler must answer and have a worker: a job may have started both just now.
PATIENCE = 60.0
# A piece is sent so often before its processes count as lost for a reason of its own.
ATTEMPTS = 4
# Exit code of a worker that, as it starts, would start workers itself.
_NO_GUARD = 79
_GUARD = 'below `if __name__ == "__main__":`'  # words for where a script starts workers

# A function that computes the items `first` to `first + count`. It and its result can be sent to a
# process.
Work = Callable[[int, int], Any]


class Processes(ThreadPoolExecutor):
    """An executor of `workers` processes of this machine that replaces those it loses.

    Each process serves one thread of this one over a pipe of their own, so that a process that dies
    while it writes a result ends the pipe, and keeps no other one waiting. Its kernels take an
    equal share of this process's threads.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise InputError(f"workers: {workers}; it must be at least 1")
        if getattr(current_process(), "_inheriting", False):
            # A worker imports the script that started it, which has come here once more. The
            # parent reports it; an error here would be printed by every worker.
            os._exit(_NO_GUARD)
        super().__init__(workers)
        self.workers = workers
        self._is_closed = False
        self._of_thread = local()
        self._all = list[Any]()

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:  # type: ignore[override]
        """Have `work(*arguments)` done by one of the processes."""
        return super().submit(self._send, work, arguments)

    def _send(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return the result of work by the process of this thread; if lost, it is sent again.

        Raises:
            SimulationError: the executor is closed, or the work lost its process `ATTEMPTS` times.
        """
        for _ in range(ATTEMPTS):
            try:
                pipe = self._pipe()
                pipe.send((work, arguments))
                has_result, result = pipe.recv()
            except (EOFError, OSError):
                del self._of_thread.pipe
                if self._is_closed:
                    raise SimulationError("the executor is closed") from None
                log.warning("a worker was lost; what it had is done again")
                continue
            if has_result:
                return result
            raise result
        raise SimulationError(
            f"a piece of work lost its worker {ATTEMPTS} times; is there enough memory for each of "
            f"the {self.workers} workers?"
        )

    def _pipe(self) -> Connection:
        """Return the pipe to the process of this thread, which is started if there is none."""
        if not hasattr(self._of_thread, "pipe"):
            self._of_thread.pipe, far_end = get_context("spawn").Pipe()
            threads = max(1, numba.get_num_threads() // self.workers)
            process = get_context("spawn").Process(
                target=_serve, args=(far_end, threads), daemon=True
            )
            process.start()
            far_end.close()
            self._all.append(process)
            if self._is_closed:  # it was closed since this process was started
                process.kill()
            self._wait_for_start(process)
        return self._of_thread.pipe

    def _wait_for_start(self, process: BaseProcess) -> None:
        """Wait until the process of this thread says that it serves.

        Raises:
            InputError: it has imported a script that starts processes without a main guard.
            SimulationError: an error ended it.
            EOFError: it was lost.
        """
        with suppress(EOFError, OSError):
            self._of_thread.pipe.recv()
            return
        process.join()
        code = process.exitcode or 0
        if code <= 0:  # by a signal
            raise EOFError
        script = getattr(sys.modules["__main__"], "__file__", None) or "the script"
        if code == _NO_GUARD:
            raise InputError(
                f"{script}: each worker imports it, and it starts workers as it is imported; write "
                f"what it does {_GUARD}"
            )
        raise SimulationError(
            f"a worker ended with exit code {code} as it started, see its error above; each worker "
            f"imports {script} except for what stands {_GUARD}"
        )

    def close(self) -> None:
        """End all processes at once, whatever they do."""
        self._is_closed = True
        for process in self._all:
            process.kill()
        self.shutdown(cancel_futures=True)


def _serve(pipe: Connection, threads: int) -> None:
    """Do the work that comes through a pipe, in a process of its own, until the pipe ends.

    Interrupts are for its parent, with which it ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    take_process()
    Thread(target=_end_with_parent, daemon=True).start()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    with suppress(EOFError):
        pipe.send("started")
        while True:
            work, arguments = pipe.recv()
            try:
                result = (True, work(*arguments))
            except Exception as error:
                error.add_note(traceback.format_exc())
                result = (False, error)
            pipe.send(result)


def _end_with_parent() -> None:
    """End this process as soon as its parent has ended."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def executor_of(workers: int = 0, scheduler: str | None = None) -> Iterator[Any]:
    """Make the executor that a command asks for, and close it after the block.

    Args:
        workers: number of processes; 0: none.
        scheduler: address tcp://… of a cluster of Dask; None: none.

    Yields:
        The executor; None where neither is asked for.

    Raises:
        InputError: both are given, dask.distributed is not installed, or no scheduler answers.
    """
    if workers and scheduler:
        raise InputError(f"--workers: {workers}; with --scheduler the cluster has the workers")
    if workers:
        processes = Processes(workers)
        try:
            yield processes
        finally:
            processes.close()
    elif scheduler:
        with _cluster(scheduler) as executor:
            yield executor
    else:
        yield None


@contextmanager
def _cluster(address: str) -> Iterator[Any]:
    """Yield an executor of a Dask cluster.

    Raises:
        InputError: dask.distributed is not installed, or there is no scheduler with workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler: dask.distributed is not installed; pip install 'surrofe2[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--scheduler: {address}; no scheduler answers there: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise InputError(
                f"--scheduler: {address}; the scheduler has no workers after {PATIENCE:g} s"
            ) from None
        with client.get_executor() as executor:
            yield executor


def in_pieces(work: Work, items: range, unit: int, executor: Any = None) -> Iterator[Any]:
    """Do work on items piece by piece, and yield the results in their order.

    Pieces are of whole `unit`s except the last. Without an executor each is a unit and is done
    here. With one, the first two units are done here as well: they load the kernels and measure how
    many units take a second.

    Raises:
        InputError: the executor's processes cannot run kernels.
        SimulationError: they were lost.
    """
    prepare(executor)
    next_item = items.start
    seconds = 0.0
    while next_item < items.stop and (executor is None or next_item < items.start + 2 * unit):
        count = min(unit, items.stop - next_item)
        begin = time.perf_counter()
        result = work(next_item, count)
        seconds = time.perf_counter() - begin
        yield result
        next_item += count
    # 1e-6: a clock may show no time at all
    size = unit * max(1, round(PIECE / max(seconds, 1e-6)))
    sent = deque[Future[Any]]()
    for first in range(next_item, items.stop, size):
        sent.append(executor.submit(work, first, min(size, items.stop - first)))
        if len(sent) == MANY:
            yield result_of(sent.popleft())
    while sent:
        yield result_of(sent.popleft())


def prepare(executor: Any) -> None:
    """Make sure that the processes of an executor of forks can run kernels.

    GNU OpenMP ends a process that was forked from one in which its threads have run. Processes
    that are forked before that run kernels as any other.

    Raises:
        InputError: this process has run kernels, and would fork only now.
    """
    if not isinstance(executor, ProcessPoolExecutor):
        return
    # Python has no public way to learn how a pool starts its processes. Where this one is gone, a
    # pool that cannot run kernels ends as `result_of` says.
    context: Any = getattr(executor, "_mp_context", None)
    if context is None or context.get_start_method() != "fork":
        return
    if getattr(executor, "_processes", None):
        return
    if _has_threads():
        raise InputError(
            "executor: a ProcessPoolExecutor that forks, of a process that has run kernels; give "
            'it mp_context=multiprocessing.get_context("spawn")'
        )
    executor.submit(os.getpid).result()  # forks all its processes


def _has_threads() -> bool:
    """Return whether kernels have run here on threads of OpenMP."""
    try:
        return numba.threading_layer() == "omp"
    except ValueError:  # none have run
        return False


def result_of(future: Future[Any]) -> Any:
    """Return the result of work by an executor, or raise its error.

    Raises:
        SimulationError: the executor has lost its processes.
    """
    try:
        return future.result()
    except BrokenExecutor as error:
        raise SimulationError(
            f"the executor lost its processes ({error}); they need memory for each, a script that "
            f'starts them {_GUARD}, and mp_context=multiprocessing.get_context("spawn")'
        ) from error
