"""How the moduli of a plant cell change with turgor, wall stiffness and particles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.studies.moduli import CellModuli, Turgor, cell_moduli, turgor, with_turgor

TURGOR_FACTORS = (0.5, 0.75, 1.0, 1.5, 2.0)
STIFFNESS_FACTORS = (0.5, 0.75, 1.0, 1.5, 2.0)
WALL_SPRINGS = (6, 8, 10, 12, 14)
FLUID_PARTICLES = (2, 4, 6, 8)


@dataclass(frozen=True, slots=True)
class ModuliRow:
    """One cell of a table; `trouble` says why there are no moduli, else it is empty."""

    value: float
    turgor: Turgor | None
    relative_rest_length: float | None
    moduli: CellModuli | None
    trouble: str = ""


def over_turgor(
    cell: CellParameters, initialisation: str, factors: Sequence[float] = TURGOR_FACTORS
) -> list[ModuliRow]:
    """Turgor (MPa, `Turgor.mean`) by the fluid's mass, everything else kept."""
    here = turgor(cell).mean
    return _rows(initialisation, [here * k for k in factors], lambda p: with_turgor(cell, p))


def over_wall_stiffness(
    cell: CellParameters, initialisation: str, factors: Sequence[float] = STIFFNESS_FACTORS
) -> list[ModuliRow]:
    """Stiffness of a wall spring, N/m; the damping constant of the wall follows (eq. 1)."""
    values = [cell.wall_stiffness * k for k in factors]
    return _rows(initialisation, values, lambda k: replace(cell, wall_stiffness=k))


def over_wall_particles(
    cell: CellParameters, initialisation: str, counts: Sequence[int] = WALL_SPRINGS
) -> list[ModuliRow]:
    """Springs a side, the wall as a whole kept: stiffness ∝ n, particle mass and λ ∝ 1/n.

    Repulsion between second neighbours along a wall grows with n all the same, for its cut-off
    does not shrink with the spacing.
    """

    def refined(n: float) -> CellParameters:
        r = n / cell.wall_springs_per_side
        return replace(
            cell,
            wall_springs_per_side=int(n),
            wall_stiffness=cell.wall_stiffness * r,
            wall_particle_mass=cell.wall_particle_mass / r,
            repulsion_strength=cell.repulsion_strength / r,
        )

    return _rows(initialisation, counts, refined)


def over_fluid_particles(
    cell: CellParameters, initialisation: str, counts: Sequence[int] = FLUID_PARTICLES
) -> list[ModuliRow]:
    """Fluid particles a side, the fluid as a whole kept: mass and λ ∝ 1/n², h ∝ 1/n."""

    def refined(n: float) -> CellParameters:
        r = n / cell.fluid_particles_per_side
        return replace(
            cell,
            fluid_particles_per_side=int(n),
            fluid_particle_mass=cell.fluid_particle_mass / r**2,
            smoothing_length=cell.smoothing_length / r,
            repulsion_strength=cell.repulsion_strength / r**2,
        )

    return _rows(initialisation, counts, refined)


TABLES: Mapping[str, tuple[str, Callable[[CellParameters, str], list[ModuliRow]]]] = {
    "turgor": ("turgor (MPa)", over_turgor),
    "wall stiffness": ("wall stiffness (N/m)", over_wall_stiffness),
    "wall particles": ("wall springs a side", over_wall_particles),
    "fluid particles": ("fluid particles a side", over_fluid_particles),
}


def _rows(
    initialisation: str, values: Sequence[float], make: Callable[[float], CellParameters]
) -> list[ModuliRow]:
    return [_row(initialisation, value, make) for value in values]


def _row(initialisation: str, value: float, make: Callable[[float], CellParameters]) -> ModuliRow:
    try:
        cell = make(value)
        spring = cell.cell_side / cell.wall_springs_per_side
        relative = RveLaw(cell).rest_length / spring
        return ModuliRow(value, turgor(cell), relative, cell_moduli(cell, initialisation))
    except InputError as error:
        return ModuliRow(value, None, None, None, str(error))


def to_numbers(row: ModuliRow) -> dict[str, Any]:
    """For JSON."""
    if row.moduli is None or row.turgor is None:
        return {"value": row.value, "trouble": row.trouble}
    return {
        "value": row.value,
        "turgor_mean": row.turgor.mean,
        "turgor_virial": row.turgor.virial,
        "rest_length_per_spring": row.relative_rest_length,
        "elastic": row.moduli.elastic.to_dict(),
        "viscous": row.moduli.viscous.to_dict(),
    }
