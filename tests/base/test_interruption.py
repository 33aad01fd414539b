"""Where an interruption would be taken for another error, it comes a moment later."""

from __future__ import annotations

import os
import subprocess
import sys

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


def said(name, signal):
    code = WORK.format(name=name, signal=signal)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=10)
    return done.stdout.split(), done.returncode


def test_python_that_machine_code_has_called_is_not_cut():
    assert said("_numba_unpickle", "SIGINT") == (["whole", "ended"], 130)
    assert said("_numba_unpickle", "SIGTERM") == (["whole", "ended"], 143)


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
        done = subprocess.run(
            [sys.executable, "reading.py", str(seconds)],
            cwd=tmp_path,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.stdout.split(), done.returncode) == (wanted, 0), done.stderr


def test_other_work_is_cut_at_once():
    assert said("work", "SIGINT") == (["cut", "ended"], 130)
