"""The time loop over MPI ranks against threads, what messages cost, and what rank 0 keeps.

From these docs/scaling.md foresees more ranks than this machine has cores.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import Setting

TITLE = "MPI ranks"
_DURATION = 0.5
"""µs of 64 × 64 elements, some seconds."""


def run(setting: Setting) -> list[Row]:
    """2 ranks of 1 thread against 1 rank of 2 threads by RVEs, in turns."""
    elements = setting.pick(64, 16)
    arguments = ["--elements", str(elements), "--duration", str(_DURATION)]
    pairs = [
        (probe(1, *arguments, "--threads", "2"), probe(2, *arguments, "--threads", "1"))
        for _ in range(setting.pick(5, 1))
    ]
    for one, two in pairs:  # another number of threads changes the last digits
        far = np.abs(one["last"]).max()
        np.testing.assert_allclose(two["last"], one["last"], rtol=0.0, atol=1e-9 * far)
    speed = np.array([one["total"] / two["total"] for one, two in pairs])
    two = sorted((two for _, two in pairs), key=lambda each: float(each["total"]))[len(pairs) // 2]
    one = sorted(one["total"] for one, _ in pairs)[len(pairs) // 2]
    bar = f"rve: {elements} × {elements} elements over {_DURATION:g} µs"
    away = two["computing"] + two["messages"]
    seconds = {
        "assembly and time stepping": two["macro"],
        "what the law decides": two["law"] - away,
        "messages": two["messages"],
    }
    rows = [
        Row(
            name=f"{bar}: speed of 2 ranks of 1 thread by that of 1 rank of 2 threads",
            value=float(np.median(speed)),
            spread=float(np.subtract(*np.percentile(speed, (75, 25)))),
            unit="×",
            limit=setting.if_full(0.9),
            at_least=True,
            baseline="1 rank of 2 threads",
            baseline_value=one,
            threads=1,
            note=f"{two['total']:.3g} against {one:.3g} s; {two['steps']} steps",
        )
    ]
    rows += [
        Row(
            name=f"{bar}: {name} on rank 0, a stress", value=1e9 * each / two["stresses"], unit="ns"
        )
        for name, each in seconds.items()
    ]
    (small, latency), *_, (large, longest) = (
        (int(size), taken) for size, taken in two["messages_by_size"].items()
    )
    rows += [
        Row(name=f"a message of {small} bytes between two ranks", value=1e6 * latency, unit="µs"),
        Row(
            name=f"a message of {large} bytes between two ranks",
            value=large / longest / 1e9,
            unit="GB/s",
        ),
    ]
    return rows


def probe(ranks: int, *arguments: str) -> dict[str, Any]:
    """What `ranks_probe` prints, by so many ranks."""
    command = [sys.executable, "-m", "benchmarks.ranks_probe", *arguments]
    if ranks > 1:
        command = [str(Path(sys.executable).with_name("mpiexec")), "-n", str(ranks), *command]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    found: dict[str, Any] = json.loads(done.stdout)
    return found
