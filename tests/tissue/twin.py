"""A finite tissue of square cells in plain numpy, written from docs/theory.md."""

from __future__ import annotations

import numpy as np

from tests.plant_cell.twin import resultants, sort_pairs

NONE = np.zeros((2, 2))


class TissueTwin:
    """Particles in an order of its own; the reference only places them at the start."""

    def __init__(self, cell, reference, cells):
        self.cell, self.rest_length, self.cells = cell, reference.rest_length, cells
        position = reference.position
        per_side = self.per_side = cell.wall_springs_per_side
        n, m = cells
        side = cell.cell_side
        grid = [
            (i, j)
            for i in range(n * per_side + 1)
            for j in range(m * per_side + 1)
            if i % per_side == 0 or j % per_side == 0
        ]
        self.grid = np.array(grid)
        self.walls = len(grid)
        self.home = np.array(
            [(a, b) for a in range(n) for b in range(m)
             for _ in range(cell.fluid_particles_per_side**2)]
        )  # fmt: skip
        fluid = position[2 * per_side - 1 :]
        self.start = np.concatenate(
            [[self._wall_start(*at, position) for at in grid],
             *(fluid + side * np.array([a, b]) for a in range(n) for b in range(m))]
        )  # fmt: skip
        self.mass = np.concatenate(
            [[cell.wall_particle_mass * self._cells_at(*at) for at in grid],
             np.full(len(self.home), cell.fluid_particle_mass)]
        )  # fmt: skip
        edges = [(0, 0), (0, n * per_side), (1, 0), (1, m * per_side)]
        self.pairs = sort_pairs(cell, self.grid, self.home, edges=edges)

    def _wall_start(self, i, j, position):
        a, b = i // self.per_side, j // self.per_side
        i, j = i % self.per_side, j % self.per_side
        own = i if j == 0 else self.per_side + j - 1
        return position[own] + self.cell.cell_side * np.array([a, b])

    def _cells_at(self, i, j):
        """Cells present over cells that share this wall particle in the inside."""
        n, m = self.cells
        around = {
            ((i + di) // self.per_side, (j + dj) // self.per_side)
            for di in (-0.5, 0.5)
            for dj in (-0.5, 0.5)
        }
        return sum(0 <= a < n and 0 <= b < m for a, b in around) / len(around)

    def evaluate(self, x, v):
        """f (n, 2), elastic energy and power lost to damping."""
        return resultants(self.cell, self.rest_length, x, v, self.pairs, NONE, NONE)[:3]
