"""Living plant cells by what was measured of them: turgor, walls, size, sap and density.

Beside a preset that is made of measurements, `LivingTissue`, others replace the preset's. The
constants follow by docs/cells.md, “Translation”, and `measurements_of` goes the way back::

    cell = living_cell("apple", turgor=0.6, wall_modulus=250.0)     # MPa
    measurements_of(cell)["turgor"]                                # 0.6
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from math import isclose, sqrt
from typing import Any

from surrofe2.base.errors import InputError, quoted
from surrofe2.plant_cell.parameters import LIVING, WALL_DENSITY, CellParameters, LivingTissue

MEASUREMENTS = tuple(item.name for item in fields(LivingTissue))
"""Names of what is measured, as recipes have them in [cell] beside a preset of living cells."""
DETERMINED: dict[str, tuple[str, ...]] = {
    "cell_size": ("cell_side",),
    "turgor": ("sound_speed",),
    "wall_modulus": ("wall_stiffness",),
    "wall_thickness": ("wall_stiffness", "wall_particle_mass"),
    "sap_viscosity": ("viscosity",),
    "density": ("fluid_particle_mass",),
}
"""Constants that a measurement determines, and over which it wins."""
RESOLUTION = ("wall_springs_per_side", "fluid_particles_per_side", "tissue_thickness")
"""Constants that say how finely a tissue is resolved and how thick a layer of it is computed. They
leave a measured tissue as it is."""
_USUAL = 1e-6
"""Relative difference up to which contacts of SPH fluid are those of living cells."""


def living_cell(preset: str, **changes: Any) -> CellParameters:
    """Return the constants of a preset with some measurements, and other constants, changed.

    Measurements win over the constants that they determine (`DETERMINED`), and `RESOLUTION` does
    not change what was measured. Without a measurement among the changes it is
    `CellParameters.preset`, whose constants replace those of the preset and nothing else.

    Args:
        preset: preset of living cells; any, where no measurement is among the changes.
        changes: fields of `LivingTissue` and of `CellParameters`.

    Raises:
        InputError: a name is unknown, a value out of bounds, or a measurement stands beside a
            preset that is not made of measurements.

    Examples:
        The shear modulus of apple flesh at rest, at its turgor of 0.4 MPa and wilted to 0.1 MPa:

        >>> import numpy as np
        >>> from surrofe2 import RveLaw, living_cell
        >>> rest = np.eye(2)[None]
        >>> no_rate = np.zeros((1, 2, 2))
        >>> for turgor in (0.4, 0.1):
        ...     cell = living_cell("apple", turgor=turgor)
        ...     answer = RveLaw(cell).respond(rest, no_rate, tangents=True)
        ...     modulus = answer.tangents.P_by_F[0, 0, 1, 0, 1] / cell.tissue_thickness
        ...     print(f"{turgor} MPa: {modulus:.2f} MPa")
        0.4 MPa: 0.43 MPa
        0.1 MPa: 0.11 MPa
    """
    measured = {key: value for key, value in changes.items() if key in MEASUREMENTS}
    constants = {key: value for key, value in changes.items() if key not in MEASUREMENTS}
    if not measured:
        return CellParameters.preset(preset, **constants)
    # refuses unknown names and values out of bounds, with the same message as without measurements
    CellParameters.preset(preset, **constants)
    if preset not in LIVING:
        key, value = next(iter(measured.items()))
        raise InputError(
            f"cell.{key}",
            f"{quoted(value)}; preset {preset} is made of constants: take {' or '.join(LIVING)} "
            "with measurements",
        )
    check_turgor("cell.turgor", measured.get("turgor"))
    try:
        tissue = replace(LIVING[preset][0], **measured)
    except InputError as error:
        raise error.within("cell") from None
    # living cells have a uniform fluid unless another is asked for
    fluid = constants.get("fluid", "auto")
    cell = tissue.parameters("uniform" if fluid == "auto" else fluid)
    resolution = {key: constants[key] for key in RESOLUTION if key in constants}
    cell = resolved(cell, **resolution)
    determined = overruled(changes)
    stated = {key: value for key, value in constants.items() if key not in determined}
    changed = replace(cell, **{**stated, "fluid": cell.fluid})
    if "turgor" in measured and not {"cell_side", "fluid_particle_mass"}.isdisjoint(stated):
        # of another mass or size, another sound speed carries the turgor
        ratio = even_pressure(cell) / even_pressure(changed)
        changed = replace(changed, sound_speed=cell.sound_speed * sqrt(ratio))
    return changed


def check_turgor(name: str, pressure: Any) -> None:
    """Raise InputError, which names the entry `name`, for a turgor of 0."""
    if isinstance(pressure, int | float) and pressure == 0:
        raise InputError(
            name,
            "0; walls here do not resist bending, so that without tension no shape of a plant cell "
            "is stable: give a small turgor, such as 0.01 (MPa)",
        )


def overruled(changes: Mapping[str, Any]) -> dict[str, str]:
    """Return constants among the changes that a measurement among them determines.

    Each comes with the name of that measurement.
    """
    determined = {}
    for measured, constants in DETERMINED.items():
        for constant in constants:
            if measured in changes and constant in changes:
                determined[constant] = measured
    return determined


def resolved(cell: CellParameters, **resolution: Any) -> CellParameters:
    """Return the square plant cell with another `RESOLUTION`: walls, pressure, density stay."""
    finer = replace(cell, **resolution)
    if finer == cell:
        return cell
    thickness = finer.tissue_thickness / cell.tissue_thickness
    springs = finer.wall_springs_per_side / cell.wall_springs_per_side
    wall_mass = cell.wall_particle_mass * thickness / springs
    # two walls of a square are its own, and share a corner
    walls = (2 * cell.wall_springs_per_side - 1) * cell.wall_particle_mass * thickness
    finer_walls = (2 * finer.wall_springs_per_side - 1) * wall_mass
    fluid = cell.fluid_particle_mass * cell.fluid_particles_per_side**2 * thickness
    finer_fluid = fluid + walls - finer_walls
    return replace(
        finer,
        wall_stiffness=cell.wall_stiffness * thickness * springs,
        wall_particle_mass=wall_mass,
        fluid_particle_mass=finer_fluid / finer.fluid_particles_per_side**2,
        # c_s² times the mass of the fluid is the pressure's
        sound_speed=cell.sound_speed * sqrt(fluid / finer_fluid),
        # the force between two walls a spring's length apart
        repulsion_strength=cell.repulsion_strength * thickness / springs**6,
        viscosity=cell.viscosity * thickness,
    )


def even_pressure(cell: CellParameters) -> float:
    """Return c_s² ρ of the fluid spread over its plant cell, MPa: the turgor, if it is uniform."""
    return cell.fluid_density * cell.sound_speed**2 / cell.tissue_thickness


def measurements_of(cell: CellParameters) -> dict[str, float]:
    """Return the measurements of a plant cell, by the names and in the units of `LivingTissue`.

    The thickness of the walls is that of wet walls of their mass. SPH fluid whose contacts are not
    those of living cells has no turgor here: it depends on where its particles rest.
    """
    thickness = cell.tissue_thickness
    cross_section = cell.wall_particle_mass / WALL_DENSITY / cell.spring_length
    values = {
        "cell_size": cell.cell_side,
        "turgor": even_pressure(cell),
        "wall_modulus": cell.wall_stiffness * cell.spring_length / cross_section,
        "wall_thickness": cross_section / 2.0 / thickness,
        "sap_viscosity": 1e3 * cell.viscosity / thickness,
        "density": 1e6 * cell.density / thickness,
    }
    if cell.has_uniform_fluid:
        return values
    # Walls carry more than the mean pressure of SPH particles, by a factor that all living cells
    # share whose contacts are alike; it is taken from one of them.
    tissue, _ = LIVING["apple"]
    sph = tissue.parameters("sph")
    uniform = tissue.parameters("uniform")
    values["turgor"] *= even_pressure(uniform) / even_pressure(sph)
    contacts = _relative_contacts(cell, values["turgor"])
    usual_contacts = _relative_contacts(sph, tissue.turgor)
    pairs = zip(contacts, usual_contacts, strict=True)
    if not all(isclose(a, b, rel_tol=_USUAL) for a, b in pairs):
        del values["turgor"]
    return values


def _relative_contacts(cell: CellParameters, turgor: float) -> tuple[float, float, float]:
    """Return strength, cut-off and smoothing length of contacts, relative to tension and size.

    The strength is the contact force at the length of a spring over the walls' tension.
    """
    tension = turgor * cell.tissue_thickness * cell.cell_side
    return (
        cell.repulsion_strength / tension / cell.spring_length**6,
        cell.repulsion_cutoff / cell.cell_side,
        cell.smoothing_length / cell.cell_side,
    )


def cell_called(cell: Any) -> CellParameters:
    """Return the plant cell itself, or the preset of that name.

    Raises:
        InputError: there is no such preset, or it is neither.
    """
    if isinstance(cell, str):
        return CellParameters.preset(cell)
    if isinstance(cell, CellParameters):
        return cell
    raise InputError(
        f"cell: {cell!r}; it must be CellParameters, as CellParameters.preset(name) makes, or the "
        "name of a preset"
    )
