"""A finite tissue of square cells in plain numpy, written from docs/theory.md."""

import numpy as np

from tests.plant_cell.twin import resultants, sort_pairs

NONE = np.zeros((2, 2))


class TissueTwin:
    """Particles in an order of its own; the reference only places them at the start.

    What is asked and answered is in the order of a tissue of one type; `order` leads there.
    """

    def __init__(self, tissue):
        cell, reference, cells = tissue.cell, tissue.references[0], tissue.kind.shape[:2]
        self.cell, self.rest_length = cell, reference.rest_length
        per_side, side, position = cell.wall_springs_per_side, cell.cell_side, reference.position
        outer = per_side * np.array(cells)
        grid = np.array([at for at in np.ndindex(*(outer + 1)) if 0 in np.mod(at, per_side)])
        cell_of, (i, j) = grid // per_side, (grid % per_side).T
        walls = position[np.where(j == 0, i, per_side + j - 1)] + side * cell_of
        fluid, each = position[2 * per_side - 1 :], np.array([*np.ndindex(*cells)])
        home = np.repeat(each, len(fluid), axis=0)
        start = np.concatenate([walls, np.tile(fluid, (len(each), 1)) + side * home])
        there = tissue.to_particles(tissue.start)
        distance = np.linalg.norm(there[:, None] - start, axis=2)
        self.order = distance.argmin(axis=1)
        assert sorted(self.order) == [*range(len(start))]
        assert distance.min(axis=1).max() < 1e-9
        share = 0.5 ** ((grid == 0) | (grid == outer)).sum(axis=1)
        mass = [cell.wall_particle_mass * share, np.full(len(home), cell.fluid_particle_mass)]
        self.mass = np.concatenate(mass)[self.order]
        edges = [(axis, line) for axis in (0, 1) for line in (0, outer[axis])]
        self.pairs = sort_pairs(cell, grid, home, edges=edges)

    def evaluate(self, x, v):
        """f (n, 2), elastic energy and power lost to damping."""
        place = np.argsort(self.order)
        x, v = x[place], v[place]
        f, *rest = resultants(self.cell, self.rest_length, x, v, self.pairs, NONE, NONE)[:3]
        return f[self.order], *rest
