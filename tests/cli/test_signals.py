"""Signals of people and of batch systems end a command soon, which says how to resume it.

`SURROFE2_SIGNALS` is how many signals the long tests send to each command; default: 20.
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base import interruption
from surrofe2.store.run_folder import read_record

SIGNALS = int(os.environ.get("SURROFE2_SIGNALS", "20"))

COMMANDS = {
    "generate": "generate {recipe} --fresh",
    "train": "train {recipe} --fresh",
    "run": "run {recipe} --law rve --out {out} --fresh",
    "table": "run {recipe} --law table --out {out} --fresh",
    "implicit": "run {recipe} --law rve --integrator implicit --out {out} --fresh",
    "tissue": "tissue {recipe} --out {out} --fresh",
    "rest": "rest {recipe} --out {out} --load-steps 100000 --fresh",
    "refine": "refine {recipe} --out {out} --fresh",
    "grid": "grid {recipe} --set cache.tolerance=0.1 --out {out} --fresh",
}
SOON = 2.0


@pytest.fixture
def long_recipe(changed_recipe, invoke):
    """A recipe whose data set is there, and whose commands all take longer than the test."""
    path = changed_recipe("iterations = 40", "iterations = 1000000")
    invoke("generate", path)
    return changed_recipe("= 4.0", "= 100000.0", "[macro]", "[macro]\nframes = 2")


def of_its_own(arguments, folder):
    command = [sys.executable, "-m", "surrofe2", *arguments]
    return subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def start(arguments, folder, begin=of_its_own):
    """A command that has taken the signals."""
    process = begin(arguments, folder)
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        caught = next(line for line in status.read_text().splitlines() if "SigCgt" in line)
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return process
        time.sleep(0.002)
    pytest.fail(process.communicate()[1])


def struck(process, number, instant, folder):
    """(the arguments to go on with or None, how long it took) after a signal at an instant."""
    time.sleep(instant)
    process.send_signal(number)
    begin = time.perf_counter()
    _, said = process.communicate(timeout=60)
    took = time.perf_counter() - begin
    assert process.returncode == 128 + number, said
    assert "Traceback" not in said, said
    assert "error" not in said, said
    told = said.strip().splitlines()[-1]
    cause = "interrupted" if number == signal.SIGINT else f"interrupted by {number.name}"
    assert told.startswith(f"{cause}: "), said
    load = max(os.getloadavg()[0], 2.0)  # which lags behind: two workers of pytest at least
    assert took < SOON * (1 + load / 2)
    assert not [*folder.rglob("*.lock"), *folder.rglob("*.partial")]
    for path in folder.rglob("run.json"):
        assert read_record(path.parent).status in ("interrupted", "finished")
    if "resume with: " not in told:
        assert told == f"{cause}: nothing was changed"
        return None, took
    again = shlex.split(told.split("resume with: ")[1])
    assert again[0] == "surrofe2"
    return again[1:], took


def first_arguments(command, recipe, folder):
    """Of the command from its beginning; its output goes into the folder."""
    if command == "generate":
        recipe.write_text(recipe.read_text().replace("count = 40\n", "count = 10000000\n"))
    return shlex.split(COMMANDS[command].format(recipe=recipe, out=folder / "out"))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize("command", ["run", pytest.param("generate", marks=pytest.mark.slow)])
def test_a_signal_ends_a_command(long_recipe, tmp_path, command):
    first, second = (signal.SIGINT, signal.SIGHUP) if command == "run" else [signal.SIGTERM] * 2
    arguments = first_arguments(command, long_recipe, tmp_path)
    again, _ = struck(start(arguments, tmp_path), first, 2.0, tmp_path)
    struck(start(again or arguments, tmp_path), second, 1.5, tmp_path)


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize("command", COMMANDS)
def test_signals_at_random_instants_end_every_command(
    long_recipe, tmp_path, command, forks, record_property
):
    """Each is the command that the one before it named, but every tenth, which begins anew in a
    process of its own."""

    def forked(arguments, folder):
        return forks("surrofe2.__main__", arguments, folder / "said.txt")

    random, times, wrong, arguments = np.random.default_rng(SIGNALS), [], [], None
    for k, instant in enumerate(random.uniform(0.0, 5.0, size=SIGNALS)):
        number = interruption.SIGNALS[random.integers(len(interruption.SIGNALS))]
        begin = forked
        if arguments is None or k % 10 == 0:
            begin, folder = of_its_own, tmp_path / str(k)
            folder.mkdir()
            arguments = first_arguments(command, long_recipe, folder)
        try:
            process = start(arguments, folder, begin)
            again, took = struck(process, number, instant, folder)
            arguments = again or arguments
            times.append(took)
        except (AssertionError, pytest.fail.Exception) as error:
            wrong.append((k, int(number), instant, arguments, str(error)))
            arguments = None
    record_property("seconds", " ".join(f"{each:.3f}" for each in sorted(times)))
    assert not wrong
