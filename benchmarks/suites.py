"""How long the three kinds of tests take, kernels compiled: `python -m benchmarks suites`."""

from __future__ import annotations

import subprocess
import sys
from time import perf_counter

from benchmarks.measured import ROOT, Bench

SUITES = {
    "quick": "not slow",
    "slow": "slow and not nightly",
    "nightly": "nightly",
}
"""Expression of markers by the name of a kind of test."""


def run(bench: Bench) -> None:
    """Each kind by two workers, as `make` starts them; the first once before, to compile."""
    for name in bench.pick(("quick", *SUITES), ()):
        words = ["-q", "-n", "2", "--dist", "loadfile", "-m", SUITES[name]]
        begin = perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words],
            cwd=ROOT, capture_output=True, text=True, check=False,
        )  # fmt: skip
        minutes = (perf_counter() - begin) / 60.0
        if done.returncode:
            raise RuntimeError(f"{name} tests: {done.stdout.splitlines()[-1]}")
        bench.add(f"tests.{name}", minutes, "min", f"{name} tests, by two workers")
