"""Elastic and viscous moduli of a plant cell at rest, from the exact tangents of the stress.

At F = I and Ḟ = 0 the stress vanishes, so ∂P/∂F and ∂P/∂Ḟ are the moduli of small strain and of
its rate. In Voigt's order xx, yy, xy (engineering shear, minor symmetries taken) they make a
3 × 3 matrix C, of which::

    bulk K = (C₁₁ + C₁₂)/2         shear along the axes G₀ = C₆₆, at 45° G₄₅ = (C₁₁ − C₁₂)/2
    Young E = C₁₁ − C₁₂²/C₂₂       Poisson ν = C₁₂/C₂₂        (pulled along x, free across)

All are two-dimensional; divided by the thickness of the tissue they are in MPa and MPa µs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.rve.particles import look_into

MODULI: Mapping[str, Callable[[Array], float]] = {
    "C11": lambda C: C[0, 0],
    "C12": lambda C: C[0, 1],
    "C66": lambda C: C[2, 2],
    "bulk": lambda C: (C[0, 0] + C[0, 1]) / 2.0,
    "shear": lambda C: C[2, 2],
    "shear 45°": lambda C: (C[0, 0] - C[0, 1]) / 2.0,
    "young": lambda C: C[0, 0] - C[0, 1] * C[1, 0] / C[1, 1],
    "poisson": lambda C: C[1, 0] / C[1, 1],
}
"""Of a matrix (3, 3), by name; all but Poisson's ratio in its unit."""


@dataclass(frozen=True, slots=True)
class CellModuli:
    """Matrices (3, 3) of one initialisation: elastic in µN/µm = N/m, viscous in µN µs/µm."""

    elastic: Array
    viscous: Array


def cell_moduli(cell: CellParameters, initialisation: str) -> CellModuli:
    """Moduli at rest. One-sided where a pair sits at the cut-off of the repulsion.

    Raises:
        InputError: the plant cell has no equilibrium at rest.
    """
    F, law = np.eye(2)[None], RveLaw(cell, initialisation=initialisation)
    tangents = law.respond(F, 0.0 * F, tangents=True).tangents
    if tangents is None or not np.isfinite(tangents.P_by_F).all():
        raise InputError(f"moduli: no equilibrium at rest by initialisation {initialisation}")
    return CellModuli(voigt(tangents.P_by_F[0]), voigt(tangents.P_by_F_dot[0]))


def voigt(tangent: Array) -> Array:
    """(3, 3) of a tangent (2, 2, 2, 2), its minor symmetries taken: xx, yy, xy."""
    symmetric = 0.5 * (tangent + tangent.transpose(1, 0, 2, 3))
    symmetric = 0.5 * (symmetric + symmetric.transpose(0, 1, 3, 2))
    a, b = np.array([0, 1, 0]), np.array([0, 1, 1])
    return np.asarray(symmetric[a[:, None], b[:, None], a[None], b[None]])


def turgor(cell: CellParameters) -> float:
    """Pressure that the tension of the walls carries in the reference state, MPa.

    It is the virial of the wall springs and of the repulsion between wall particles, over the
    thickness. A uniform fluid has this pressure. The mean of c_s² ρ over SPH particles is smaller,
    since walls and fluid repel each other over a distance and the fluid does not fill the cell.
    """
    unit, still = RveLaw(cell).unit_cell, np.zeros((1, 2, 2))
    position = unit.position[None]
    seen = look_into(unit, np.eye(2)[None], still, position, 0.0 * position)
    return float(np.trace(seen.wall_stress[0])) / 2.0 / cell.tissue_thickness


def with_turgor(cell: CellParameters, pressure: float) -> CellParameters:
    """The cell with the fluid mass that gives it a `turgor`, MPa.

    p = c_s² ρ has no reference density, so the mass sets the pressure.

    Raises:
        InputError: not positive, or more than the walls bear at any rest length.
    """
    if not 0.0 < pressure < float("inf"):
        raise InputError(f"turgor: {pressure}; it must be positive (MPa)")

    # Mass of a fluid that fills the cell evenly; pressure grows nearly in proportion. SPH fluid is
    # carried by walls with a sixth more.
    spread = cell.cell_side**2 / cell.fluid_particles_per_side**2
    guess = pressure * cell.tissue_thickness / cell.sound_speed**2 * spread

    def excess(mass: float) -> float:
        return turgor(replace(cell, fluid_particle_mass=mass)) / pressure - 1.0

    try:
        mass = float(brentq(excess, 0.6 * guess, 1.6 * guess, rtol=1e-10))
    except InputError:
        raise
    except ValueError:
        message = f"turgor: {pressure} MPa; no fluid mass near {guess:.3g} ng gives it"
        raise InputError(message) from None
    return replace(cell, fluid_particle_mass=mass)


def moduli_tables(cell: CellParameters, found: Mapping[str, CellModuli]) -> dict[str, Table[Any]]:
    """By title: elastic and viscous moduli by initialisation, in 2D and over the thickness."""
    tables = {}
    for kind, unit in (("elastic", ""), ("viscous", " µs")):
        for of, over in (("N/m", 1.0), ("MPa", cell.tissue_thickness)):
            rows = [
                {"initialisation": method}
                | {name: float(of_C(getattr(each, kind) / over)) for name, of_C in MODULI.items()}
                for method, each in found.items()
            ]
            columns: list[Quantity[Any]] = [Quantity("initialisation", "", "")]
            columns += [Quantity(name, "", ".4g") for name in MODULI]
            tables[f"{kind.capitalize()} moduli, {of}{unit}"] = Table(columns, rows)
    return tables
