"""Processes of Python: one by one, and many of a server that need not import anything.

`python -m tests.processes` is the server. Of each line, JSON of [module, arguments, file], it makes
a process that runs `main` of the module with these arguments and says what it says into the file.
It tells first the number of the process and then its exit code.
"""

import faulthandler
import json
import os
import select
import signal
import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module

from surrofe2 import cli
from tests.conftest import ROOT


def python(*words, code=0, **settings):
    """What a process of Python says, which ends with this exit code."""
    words = [sys.executable, *map(str, words)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, **settings)
    assert done.returncode == code, done.stdout + done.stderr
    return done


class Forked:
    """A process of the server, with what `subprocess.Popen` has of it."""

    def __init__(self, server, module, arguments, said):
        self._server, self._said = server, said
        line = json.dumps([module, [str(each) for each in arguments], str(said)])
        server.stdin.write(f"{line}\n".encode())
        self.pid, self.returncode = int(server.stdout.readline()), None

    def wait(self, timeout=None):
        """Its exit code, or None where it has not ended after so many seconds."""
        if self.returncode is None and select.select([self._server.stdout], [], [], timeout)[0]:
            self.returncode = int(self._server.stdout.readline())
        return self.returncode

    def poll(self):
        return self.wait(0.0)

    def send_signal(self, number):
        os.kill(self.pid, number)  # nobody else has it before the server hears of the next command

    def communicate(self, timeout=None):
        """What it said, when it has ended."""
        if self.wait(timeout) is None:
            self.send_signal(signal.SIGKILL)
            self.wait()
        return "", self._said.read_text(encoding="utf-8")


@contextmanager
def server():
    """start(module, arguments, said) → `Forked`."""
    words = [sys.executable, "-m", "tests.processes"]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, cwd=ROOT, stdin=pipe, stdout=pipe, bufsize=0) as process:
        assert process.stdout.readline() == b"ready\n"
        yield lambda *command: Forked(process, *command)


def serve():
    for module, _ in cli.COMMANDS.values():
        import_module(f"surrofe2.cli.{module}")
    import_module("surrofe2.workflow.refine")  # torch too
    import_module("tests.commands")
    faulthandler.enable()
    tell("ready")
    process = 0
    for line in sys.stdin:
        if process:
            os.waitpid(process, 0)
        module, arguments, file = json.loads(line)
        process = os.fork()
        if process == 0:
            said = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for stream in (1, 2):
                os.dup2(said, stream)
            sys.argv = ["surrofe2", *arguments]
            import_module(module).main()
            sys.exit()
        tell(process)
        ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
        tell(ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status)


def tell(value):
    sys.stdout.write(f"{value}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    serve()
