"""What the slow manifold and tangents cost beside a warm constrained-runs solve; one thread."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import POINTS, PRESETS, Setting, deformations, rve
from benchmarks.timing import side_by_side, threads
from benchmarks.watched_law import TimedLaw
from surrofe2 import LoadCase, simulate
from surrofe2.rve import INITIALISATIONS

TITLE = "Initialisations and tangents"
_MICRO = 1e6
_WARM = ("constrained-runs", "slow-manifold")


def run(setting: Setting) -> list[Row]:
    """All figures of both presets."""
    with threads(1):
        return [
            row
            for preset in PRESETS
            for row in (
                _slow_against_constrained(setting, preset),
                *(_tangents(setting, preset, method) for method in INITIALISATIONS),
            )
        ]


def _slow_against_constrained(setting: Setting, preset: str) -> Row:
    """Mean time of a solve along the bar, the two laws in turns."""
    duration = setting.pick(50.0, 5.0)
    laws = [rve(preset, initialisation=name) for name in _WARM]
    for law in laws:
        simulate(LoadCase(duration=0.5), law)
    solves: list[list[float]] = [[], []]
    accepts: list[list[float]] = [[], []]
    for _ in range(setting.pick(5, 3)):
        for k, law in enumerate(laws):
            timed = TimedLaw(law)
            simulate(LoadCase(duration=duration), timed)
            solves[k].append(timed.respond_seconds / timed.solved * _MICRO)
            accepts[k].append(timed.accept_seconds / timed.accepted * _MICRO)
    times = np.divide(solves[1], solves[0])
    low, high = np.percentile(times, (25, 75))
    constrained, slow = (float(np.median(taken)) for taken in solves)
    checks = [float(np.median(taken)) for taken in accepts]
    return Row(
        name=f"{preset}: a warm slow-manifold solve, times a constrained-runs solve, along the bar "
        f"over {duration:g} µs",
        value=float(np.median(times)),
        spread=float(high - low),
        unit="×",
        limit=2.5,
        note=f"{slow:.3g} against {constrained:.3g} µs; acceptance at the end of a step "
        f"{checks[1]:.3g} against {checks[0]:.3g} µs",
    )


def _tangents(setting: Setting, preset: str, method: str) -> Row:
    law = rve(preset, initialisation=method)
    F, F_dot = deformations(preset, POINTS)
    state = law.respond(F, F_dot).state
    ask = partial(law.respond, F, F_dot, state)
    without, with_tangents = side_by_side([ask, partial(ask, tangents=True)], setting.pick(15, 5))
    per_rve = _MICRO / POINTS
    extra = np.subtract(with_tangents.samples, without.samples) * per_rve
    low, high = np.percentile(extra, (25, 75))
    return Row(
        name=f"{preset}: tangents of an RVE, on top of its stress, {method}",
        value=float(np.median(extra)),
        spread=float(high - low),
        unit="µs",
        limit=80.0,
        note=f"{POINTS} points, warm; the stress alone {without.median * per_rve:.3g} µs",
    )
