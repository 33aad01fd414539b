"""SIGINT (Ctrl-C), SIGTERM and SIGHUP end a command soon, once, and wherever it is.

So do SIGUSR1, SIGUSR2 and SIGXCPU, by which batch systems warn before the time of a job is over. A
second SIGINT, SIGTERM or SIGHUP ends it at once. Signals that are ignored when the command starts,
as by nohup and in the background of a shell, stay ignored.

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from select import select
from threading import Thread
from time import monotonic, sleep
from types import FrameType
from typing import Any

from surrofe2.base.launcher import HEARD

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNALS = (*ENDING, signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU)
# Seconds between a signal and the next one that counts as another: launchers of MPI pass on what
# ranks have got.
_APART = 1.0
# Seconds after which a signal that could not be taken yet is answered by a line.
_PATIENCE = 5.0
# Seconds until an interruption that was swallowed or put off is raised again.
_AGAIN = 0.25
# Functions in Python that numba's machine code and llvmlite's compiler call; and every import,
# since torch's C++ aborts the process at an exception in the Python that it calls meanwhile.
NOT_CUT = (
    "_numba_unpickle",
    "_raw_object_cache_getbuffer",
    "_raw_object_cache_notify",
    "_find_and_load",
)


@dataclass(slots=True)
class _State:
    """The state of the process with respect to signals.

    Attributes:
        is_working: whether there may be work to keep.
        number: the signal that interrupts it, or 0.
        source: words for another process that got the signal, empty for this one.
        held: number of blocks in which an interruption waits.
        end: ends the process with an exit code at a second signal.
    """

    is_working: bool = False
    number: int = 0
    source: str = ""
    held: int = 0
    end: Callable[[int], Any] = os._exit


_state = _State()


def watch() -> None:
    """Take these signals from now on; the command starts."""
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _take)
    fill_standard_streams()
    # Python takes signals between its own instructions alone. A thread learns of them at once, also
    # where the main thread waits in a library, as for a rank that does not answer.
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)
    signal.set_wakeup_fd(sender, warn_on_full_buffer=False)
    Thread(target=_end_at_the_second, args=(receiver,), daemon=True).start()


def begin_work() -> None:
    """Note that from now on there may be work to keep."""
    _state.is_working = True


def end_work() -> None:
    """Ignore these signals from now on; the command is over."""
    _state.is_working = False
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in SIGNALS:
        if signal.getsignal(number) is _take:
            signal.signal(number, signal.SIG_IGN)


def fill_standard_streams() -> None:
    """Let no file get the number of a standard stream that was closed before the process began."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)  # the first of them is the lowest free


def end_by(end: Callable[[int], Any]) -> None:
    """Let a second signal end the process by this call with its exit code, from now on."""
    _state.end = end


@contextmanager
def uncaught() -> Iterator[None]:
    """Let a signal end the process at once, also within a library that does not come back."""
    taken = [number for number in SIGNALS if signal.getsignal(number) is _take]
    for number in taken:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, _take)


def received() -> int:
    """Return the signal that interrupts this process, or 0."""
    return _state.number


def pass_on(number: int, source: str) -> None:
    """Interrupt this process by a signal that another one has got, which the message names."""
    if not _state.number:
        _state.source = f" to {source}"
        os.kill(os.getpid(), number)


def cause() -> str:
    """Say for a message that the command was interrupted, and by what if not by Ctrl-C."""
    return _interrupted_by(_state.number or signal.SIGINT, _state.source)


def _interrupted_by(number: int, source: str = "") -> str:
    """Write by which signal the command was interrupted, if not by Ctrl-C."""
    if number == signal.SIGINT and not source:
        return "interrupted"
    return f"interrupted by {signal.Signals(number).name}{source}"


@contextmanager
def held() -> Iterator[None]:
    """Let an interruption wait until the block is over, and a moment longer."""
    _state.held += 1
    try:
        yield
    finally:
        _state.held -= 1


@contextmanager
def interruptible() -> Iterator[None]:
    """Take an error that ends the block after a signal for the interruption.

    Machine code that has called Python, numpy's too, may turn a KeyboardInterrupt into a TypeError
    or a SystemError.
    """
    try:
        yield
    except Exception as error:
        # After the work, as on a rank that rank 0 has ended, an error is itself.
        if not (_state.number and _state.is_working):
            raise
        raise KeyboardInterrupt from error


def exit_code() -> int:
    """Return 128 and the number of the signal, as shells have it."""
    return 128 + (_state.number or signal.SIGINT)


def _take(number: int, frame: FrameType | None) -> None:
    """Take a signal: end at once before work begins; else raise, and again until it is noticed."""
    if not _state.is_working:
        os.write(2, f"{_interrupted_by(number)}: nothing was changed\n".encode())
        os._exit(128 + number)
    if not _state.number:
        _state.number = number
        sys.unraisablehook = _report_others
        signal.signal(signal.SIGALRM, _raise_again)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
        _raise_again(number, frame)


def _raise_again(number: int, frame: FrameType | None) -> None:
    """Raise the interruption, unless it must wait or is already being handled.

    Machine code that has called Python, see `NOT_CUT`, would take it for an error, or abort.
    """
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


def _end_at_the_second(receiver: int) -> None:
    """End the process at the second signal that asks for it; a thread, which nothing holds up."""
    first = 0  # the first signal, and when it came
    begin = 0.0
    is_reported = False
    while True:
        is_waiting = first != 0 and not (_state.number or is_reported)
        if not select([receiver], [], [], _PATIENCE if is_waiting else None)[0]:
            is_reported = True
            if not _state.number:
                line = f"{_interrupted_by(first)}: waiting for work; another signal ends it at once"
                os.write(2, f"{line}\n".encode())
            continue
        for number in os.read(receiver, 64):
            if number not in ENDING:
                continue
            if not first:
                first = number
                begin = monotonic()
            elif monotonic() - begin >= _APART:
                os.write(2, b"ended at once; files are whole, and what was kept last stays\n")
                sleep(HEARD)
                _state.end(128 + number)
                os._exit(128 + number)


def _report_others(unraisable: Any) -> None:
    """Report what a library could not pass on, but for the interruption."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
