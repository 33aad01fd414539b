"""The tissue at rest without load: damped dynamics to a stated residual force.

Dashpots and viscosity, which do not change the equilibrium, are taken out, and a drag −c m v on
every particle is put in. Critical drag of the slowest mode, c = 2 ω, is the fastest; ω² is
estimated on the way from how forces change with positions, −Δx·Δf/(Δx·m Δx) (adaptive dynamic
relaxation). Leapfrog with implicit drag: v ← [(1 − c Δt/2) v + Δt f/m]/(1 + c Δt/2), x ← x + Δt v.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import SimulationError
from surrofe2.tissue.dynamics import TissueDynamics

Array = NDArray[np.float64]

STRETCH = 50
"""Steps between two estimates of the slowest mode."""
LIMIT = 200_000
"""Steps after which relaxation gives up."""
HALVINGS = 4
"""How often a step that turns out unstable is halved."""
_STEP = 0.36
"""Step times √(k/m) of the wall; undamped springs are stable up to 1."""
_FIRST_DRAG = 0.02
"""First drag, times √(k/m)."""

_log = logging.getLogger(__name__)


def relax(dynamics: TissueDynamics, residual: float) -> Array:
    """Bring all particles to rest in a stable equilibrium; (particles, 2) positions, µm.

    Args:
        dynamics: starts at rest where it is and ends at rest in equilibrium.
        residual: largest force that may remain on a free particle, µN.

    Raises:
        SimulationError: no equilibrium within `LIMIT` steps, or the tissue collapses.
    """
    tissue, start = dynamics.tissue, dynamics.x
    stiffest = max(each.wall_stiffness for each in tissue.types)
    # Of wall particles, which are whole inside; a boundary halves springs and masses alike.
    lightest = min(tissue.wall_masses)
    frequency = np.sqrt(stiffest / lightest)
    for halvings in range(HALVINGS + 1):
        try:
            return _settle(dynamics, residual, _STEP / frequency / 2**halvings, frequency)
        except SimulationError as error:
            _log.info("relaxation: %s; trying half the step", error)
            dynamics.place(start)
    raise SimulationError(
        f"tissue: the unloaded tissue does not come to rest within {residual:g} µN; "
        "check the parameters of the plant cell, or raise tissue.residual"
    )


def _settle(dynamics: TissueDynamics, residual: float, step: float, frequency: float) -> Array:
    constants = dynamics.tissue.constants._replace(
        wall_damping=0.0, contact_damping=0.0, viscosity=0.0
    )
    mass = dynamics.free_mass[:, None]
    drag = _FIRST_DRAG * frequency
    x, f = dynamics.x, dynamics.free_forces(constants)
    for _ in range(0, LIMIT, STRETCH):
        implicit = 1.0 + 0.5 * drag * step
        drifts = np.full(STRETCH, step)
        dynamics.leap(
            drifts / implicit, drifts, np.zeros(STRETCH), constants=constants,
            retained=(1.0 - 0.5 * drag * step) / implicit,
        )  # fmt: skip
        x_before, f_before, x, f = x, f, dynamics.x, dynamics.free_forces(constants)
        if np.hypot(*f.T).max() <= residual:
            dynamics.place(x)
            return x
        moved = x - x_before
        stiffness = -float(np.sum(moved * (f - f_before)))
        square = max(stiffness, 0.0) / float(np.sum(mass * moved * moved))
        drag = float(np.clip(2.0 * np.sqrt(square), 1e-4 * frequency, 0.1 * frequency))
    raise SimulationError("no equilibrium within the limit of steps")
