"""The size of a tissue against its plant cells, and the cost of all of its particles.

FE² takes a plant cell to be small against an element, and saves what a homogeneous neighbourhood
allows: where elements are smaller than plant cells it solves several RVEs for each of them, and all
particles cost less.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.base.units import number, rough_number, rough_time
from surrofe2.macro.elements import make_discretisation
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import CellName, Recipe
from surrofe2.store.samples import kept_reference

# Particle-steps in a second by two cores: an order of magnitude.
PARTICLE_STEPS = 3e7
# Widths that differ by less than this fraction are the same.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Particles:
    """The cost of a run of all particles.

    Attributes:
        plant_cells, particles, steps: numbers of them.
        refusal: why `surrofe2 tissue` does not take the recipe; empty where it does.
    """

    plant_cells: float
    particles: float
    steps: float
    refusal: str

    @property
    def is_possible(self) -> bool:
        """True if `surrofe2 tissue` takes the recipe."""
        return not self.refusal

    @property
    def seconds(self) -> float:
        """Order of magnitude of its time, s, at `PARTICLE_STEPS`."""
        return self.particles * self.steps / PARTICLE_STEPS


class _Elements(NamedTuple):
    """Areas, µm², and smallest widths, µm, of elements, (e,) each."""

    areas: Array
    widths: Array


def scale_warnings(recipe: Recipe, halvings: int = 0) -> Iterator[str]:
    """Warn of each kind of plant cell that is larger, or whose RVE is wider, than its elements.

    Args:
        halvings: how often elements were merged each way for this recipe's mesh.
    """
    elements = _elements_by_cell(recipe)
    for name, entry in recipe.cells.items():
        cell = entry.parameters
        smallest = float(elements[name].widths.min()) / 2**halvings
        where = "" if name is None else f" of {name}"
        width = float(np.linalg.norm(cell.tessellation.lattice, axis=0).max())
        if smallest < cell.cell_side * (1.0 - _ROUNDING):
            yield (
                f"an element{where} is {smallest:.3g} µm wide, a plant cell {cell.cell_side:.3g}"
                " µm: FE² then solves more RVEs than there are plant cells; take larger elements"
            )
        elif smallest < width * (1.0 - _ROUNDING):
            yield (
                f"an RVE{where} is {width:.3g} µm wide, an element {smallest:.3g} µm: what the "
                "RVE sees as even varies within it; take larger elements or fewer plant cells per "
                "RVE"
            )


def sap_notes(recipe: Recipe, step: float | None = None) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on time steps of an explicit run with undrained sap; none warns.

    There is none on a recipe that states a rest.

    Args:
        step: mean step of a finished run, µs; None: before the run.
    """
    undrained = {
        name: cell.parameters
        for name, cell in recipe.cells.items()
        if cell.parameters.sap_bulk_modulus > 0.0
    }
    is_explicit = recipe.rest is None and recipe.macro.integrator == "explicit"
    if not (undrained and is_explicit):
        return
    elements = _elements_by_cell(recipe)
    crossings = {
        name: float(elements[name].widths.min()) / sap_wave_speed(cell)
        for name, cell in undrained.items()
    }
    name = min(crossings, key=crossings.__getitem__)
    cell = undrained[name]
    steps = "steps are short" if step is None else f"steps of {number(step)} µs on average"
    yield (
        f"explicit: {steps}, since waves in undrained sap (sap_bulk_modulus "
        f"{cell.sap_bulk_modulus:g} MPa) run at {number(sap_wave_speed(cell))} µm/µs and cross "
        f"{number(crossings[name] * sap_wave_speed(cell))} µm, the smallest element, in "
        f'{number(crossings[name])} µs; integrator = "implicit" takes longer ones, `surrofe2 rest` '
        "none, and shear is the same from 40 MPa on",
        False,
    )


def sap_wave_speed(cell: CellParameters) -> float:
    """Compute the speed √(K/ρ) of pressure waves by the sap's bulk modulus alone, µm/µs."""
    return math.sqrt(cell.sap_bulk_modulus * cell.tissue_thickness / cell.density)


def all_particles(recipe: Recipe) -> Particles:
    """Estimate the full particle model of a recipe's tissue, by the area of each kind of cell.

    Where an image outlines the tissue, its cells and particles are counted.
    """
    # late: a run asks for `sap_notes` alone, and imports no full tissue for them
    from surrofe2.tissue.relaxation import rounded_step, stable_step
    from surrofe2.workflow.tissue import tissue_of

    elements = _elements_by_cell(recipe)
    plant_cells = 0.0
    particles = 0.0
    step = math.inf if recipe.tissue.micro_step is None else recipe.tissue.micro_step
    for name, entry in recipe.cells.items():
        cell = entry.parameters
        count = float(elements[name].areas.sum()) / cell.cell_side**2
        plant_cells += count
        particles += count * _particles_of(cell)
        if recipe.tissue.micro_step is None:
            step = min(step, rounded_step(stable_step(cell, kept_reference(cell))))
    refusal = ""
    try:
        outlined = tissue_of(recipe).outlined
    except InputError as error:
        refusal = str(error)
    else:
        if outlined is not None:
            # cells that the border of the image cuts are smaller than cell_side, and count, too
            plant_cells = float(outlined.is_cell.sum())
            particles = float(len(outlined.arrangement.wall_position))
    return Particles(plant_cells, particles, recipe.duration / step, refusal)


def particles_sentence(full: Particles) -> str:
    """Say what a run of all particles would take."""
    total = rough_number(full.particles * full.steps)
    remark = ""
    if not full.is_possible:
        remark = f" (surrofe2 tissue does not take this problem: {full.refusal})"
    return (
        f"All particles: {full.plant_cells:,.0f} plant cells, {full.particles:,.0f} particles, "
        f"{full.steps:,.0f} steps. At {PARTICLE_STEPS / 1e6:.0f} million particle-steps a second, "
        f"{total} of them take about {rough_time(full.seconds)}{remark}"
    )


def _particles_of(cell: CellParameters) -> float:
    """Return the mean number of particles of a plant cell; walls that it shares count once."""
    walls = cell.tessellation.wall_particles(cell.spring_length)
    return cell.fluid_particles + walls / cell.cells


def _elements_by_cell(recipe: Recipe) -> dict[CellName, _Elements]:
    """Return the elements of each kind of plant cell by its name."""
    mesh = recipe.problem().mesh
    space = make_discretisation(mesh)
    corners = 4 if space.pressure_apart else 3
    outline = space.nodes[space.elements[:, :corners]]
    edges = np.linalg.norm(outline - np.roll(outline, 1, axis=1), axis=2)
    # of a triangle its height over the longest side
    widths = (1.0 if corners == 4 else 2.0) * space.areas / edges.max(axis=1)
    if len(recipe.cells) == 1:
        return {name: _Elements(space.areas, widths) for name in recipe.cells}
    elements: dict[CellName, _Elements] = {}
    for name, points in recipe.points_of_cells(mesh).items():
        numbers = np.unique(points // space.points_per_element)
        elements[name] = _Elements(space.areas[numbers], widths[numbers])
    return elements
