"""Where an interruption would be taken for another error, it comes a moment later."""

import os

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
