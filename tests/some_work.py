"""Work for processes: it has to be in a module that they can import."""

import os
import select
import signal
import time
from collections.abc import Callable
from functools import partialmethod
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from surrofe2 import CellParameters, RveLaw


def squares(first: int, count: int) -> list[int]:
    return [k * k for k in range(first, first + count)]


def stresses(first: int, count: int) -> float:
    """The sum of stresses that kernels on several threads compute."""
    law = RveLaw(CellParameters.preset("printed"), initialisation="cauchy-born")
    stretch = 1.0 + 0.001 * np.arange(first, first + count)
    F = stretch[:, None, None] * np.eye(2)
    return float(law.respond(F, 0.0 * F).stress.sum())


def squares_or_death(folder: str, deaths: int, first: int, count: int) -> list[int]:
    """Squares; the process that is given 20 among them dies, `deaths` times."""
    if first <= 20 < first + count:
        died = len(list(Path(folder).iterdir()))
        if died < deaths:
            (Path(folder) / str(died)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return squares(first, count)


def killed_once(folder: str, pattern: str, work: Callable[..., Any], *arguments: Any) -> Any:
    """What work gives; the first process that does some dies once files of a pattern are there."""
    dead = Path(folder) / "dead"
    if not dead.exists():
        dead.touch()
        Thread(target=_die, args=(Path(folder), pattern), daemon=True).start()
    return work(*arguments)


def _die(folder: Path, pattern: str) -> None:
    while not any(folder.glob(pattern)):
        time.sleep(0.005)
    os.kill(os.getpid(), signal.SIGKILL)


def squares_cut_off(folder: str, first: int, count: int) -> tuple[list[int], bytes]:
    """Squares and many bytes; one process dies within a write to a pipe that is not atomic."""
    if first <= 20 < first + count:
        Connection._send = partialmethod(_half, Path(folder), Connection._send)
    return squares(first, count), bytes(1_000_000)


def _half(pipe: Connection, folder: Path, send: Callable[..., None], data: bytes) -> None:
    if len(data) > select.PIPE_BUF and not any(folder.iterdir()):
        (folder / "died").touch()
        send(pipe, data[: len(data) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    send(pipe, data)
