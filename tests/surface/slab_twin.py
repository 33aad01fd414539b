"""A slab's forces in plain numpy, pair by pair over its images, by the rules of a tissue."""

import numpy as np

from tests.plant_cell.twin import pair_forces, resultants, sort_pairs


class SlabTwin:
    """Forces of a column of square plant cells with single walls above and below.

    Particles are owned by one column or by the next, so their images reach two columns far.
    """

    def __init__(self, cell, rest_length, start, rows):
        self.cell, self.rest_length, per_side = cell, rest_length, cell.wall_springs_per_side
        walls = rows * (2 * per_side - 1) + per_side
        grid = np.round(start[:walls] / (cell.cell_side / per_side)).astype(int)
        home = (start[walls:] // cell.cell_side).astype(int)
        images = [(a, 0) for a in range(-2, 3)]
        self.pairs = sort_pairs(cell, grid, home, images, [(1, 0), (1, rows * per_side)])

    def forces(self, x, v, stretch, rate):
        """f (n, 2) at x and v, the force that neighbouring columns pull each other with, and its
        moment by the distance from the middle of the slab: the forces of both halves added up.
        """
        side, resultant, moment = self.cell.cell_side, 0.0, 0.0
        middle = 0.5 * (x[:, 1].min() + x[:, 1].max())
        lattices = (np.diag([size * side, 0.0]) for size in (stretch, rate))
        of = self.cell, self.rest_length, x, v, self.pairs, *lattices
        for i, _, shift, r, force, *_ in pair_forces(*of):
            resultant += shift[:, 0] @ force[:, 0]
            apart = abs(x[i, 1] + 0.5 * r[:, 1] - middle)
            moment += (force[:, 0] * r[:, 0]) @ apart / (stretch * side)
        f, *_ = resultants(*of)
        return f, resultant, moment
