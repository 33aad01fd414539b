"""Where an interruption would be taken for another error, it comes a moment later."""

from __future__ import annotations

import subprocess
import sys

WORK = """
import os, signal, sys, time
from surrofe2 import interruption

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


def test_other_work_is_cut_at_once():
    assert said("work", "SIGINT") == (["cut", "ended"], 130)
