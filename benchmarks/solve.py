"""The calls that runs are made of: one RVE, one lookup; seconds per point on one thread."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks import commands, runs
from benchmarks.measured import Bench
from benchmarks.timing import side_by_side, threads
from surrofe2 import CachedLaw, CacheSettings, CellParameters, RveLaw, RveSettings, read_surrogate

SPREAD = {"printed": 0.08, "water": 0.04}
"""Largest entry of F − I at which RVEs of a preset must be solved."""
POINTS = 80
"""Of the bar of 4 × 4 elements."""
MICRO = 1e6


def run(bench: Bench) -> None:
    """RVEs of both presets, then a lookup of the shipped surrogate."""
    with threads(1):
        for preset in SPREAD:
            _rve(bench, preset)
        _lookup(bench)


def deformations(preset: str, points: int, seed: int = 0) -> tuple[Any, Any]:
    """Random F and Ḟ (points, 2, 2), uniform over what RVEs of the preset must bear."""
    rng = np.random.default_rng(seed)
    F = np.eye(2) + SPREAD[preset] * rng.uniform(-1.0, 1.0, (points, 2, 2))
    return F, 0.01 * rng.uniform(-1.0, 1.0, (points, 2, 2))


def _law(preset: str, initialisation: str = "constrained-runs") -> RveLaw:
    return RveLaw(CellParameters.preset(preset), RveSettings(initialisation=initialisation))


def _rve(bench: Bench, preset: str) -> None:
    repeats = bench.pick(15, 3)
    law, slow = _law(preset), _law(preset, "slow-manifold")
    F, F_dot = deformations(preset, bench.pick(800, 80))
    (cold_seconds,) = side_by_side([partial(law.respond, F, F_dot)], repeats)
    cold = cold_seconds / len(F) * MICRO
    F, F_dot = F[:POINTS], F_dot[:POINTS]
    moved = F + 0.02 * F_dot  # about a stage of a time step further
    states = [each.respond(F, F_dot).state for each in (law, slow)]
    warm, with_tangents, slowly = side_by_side(
        [
            partial(law.respond, moved, F_dot, states[0]),
            partial(law.respond, moved, F_dot, states[0], tangents=True),
            partial(slow.respond, moved, F_dot, states[1]),
        ],
        repeats,
    )

    per = MICRO / POINTS
    bench.add_group(f"solve.{preset}", (
        ("cold", cold, "µs",
         "an RVE from its rest state to random F and Ḟ, stability check included"),
        ("warm", warm * per, "µs", "an RVE from the state of the time before"),
        ("warm_over_cold", warm * per / cold, "", "warm over cold solve", {"at_most": 0.5}),
        ("slow_over_constrained", slowly / warm, "×",
         "slow-manifold over constrained-runs solve, warm", {"at_most": 3.0}),
        ("tangents", with_tangents / warm, "×",
         "warm solve with exact tangents over one without"),
    ))  # fmt: skip


def _lookup(bench: Bench) -> None:
    recipe = commands.made(commands.shipped(runs.RECIPES["printed"], runs.folder(bench, "printed")))
    surrogate = read_surrogate(recipe.study().training_path())
    law, rve = CachedLaw(surrogate, _law("printed"), CacheSettings(audit=0.0)), _law("printed")
    rng = np.random.default_rng(5)
    F = np.eye(2) + 0.02 * rng.uniform(-1.0, 1.0, (5000, 2, 2))
    F_dot = 0.002 * rng.uniform(-1.0, 1.0, (5000, 2, 2))
    state = rve.respond(F, F_dot).state
    moved = F + 0.02 * F_dot  # as in `_rve`: a repeated F needs no iteration
    lookup, solve = side_by_side(
        [partial(law.respond, moved, F_dot), partial(rve.respond, moved, F_dot, state)],
        bench.pick(15, 3),
    )
    bench.add("solve.lookup", lookup / len(F) * MICRO, "µs", "a lookup of the surrogate")
    bench.add("solve.lookup_speed_up", solve / lookup, "×",
              "a lookup faster than a warm RVE solve, whose F has moved", at_least=8.0)  # fmt: skip
