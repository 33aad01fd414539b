"""Commands in processes that need not import anything: `python -m tests.cli.forks`.

Of each line, JSON of [arguments, file], it makes a process that runs the command and says what it
says into the file; it tells first the number of the process and then its exit code.
"""

from __future__ import annotations

import faulthandler
import json
import os
import select
import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from surrofe2 import __main__, cli

ROOT = Path(__file__).parents[2]


class Forked:
    """A command in a process of the server, with what `subprocess.Popen` has of it."""

    def __init__(self, server, arguments, folder):
        self._server, self._said = server, folder / "said.txt"
        server.stdin.write(json.dumps([[str(each) for each in arguments], str(self._said)]) + "\n")
        server.stdin.flush()
        self.pid, self.returncode = int(server.stdout.readline()), None

    def poll(self):
        """The exit code of a process that has ended."""
        if self.returncode is None and select.select([self._server.stdout], [], [], 0.0)[0]:
            self.returncode = int(self._server.stdout.readline())
        return self.returncode

    def send_signal(self, number):
        os.kill(self.pid, number)  # nobody else has it before the server hears of the next command

    def communicate(self, timeout=None):
        """What it said, when it has ended."""
        if self.returncode is None and not select.select([self._server.stdout], [], [], timeout)[0]:
            self.send_signal(9)
        while self.poll() is None:
            pass
        return "", self._said.read_text(encoding="utf-8")


@contextmanager
def server():
    """start(arguments, folder) → `Forked`."""
    words = [sys.executable, "-m", "tests.cli.forks"]
    process = subprocess.Popen(
        words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert process.stdout.readline() == "ready\n"
    try:
        yield lambda arguments, folder: Forked(process, arguments, folder)
    finally:
        process.stdin.close()
        process.wait()
        process.stdout.close()


def serve():
    for module, _ in cli.COMMANDS.values():
        import_module(f"surrofe2.cli.{module}")
    import_module("surrofe2.surrogate.training")  # torch
    faulthandler.enable()
    tell("ready")
    process = 0
    for line in sys.stdin:
        if process:
            os.waitpid(process, 0)
        arguments, file = json.loads(line)
        process = os.fork()
        if process == 0:
            said = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for stream in (1, 2):
                os.dup2(said, stream)
            sys.argv = ["surrofe2", *arguments]
            __main__.main()
            sys.exit()
        tell(process)
        ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
        code = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
        tell(code)


def tell(value):
    sys.stdout.write(f"{value}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    serve()
