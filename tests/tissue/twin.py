"""A finite tissue of square cells in plain numpy, written from docs/theory.md."""

from __future__ import annotations

import numpy as np

from tests.plant_cell.twin import resultants, sort_pairs

NONE = np.zeros((2, 2))


class TissueTwin:
    """Particles in an order of its own; the reference only places them at the start."""

    def __init__(self, cell, reference, cells):
        self.cell, self.rest_length = cell, reference.rest_length
        per_side, side, position = cell.wall_springs_per_side, cell.cell_side, reference.position
        outer = per_side * np.array(cells)
        grid = np.array([at for at in np.ndindex(*(outer + 1)) if 0 in np.mod(at, per_side)])
        cell_of, (i, j) = grid // per_side, (grid % per_side).T
        walls = position[np.where(j == 0, i, per_side + j - 1)] + side * cell_of
        fluid, each = position[2 * per_side - 1 :], np.array([*np.ndindex(*cells)])
        home = np.repeat(each, len(fluid), axis=0)
        self.start = np.concatenate([walls, np.tile(fluid, (len(each), 1)) + side * home])
        share = 0.5 ** ((grid == 0) | (grid == outer)).sum(axis=1)
        self.mass = np.concatenate(
            [cell.wall_particle_mass * share, np.full(len(home), cell.fluid_particle_mass)]
        )
        edges = [(axis, line) for axis in (0, 1) for line in (0, outer[axis])]
        self.pairs = sort_pairs(cell, grid, home, edges=edges)

    def evaluate(self, x, v):
        """f (n, 2), elastic energy and power lost to damping."""
        return resultants(self.cell, self.rest_length, x, v, self.pairs, NONE, NONE)[:3]
