"""Item 9: cost of a right-hand side over the number of points, on one motion for all meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import Array, Setting, rve
from benchmarks.timing import all_cores
from surrofe2 import LoadCase, StressLaw
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.system import System, make_system
from surrofe2.report.figures import Curve, Panel, write_figure

TITLE = "Cost over the number of points"
PRESET = "printed"
SWING, PERIOD = 20.0, 100.0
"""Of the motion of the bar's free side, µm and µs; about those of the bending bar."""
STAGE, STAGES = 0.1, 6
"""Time between two right-hand sides, µs; how many of them make a step."""
START = 0.25 * PERIOD
"""Where the motion is fastest; the cold solve there is not counted."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds of a right-hand side, (sizes, steps), over the number of points (sizes,)."""

    label: str
    points: Array
    seconds: Array

    @property
    def median(self) -> Array:
        """(sizes,) s."""
        middle: Array = np.median(self.seconds, axis=1)
        return middle

    @property
    def exponent(self) -> float:
        """p of seconds ~ points**p, a least-squares line through the logarithms."""
        return float(np.polyfit(np.log(self.points), np.log(self.median), 1)[0])


def run(setting: Setting) -> list[Row]:
    """Both laws on n × n elements; writes cost.png into the output folder."""
    sizes = setting.pick((2, 4, 8, 16, 32, 64), (2, 4, 8))
    laws: dict[str, StressLaw] = {
        "true FE²": rve(PRESET),
        "cached FE²": setting.cached(PRESET, tolerance=np.inf),
    }
    bars = [make_system(LoadCase(elements=(n, n)), rve(PRESET).density) for n in sizes]
    points = np.array([float(system.discretisation.n_points) for system in bars])
    steps = setting.pick(8, 3)
    costs = [
        Costs(label, points, np.array([_seconds(system, law, steps) for system in bars]))
        for label, law in laws.items()
    ]
    write_cost_plot(setting.out / "cost.png", costs, all_cores())
    return [row for cost in costs for row in _rows(setting, cost)]


def _seconds(system: System, law: StressLaw, steps: int) -> Array:
    """(steps,) seconds of a right-hand side, acceptance of the steps included."""
    equations = EquationsOfMotion(system, law)
    shape = _shape(system)
    taken: list[float] = []
    for step in range(steps + 1):
        states = [_motion(shape, START + (step * STAGES + k) * STAGE) for k in range(STAGES)]
        begin = perf_counter()
        for y in states:
            now = equations.evaluate(0.0, y)
        equations.accept(now)
        taken.append((perf_counter() - begin) / STAGES)
    if equations.tally.effort.get("fallbacks"):
        raise RuntimeError("the motion leaves the surrogate's range; the cost is that of RVEs")
    return np.array(taken[1:])


def _shape(system: System) -> Array:
    """(m,) bent bar whose free side moves by 1 µm: −(x/W)² down, fibres turned along."""
    x, y = system.discretisation.nodes.T / 400.0
    return system.pick(np.stack([2.0 * x * (y - 0.5), -(x**2)], axis=1))


def _motion(shape: Array, t: float) -> Array:
    """Displacement and velocity at time t (µs), at rest at first."""
    w = 2.0 * np.pi / PERIOD
    phase = 0.5 * (1.0 - np.cos(w * t)), 0.5 * w * np.sin(w * t)
    return SWING * np.concatenate([factor * shape.ravel() for factor in phase])


def _rows(setting: Setting, cost: Costs) -> list[Row]:
    first, last = int(cost.points[0]), int(cost.points[-1])
    per_point = 1e6 * cost.median / cost.points
    return [
        Row(
            name=f"{cost.label}: exponent p of time ~ pointsᵖ, {first} to {last:,} points",
            value=cost.exponent,
            unit="",
            limit=setting.if_full(1.1),
            threads=all_cores(),
            note="1: linear; fixed costs of a call make it smaller",
        ),
        *(
            Row(
                name=f"{cost.label}: a right-hand side, a point, {int(points):,} points",
                value=float(micro),
                spread=float(np.subtract(*np.percentile(row, (75, 25))) * 1e6 / points),
                unit="µs",
                threads=all_cores(),
            )
            for points, micro, row in zip(cost.points, per_point, cost.seconds, strict=True)
        ),
    ]


def write_cost_plot(path: Path, costs: Sequence[Costs], threads: int) -> None:
    """Milliseconds of a right-hand side over points, both logarithmic, with lines of slope 1."""
    curves = []
    for k, cost in enumerate(costs):
        milli = 1e3 * cost.median
        label = (
            f"{cost.label} ~ points$^{{{cost.exponent:.2f}}}$, "
            f"{1e3 * milli[-1] / cost.points[-1]:.2g} µs a point"
        )
        curves.append(Curve(cost.label, cost.points, milli, label, colour=k))
        proportional = milli[-1] * cost.points / cost.points[-1]
        dotted = "" if k else "proportional to points"
        curves.append(
            Curve("", cost.points, proportional, dotted, markers=False, colour=k, dash=":")
        )
    panel = Panel(
        x_label="stress points (five an element)",
        y_label="a right-hand side (ms)",
        curves=tuple(curves),
        log_x=True,
        log_y=True,
    )
    write_figure(path, f"Cost of the macro scale and its stress law, {threads} threads", [panel])
