"""Figure 5: stress of one RVE over shear steps F_α (eq. 73), for every initialisation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
from surrofe2.studies.drives import SHEAR_RATE, shear_rate_tensor, sheared, steady_shear

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

    @property
    def compared(self) -> NDArray[np.bool_]:
        """(m,) where: from `_SETTLED` on if the reference is integrated."""
        return self.shear >= (_SETTLED if self.reference == INTEGRATED else 0.0)

    def difference(self, method: str) -> Array:
        """|Δσ| from the reference where it is compared, (k, 2, 2)."""
        return np.abs(self.stress[method] - self.stress[self.reference])[self.compared]


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
        lambda row: float(np.nanmax(row[0].difference(row[1]))),
    ),
    Quantity("compared from shear", "", "g", lambda row: float(row[0].shear[row[0].compared][0])),
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
    panels = [_panel(run, label) for label in _COMPONENTS for run in runs]
    panels += [
        _error_panel(run, label)
        for run in runs
        if INTEGRATED in run.stress
        for label in _COMPONENTS
    ]
    return Study(
        name=f"fig5-{preset}",
        title=f"Figure 5: stress of one RVE over shear steps, preset “{preset}”",
        panels=tuple(panels),
        columns=len(runs),
        table=Table(QUANTITIES, [(run, method) for run in runs for method in _others(run)]),
        series={"F_xy (1)": runs[0].shear, **stresses},
    )


def _others(run: ShearSteps) -> Iterator[str]:
    return (method for method in run.stress if method != run.reference)


def _panel(run: ShearSteps, label: str) -> Panel:
    a, b = _COMPONENTS[label]
    order = sorted(run.stress, key=lambda method: method != INTEGRATED)
    return Panel(
        title=rf"$\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$\sigma_{{{label}}}$ (µN/µm)",
        curves=tuple(
            Curve(
                method,
                run.shear,
                run.stress[method][:, a, b],
                "integrated in time" if method == INTEGRATED else "",
                markers=method != INTEGRATED,
            )
            for method in order
        ),
    )


def _error_panel(run: ShearSteps, label: str) -> Panel:
    """Difference from the integrated line once its start has died away; lines coincide above."""
    a, b = _COMPONENTS[label]
    curves = []
    for method in _others(run):
        error = run.difference(method)[:, a, b]
        curves.append(Curve(method, run.shear[run.compared], np.where(error > 0, error, np.nan)))
    return Panel(
        title=rf"against integrated, $\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
        x_label="shear $F_{xy}$",
        y_label=rf"$|\Delta\sigma_{{{label}}}|$ (µN/µm)",
        curves=tuple(curves),
        log_y=True,
    )
