"""Elastic and viscous moduli of a plant cell at rest, from the exact tangents of the stress.

At F = I and Ḟ = 0 the stress vanishes, so ∂P/∂F and ∂P/∂Ḟ are the moduli of small strain and of
its rate. In Voigt's order xx, yy, xy (engineering shear, minor symmetries taken) they make a
3 × 3 matrix C, of which::

    bulk K = (C₁₁ + C₁₂)/2         shear along the axes G₀ = C₆₆, at 45° G₄₅ = (C₁₁ − C₁₂)/2
    Young E = C₁₁ − C₁₂²/C₂₂       Poisson ν = C₁₂/C₂₂        (pulled along x, free across)

Along n = (cos θ, sin θ), with m across it and S = C⁻¹, a test finds::

    1/E = v·S v      ν = −E w·S v      1/G = u·S u
    v = (n₁², n₂², n₁n₂)      w = (m₁², m₂², m₁m₂)      u = (2 n₁m₁, 2 n₂m₂, n₁m₂ + n₂m₁)

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
from surrofe2.plant_cell.measurements import check_turgor, even_pressure
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.stability import WAYS, find_onset
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.rve.particles import look_into

# Moduli of a matrix (3, 3) by name; all but Poisson's ratio are in its unit.
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


def _along(degrees: float) -> tuple[Array, Array, Array]:
    """Compute v, w and u of the module's formulas: stress along and across, and shear."""
    angle = np.deg2rad(degrees)
    n = np.array([np.cos(angle), np.sin(angle)])
    m = np.array([-n[1], n[0]])
    v = np.array([n[0] ** 2, n[1] ** 2, n[0] * n[1]])
    w = np.array([m[0] ** 2, m[1] ** 2, m[0] * m[1]])
    u = np.array([2.0 * n[0] * m[0], 2.0 * n[1] * m[1], n[0] * m[1] + n[1] * m[0]])
    return v, w, u


def young(C: Array, degrees: float) -> float:
    """Compute Young's modulus of C (3, 3) in this direction from x towards y, in the unit of C."""
    v, _, _ = _along(degrees)
    return float(1.0 / (v @ np.linalg.solve(C, v)))


def poisson(C: Array, degrees: float) -> float:
    """Compute Poisson's ratio of C pulled in this direction and free across."""
    v, w, _ = _along(degrees)
    strain = np.linalg.solve(C, v)
    return float(-(w @ strain) / (v @ strain))


def shear_modulus(C: Array, degrees: float) -> float:
    """Compute the modulus of shear between this direction and the one across."""
    _, _, u = _along(degrees)
    return float(1.0 / (u @ np.linalg.solve(C, u)))


@dataclass(frozen=True, slots=True)
class CellModuli:
    """Matrices (3, 3) of one initialisation: elastic in µN/µm = N/m, viscous in µN µs/µm."""

    elastic: Array
    viscous: Array


def cell_moduli(cell: CellParameters, initialisation: str) -> CellModuli:
    """Compute the moduli at rest; one-sided where a pair sits at the cut-off of the repulsion.

    Raises:
        InputError: the plant cell has no equilibrium at rest.
    """
    F = np.eye(2)[None]
    law = RveLaw(cell, initialisation=initialisation)
    tangents = law.respond(F, 0.0 * F, tangents=True).tangents
    if tangents is None or not np.isfinite(tangents.P_by_F).all():
        raise InputError(f"moduli: no equilibrium at rest by initialisation {initialisation}")
    return CellModuli(voigt(tangents.P_by_F[0]), voigt(tangents.P_by_F_dot[0]))


def voigt(tangent: Array) -> Array:
    """Return the matrix (3, 3), xx, yy, xy, of a tangent (2, 2, 2, 2) with minor symmetries."""
    symmetric = 0.5 * (tangent + tangent.transpose(1, 0, 2, 3))
    symmetric = 0.5 * (symmetric + symmetric.transpose(0, 1, 3, 2))
    a = np.array([0, 1, 0])
    b = np.array([0, 1, 1])
    return np.asarray(symmetric[a[:, None], b[:, None], a[None], b[None]])


def turgor(cell: CellParameters) -> float:
    """Compute the pressure that the tension of the walls carries in the reference state, MPa.

    It is the virial of the wall springs and of the repulsion between wall particles, over the
    thickness. A uniform fluid has this pressure. The mean of c_s² ρ over SPH particles is smaller,
    since walls and fluid repel each other over a distance and the fluid does not fill the cell.
    """
    unit = RveLaw(cell).unit_cell
    still = np.zeros((1, 2, 2))
    position = unit.position[None]
    seen = look_into(unit, np.eye(2)[None], still, position, 0.0 * position)
    return float(np.trace(seen.wall_stress[0])) / 2.0 / cell.tissue_thickness


def with_turgor(cell: CellParameters, pressure: float) -> CellParameters:
    """Return the cell with that `turgor`, MPa, at the density that it has.

    The sound speed sets the pressure c_s² ρ of the fluid. Contacts are as much stronger as the
    turgor, as in `LivingTissue`, so that the distance of walls and fluid stays.

    Raises:
        InputError: not positive, or more than the walls bear at any rest length.
    """
    check_turgor("turgor", pressure)
    if not 0.0 < pressure < float("inf"):
        raise InputError(f"turgor: {pressure}; it must be positive (MPa)")

    def scaled(ratio: float) -> CellParameters:
        """Return the cell with so many times the pressure of its fluid."""
        return replace(
            cell,
            sound_speed=cell.sound_speed * ratio**0.5,
            repulsion_strength=cell.repulsion_strength * ratio,
        )

    # ratio of a fluid that fills the cell evenly, as a uniform one does
    even = pressure / even_pressure(cell)
    if cell.has_uniform_fluid:
        return scaled(even)

    def excess(ratio: float) -> float:
        """Return by which fraction the turgor exceeds what is wanted."""
        return turgor(scaled(ratio)) / pressure - 1.0

    try:  # walls carry a sixth more than the mean pressure of SPH particles
        return scaled(float(brentq(excess, 0.6 * even, 1.6 * even, rtol=1e-10)))
    except InputError:
        raise
    except ValueError:
        speed = cell.sound_speed * even**0.5
        message = f"turgor: {pressure} MPa; no sound speed near {speed:.3g} µm/µs gives it"
        raise InputError(message) from None


def experiment_table(cell: CellParameters) -> Table[Any]:
    """Return what experiments at rest would measure: moduli, turgor, walls, stability.

    Moduli are drained or not as the cell's sap is, and of slow tests, whose particles relax.

    Raises:
        InputError: the plant cell has no equilibrium at rest.
    """
    C = cell_moduli(cell, "elastic").elastic / cell.tissue_thickness
    onset = find_onset(cell, *WAYS["uniaxial compression"])
    furthest = WAYS["uniaxial compression"][1]
    walls = RveLaw(cell).particles(np.eye(2)[None], np.zeros((1, 2, 2)))
    rows: list[dict[str, Any]] = [
        {"quantity": f"{name} {where}", "value": of(C, degrees), "unit": unit}
        for name, of, unit, places in _TESTS
        for where, degrees in places.items()
    ]
    rows += [
        {"quantity": "turgor", "value": turgor(cell), "unit": "MPa"},
        {
            "quantity": "mean stretch of the walls by the turgor",
            "value": 100.0 * (float(walls.stretch.mean()) - 1.0),
            "unit": "%",
        },
        {
            "quantity": "stable in compression along x up to",
            "value": 100.0 * (furthest if onset is None else onset),
            "unit": "% and beyond" if onset is None else "%",
        },
    ]
    return Table((Quantity("quantity", "", ""), Quantity("value", "", ".4g"), _UNIT), rows)


_AXES = {"along x": 0.0, "along y": 90.0, "at 45°": 45.0}
# Name, formula, unit and directions of each modulus.
_TESTS: tuple[tuple[str, Callable[[Array, float], float], str, dict[str, float]], ...] = (
    ("Young's modulus", young, "MPa", _AXES),
    ("shear modulus", shear_modulus, "MPa", {"along the axes": 0.0, "at 45°": 45.0}),
    ("Poisson's ratio", poisson, "", _AXES),
)
_UNIT: Quantity[Any] = Quantity("unit", "", "")


def moduli_tables(
    cell: CellParameters, by_method: Mapping[str, CellModuli]
) -> dict[str, Table[Any]]:
    """Make tables of elastic and viscous moduli by initialisation, in 2D and over the thickness.

    Returns:
        The tables by title.
    """
    tables = {}
    for kind, unit in (("elastic", ""), ("viscous", " µs")):
        for of, over in (("N/m", 1.0), ("MPa", cell.tissue_thickness)):
            rows = []
            for method, moduli in by_method.items():
                matrix = getattr(moduli, kind) / over
                values = {name: float(modulus_of(matrix)) for name, modulus_of in MODULI.items()}
                rows.append({"initialisation": method, **values})
            columns: list[Quantity[Any]] = [Quantity("initialisation", "", "")]
            columns += [Quantity(name, "", ".4g") for name in MODULI]
            tables[f"{kind.capitalize()} moduli, {of}{unit}"] = Table(columns, rows)
    return tables
