"""The stress of each initialisation against an RVE integrated in time.

Figure 5: one RVE over shear steps F_α (eq. 73), at rest and at a rate.

Orders in the rate: the same way through F, slowed by s, has Ḟ ∝ 1/s and F̈ ∝ 1/s². The stress of
Cauchy–Born is wrong by O(1), elastic equilibrium and constrained runs by O(Ḟ), the slow manifold by
O(Ḟ², F̈): orders 0, 1, 1, 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from surrofe2.studies.drives import SHEAR_RATE, along, oscillation, steady_shear

Array = NDArray[np.float64]

INTEGRATED = "micro-integration"
_SETTLED = 0.02
"""Shear from which the integrated line is compared: its start from rest has died away."""
_COMPONENTS = {"xy": (0, 1), "xx": (0, 0)}

EXPECTED = {"cauchy-born": 0, "elastic": 1, "constrained-runs": 1, "slow-manifold": 2}
"""Order in the rate of the error of each initialisation."""
SLOWNESS = (1.0, 2.0, 4.0, 8.0)


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
        times = shear / rate
        stress[INTEGRATED] = integrate_rve(RveLaw(cell), steady_shear(rate), times, micro_step)
    return ShearSteps(rate, shear, stress, trouble)


def _walk(law: RveLaw, shear: Array, rate: float) -> tuple[Array, float | None]:
    state, stresses, trouble = None, [], None
    for value in shear:
        F, F_dot = (tensor[None] for tensor in steady_shear(rate, float(value))(0.0))
        answer = law.respond(F, F_dot, state)
        stresses.append(answer.stress[0])
        status, state = answer.status[0], None
        if status == Status.OK:
            accepted = law.accept(F, F_dot, answer)
            status, state = accepted.status[0], accepted.state
        if trouble is None and status != Status.OK:
            trouble = float(value)
    return np.array(stresses), trouble


Row = tuple[ShearSteps, str]
"""A rate, and a method that is compared there."""
FIGURE_5: tuple[Quantity[Row], ...] = (
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


def figure_5(runs: Sequence[ShearSteps]) -> Study:
    """σ_xy above, σ_xx below, a column for each rate; then the differences where one integrated."""
    panels = [
        Panel(
            title=rf"$\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
            x_label="shear $F_{xy}$",
            y_label=rf"$\sigma_{{{label}}}$ (µN/µm)",
            curves=tuple(Curve(name, run.shear, s[:, a, b]) for name, s in run.stress.items()),
        )
        for label, (a, b) in _COMPONENTS.items()
        for run in runs
    ]
    for run in runs:
        if run.reference != INTEGRATED:
            continue
        apart = {name: run.difference(name) for name in INITIALISATIONS}
        panels += [
            Panel(
                title=rf"against integrated, $\dot F_{{xy}}$ = {run.rate:g} µs$^{{-1}}$",
                x_label="shear $F_{xy}$",
                y_label=rf"$|\Delta\sigma_{{{label}}}|$ (µN/µm)",
                curves=tuple(Curve(name, x, e[:, a, b]) for name, (x, e) in apart.items()),
                log_y=True,
            )
            for label, (a, b) in _COMPONENTS.items()
        ]
    return Study(
        title="Figure 5: stress of one RVE over shear steps",
        panels=tuple(panels),
        columns=len(runs),
        table=Table(
            FIGURE_5, [(r, name) for r in runs for name in r.stress if name != r.reference]
        ),
        series={
            "F_xy (1)": runs[0].shear,
            **{
                f"sigma_{label} {name} at rate {run.rate:g} (µN/µm)": stress[:, a, b]
                for run in runs
                for name, stress in run.stress.items()
                for label, (a, b) in _COMPONENTS.items()
            },
        },
    )


@dataclass(frozen=True, slots=True)
class RateErrors:
    """rate: (k,) largest entry of Ḟ, 1/µs. stress: (k,) largest stress, µN/µm. error: by
    initialisation, (k,) largest stress error, µN/µm."""

    rate: Array
    stress: Array
    error: Mapping[str, Array]

    def order(self, name: str) -> float:
        """Slope of log error over log rate, by least squares."""
        return float(np.polyfit(np.log(self.rate), np.log(self.error[name]), 1)[0])


def rate_errors(
    cell: CellParameters,
    slowness: Sequence[float] = SLOWNESS,
    *,
    times: Sequence[float] = (0.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0),
    micro_step: float = 2e-3,
    progress: Callable[[float], None] = lambda done: None,
) -> RateErrors:
    """Stress errors against micro-integration along `drives.oscillation`.

    Args:
        times: µs at slowness 1, from rest; all but the first are compared, the start's own
            motion having died away.
        progress: called with the fraction that is done.
    """
    laws = {name: RveLaw(cell, initialisation=name) for name in INITIALISATIONS}
    errors: dict[str, list[float]] = {name: [] for name in laws}
    rates, stresses = [], []
    for done, slow in enumerate(slowness):
        path, moments = oscillation(slow), slow * np.array(times)
        exact = integrate_rve(laws["elastic"], path, moments, micro_step)[1:]
        F, F_dot = along(path, moments)
        for name, law in laws.items():
            errors[name].append(float(np.abs(law.respond(F[1:], F_dot[1:]).stress - exact).max()))
        rates.append(float(np.abs(F_dot).max()))
        stresses.append(float(np.abs(exact).max()))
        progress((done + 1) / len(slowness))
    error = {name: np.array(values) for name, values in errors.items()}
    return RateErrors(np.array(rates), np.array(stresses), error)


def orders_in_the_rate(errors: RateErrors) -> Study:
    """The log-log figure with its fitted orders."""
    quantities: tuple[Quantity[str], ...] = (
        Quantity("initialisation", "", "", lambda name: name),
        Quantity("order", "", ".3f", errors.order),
        Quantity("expected order", "", "d", EXPECTED.get),
        Quantity("largest error", "µN/µm", ".3g", lambda name: float(errors.error[name].max())),
    )
    panel = Panel(
        x_label=r"largest rate $|\dot F|$ (µs$^{-1}$)",
        y_label="largest stress error (µN/µm)",
        curves=tuple(
            Curve(name, errors.rate, error, f"{name}, order {abs(errors.order(name)):.2f}")
            for name, error in errors.error.items()
        ),
        log_x=True,
        log_y=True,
    )
    return Study(
        title="Error of each initialisation against the RVE integrated in time,\n"
        f"oscillating drive slowed by {', '.join(f'{slow:g}' for slow in SLOWNESS)}",
        panels=(panel,),
        table=Table(quantities, tuple(errors.error)),
        series={
            "rate (1/µs)": errors.rate,
            "largest stress (µN/µm)": errors.stress,
            **{f"error {name} (µN/µm)": error for name, error in errors.error.items()},
        },
    )
