"""Tables of the moduli of a plant cell, and how they change with turgor, walls and particles."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.tables import Quantity, Table
from surrofe2.rve import RveLaw
from surrofe2.studies.moduli import MODULI, CellModuli, Turgor, cell_moduli, turgor, with_turgor

Array = NDArray[np.float64]
Row = TypeVar("Row")

FACTORS = (0.5, 0.75, 1.0, 1.5, 2.0)


def moduli_tables(cell: CellParameters, found: Mapping[str, CellModuli]) -> dict[str, Table[Any]]:
    """By title: elastic and viscous moduli by initialisation, in 2D and over the thickness."""
    t, rows = cell.tissue_thickness, tuple(found.items())
    name: Quantity[tuple[str, CellModuli]] = Quantity("initialisation", "", "", lambda row: row[0])
    matrices: dict[str, Callable[[tuple[str, CellModuli]], Array]] = {
        "Elastic moduli, N/m": lambda row: row[1].elastic,
        "Elastic moduli, MPa": lambda row: row[1].elastic / t,
        "Viscous moduli, N/m µs": lambda row: row[1].viscous,
        "Viscous moduli, MPa µs": lambda row: row[1].viscous / t,
    }
    return {
        title: Table((name, *_moduli_of(matrix, MODULI)), rows)
        for title, matrix in matrices.items()
    }


def _moduli_of(
    matrix: Callable[[Row], Array | None], shown: Container[str], kind: str = ""
) -> list[Quantity[Row]]:
    """Every modulus of the matrix of a row; `kind` goes before the name."""

    def quantity(name: str) -> Quantity[Row]:
        def get(row: Row) -> float | None:
            C = matrix(row)
            return None if C is None else float(MODULI[name](C))

        return Quantity(f"{kind}{name}", "", ".4g" if name in shown else None, get)

    return [quantity(name) for name in MODULI]


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter that is changed: its heading with unit, values about a cell's own, how."""

    heading: str
    values: Callable[[CellParameters], Sequence[float]]
    make: Callable[[CellParameters, float], CellParameters]


def with_wall_springs(cell: CellParameters, n: float) -> CellParameters:
    """n springs a side, the wall as a whole kept: stiffness ∝ n, particle mass and λ ∝ 1/n.

    Repulsion between second neighbours along a wall grows with n all the same, for its cut-off
    does not shrink with the spacing.
    """
    r = n / cell.wall_springs_per_side
    return replace(
        cell,
        wall_springs_per_side=int(n),
        wall_stiffness=cell.wall_stiffness * r,
        wall_particle_mass=cell.wall_particle_mass / r,
        repulsion_strength=cell.repulsion_strength / r,
    )


def with_fluid_particles(cell: CellParameters, n: float) -> CellParameters:
    """n fluid particles a side, the fluid as a whole kept: mass and λ ∝ 1/n², h ∝ 1/n."""
    r = n / cell.fluid_particles_per_side
    return replace(
        cell,
        fluid_particles_per_side=int(n),
        fluid_particle_mass=cell.fluid_particle_mass / r**2,
        smoothing_length=cell.smoothing_length / r,
        repulsion_strength=cell.repulsion_strength / r**2,
    )


CHANGES: Mapping[str, Change] = {
    # by the fluid's mass, everything else kept
    "turgor": Change(
        "turgor (MPa)", lambda cell: [k * turgor(cell).mean for k in FACTORS], with_turgor
    ),
    # the damping constant of the wall follows (eq. 1)
    "wall stiffness": Change(
        "wall stiffness (N/m)",
        lambda cell: [k * cell.wall_stiffness for k in FACTORS],
        lambda cell, stiffness: replace(cell, wall_stiffness=stiffness),
    ),
    "wall particles": Change(
        "wall springs a side", lambda cell: (6, 8, 10, 12, 14), with_wall_springs
    ),
    "fluid particles": Change(
        "fluid particles a side", lambda cell: (2, 4, 6, 8), with_fluid_particles
    ),
}


@dataclass(frozen=True, slots=True)
class ChangedCell:
    """A cell with one value changed; `trouble` says why there are no moduli, else it is empty.

    relative_rest_length: of a wall spring, over its length in the square cell.
    """

    value: float
    trouble: str = ""
    turgor: Turgor | None = None
    relative_rest_length: float | None = None
    moduli: CellModuli | None = None


def changed_cells(
    cell: CellParameters,
    initialisation: str,
    change: Change,
    values: Sequence[float] | None = None,
) -> Table[ChangedCell]:
    """Moduli over a parameter in MPa and MPa µs; those of some are in files alone."""
    t = cell.tissue_thickness
    rows = [
        _changed(cell, initialisation, change, value) for value in values or change.values(cell)
    ]
    quantities: tuple[Quantity[ChangedCell], ...] = (
        Quantity(change.heading, "", ".4g", lambda row: row.value),
        Quantity("mean turgor", "MPa", ".4g", lambda row: row.turgor and row.turgor.mean),
        Quantity("virial turgor", "MPa", None, lambda row: row.turgor and row.turgor.virial),
        Quantity("l₀/spring", "", ".4g", lambda row: row.relative_rest_length),
        *_moduli_of(
            lambda row: row.moduli and row.moduli.elastic / t,
            ("bulk", "shear", "shear 45°", "young"),
        ),
        *_moduli_of(lambda row: row.moduli and row.moduli.viscous / t, ("shear",), "viscous "),
        Quantity("trouble", "", "", lambda row: row.trouble or None),
    )
    return Table(quantities, rows)


def _changed(
    cell: CellParameters, initialisation: str, change: Change, value: float
) -> ChangedCell:
    try:
        changed = change.make(cell, value)
        spring = changed.cell_side / changed.wall_springs_per_side
        relative = RveLaw(changed).rest_length / spring
        moduli = cell_moduli(changed, initialisation)
        return ChangedCell(value, "", turgor(changed), relative, moduli)
    except InputError as error:
        return ChangedCell(value, str(error))
