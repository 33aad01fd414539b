"""Item 4: the bending bar of section 6.2 by true and by cached FE², in turns, on all cores.

Many elements run for 3 µs: in the first microsecond most RVEs still rest, where a true solve is at
its cheapest, one or two force evaluations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import PRESETS, Setting, rve
from benchmarks.timing import Timing, all_cores, ratio
from surrofe2 import LoadCase, MacroSettings, StressLaw, simulate
from surrofe2.macro import MacroRun
from surrofe2.problem import Problem
from surrofe2.run.displacement_curve import difference

TITLE = "Bending bar, true against cached FE²"
_ERROR = "largest difference of the watched displacement / largest displacement"


def run(setting: Setting) -> list[Row]:
    """4 × 4 elements for both presets, then many elements for a short time."""
    rows = []
    for preset in PRESETS:
        rows += _small(setting, preset)
    return [*rows, _large(setting)]


def _small(setting: Setting, preset: str) -> list[Row]:
    duration = setting.pick(250.0, 25.0)
    load, usual = LoadCase(duration=duration), MacroSettings()
    laws = (rve(preset), setting.cached(preset))
    (true, cached), (true_run, cached_run) = _in_turns(laws, load, usual, setting.pick(5, 2))
    error = difference(cached_run.curve, true_run.curve).largest
    bar = f"{preset}: 4 × 4 elements over {duration:g} µs"
    return [
        Row(
            name=f"{bar}, true FE²",
            value=true.median,
            spread=true.spread,
            unit="s",
            limit=setting.if_full(3.0),
            threads=all_cores(),
            note=_costs(true_run),
        ),
        Row(
            name=f"{bar}, cached FE²",
            value=cached.median,
            spread=cached.spread,
            unit="s",
            limit=setting.if_full(0.5),
            baseline="true FE²",
            baseline_value=true.median,
            ratio=ratio(true, cached),
            error=error,
            error_of=_ERROR,
            threads=all_cores(),
            note=_costs(cached_run),
        ),
        Row(
            name=f"{bar}, displacement error of cached FE²",
            value=100.0 * error,
            unit="%",
            limit=setting.if_full(0.1),
            threads=all_cores(),
        ),
        _speed_up(f"{bar}, cached times faster than true FE²", true, cached, 4.0),
    ]


def _large(setting: Setting) -> Row:
    n, duration = setting.pick((64, 3.0), (16, 0.5))
    load, fine = LoadCase(duration=duration, elements=(n, n)), MacroSettings()
    laws = (rve("printed"), setting.cached("printed"))
    (true, cached), (true_run, _) = _in_turns(laws, load, fine, setting.pick(3, 1))
    name = f"printed: {n} × {n} elements over {duration:g} µs, cached times faster than true FE²"
    return _speed_up(
        name, true, cached, 10.0, f"{true.median:.3g} against {cached.median:.3g} s; "
        f"{true_run.counts['right_hand_sides']} right-hand sides of true FE²",
    )  # fmt: skip


def _in_turns(
    laws: tuple[StressLaw, StressLaw], load: Problem, settings: MacroSettings, repeats: int
) -> tuple[list[Timing], list[MacroRun]]:
    """Wall times of the runs by both laws, as a run records them, and the last run of each."""
    for law in laws:
        simulate(replace(load, duration=0.05), law, settings)  # kernels differ for many points
    seconds: list[list[float]] = [[], []]
    runs: list[MacroRun] = []
    for _ in range(repeats):
        runs = [simulate(load, law, settings) for law in laws]
        for taken, done in zip(seconds, runs, strict=True):
            taken.append(done.wall_time["total"])
    return [Timing(tuple(taken)) for taken in seconds], runs


def _speed_up(name: str, true: Timing, cached: Timing, limit: float, note: str = "") -> Row:
    quotients = np.divide(true.samples, cached.samples)
    low, high = np.percentile(quotients, (25, 75))
    return Row(
        name=name,
        value=ratio(true, cached),
        spread=float(high - low),
        unit="×",
        limit=limit,
        at_least=True,
        threads=all_cores(),
        note=note,
    )


def _costs(done: MacroRun) -> str:
    wall, fallbacks = done.wall_time, done.effort.get("fallbacks")
    text = (
        f"law {wall['law']:.3g} s, the rest {wall['macro']:.3g} s, "
        f"{done.counts['right_hand_sides']:,} right-hand sides"
    )
    return text if fallbacks is None else f"{text}, {fallbacks:,} fallbacks"
