"""Where an interruption would be taken for another error, it comes a moment later."""

import os
import signal

import pytest

from tests.processes import python

WORK = """
import os, signal, sys, time
from surrofe2.base import interruption

def {name}():
    try:
        os.kill(os.getpid(), signal.{signal})
        time.sleep(0.05)
        return "whole"
    except KeyboardInterrupt:
        print("cut", end=" ")
        raise

interruption.watch()
interruption.begin_work()
try:
    print({name}(), end=" ")
    time.sleep(20.0)
except KeyboardInterrupt:
    print("ended")
sys.exit(interruption.exit_code())
"""


@pytest.mark.parametrize(
    ("name", "signal", "code", "told"),
    [
        ("_numba_unpickle", "SIGINT", 130, "whole ended"),
        ("_numba_unpickle", "SIGTERM", 143, "whole ended"),
        ("work", "SIGINT", 130, "cut ended"),
    ],
)
def test_python_that_machine_code_has_called_is_not_cut_and_other_work_at_once(
    name, signal, code, told
):
    work = WORK.format(name=name, signal=signal)
    assert python("-c", work, code=code, timeout=10).stdout.split() == told.split()


IMPORT = """
import sys
from surrofe2.base import interruption

interruption.watch()
interruption.begin_work()
try:
    import signalled
    for k in range(100):
        signalled.time.sleep(0.1)
except KeyboardInterrupt:
    print("ended")
sys.exit(interruption.exit_code())
"""


def test_an_import_is_not_cut(tmp_path):
    """Libraries in C++ abort the process at an exception there; torch does."""
    (tmp_path / "signalled.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(0.5)\n"
        "print('whole')\n",
        encoding="utf-8",
    )
    done = python("-c", IMPORT, code=130, timeout=30, cwd=tmp_path)
    assert done.stdout.split() == ["whole", "ended"]


READING = """
import os, signal, sys, time
from numba.core.codegen import JITCodeLibrary

read = JITCodeLibrary._object_getbuffer_hook.__func__

def interrupted(cls, module):
    kept = read(cls, module)
    if kept is not None:
        os.kill(os.getpid(), signal.SIGINT)
    return kept

JITCodeLibrary._object_getbuffer_hook = classmethod(interrupted)
from surrofe2.base import interruption
from surrofe2.base.compilation import kernel

@kernel
def twice(x):
    return 2.0 * x

interruption.watch()
interruption.begin_work()
try:
    print(twice(1.5))
    for k in range(int(sys.argv[1])):
        time.sleep(1.0)
except KeyboardInterrupt:
    print("ended")
interruption.end_work()
"""


def test_a_kernel_that_is_being_read_is_read_whole(tmp_path):
    """An interruption there would be lost in the compiler, and the kernel be at address 0."""
    (tmp_path / "reading.py").write_text(READING, encoding="utf-8")
    for seconds, wanted in ((0, ["3.0"]), (20, ["3.0", "ended"])):
        env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        assert python("reading.py", seconds, cwd=tmp_path, env=env).stdout.split() == wanted


SIGNALLED = """
import os, signal, sys, threading, time
from surrofe2.base import interruption

for name in {ignored}:
    signal.signal(getattr(signal, name), signal.SIG_IGN)
interruption.watch()
interruption.begin_work()

def send():
    time.sleep(0.2)
    for number, pause in {signals}:
        os.kill(os.getpid(), number)
        time.sleep(pause)

threading.Thread(target=send, daemon=True).start()
try:
    with interruption.{how}():
        time.sleep({seconds})
    if interruption.received():
        time.sleep(5.0)  # what was put off comes soon
    print("whole")
except KeyboardInterrupt:
    print(interruption.cause())
    sys.exit(interruption.exit_code())
"""


def signalled(signals, code, ignored=(), how="interruptible", seconds=20.0):
    """(standard output, standard error) of a process that sends itself (signal, pause) in turn."""
    sent = f"[{', '.join(f'(signal.{name}, {pause})' for name, pause in signals)}]"
    work = SIGNALLED.format(ignored=ignored, signals=sent, how=how, seconds=seconds)
    done = python("-c", work, code=code, timeout=30)
    return done.stdout.strip(), done.stderr.strip()


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("SIGINT", "interrupted"),
        ("SIGTERM", "interrupted by SIGTERM"),
        ("SIGHUP", "interrupted by SIGHUP"),
        ("SIGUSR1", "interrupted by SIGUSR1"),
        ("SIGUSR2", "interrupted by SIGUSR2"),
        ("SIGXCPU", "interrupted by SIGXCPU"),
    ],
)
def test_signals_of_people_and_of_batch_systems_interrupt_and_are_named(name, cause):
    number = getattr(signal, name)
    assert signalled([(name, 0.0)], 128 + number) == (cause, "")


@pytest.mark.parametrize("name", ["SIGHUP", "SIGINT", "SIGUSR1"])
def test_an_ignored_signal_stays_ignored(name):
    """As by nohup, and SIGINT in the background of a shell."""
    assert signalled([(name, 0.0)], 0, ignored=(name,), seconds=0.3) == ("whole", "")


AT_ONCE = "ended at once; files are whole, and what was kept last stays"


def test_a_second_signal_ends_the_process_at_once_wherever_it_is():
    for signals in ([("SIGTERM", 1.2), ("SIGTERM", 1)], [("SIGINT", 1.2), ("SIGTERM", 1)]):
        assert signalled(signals, 143, how="held") == ("", AT_ONCE)


def test_warnings_and_repeated_signals_do_not_end_it_at_once():
    signals = [("SIGUSR1", 1.1), ("SIGTERM", 0.1), ("SIGTERM", 0.1), ("SIGUSR1", 1.1)]
    signals += [("SIGXCPU", 0.1)]
    out, error = signalled(signals, 128 + signal.SIGUSR1, how="held", seconds=3.0)
    assert (out, error) == ("interrupted by SIGUSR1", "")


STARTING = """
import os, signal, time
from surrofe2.base import interruption

interruption.watch()
os.kill(os.getpid(), signal.{name})
time.sleep(5.0)
"""


@pytest.mark.parametrize(
    ("name", "cause"), [("SIGINT", "interrupted"), ("SIGTERM", "interrupted by SIGTERM")]
)
def test_a_signal_before_any_work_is_named_as_later_ones_are(name, cause):
    done = python("-c", STARTING.format(name=name), code=128 + getattr(signal, name))
    assert (done.stdout, done.stderr) == ("", f"{cause}: nothing was changed\n")


BUSY = """
import hashlib, os, signal, threading
from surrofe2.base import interruption

interruption._PATIENCE = 0.1
interruption.watch()
interruption.begin_work()
threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
try:
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2_000_000)
except KeyboardInterrupt:
    print(interruption.cause())
"""


def test_a_signal_that_a_library_holds_up_is_named_while_it_waits():
    done = python("-c", BUSY)
    line = "interrupted by SIGTERM: waiting for work; another signal ends it at once\n"
    assert (done.stdout, done.stderr) == ("interrupted by SIGTERM\n", line)
