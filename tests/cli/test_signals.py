"""SIGINT and SIGTERM at any instant end a command soon, with a sentence that says how to go on."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from surrofe2.io.run_folder import read_record

COMMANDS = {
    "generate": "generate {recipe} --fresh",
    "train": "train {recipe} --fresh",
    "run": "run {recipe} --law rve --out {out} --fresh",
    "table": "run {recipe} --law table --out {out} --fresh",
    "implicit": "run {recipe} --law rve --integrator implicit --out {out} --fresh",
    "tissue": "tissue {recipe} --out {out} --fresh",
    "rest": "rest {recipe} --out {out} --load-steps 100000 --fresh",
}
SOON = 2.0


@pytest.fixture
def long_recipe(changed_recipe, invoke):
    """A recipe whose data set is there, and whose commands all take longer than the test."""
    path = changed_recipe("iterations = 40", "iterations = 1000000")
    assert invoke("generate", path).exit_code == 0
    text = path.read_text().replace("duration = 4.0", "duration = 100000.0")
    path.write_text(text + "frames = 2\n")
    return path


def start(arguments, folder):
    """A command that has taken the signals."""
    command = [sys.executable, "-m", "surrofe2", *arguments]
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        caught = next(line for line in status.read_text().splitlines() if "SigCgt" in line)
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return process
        time.sleep(0.002)
    pytest.fail(process.communicate()[1])


def end(process, number, instant):
    """(exit code, what it said last, how long it took) after a signal at an instant."""
    time.sleep(instant)
    process.send_signal(number)
    begin = time.perf_counter()
    _, said = process.communicate(timeout=30)
    return process.returncode, said, time.perf_counter() - begin


def check(command, recipe, folder, number, instant):
    out = folder / "out"
    arguments = shlex.split(COMMANDS[command].format(recipe=recipe, out=out))
    if command == "generate":
        recipe.write_text(recipe.read_text().replace("count = 40", "count = 10000000"))
    code, said, took = end(start(arguments, folder), number, instant)
    assert code == 128 + number, (command, instant, said)
    assert "Traceback" not in said, said
    told = said.strip().splitlines()[-1]
    assert told.startswith("interrupted: "), said
    assert took < SOON * (1 + os.getloadavg()[0] / 2), (command, instant, took)
    record = out / "run.json"
    if "go on with: " not in told:
        assert told == "interrupted: nothing was changed"
        return
    if record.exists():
        assert read_record(out).status == "interrupted"
    again = shlex.split(told.split("go on with: ")[1])
    assert again[0] == "surrofe2"
    code, said, _ = end(start(again[1:], folder), number, 2.5)
    assert code == 128 + number, said
    assert "error" not in said


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize("command", ["generate", "run"])
def test_a_signal_ends_a_command(long_recipe, tmp_path, command):
    number = signal.SIGINT if command == "run" else signal.SIGTERM
    check(command, long_recipe, tmp_path, number, 3.0)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("command", COMMANDS)
def test_signals_at_random_instants_end_every_command(long_recipe, tmp_path, command, number):
    instants = np.random.default_rng(number).uniform(0.0, 5.0, size=8)
    for k, instant in enumerate(instants):
        folder = tmp_path / str(k)
        folder.mkdir()
        check(command, long_recipe, folder, number, float(instant))
