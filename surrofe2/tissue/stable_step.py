"""How long a leapfrog step a plant cell bears, from its largest frequency and damping at rest.

With lagged velocities a mode of stiffness κ and damping c by its mass is stable while
4 − 2 c Δt − κ Δt² > 0. The largest κ (walls, contacts and fluid) and the largest c of all modes,
taken together, give a limit on the safe side.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.layout import make_tissue

Array = NDArray[np.float64]

LONGEST = 2e-3
"""µs; accuracy asks for no less on the paper's cells."""
_SHARE = 0.87
"""Of the limit at rest, as deformed cells are stiffer; `LONGEST` takes as much of `printed`'s."""
_ITERATIONS = 100
_SHIFT = 1e-6  # µm, of differences


def safe_step(limit: float) -> float:
    """The longest step that a tissue bears in motion too, where it is stable to `limit` at rest."""
    return _SHARE * limit


def rounded_step(limit: float) -> float:
    """`LONGEST`, or what is borne for sure if that is less, rounded down to two digits, µs."""
    wanted = safe_step(limit)
    if wanted >= LONGEST:
        return LONGEST
    unit = 10.0 ** (np.floor(np.log10(wanted)) - 1.0)
    return float(f"{np.floor(wanted / unit) * unit:.2g}")


def stable_step(
    cell: CellParameters, reference: ReferenceState, outside: tuple[float, float] = (0.0, 0.0)
) -> float:
    """The longest stable step of two by two plant cells at rest, µs.

    Args:
        outside: the largest stiffness and damping by mass that what acts on the outline adds, 1/µs²
            and 1/µs.
    """
    dynamics = TissueDynamics(make_tissue(cell, reference, (2, 2)))
    at_rest = dynamics.x
    elastic = dynamics.tissue.constants._replace(
        wall_damping=0.0, contact_damping=0.0, viscosity=0.0
    )

    def stiffness(u: Array) -> Array:
        dynamics.place(at_rest + _SHIFT * u)
        ahead = dynamics.forces(elastic)
        dynamics.place(at_rest - _SHIFT * u)
        return (dynamics.forces(elastic) - ahead) / (2.0 * _SHIFT)

    def damping(v: Array) -> Array:
        dynamics.place(at_rest, v)
        moving = dynamics.forces()
        dynamics.place(at_rest)
        return dynamics.forces() - moving

    mass = dynamics.free_mass[:, None]
    kappa, c = (_largest(product, mass) for product in (stiffness, damping))
    kappa, c = kappa + outside[0], c + outside[1]
    return (sqrt(c * c + 4.0 * kappa) - c) / kappa


def _largest(product: Callable[[Array], Array], mass: Array) -> float:
    """Largest eigenvalue of a matrix by the masses (n, 1), by power iteration."""
    u = np.random.default_rng(1).standard_normal((len(mass), 2))
    found = 0.0
    for _ in range(_ITERATIONS):
        u /= np.sqrt((mass * u * u).sum())
        force = product(u)
        if not force.any():
            return 0.0
        found = max(found, float((u * force).sum()))
        u = force / mass
    return found
