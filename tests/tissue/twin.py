"""A finite tissue of square cells in plain numpy: every pair of particles, no lists, no lanes.

Written from docs/theory.md. Wall particles are the points of a grid of springs, fluid belongs to a
cell.
"""

from __future__ import annotations

import numpy as np

from tests.plant_cell.twin import spline, spline_slope


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
        """Factor of every pair (i < j): bonds, contacts, and which fluid shares a cell."""
        n, m = self.cells
        count, walls, per_side = len(self.start), self.walls, self.per_side
        self.i, self.j = np.triu_indices(count, 1)
        both_walls = self.j < walls
        first, second = self.grid[self.i[both_walls]], self.grid[self.j[both_walls]]
        factor = np.ones(len(first))
        for axis, last in ((0, n * per_side), (1, m * per_side)):
            for edge in (0, last):
                factor[(first[:, axis] == edge) & (second[:, axis] == edge)] = 0.5
        bonded = abs(first - second).sum(axis=1) == 1
        self.bond, self.contact = np.zeros(len(self.i)), np.zeros(len(self.i))
        self.bond[both_walls] = factor * bonded
        self.contact[both_walls] = factor * ~bonded
        mixed = (self.i < walls) & (self.j >= walls)
        lower = self.home[self.j[mixed] - walls] * per_side
        at = self.grid[self.i[mixed]]
        self.contact[mixed] = ((at >= lower) & (at <= lower + per_side)).all(axis=1)
        fluid = self.i >= walls
        same = (self.home[self.i[fluid] - walls] == self.home[self.j[fluid] - walls]).all(axis=1)
        self.fluid = np.zeros(len(self.i))
        self.fluid[fluid] = same

    def evaluate(self, x, v):
        """f (n, 2), elastic energy and power lost to damping."""
        c, i, j = self.cell, self.i, self.j
        r, w = x[j] - x[i], v[j] - v[i]
        length = np.hypot(*r.T)
        unit = r / length[:, None]
        rate = (unit * w).sum(axis=1)
        stretch = length - self.rest_length
        gamma = 2.0 * np.sqrt(c.wall_particle_mass * c.wall_stiffness) * c.wall_damping_ratio
        force = self.bond * (c.wall_stiffness * stretch + gamma * rate)
        energy = (self.bond * 0.5 * c.wall_stiffness * stretch**2).sum()
        lost = (self.bond * gamma * rate**2).sum()

        x0, strength = c.repulsion_cutoff, c.repulsion_strength
        touching = self.contact * (length < x0)
        damping = 2.0 * np.sqrt(6.0 * strength * c.wall_particle_mass / length**7)
        damping *= (1.0 - (length / x0) ** 6) * c.contact_damping_ratio
        force -= touching * (strength * (length**-6 - x0**-6) - damping * rate)
        stored = strength * (length**-5 / 5 + length * x0**-6 - 1.2 * x0**-5)
        energy += (touching * stored).sum()
        lost += (touching * damping * rate**2).sum()
        total = force[:, None] * unit

        m, h = c.fluid_particle_mass, c.smoothing_length
        fluid = self.fluid > 0
        density = np.full(len(x), m * spline(0.0, h))
        for k in (i, j):
            np.add.at(density, k[fluid], m * spline(length[fluid], h))
        energy += m * c.sound_speed**2 * np.log(density[self.walls :]).sum()
        slope = m * m * spline_slope(length, h) / length * self.fluid
        per = 1.0 / density
        pressure = slope * c.sound_speed**2 * (per[i] + per[j])
        viscous = -2.0 * c.viscosity * slope * per[i] * per[j]
        total += pressure[:, None] * r + viscous[:, None] * w
        lost += (viscous * (w * w).sum(axis=1)).sum()
        f = np.zeros_like(x)
        np.add.at(f, i, total)
        np.add.at(f, j, -total)
        return f, energy, lost
