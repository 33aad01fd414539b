"""Figure 5: stress of one RVE over shear steps F_α (eq. 73), for every initialisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Curve, Panel, Study
from surrofe2.rve import INITIALISATIONS, RveLaw
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.stress_law import Status
from surrofe2.studies.drives import SHEAR_RATE, shear_rate_tensor, sheared, steady_shear

Array = NDArray[np.float64]

INTEGRATED = "micro-integration"
_SETTLED = 0.02
"""Shear from which the integrated line is compared: its start from rest has died away."""


@dataclass(frozen=True, slots=True)
class ShearSteps:
    """Stress over shear at one rate.

    Attributes:
        rate: Ḟ_xy, 1/µs.
        shear: (m,) F_xy.
        stress: by initialisation and, at a rate, "micro-integration": (m, 2, 2) µN/µm.
        unstable_from: by initialisation, the first shear whose equilibrium is unstable or was not
            found; None where all are well.
    """

    rate: float
    shear: Array
    stress: Mapping[str, Array]
    unstable_from: Mapping[str, float | None]


def shear_steps(
    cell: CellParameters,
    rate: float = SHEAR_RATE,
    *,
    steps: int = 20,
    increment: float = 0.01,
    micro_step: float = 1e-3,
) -> ShearSteps:
    """Shear an RVE in steps, each from the state of the last one (section 6.1).

    At a rate the RVE is integrated in time, too: from F₀ at rest under constant Ḟ, so that it
    passes F_α at t = 0.01 α/Ḟ_xy.
    """
    shear: Array = increment * np.arange(steps + 1, dtype=np.float64)
    stress, trouble = {}, {}
    for name in INITIALISATIONS:
        stress[name], trouble[name] = _walk(RveLaw(cell, initialisation=name), shear, rate)
    if rate != 0.0:
        stress[INTEGRATED] = integrate_rve(
            RveLaw(cell), steady_shear(rate), shear / rate, micro_step
        )
    return ShearSteps(rate, shear, stress, trouble)


def _walk(law: RveLaw, shear: Array, rate: float) -> tuple[Array, float | None]:
    state, stresses, trouble = None, [], None
    F_dot = shear_rate_tensor(rate)[None]
    for value in shear:
        F = sheared(float(value))[None]
        answer = law.respond(F, F_dot, state)
        stresses.append(answer.stress[0])
        solved = answer.status[0] == Status.OK
        accepted = law.accept(F, F_dot, answer) if solved else None
        state = accepted.state if accepted else None
        if trouble is None and (accepted is None or accepted.status[0] != Status.OK):
            trouble = float(value)
    return np.array(stresses), trouble


_COMPONENTS = {"xy": (0, 1), "xx": (0, 0)}


def describe(runs: tuple[ShearSteps, ...], preset: str, name: str) -> Study:
    """Figure 5: σ_xy above, σ_xx below; one column for each rate."""
    table: dict[str, Any] = {"F_xy (1)": runs[0].shear}
    for run in runs:
        for method, stress in run.stress.items():
            for label, (a, b) in _COMPONENTS.items():
                table[f"sigma_{label} {method} at rate {run.rate:g} (µN/µm)"] = stress[:, a, b]
    panels = tuple(
        _panel(run, label, index) for label, index in _COMPONENTS.items() for run in runs
    )
    integrated = [run for run in runs if INTEGRATED in run.stress]
    panels += tuple(
        _error_panel(run, label, index)
        for run in integrated
        for label, index in _COMPONENTS.items()
    )
    return Study(
        name=name,
        title=f"Figure 5: stress of one RVE over shear steps, preset “{preset}”",
        panels=panels,
        columns=len(runs),
        table=table,
        results={"rates": [_numbers(run) for run in runs]},
        units={"rate": "1/µs", "shear": "1", "largest_difference": "µN/µm"},
    )


def _panel(run: ShearSteps, label: str, index: tuple[int, int]) -> Panel:
    order = sorted(run.stress, key=lambda method: method != INTEGRATED)
    return Panel(
        title=rf"$\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$\sigma_{{{label}}}$ (µN/µm)",
        curves=tuple(
            Curve(
                method,
                run.shear,
                run.stress[method][:, *index],
                "integrated in time" if method == INTEGRATED else "",
                markers=method != INTEGRATED,
            )
            for method in order
        ),
    )


def _error_panel(run: ShearSteps, label: str, index: tuple[int, int]) -> Panel:
    """Difference from the integrated line once its start has died away; lines coincide above."""
    settled = run.shear >= _SETTLED
    curves = []
    for method, stress in run.stress.items():
        if method != INTEGRATED:
            error = np.abs(stress - run.stress[INTEGRATED])[settled][:, *index]
            curves.append(Curve(method, run.shear[settled], np.where(error > 0, error, np.nan)))
    return Panel(
        title=rf"against integrated, $\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$|\Delta\sigma_{{{label}}}|$ (µN/µm)",
        curves=tuple(curves),
        log_y=True,
    )


def _numbers(run: ShearSteps) -> dict[str, Any]:
    """Largest difference from the integrated line, else from the elastic equilibrium."""
    reference = INTEGRATED if INTEGRATED in run.stress else "elastic"
    settled = run.shear >= _SETTLED if reference == INTEGRATED else run.shear >= 0.0
    return {
        "rate": run.rate,
        "reference": reference,
        "largest_difference": {
            method: float(np.nanmax(np.abs(stress - run.stress[reference])[settled]))
            for method, stress in run.stress.items()
            if method != reference
        },
        "compared_from_shear": float(run.shear[settled][0]),
        "unstable_from_shear": dict(run.unstable_from),
    }
