"""Pieces of work by this process, by several, or by whatever executor a user brings.

A piece is a pure function of where it begins and how much it takes, so a piece whose worker is
lost is done again, and results do not depend on who did what. Executors are those of
`concurrent.futures`, as also mpi4py.futures, executorlib, Parsl and dask.distributed offer them.
"""

from __future__ import annotations

import logging
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory, mkstemp
from threading import Thread
from typing import Any

import numba

from surrofe2.base.errors import InputError, SimulationError

log = logging.getLogger(__name__)

PIECE = 1.0
"""Least seconds of work of a piece that is sent to a worker."""
AHEAD = 2
"""Pieces for each worker that are sent before the first of them is back."""
MANY = 128
"""Pieces on their way to an executor that does not say how many workers it has."""
PATIENCE = 60.0
"""s until a scheduler must answer and have a worker: a job may have started both just now."""
ATTEMPTS = 4
"""How often a piece is sent before its workers are taken to be lost for a reason of its own."""

Work = Callable[[int, int], Any]
"""Result of the items `first` to `first + count`; it and its result can be sent to a process."""
Call = tuple[str, Callable[..., Any], tuple[Any, ...]]
"""What is called, for a sentence; the function, and its arguments."""


@dataclass(slots=True)
class Processes:
    """An executor of `workers` processes of this machine that replaces those it loses.

    It is a `concurrent.futures.Executor` but for the class, since its pool may change. Kernels of
    a worker take an equal share of this process's threads. Results come back by files: a process
    that died while it wrote one into the pool's pipe would leave the reader waiting for ever.
    """

    workers: int
    _pool: ProcessPoolExecutor | None = field(default=None, init=False)
    _folder: TemporaryDirectory[str] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError(f"workers: {self.workers}; it must be at least 1")

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have `work(*arguments)` done by one of the processes."""
        try:
            return self._submit(work, arguments)
        except BrokenExecutor:  # a process was lost, and what the others had is lost with it
            self._end()
            return self._submit(work, arguments)

    def _submit(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        if self._folder is None:
            self._folder = TemporaryDirectory(prefix="surrofe2-")
        result: Future[Any] = Future()
        written = self._open().submit(_write_result, self._folder.name, work, arguments)
        result.set_running_or_notify_cancel()
        written.add_done_callback(partial(_pass_on, result))
        return result

    def close(self) -> None:
        """End all processes at once, whatever they do."""
        self._end()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _end(self) -> None:
        if self._pool is None:
            return
        processes = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        for process in processes:
            process.join()
        self._pool = None

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            threads = max(1, numba.get_num_threads() // self.workers)
            self._pool = ProcessPoolExecutor(
                self.workers,
                mp_context=get_context("spawn"),  # a forked process has none of the threads
                initializer=_begin,
                initargs=(threads,),
            )
        return self._pool


def _write_result(folder: str, work: Callable[..., Any], arguments: tuple[Any, ...]) -> str:
    """The file that has what the work gives; its name takes one write to a pipe, whole or none."""
    result = work(*arguments)
    handle, name = mkstemp(dir=folder)
    with open(handle, "wb") as file:
        pickle.dump(result, file, pickle.HIGHEST_PROTOCOL)
    return name


def _pass_on(result: Future[Any], written: Future[str]) -> None:
    """Give a future what is in the file of another, or its error."""
    try:
        path = Path(written.result())
        value = pickle.loads(path.read_bytes())
        path.unlink()
    except CancelledError:  # with the pool
        result.set_exception(BrokenExecutor("its process was ended"))
    except Exception as error:
        result.set_exception(error)
    else:
        result.set_result(value)


def _begin(threads: int) -> None:
    """The first that a process does: interrupts are for its parent, with which it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def executor_of(workers: int = 0, scheduler: str | None = None) -> Iterator[Any]:
    """The executor that a command asks for: processes, a Dask cluster, or None.

    Args:
        workers: number of processes; 0: none.
        scheduler: address of a scheduler of dask.distributed, such as tcp://host:8786.

    Raises:
        InputError: both are given, dask.distributed is not installed, or no one answers.
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


def in_pieces(
    work: Work, items: range, unit: int, executor: Any = None
) -> Iterator[tuple[int, int, Any]]:
    """(first, count, result) of pieces of `items`, in their order.

    Pieces are of whole `unit`s but the last. Without an executor each is a unit and is done here.
    With one, the first two units are done here as well: they load the kernels and say how many
    units take a second.

    Args:
        executor: has `submit(work, *arguments)` that gives a future.

    Raises:
        SimulationError: a piece lost its worker several times.
    """
    at, seconds = items.start, 0.0
    while at < items.stop and (executor is None or at < items.start + 2 * unit):
        count, begin = min(unit, items.stop - at), time.perf_counter()
        result = work(at, count)
        seconds = time.perf_counter() - begin
        yield at, count, result
        at += count
    size = unit * max(1, round(PIECE / max(seconds, 1e-6)))
    pieces = [(first, min(size, items.stop - first)) for first in range(at, items.stop, size)]
    calls = ((f"items {k} to {k + count}", work, (k, count)) for k, count in pieces)
    most = AHEAD * executor.workers if isinstance(executor, Processes) else MANY
    for (first, count), done in zip(pieces, results_of(calls, executor, most), strict=True):
        yield first, count, done


def results_of(calls: Iterable[Call], executor: Any, most: int = MANY) -> Iterator[Any]:
    """What each of the calls gives by the workers of an executor, in their order.

    Args:
        most: how many calls are on their way at once.

    Raises:
        SimulationError: a call lost its worker several times.
    """
    waiting, sent, attempt = iter(calls), deque[tuple[Call, Future[Any]]](), 1

    def submitted(call: Call) -> tuple[Call, Future[Any]]:
        return call, executor.submit(call[1], *call[2])

    while True:
        while len(sent) < most and (call := next(waiting, None)) is not None:
            sent.append(submitted(call))
        if not sent:
            return
        call, first = sent[0]
        try:
            result = first.result()
        except BrokenExecutor as error:
            log.warning("a worker was lost; what it had is done again")
            if attempt == ATTEMPTS:
                raise SimulationError(
                    f"{call[0]}: their worker was lost {ATTEMPTS} times ({error}); is there enough "
                    "memory for each of the workers?"
                ) from None
            attempt += 1
            sent = deque(submitted(call) if _is_lost(at) else (call, at) for call, at in sent)
            continue
        attempt = 1
        sent.popleft()
        yield result


def _is_lost(call: Future[Any]) -> bool:
    """Whether a call went with its worker."""
    return call.cancelled() or (call.done() and isinstance(call.exception(), BrokenExecutor))
