"""A column of square plant cells between two free sides, periodic along them: the slab RVE.

It is an RVE as any other, whose box is taller than its plant cells by a gap beyond every list of
contacts. So images above and below never meet, and what F₂₂ is changes nothing but the names of
places: particles are free across. Bent evenly, column a is column 0 turned by a θ about a centre
λ h/θ above the slab's middle (docs/theory.md, surface law, where it acts)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.arrangement import ReferenceState, make_slab_arrangement
from surrofe2.plant_cell.block_matrices import solve
from surrofe2.plant_cell.forces import local_forces
from surrofe2.plant_cell.neighbours import FARTHEST, make_neighbours
from surrofe2.plant_cell.pair_sums import make_workspace
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve.rve_state import kept_factors
from surrofe2.rve.unit_cell import UnitCell, equilibria_in, unit_around

GAP = FARTHEST + 1.0
"""Cut-offs between the images of a slab."""
TURN = 2e-4
"""θ, by which the moment is differenced."""
_LIMIT, _DONE = 200, 1e-8


@lru_cache(maxsize=32)
def make_slab(cell: CellParameters, reference: ReferenceState, rows: int) -> UnitCell:
    """`rows` plant cells relaxed between two free sides at λ = 1, as the unit cell of an RVE.

    Args:
        cell: one square plant cell. reference: its state in the bulk.

    Raises:
        InputError: the cell is not one square, or its slab has no stable equilibrium.
        MismatchError: the reference is of another cell."""
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
    return unit_around(cell, at_rest, make_neighbours(cell, relaxed, lattice, arrangement=made))


def bend(unit: UnitCell, F: Array, z: Array) -> tuple[float, Array]:
    """(∂(dW/dθ)/∂κ in µN µm², (n, 2) particles at θ = `TURN`) of a slab without resultant.

    Positions count from the middle of the slab, where column 0 begins and x runs along it.

    Args:
        F: (2, 2) diagonal, at which the straight slab has no resultant.
        z: (n, 2) material positions of its particles there.

    Raises:
        InputError: the bent slab does not come to rest.
    """
    topology, n = unit.topology, len(z)
    side, span = unit.cell.cell_side, F[0, 0] * unit.cell.cell_side
    theta = TURN * (-1.0) ** np.arange(TILE)
    x = z @ F.T
    x[:, 1] -= 0.5 * (x[:, 1].min() + x[:, 1].max())
    angle = theta * x[:, :1] / span
    radius = span / theta - x[:, 1:]
    at = np.stack([radius * np.sin(angle), x[:, 1:] + 2.0 * radius * np.sin(0.5 * angle) ** 2])
    column = np.rint(topology.image_offset[:, :1] / side)
    turn = column * theta
    cos, sin = np.cos(turn), np.sin(turn)
    moved = span / theta * np.stack([sin, 2.0 * np.sin(0.5 * turn) ** 2])
    by_theta = (column * span * np.stack([cos, sin]) - moved) / theta
    work, (lu, _) = make_workspace(topology), kept_factors(unit.factors.address[0], topology)
    work.v[:] = 0.0
    for _ in range(_LIMIT):
        own = at[:, topology.owner]
        turned = np.stack([cos * own[0] - sin * own[1], sin * own[0] + cos * own[1]])
        work.x[:] = np.concatenate([at, turned + moved], axis=1)
        local_forces(work, topology, unit.constants)
        f, pulled = work.f[:, :n].copy(), work.f[:, n:]
        back = np.stack([cos * pulled[0] + sin * pulled[1], cos * pulled[1] - sin * pulled[0]])
        for axis in range(2):
            np.add.at(f[axis], topology.owner, back[axis])
        if abs(f[:, 1:]).max() < _DONE * abs(work.f).max():
            across = column * np.stack([-turned[1], turned[0]]) + by_theta
            moment = -(pulled * across).sum(axis=(0, 1))
            return float(side * np.mean(moment / theta)), at[..., 0].T.copy()
        step = np.ascontiguousarray(-np.swapaxes(f[:, 1:], 0, 1)).reshape(-1, TILE)
        solve(lu, step, topology)
        at[:, 1:] += np.swapaxes(step.reshape(-1, 2, TILE), 0, 1)
    raise InputError("surface: a bent slab finds no rest; check outer_wall and wall_stiffness")
