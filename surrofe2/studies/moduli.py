"""Elastic and viscous moduli of a plant cell at rest, from the exact tangents of the stress.

At F = I and Ḟ = 0 the stress vanishes, so ∂P/∂F and ∂P/∂Ḟ are the moduli of small strain and of
its rate. In Voigt's order xx, yy, xy (engineering shear, minor symmetries taken) they make a
3 × 3 matrix C, of which::

    bulk K = (C₁₁ + C₁₂)/2         shear along the axes G₀ = C₆₆, at 45° G₄₅ = (C₁₁ − C₁₂)/2
    Young E = C₁₁ − C₁₂²/C₂₂       Poisson ν = C₁₂/C₂₂        (pulled along x, free across)

All are two-dimensional; divided by the thickness of the tissue they are in MPa and MPa µs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from surrofe2.errors import InputError
from surrofe2.plant_cell.forces import fluid_specific_volume
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.simd import TILE

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moduli:
    """Moduli of one kind. matrix: (3, 3) Voigt, µN/µm (elastic) or µN µs/µm (viscous)."""

    matrix: Array

    @property
    def bulk(self) -> float:
        """(C₁₁ + C₁₂)/2."""
        return float(self.matrix[0, 0] + self.matrix[0, 1]) / 2.0

    @property
    def shear(self) -> float:
        """C₆₆, along the walls."""
        return float(self.matrix[2, 2])

    @property
    def shear_45(self) -> float:
        """(C₁₁ − C₁₂)/2, at 45° to the walls."""
        return float(self.matrix[0, 0] - self.matrix[0, 1]) / 2.0

    @property
    def young(self) -> float:
        """C₁₁ − C₁₂²/C₂₂."""
        C = self.matrix
        return float(C[0, 0] - C[0, 1] * C[1, 0] / C[1, 1])

    @property
    def poisson(self) -> float:
        """C₁₂/C₂₂."""
        return float(self.matrix[1, 0] / self.matrix[1, 1])

    def to_dict(self) -> dict[str, float]:
        """By name."""
        return {
            "C11": float(self.matrix[0, 0]),
            "C12": float(self.matrix[0, 1]),
            "C66": self.shear,
            "bulk": self.bulk,
            "shear": self.shear,
            "shear_45": self.shear_45,
            "young": self.young,
            "poisson": self.poisson,
        }


@dataclass(frozen=True, slots=True)
class CellModuli:
    """elastic in µN/µm = N/m, viscous in µN µs/µm, of one initialisation."""

    elastic: Moduli
    viscous: Moduli


def cell_moduli(cell: CellParameters, initialisation: str) -> CellModuli:
    """Moduli at rest. One-sided where a pair sits at the cut-off of the repulsion.

    Raises:
        InputError: the plant cell has no equilibrium at rest.
    """
    F = np.eye(2)[None]
    tangents = (
        RveLaw(cell, initialisation=initialisation).respond(F, 0.0 * F, tangents=True).tangents
    )
    if tangents is None or not np.isfinite(tangents.P_by_F).all():
        raise InputError(f"moduli: no equilibrium at rest by initialisation {initialisation}")
    return CellModuli(Moduli(voigt(tangents.P_by_F[0])), Moduli(voigt(tangents.P_by_F_dot[0])))


def voigt(tangent: Array) -> Array:
    """(3, 3) of a tangent (2, 2, 2, 2), its minor symmetries taken: xx, yy, xy."""
    symmetric = 0.5 * (tangent + tangent.transpose(1, 0, 2, 3))
    symmetric = 0.5 * (symmetric + symmetric.transpose(0, 1, 3, 2))
    a, b = np.array([0, 1, 0]), np.array([0, 1, 1])
    return np.asarray(symmetric[a[:, None], b[:, None], a[None], b[None]])


@dataclass(frozen=True, slots=True)
class Turgor:
    """Pressure of the fluid in the reference state, MPa.

    Attributes:
        mean: of c_s² ρ (eq. 9) over the fluid particles, over the thickness: what `turgor` means
            wherever surrofe2 takes it as an input.
        virial: of the fluid's pair forces alone, Σ f·r/(2 area), over the thickness: what the
            fluid adds to −tr σ/2. Smaller, since walls and fluid repel each other over a distance.
    """

    mean: float
    virial: float


def turgor(cell: CellParameters) -> Turgor:
    """Fluid pressure of the undeformed cell."""
    unit = RveLaw(cell).unit_cell
    topology = unit.topologies[0]
    x = np.ascontiguousarray(np.repeat(unit.position.T[..., None], TILE, axis=-1))
    slope = np.empty((len(topology.fluid_pairs), TILE))
    volume = np.empty((topology.particles - topology.walls, TILE))
    fluid_specific_volume(x, topology, unit.constants, slope, volume)
    per_density = volume[:, 0]
    speed = unit.constants.sound_speed_squared
    i, j = topology.fluid_pairs.T
    square = np.sum((unit.position[j] - unit.position[i]) ** 2, axis=1)
    v = per_density[i - topology.walls] + per_density[j - topology.walls]
    pull = cell.fluid_particle_mass**2 * speed * slope[:, 0] * v
    t = cell.tissue_thickness
    return Turgor(
        mean=float(np.mean(speed / per_density)) / t,
        virial=float(-np.sum(pull * square)) / (2.0 * unit.area * t),
    )


def with_turgor(cell: CellParameters, pressure: float) -> CellParameters:
    """The cell with the fluid mass that gives it a turgor (`Turgor.mean`), MPa.

    p = c_s² ρ has no reference density, so mass and pressure go together.

    Raises:
        InputError: not positive, or more than the walls bear at any rest length.
    """
    if not 0.0 < pressure < float("inf"):
        raise InputError(f"turgor: {pressure}; it must be positive (MPa)")

    def heavy(factor: float) -> CellParameters:
        return replace(cell, fluid_particle_mass=guess * factor)

    # Mass of a fluid that fills the cell evenly; pressure grows nearly in proportion.
    spread = cell.cell_side**2 / cell.fluid_particles_per_side**2
    guess = pressure * cell.tissue_thickness / cell.sound_speed**2 * spread

    def excess(factor: float) -> float:
        return turgor(heavy(factor)).mean / pressure - 1.0

    try:
        factor = brentq(excess, 0.6, 1.6, rtol=1e-10)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"turgor: {pressure} MPa; no fluid mass near {guess:.3g} ng gives it"
        ) from None
    return heavy(float(factor))


def to_numbers(cell: CellParameters, moduli: CellModuli) -> dict[str, Any]:
    """Both kinds in 2D and 3D units."""
    t = cell.tissue_thickness
    numbers: dict[str, Any] = {}
    for kind, unit, value in (
        ("elastic", "N/m", moduli.elastic),
        ("viscous", "N/m µs", moduli.viscous),
    ):
        flat = value.to_dict()
        solid = {k: v if k == "poisson" else v / t for k, v in flat.items()}
        numbers[kind] = {unit: flat, unit.replace("N/m", "MPa"): solid}
    return numbers
