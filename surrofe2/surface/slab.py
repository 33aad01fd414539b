"""A column of square plant cells between two free sides, periodic along them: the slab RVE.

It is an RVE as any other, whose box is taller than its plant cells by a gap beyond every list of
contacts. So images above and below never meet, and what F₂₂ is changes nothing but the names of
places: particles are free across. Outer walls are those of the tissue (docs/theory.md, walls at a
free boundary).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.arrangement import make_slab_arrangement
from surrofe2.plant_cell.pair_lists import FARTHEST, make_patches
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.rve.unit_cell import UnitCell, equilibria_in, unit_around

GAP = FARTHEST + 1.0
"""Cut-offs between the images of a slab."""


@lru_cache(maxsize=32)
def make_slab(cell: CellParameters, reference: ReferenceState, rows: int) -> UnitCell:
    """`rows` plant cells relaxed between two free sides at λ = 1, as the unit cell of an RVE.

    Args:
        cell: one square plant cell. reference: its state in the bulk.

    Raises:
        InputError: the cell is not one square, or its slab has no stable equilibrium.
        MismatchError: the reference is of another cell.
    """
    if not cell.is_one_square:
        raise InputError(
            f"cell.arrangement: {cell.cells} of {cell.arrangement}; a surface law must be of one "
            "square plant cell"
        )
    reference.check_belongs_to(cell)
    made = make_slab_arrangement(cell, rows, GAP * cell.repulsion_cutoff)
    lattice, walls = made.tessellation.lattice, len(reference.position) - cell.fluid_particles
    up = np.array([0.0, cell.cell_side])
    fluid = [reference.position[walls:] + k * up for k in range(rows)]
    start = np.concatenate([made.wall_position, *fluid])
    try:
        found = equilibria_in(cell, lattice, reference.rest_length, start[None], made)
    except InputError:
        found = None
    if found is None or not found.stable[0]:
        raise InputError(
            "cell: no stable equilibrium between free sides was found; check outer_wall, "
            "fluid_particle_mass and wall_stiffness"
        )
    relaxed = found.z[0].T.copy()
    at_rest = ReferenceState(cell.fingerprint, relaxed, lattice, reference.rest_length)
    return unit_around(cell, at_rest, make_patches(cell, relaxed, lattice, arrangement=made))
