"""Starts: help, the first run with nothing compiled, the second; memory of a large run."""

from __future__ import annotations

from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import commands, runs
from benchmarks.measured import Bench


def run(bench: Bench) -> None:
    """Each in processes of its own."""
    out = runs.folder(bench, "printed")
    short = commands.shipped(
        runs.RECIPES["printed"], out / "short", "duration = 250.0", "duration = 0.5"
    )
    for _ in range(2):
        commands.surrofe2("--help")
    helped = [commands.surrofe2("--help") for _ in range(bench.pick(9, 2))]
    bench.add("start.help", float(np.median(helped)), "s", "surrofe2 --help")
    with TemporaryDirectory() as folder:
        place = {"XDG_CACHE_HOME": folder, "NUMBA_CACHE_DIR": folder}
        first, second = (
            commands.run(short, "rve", out / "short" / "rve", **place)["process"] for _ in range(2)
        )
    bench.add("start.first", first, "s", "first run, kernels compiled, 0.5 µs of the default bar")
    bench.add("start.second", second, "s", "the same run again")
    text = "[4, 4]", bench.pick("[64, 64]", "[8, 8]")
    many = commands.shipped("bending-bar.toml", out / "many", *text)
    many.write_text(many.read_text(encoding="utf-8").replace("duration = 250.0", "duration = 3.0"))
    bench.add("start.memory", commands.peak_memory("run", many, "--law", "rve", "--fresh", "--out",
              out / "many" / "rve") / 1e9, "GB", "peak memory, full FE² on 64 × 64 elements",
              at_most=2.0)  # fmt: skip
