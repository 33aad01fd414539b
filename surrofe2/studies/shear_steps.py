"""Figure 5: stress of one RVE over shear steps F_α (eq. 73), for every initialisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS, RveLaw
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.stress_law import Status
from surrofe2.studies.drives import SHEAR_RATE, steady_shear

Array = NDArray[np.float64]

INTEGRATED = "micro-integration"
_SETTLED = 0.02
"""Shear from which the integrated line is compared: its start from rest has died away."""
_COMPONENTS = {"xy": (0, 1), "xx": (0, 0)}


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

    @property
    def reference(self) -> str:
        """What the others are compared with: the integrated line, else elastic equilibrium."""
        return INTEGRATED if INTEGRATED in self.stress else "elastic"

    def difference(self, method: str) -> tuple[Array, Array]:
        """Shear (k,) where it is compared with the reference, and |Δσ| there (k, 2, 2)."""
        compared = self.shear >= (_SETTLED if self.reference == INTEGRATED else 0.0)
        error = np.abs(self.stress[method] - self.stress[self.reference])
        return self.shear[compared], error[compared]


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
        drive = steady_shear(rate)
        stress[INTEGRATED] = integrate_rve(RveLaw(cell), drive, shear / rate, micro_step)
    return ShearSteps(rate, shear, stress, trouble)


def _walk(law: RveLaw, shear: Array, rate: float) -> tuple[Array, float | None]:
    state, stresses, trouble = None, [], None
    for value in shear:
        F, F_dot = (tensor[None] for tensor in steady_shear(rate, float(value))(0.0))
        answer = law.respond(F, F_dot, state)
        stresses.append(answer.stress[0])
        solved = answer.status[0] == Status.OK
        accepted = law.accept(F, F_dot, answer) if solved else None
        state = accepted.state if accepted else None
        if trouble is None and (accepted is None or accepted.status[0] != Status.OK):
            trouble = float(value)
    return np.array(stresses), trouble


Row = tuple[ShearSteps, str]
"""A rate, and a method that is compared there."""
QUANTITIES: tuple[Quantity[Row], ...] = (
    Quantity("method", "", "", lambda row: row[1]),
    Quantity("rate", "1/µs", "g", lambda row: row[0].rate),
    Quantity("reference", "", "", lambda row: row[0].reference),
    Quantity(
        "largest difference",
        "µN/µm",
        ".3g",
        lambda row: float(np.nanmax(row[0].difference(row[1])[1])),
    ),
    Quantity("compared from shear", "", "g", lambda row: float(row[0].difference(row[1])[0][0])),
    Quantity("unstable from shear", "", "g", lambda row: row[0].unstable_from[row[1]]),
)


def describe(runs: Sequence[ShearSteps], preset: str) -> Study:
    """Figure 5: σ_xy above, σ_xx below; one column for each rate; then the differences."""
    stresses = {
        f"sigma_{label} {method} at rate {run.rate:g} (µN/µm)": stress[:, a, b]
        for run in runs
        for method, stress in run.stress.items()
        for label, (a, b) in _COMPONENTS.items()
    }
    integrated = [run for run in runs if run.reference == INTEGRATED]
    others = [(run, method) for run in runs for method in run.stress if method != run.reference]
    return Study(
        name=f"fig5-{preset}",
        title=f"Figure 5: stress of one RVE over shear steps, preset “{preset}”",
        panels=(
            *(_panel(run, label) for label in _COMPONENTS for run in runs),
            *(_error_panel(run, label) for run in integrated for label in _COMPONENTS),
        ),
        columns=len(runs),
        table=Table(QUANTITIES, others),
        series={"F_xy (1)": runs[0].shear, **stresses},
    )


def _panel(run: ShearSteps, label: str) -> Panel:
    a, b = _COMPONENTS[label]
    curves = [
        Curve(method, run.shear, stress[:, a, b])
        for method, stress in run.stress.items()
        if method != INTEGRATED
    ]
    if INTEGRATED in run.stress:
        line = run.stress[INTEGRATED][:, a, b]
        curves.insert(0, Curve(INTEGRATED, run.shear, line, "integrated in time", markers=False))
    return Panel(
        title=rf"$\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$\sigma_{{{label}}}$ (µN/µm)",
        curves=tuple(curves),
    )


def _error_panel(run: ShearSteps, label: str) -> Panel:
    """Difference from the integrated line once its start has died away; lines coincide above."""
    a, b = _COMPONENTS[label]
    curves = []
    for method in INITIALISATIONS:
        shear, error = run.difference(method)
        curves.append(Curve(method, shear, np.where(error > 0, error, np.nan)[:, a, b]))
    return Panel(
        title=rf"against integrated, $\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$|\Delta\sigma_{{{label}}}|$ (µN/µm)",
        curves=tuple(curves),
        log_y=True,
    )
