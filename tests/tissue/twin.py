"""A finite tissue of square cells in plain numpy: every pair of particles, no lists, no lanes.

Written from docs/theory.md. Wall particles are the points of a grid of springs, fluid belongs to a
cell.
"""

from __future__ import annotations

import numpy as np

from tests.plant_cell.twin import densities, pair_forces


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
        self._sort_pairs()

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

    def _sort_pairs(self):
        """Every pair (i < j) by kind, and its share: bonds, contacts, fluid of one cell."""
        n, m = self.cells
        walls, per_side = self.walls, self.per_side
        i, j = np.triu_indices(len(self.start), 1)
        both_walls, fluid = j < walls, i >= walls
        first, second = self.grid[i[both_walls]], self.grid[j[both_walls]]
        share = np.ones(len(i))
        for axis, last in ((0, n * per_side), (1, m * per_side)):
            for edge in (0, last):
                on_edge = (first[:, axis] == edge) & (second[:, axis] == edge)
                share[np.flatnonzero(both_walls)[on_edge]] = 0.5
        bonded = np.zeros(len(i), dtype=bool)
        bonded[both_walls] = abs(first - second).sum(axis=1) == 1
        mixed = ~both_walls & ~fluid
        touching = both_walls & ~bonded
        lower, at = self.home[j[mixed] - walls] * per_side, self.grid[i[mixed]]
        touching[mixed] = ((at >= lower) & (at <= lower + per_side)).all(axis=1)
        same = np.zeros(len(i), dtype=bool)
        same[fluid] = (self.home[i[fluid] - walls] == self.home[j[fluid] - walls]).all(axis=1)
        kinds = {"bond": bonded, "contact": touching, "fluid": same}
        self.pairs = {kind: (i[of], j[of], share[of], 0.0, 0.0) for kind, of in kinds.items()}

    def evaluate(self, x, v):
        """f (n, 2), elastic energy and power lost to damping."""
        c, f, lost = self.cell, np.zeros_like(x), 0.0
        density = densities(c, x, self.pairs["fluid"])[self.walls :]
        energy = c.fluid_particle_mass * c.sound_speed**2 * np.log(density).sum()
        for _, i, j, _, force, stored, power in pair_forces(c, self.rest_length, x, v, self.pairs):
            np.add.at(f, i, force)
            np.add.at(f, j, -force)
            energy, lost = energy + stored.sum(), lost + power.sum()
        return f, energy, lost
