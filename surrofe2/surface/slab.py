"""A column of square plant cells between two free sides, periodic along them: the slab RVE.

It is an RVE as any other, whose box is taller than its plant cells by a gap wider than every list
of contacts reaches. So images above and below never meet, and F₂₂ is of no effect on forces:
particles are free across. In an evenly bent slab, column a is column 0 turned by a θ about a centre
λ h/θ above the slab's middle (docs/theory.md, surface law, where it acts).
"""

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
"""Cut-offs between the images of a slab: one more than the farthest list of contacts reaches."""
TURN = 2e-4
"""The angle θ, rad, by which the moment is differenced.

A larger one would bend the slab beyond its linear range, a smaller one would lose digits."""
# Newton steps of a bent slab, and the force left, relative to the largest, at which it is at rest.
_MOST_STEPS = 200
_DONE = 1e-8


@lru_cache(maxsize=32)
def make_slab(cell: CellParameters, reference: ReferenceState, rows: int) -> UnitCell:
    """Relax `rows` plant cells between two free sides at λ = 1, as the unit cell of an RVE.

    Args:
        cell: one square plant cell.
        reference: its settled state in the bulk.
        rows: plant cells across the slab.

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
    arrangement = make_slab_arrangement(cell, rows, GAP * cell.repulsion_cutoff)
    lattice = arrangement.tessellation.lattice
    # the fluid of the settled cell is copied into every row; walls are those of the slab
    wall_particles = len(reference.position) - cell.fluid_particles
    up = np.array([0.0, cell.cell_side])
    fluid = [reference.position[wall_particles:] + k * up for k in range(rows)]
    start = np.concatenate([arrangement.wall_position, *fluid])
    no_equilibrium = InputError(
        "cell: no stable equilibrium between free sides was found; check outer_wall, "
        "fluid_particle_mass and wall_stiffness"
    )
    try:
        equilibria = equilibria_in(cell, lattice, reference.rest_length, start[None], arrangement)
    except InputError:
        raise no_equilibrium from None
    if not equilibria.stable[0]:
        raise no_equilibrium
    relaxed = equilibria.z[0].T.copy()
    at_rest = ReferenceState(cell.fingerprint, relaxed, lattice, reference.rest_length)
    neighbours = make_neighbours(cell, relaxed, lattice, arrangement=arrangement)
    return unit_around(cell, at_rest, neighbours)


def bend(unit: UnitCell, F: Array, z: Array) -> tuple[float, Array]:
    """Bend a slab without resultant, and return its bending stiffness and its bent state.

    The stiffness is ∂(dW/dθ)/∂κ in µN µm²; the state is (n, 2) positions of particles at θ =
    `TURN`, in µm from the middle of the slab, where column 0 begins and x runs along it.

    Newton's method relaxes column 0; its images are turned with it. The eight lanes of a tile hold
    θ of either sign in turns, whose mean takes out the first error of the difference.

    Args:
        unit: the slab, see `make_slab`.
        F: (2, 2) diagonal, at which the straight slab has no resultant.
        z: (n, 2) material positions of its particles there, µm.

    Raises:
        InputError: the bent slab does not come to rest.
    """
    topology = unit.topology
    n = len(z)
    side = unit.cell.cell_side
    span = F[0, 0] * side  # length of a column along the slab, µm
    theta = TURN * (-1.0) ** np.arange(TILE)
    straight = z @ F.T
    straight[:, 1] -= 0.5 * (straight[:, 1].min() + straight[:, 1].max())
    # the straight slab wrapped around the centre; 2 sin²(a/2) = 1 − cos a without cancellation
    angle = theta * straight[:, :1] / span
    radius = span / theta - straight[:, 1:]
    x = radius * np.sin(angle)
    y = straight[:, 1:] + 2.0 * radius * np.sin(0.5 * angle) ** 2
    position = np.stack([x, y])  # (2, n, TILE)
    # images in column a are the particles turned by a θ and moved along the arc
    column = np.rint(topology.image_offset[:, :1] / side)
    turn = column * theta
    cos = np.cos(turn)
    sin = np.sin(turn)
    shift = span / theta * np.stack([sin, 2.0 * np.sin(0.5 * turn) ** 2])
    shift_by_theta = (column * span * np.stack([cos, sin]) - shift) / theta
    workspace = make_workspace(topology)
    # θ is so small that the factors of the slab at rest serve all steps
    lu, _ = kept_factors(unit.factors.address[0], topology)
    workspace.v[:] = 0.0
    for _ in range(_MOST_STEPS):
        imaged = position[:, topology.owner]
        turned = np.stack([cos * imaged[0] - sin * imaged[1], sin * imaged[0] + cos * imaged[1]])
        workspace.x[:] = np.concatenate([position, turned + shift], axis=1)
        local_forces(workspace, topology, unit.constants)
        # forces on images act on the particles that they are images of, turned back
        force = workspace.f[:, :n].copy()
        on_images = workspace.f[:, n:]
        turned_back = np.stack(
            [cos * on_images[0] + sin * on_images[1], cos * on_images[1] - sin * on_images[0]]
        )
        for axis in range(2):
            np.add.at(force[axis], topology.owner, turned_back[axis])
        # particle 0 is held: the slab as a whole may move along the arc
        if abs(force[:, 1:]).max() < _DONE * abs(workspace.f).max():
            image_by_theta = column * np.stack([-turned[1], turned[0]]) + shift_by_theta
            moment = -(on_images * image_by_theta).sum(axis=(0, 1))
            stiffness = float(side * np.mean(moment / theta))
            return stiffness, position[..., 0].T.copy()
        step = np.ascontiguousarray(-np.swapaxes(force[:, 1:], 0, 1)).reshape(-1, TILE)
        solve(lu, step, topology)
        position[:, 1:] += np.swapaxes(step.reshape(-1, 2, TILE), 0, 1)
    raise InputError("surface: a bent slab finds no rest; check outer_wall and wall_stiffness")
