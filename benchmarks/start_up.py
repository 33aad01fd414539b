"""Item 8: time to the first line of help, compilation, memory; each in a process of its own.

Memory is that of 3 µs: in the first microsecond the load has reached few elements, most RVEs rest
and share their factorisations.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.row import Row
from benchmarks.setting import RECIPES, ROOT, Setting
from benchmarks.timing import all_cores, time_calls

TITLE = "Start-up, compilation, memory"
PRESET = "printed"


def run(setting: Setting) -> list[Row]:
    """Help, first and second start, memory of the large bar by both laws."""
    surrogate = setting.recipe(PRESET).training_path()
    setting.surrogate(PRESET)
    n, duration = setting.pick((64, 3.0), (16, 0.2))
    rows = [_help(setting), *_compilation(surrogate)]
    for law in ("rve", "cached"):
        done = probe(
            "--law", law, "--elements", str(n), "--duration", str(duration),
            "--surrogate", str(surrogate),
        )  # fmt: skip
        rows.append(
            Row(
                name=f"peak memory of {n} × {n} elements over {duration:g} µs, {law}",
                value=done["peak_gigabytes"],
                unit="GB",
                limit=setting.if_full(2.0),
                threads=all_cores(),
                note=f"{done['right_hand_sides']} right-hand sides",
            )
        )
    return rows


def _help(setting: Setting) -> Row:
    command = [str(Path(sys.executable).with_name("surrofe2")), "--help"]

    def ask() -> None:
        subprocess.run(command, check=True, capture_output=True)

    taken = time_calls(ask, setting.pick(9, 3))
    return Row(name="surrofe2 --help", value=taken.median, spread=taken.spread, unit="s", limit=0.5)


def _compilation(surrogate: Path) -> list[Row]:
    """The same short cached run twice, on an empty cache folder and on what the first left."""
    with TemporaryDirectory() as folder:
        first = probe("--law", "cached", "--surrogate", str(surrogate), cache=folder)
        compiled = _files(folder)
        second = probe("--law", "cached", "--surrogate", str(surrogate), cache=folder)
        if not compiled or _files(folder) != compiled:
            raise RuntimeError("the second start compiled again; were sources changed meanwhile?")
    return [
        Row(
            name="first start, nothing compiled: imports, compilation, relaxed RVE, 0.5 µs",
            value=first["seconds"],
            unit="s",
            limit=60.0,
            threads=all_cores(),
        ),
        Row(
            name="second start, another process: the same from compiled kernels",
            value=second["seconds"],
            unit="s",
            threads=all_cores(),
        ),
    ]


def _files(folder: str) -> set[Path]:
    return {path for path in Path(folder).rglob("*") if path.is_file()}


def probe(*arguments: str, cache: str | None = None) -> dict[str, Any]:
    """What `benchmarks.probe` prints; `cache`: folder for compiled kernels."""
    environment = dict(os.environ)
    if cache is not None:
        environment.pop("NUMBA_CACHE_DIR", None)
        environment["XDG_CACHE_HOME"] = cache
    recipe = ROOT / "data" / RECIPES[PRESET]
    command = [sys.executable, "-m", "benchmarks.probe", "--recipe", str(recipe), *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"probe failed: {done.stderr.strip().splitlines()[-1]}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer
