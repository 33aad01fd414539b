"""The bar by true and by cached FE² against the full tissue, in one run, on all cores.

The tissue takes the micro step that is soonest done with a displacement that stays within `ERROR`
of that at `REFERENCE` over the whole run. That is not always the largest: near the limit of
stability particles rattle, and neighbour lists have to be built all the time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import PRESETS, ROOT, Setting, rve
from benchmarks.timing import all_cores
from surrofe2 import LoadCase, MacroSettings, simulate
from surrofe2.run.displacement_curve import DisplacementCurve, difference

TITLE = "FE² against the full tissue"
ERROR = 1e-3
"""Largest difference of the watched displacement over the largest displacement, in all the run."""
CANDIDATES = (2.5e-3, 2.4e-3, 2.3e-3, 2.2e-3, 2.1e-3, 2e-3)
"""µs; an output interval of 0.5 µs has a whole number of the steps taken."""
REFERENCE = 1e-3
"""Step of the run that errors are taken against, µs."""


@dataclass(frozen=True, slots=True)
class TissueTime:
    """A run of the tissue: s without relaxation, and with it; its curve, None where it broke."""

    run: float
    total: float
    curve: DisplacementCurve | None


def run(setting: Setting) -> list[Row]:
    """4 × 4 elements against 16 × 16 plant cells over 250 µs; less of one preset in quick mode."""
    presets = setting.pick(PRESETS, PRESETS[:1])
    return [row for preset in presets for row in _against(setting, preset)]


def _against(setting: Setting, preset: str) -> list[Row]:
    cells = setting.pick(16, 4)
    side, duration = 25.0 * cells, setting.pick(250.0, 10.0)
    load = LoadCase(width=side, height=side, watched=(side, 0.5 * side), duration=duration)
    reference = _tissue(preset, cells, duration, REFERENCE)
    step, tissue, error = _fastest_step(preset, cells, duration, reference)
    laws = {"true": (rve(preset), 10.0), "cached": (setting.cached(preset), 50.0)}
    rows = [
        Row(
            name=f"{preset}: full tissue, {cells} × {cells} plant cells over {duration:g} µs",
            value=tissue.run,
            unit="s",
            threads=all_cores(),
            error=error,
            error_of="largest difference of the watched displacement from a tissue run with "
            f"steps of {REFERENCE:g} µs / largest displacement, at most {ERROR:g}",
            note=f"micro step {step:.4g} µs; relaxation before: {tissue.total - tissue.run:.3g} s",
        )
    ]
    for name, (law, limit) in laws.items():
        simulate(LoadCase(duration=0.05), law, MacroSettings())
        repeats = range(setting.pick(5, 2))
        taken = [simulate(load, law, MacroSettings()).wall_time["total"] for _ in repeats]
        rows.append(
            Row(
                name=f"{preset}: {name} FE² on 4 × 4 elements, times faster than the full tissue",
                value=tissue.run / float(np.median(taken)),
                unit="×",
                limit=setting.if_full(limit),
                at_least=True,
                threads=all_cores(),
                note=f"{tissue.run:.3g} against {float(np.median(taken)):.3g} s",
            )
        )
    return rows


def _fastest_step(
    preset: str, cells: int, duration: float, reference: TissueTime
) -> tuple[float, TissueTime, float]:
    """The candidate that holds the error and takes least time: of a tenth of the run, then all."""
    if reference.curve is None:
        raise RuntimeError(f"the tissue's reference run with steps of {REFERENCE:g} µs broke")
    tried = [(step, _tissue(preset, cells, 0.1 * duration, step)) for step in CANDIDATES]
    held = [
        (made.run, step) for step, made in tried if _error(made.curve, reference.curve) <= ERROR
    ]
    for _, step in sorted(held):
        made = _tissue(preset, cells, duration, step)
        error = _error(made.curve, reference.curve)
        if error <= ERROR:
            return step, made, error
    raise RuntimeError(f"no micro step down to {CANDIDATES[-1]:g} µs holds the error")


def _error(curve: DisplacementCurve | None, reference: DisplacementCurve) -> float:
    if curve is None or not np.isfinite(curve.displacement).all():
        return float("inf")
    scale = np.linalg.norm(reference.displacement, axis=1).max()
    covered = reference.t <= curve.t[-1]
    part = DisplacementCurve(reference.t[covered], reference.displacement[covered])
    own = np.linalg.norm(part.displacement, axis=1).max()
    return float(difference(curve, part).largest * own / scale)


def _tissue(preset: str, cells: int, duration: float, step: float) -> TissueTime:
    """In a process of its own, whose threads wait for each other as `surrofe2 tissue` has them."""
    done = subprocess.run(
        [
            sys.executable, "-m", "benchmarks.tissue_probe", "--preset", preset, "--cells",
            str(cells), "--duration", str(duration), "--micro-step", str(step),
        ],
        cwd=ROOT,
        env={**os.environ, "GOMP_SPINCOUNT": "20000"},
        capture_output=True,
        text=True,
        check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    if found["failure"]:
        return TissueTime(0.0, 0.0, None)
    curve = DisplacementCurve(np.array(found["t"]), np.array(found["displacement"]))
    return TissueTime(found["run"], found["total"], curve)
