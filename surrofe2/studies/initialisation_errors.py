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
from surrofe2.report.study import Curve, Panel, Study
from surrofe2.rve import INITIALISATIONS, RveLaw
from surrofe2.rve.micro_integration import integrate_rve
from surrofe2.studies.drives import along, oscillation

Array = NDArray[np.float64]

EXPECTED = {"cauchy-born": 0, "elastic": 1, "constrained-runs": 1, "slow-manifold": 2}
"""Order in the rate of the error of each initialisation."""


@dataclass(frozen=True, slots=True)
class InitialisationErrors:
    """rate: (k,) largest entry of Ḟ, 1/µs. error: by initialisation, (k,) largest stress error,
    µN/µm. order: slope of log error over log rate. stress: (k,) largest stress, µN/µm."""

    rate: Array
    error: Mapping[str, Array]
    order: Mapping[str, float]
    stress: Array


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
    rows: dict[str, list[float]] = {name: [] for name in laws}
    rates, scales = [], []
    for done, slow in enumerate(slowness):
        path, moments = oscillation(slow), slow * np.array(times)
        exact = integrate_rve(laws["elastic"], path, moments, micro_step)[1:]
        F, F_dot = along(path, moments[1:])
        for name, law in laws.items():
            rows[name].append(float(np.abs(law.respond(F, F_dot).stress - exact).max()))
        rates.append(float(np.abs(along(path, moments)[1]).max()))
        scales.append(float(np.abs(exact).max()))
        progress((done + 1) / len(slowness))
    rate = np.array(rates)
    error = {name: np.array(values) for name, values in rows.items()}
    return InitialisationErrors(
        rate, error, {name: order(rate, e) for name, e in error.items()}, np.array(scales)
    )


def order(rate: Array, error: Array) -> float:
    """Slope of log error (k,) over log rate (k,), by least squares."""
    return float(np.polyfit(np.log(rate), np.log(error), 1)[0])


def describe(errors: InitialisationErrors, preset: str, name: str) -> Study:
    """The log-log figure with its fitted orders."""
    curves = tuple(
        Curve(method, errors.rate, e, f"{method}, order {abs(errors.order[method]):.2f}")
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
        name=name,
        title="Error of each initialisation against the RVE integrated in time,\n"
        f"oscillating drive slowed by 1, 2, 4, 8; preset “{preset}”",
        panels=(panel,),
        columns=1,
        table={
            "rate (1/µs)": errors.rate,
            "largest stress (µN/µm)": errors.stress,
            **{f"error {method} (µN/µm)": e for method, e in errors.error.items()},
        },
        results={
            "order": dict(errors.order),
            "expected_order": EXPECTED,
            "rate": errors.rate,
            "error": dict(errors.error),
        },
        units={"order": "1", "rate": "1/µs", "error": "µN/µm"},
    )
