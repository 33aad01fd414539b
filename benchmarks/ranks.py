"""Full FE² on two MPI ranks of one thread against one process of two threads, in turns."""

from __future__ import annotations

import numpy as np

from benchmarks import commands
from benchmarks.measured import Bench


def run(bench: Bench) -> None:
    """64 × 64 elements for a short time."""
    out = bench.out / "ranks"
    recipe = commands.shipped("bending-bar.toml", out, "[4, 4]", bench.pick("[64, 64]", "[16, 16]"))
    text = recipe.read_text(encoding="utf-8")
    recipe.write_text(text.replace("duration = 250.0", "duration = 1.0"), encoding="utf-8")
    ratios = []
    for turn in range(bench.pick(6, 1)):
        one = commands.run(recipe, "rve", out / "one", "--threads", "2")
        two = commands.run(recipe, "rve", out / "two", "--threads", "1", ranks=2)
        if turn or bench.quick:
            ratios.append(one["wall_time"]["total"] / two["wall_time"]["total"])
    two_ranks = commands.compared(out / "one", out / "two", out=out / "comparison")["two"]
    bench.add(
        "ranks.speed",
        float(np.median(ratios)),
        "×",
        "two ranks of one thread faster than one process of two threads",
        at_least=0.9,
    )
    bench.add("ranks.difference", 100.0 * two_ranks["difference"]["largest"], "%",
              "largest difference in displacement between the two", at_most=1e-7)  # fmt: skip
