"""How wrong each initialisation is, as the rate goes down.

The same way through F, slowed by s, has Ḟ ∝ 1/s and F̈ ∝ 1/s². Against the RVE integrated in time
the stress of Cauchy–Born is wrong by O(1), elastic equilibrium and constrained runs by O(Ḟ), the
slow manifold by O(Ḟ², F̈): orders 0, 1, 1, 2 in the rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import INITIALISATIONS, RveLaw
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.studies.drives import along, oscillation

Array = NDArray[np.float64]

EXPECTED = {"cauchy-born": 0, "elastic": 1, "constrained-runs": 1, "slow-manifold": 2}
"""Order in the rate of the error of each initialisation."""


@dataclass(frozen=True, slots=True)
class InitialisationErrors:
    """rate: (k,) largest entry of Ḟ, 1/µs. stress: (k,) largest stress, µN/µm. error: by
    initialisation, (k,) largest stress error, µN/µm."""

    rate: Array
    stress: Array
    error: Mapping[str, Array]

    def order(self, name: str) -> float:
        """Slope of log error over log rate, by least squares."""
        return float(np.polyfit(np.log(self.rate), np.log(self.error[name]), 1)[0])


def initialisation_errors(
    cell: CellParameters,
    slowness: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0),
    *,
    times: tuple[float, ...] = (0.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0),
    micro_step: float = 2e-3,
    progress: Callable[[float], None] = lambda done: None,
) -> InitialisationErrors:
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
        F, F_dot = along(path, moments[1:])
        for name, law in laws.items():
            errors[name].append(float(np.abs(law.respond(F, F_dot).stress - exact).max()))
        rates.append(float(np.abs(along(path, moments)[1]).max()))
        stresses.append(float(np.abs(exact).max()))
        progress((done + 1) / len(slowness))
    error = {name: np.array(values) for name, values in errors.items()}
    return InitialisationErrors(np.array(rates), np.array(stresses), error)


def describe(errors: InitialisationErrors, preset: str) -> Study:
    """The log-log figure with its fitted orders."""
    quantities: tuple[Quantity[str], ...] = (
        Quantity("initialisation", "", "", lambda method: method),
        Quantity("order", "", ".3f", errors.order),
        Quantity("expected order", "", "d", EXPECTED.get),
        Quantity("largest error", "µN/µm", ".3g", lambda method: float(errors.error[method].max())),
    )
    curves = tuple(
        Curve(method, errors.rate, e, f"{method}, order {abs(errors.order(method)):.2f}")
        for method, e in errors.error.items()
    )
    panel = Panel(
        x_label=r"largest rate $|\dot F|$ (µs$^{-1}$)",
        y_label="largest stress error (µN/µm)",
        curves=curves,
        log_x=True,
        log_y=True,
    )
    return Study(
        name=f"rates-{preset}",
        title="Error of each initialisation against the RVE integrated in time,\n"
        f"oscillating drive slowed by 1, 2, 4, 8; preset “{preset}”",
        panels=(panel,),
        table=Table(quantities, tuple(errors.error)),
        series={
            "rate (1/µs)": errors.rate,
            "largest stress (µN/µm)": errors.stress,
            **{f"error {method} (µN/µm)": e for method, e in errors.error.items()},
        },
    )
