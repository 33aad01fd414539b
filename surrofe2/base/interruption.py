"""SIGINT (Ctrl-C), SIGTERM and SIGHUP end a command soon, once, and wherever it is.

While a command starts, there is nothing to keep, and it ends at once. Later a signal becomes a
KeyboardInterrupt, so that work stores what it has. Where a library swallows that, it is raised
again, unless it is being handled. It is put off

- where machine code has called Python for a class that it needs, and would take it for an error;
- where the compiler fetches the kept machine code of a kernel, which else would be at address 0;
- while ranks exchange messages.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_AGAIN = 0.25
"""s until an interruption that was swallowed or put off is raised again."""
NOT_CUT = ("_numba_unpickle", "_raw_object_cache_getbuffer", "_raw_object_cache_notify")
"""Functions in Python that numba's machine code and llvmlite's compiler call."""


@dataclass(slots=True)
class _State:
    is_working: bool = False
    number: int = 0
    held: int = 0


_state = _State()


def watch() -> None:
    """Take these signals from now on; the command starts. An ignored SIGHUP (nohup) stays so."""
    for number in SIGNALS:
        if (number, signal.getsignal(number)) != (signal.SIGHUP, signal.SIG_IGN):
            signal.signal(number, _take)


def begin_work() -> None:
    """From now on there may be work to keep."""
    _state.is_working = True


def end_work() -> None:
    """The command is over, and nothing can interrupt it any more."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in SIGNALS:
        if signal.getsignal(number) is _take:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def held() -> Iterator[None]:
    """An interruption waits until the block is over, and a moment longer."""
    _state.held += 1
    try:
        yield
    finally:
        _state.held -= 1


@contextmanager
def interruptible() -> Iterator[None]:
    """An error that ends the block after a signal counts as the interruption, for machine code
    that has called Python, numpy's too, may turn that into a TypeError or a SystemError."""
    try:
        yield
    except Exception as error:
        if not _state.number:
            raise
        raise KeyboardInterrupt from error


def exit_code() -> int:
    """128 and the number of the signal, as shells have it."""
    return 128 + (_state.number or signal.SIGINT)


def _take(number: int, frame: FrameType | None) -> None:
    if not _state.is_working:
        os.write(2, b"interrupted: nothing was changed\n")
        os._exit(128 + number)
    if not _state.number:
        _state.number = number
        sys.unraisablehook = _report_others
        signal.signal(signal.SIGALRM, _raise_again)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
        _raise_again(number, frame)


def _raise_again(number: int, frame: FrameType | None) -> None:
    if _state.held:
        return
    while frame is not None:
        if frame.f_code.co_name in NOT_CUT:
            return
        frame = frame.f_back
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _report_others(unraisable: Any) -> None:
    """Report what a library could not pass on, but for the interruption."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
