"""Whole commands: `surrofe2 run` by true and by cached FE², each a process of its own, warm.

What a command takes besides the run itself is its start: Python, imports, reading recipe and
surrogate, kernels from disk, the kept reference state, and writing the run folder.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from shutil import rmtree
from time import perf_counter

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import RECIPES, ROOT, Setting
from benchmarks.timing import Timing, all_cores

TITLE = "Whole commands"
PRESET = "printed"
SHORT = 1.0
"""µs of the bar of Voronoi cells."""


def run(setting: Setting) -> list[Row]:
    """Both laws on the default bar, in turns, and the start with nine Voronoi plant cells."""
    setting.surrogate(PRESET)
    surrogate = setting.recipe(PRESET).training_path()
    recipe = ROOT / "data" / RECIPES[PRESET]
    commands = {
        "rve": [str(recipe), "--law", "rve"],
        "cached": [str(recipe), "--law", "cached", "--surrogate", str(surrogate)],
    }
    whole: dict[str, list[float]] = {law: [] for law in commands}
    start: dict[str, list[float]] = {law: [] for law in commands}
    for k in range(setting.pick(7, 2) + 1):
        for law, command in commands.items():
            seconds, of_run = _timed(command, setting.out / "commands" / law)
            if k:  # the first of each warms what it needs on disk
                whole[law].append(seconds)
                start[law].append(seconds - of_run)
    true, cached = (Timing(tuple(whole[law])) for law in commands)
    rows = [
        Row(
            name="surrofe2 run --law cached, default bar, whole process",
            value=cached.median,
            spread=cached.spread,
            unit="s",
            baseline="--law rve",
            baseline_value=true.median,
            ratio=float(np.median(np.divide(true.samples, cached.samples))),
            threads=all_cores(),
            note="pairs of processes; at least twice as fast is wanted",
        )
    ]
    for law, limit in (("rve", 1.2), ("cached", 0.8)):
        rows.append(_start(f"start of --law {law} besides the run", start[law], limit))
    return [*rows, _voronoi(setting)]


def _voronoi(setting: Setting) -> Row:
    text = (ROOT / "data" / "voronoi-bar.toml").read_text(encoding="utf-8")
    recipe = setting.out / "commands" / "voronoi-bar.toml"
    shorter = text.replace("duration = 250.0", f"duration = {SHORT}")
    recipe.write_text(shorter, encoding="utf-8")
    folder = setting.out / "commands" / "voronoi"
    taken = [_timed([str(recipe), "--law", "rve"], folder) for _ in range(setting.pick(5, 2) + 1)]
    start = [seconds - of_run for seconds, of_run in taken[1:]]
    return _start("start with nine Voronoi plant cells an RVE, --law rve", start, 2.0)


def _start(name: str, samples: list[float], limit: float) -> Row:
    timing = Timing(tuple(samples))
    return Row(
        name=name,
        value=timing.median,
        spread=timing.spread,
        unit="s",
        limit=limit,
        threads=all_cores(),
    )


def _timed(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Seconds of the process, and of the run in it as it says itself."""
    rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "surrofe2", "run", *arguments, "--out", str(folder)]
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # without bytecode, imports take twice as long
    begin = perf_counter()
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    seconds = perf_counter() - begin
    if done.returncode:
        raise RuntimeError(f"surrofe2 run failed: {done.stderr.strip().splitlines()[-1]}")
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return seconds, record["wall_time"]["total"]
