"""FE² of the bar on 4 × 4 elements against its full tissue of 16 × 16 plant cells, by commands."""

from __future__ import annotations

import numpy as np

from benchmarks import commands, runs
from benchmarks.measured import Bench


def run(bench: Bench) -> None:
    """Both presets; `printed` on fewer cells in quick mode."""
    for preset in bench.pick(("printed", "water"), ("printed",)):
        out = runs.folder(bench, preset)
        recipe = commands.shipped(runs.RECIPES[preset], out)
        commands.made(recipe)
        small = recipe.with_name("small.toml")
        text = recipe.read_text(encoding="utf-8").replace("400.0", "100.0")
        small.write_text(text.replace("200.0]", "50.0]"), encoding="utf-8")
        of = bench.pick(recipe, small)
        commands.surrofe2("tissue", of, "--out", out / "tissue", "--fresh")
        taken = commands.record(out / "tissue")["wall_time"]["run"]
        for law, key, limit in (("rve", "full", 10.0), ("cached", "cached", 50.0)):
            seconds = [
                commands.run(recipe, law, out / law)["wall_time"]["total"]
                for _ in range(bench.pick(3, 1))
            ]
            bench.add(
                f"tissue.{preset}.{key}",
                taken / float(np.median(seconds)),
                "×",
                f"{key} FE² on 4 × 4 elements faster than the full tissue, both runs alone",
                at_least=limit,
            )
        bench.add(f"tissue.{preset}.seconds", taken, "s", "full tissue, relaxation not counted")
