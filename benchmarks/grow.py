"""The cached run as its mesh grows: time for a stress and memory of 256 × 256 elements.

Tissue, load and surrogate are those of `large-bar.toml`. Runs of both meshes begin in turns, so
that a change in the machine's speed meets both.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import commands
from benchmarks.measured import Bench

_FEW, _MANY = 64, 256
"""Elements along an edge."""
_QUICK = {_FEW: 4, _MANY: 8}
_DURATIONS = {_FEW: 320.0, _MANY: 20.0}
"""µs of a run; the step of the fine mesh is a quarter, and it has sixteen times the points."""
_FRAMES = 2
"""The whole run of 4 ms has 101; so many in a short part of it would take a third of the time."""
_TURNS = 3


def run(bench: Bench) -> None:
    """Run each mesh in turns, then the fine one once more for its memory."""
    out = bench.out / "large" / "printed"
    recipes = {edge: _recipe(bench, out, edge) for edge in (_FEW, _MANY)}
    commands.made(recipes[_FEW])
    seconds: dict[int, list[float]] = {_FEW: [], _MANY: []}
    for _ in range(bench.pick(_TURNS, 1)):
        for edge, recipe in recipes.items():
            record = commands.run(recipe, "cached", out / f"grow-{edge}")
            stresses = record["counts"]["stress_points"] + record["counts"]["dissipation_points"]
            seconds[edge].append(record["wall_time"]["total"] / stresses)
    for edge, each in seconds.items():
        bench.add(
            f"grow.stress.{edge}",
            1e6 * float(np.median(each)),
            "µs",
            f"cached run, one stress, all included, {edge} × {edge} elements",
        )
    ratio = np.median(seconds[_MANY]) / np.median(seconds[_FEW])
    bench.add(
        "grow.ratio",
        float(ratio),
        "×",
        f"time for a stress, {_MANY} × {_MANY} elements over {_FEW} × {_FEW}",
        at_most=1.2,
    )
    arguments = ("run", recipes[_MANY], "--law", "cached", "--fresh", "--out", out / "grow-memory")
    bench.add(
        "grow.memory",
        commands.peak_memory(*arguments) / 1e9,
        "GB",
        f"peak memory, cached run on {_MANY} × {_MANY} elements",
        at_most=1.5,
    )


def _recipe(bench: Bench, out: Path, edge: int) -> Path:
    """Copy the recipe with so many elements along an edge, and a short time."""
    elements = _QUICK[edge] if bench.quick else edge
    return commands.changed(
        commands.shipped("large-bar.toml", out),
        "[64, 64]", f"[{elements}, {elements}]\nframes = {_FRAMES}",
        "= 4000.0", f"= {_DURATIONS[edge]}",
        name=f"grow-{edge}.toml",
    )  # fmt: skip
