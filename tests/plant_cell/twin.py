"""The model of a tissue of square cells in plain numpy, pair by pair, over all images.

Written from the formulas, not from the kernels: no pair lists, no cut lists, no lanes.
"""

import numpy as np

from surrofe2.plant_cell.parameters import CellParameters

IMAGES = [(a, b) for a in range(-2, 3) for b in range(-2, 3)]


def spline(r, h):
    s = r / h
    sigma = 10.0 / (7.0 * np.pi * h**2)
    inner = 1.0 - 1.5 * s**2 + 0.75 * s**3
    outer = 0.25 * (2.0 - s) ** 3
    return sigma * np.where(s < 1.0, inner, np.where(s < 2.0, outer, 0.0))


def spline_slope(r, h):
    s = r / h
    sigma = 10.0 / (7.0 * np.pi * h**3)
    inner = -3.0 * s + 2.25 * s**2
    outer = -0.75 * (2.0 - s) ** 2
    return sigma * np.where(s < 1.0, inner, np.where(s < 2.0, outer, 0.0))


class Twin:
    """Forces, energy and virial stress of one periodic square cell at material positions z."""

    def __init__(self, cell: CellParameters, rest_length: float) -> None:
        self.cell, self.rest_length = cell, rest_length
        self.per_side = cell.wall_springs_per_side
        self.walls = 2 * self.per_side - 1
        self.particles = self.walls + cell.fluid_particles_per_side**2
        self.kinds = {pair: self._kind(*pair) for pair in self._pairs()}

    def _pairs(self):
        """Every unordered pair of a particle with every image, once."""
        for i in range(self.particles):
            for j in range(i, self.particles):
                for shift in IMAGES:
                    if i < j or shift > (0, 0):
                        yield i, j, shift

    def _kind(self, i, j, shift):
        grid_i, grid_j = self._grid(i), self._grid(j)
        if i >= self.walls:
            return "fluid" if shift == (0, 0) else None
        ring = np.array(shift) * self.per_side
        if j >= self.walls:  # wall i seen from the cell of fluid j, which is shifted
            at = np.array(grid_i) - ring
            on_rim = (at >= 0).all() and (at <= self.per_side).all()
            return "contact" if on_rim else None
        between = np.abs(np.array(grid_j) + ring - np.array(grid_i))
        return "bond" if between.sum() == 1 else "contact"

    def _grid(self, i):
        """Wall particles lie on the lines of a grid of springs; (column, row)."""
        if i < self.per_side:
            return (i, 0)
        return (0, i - self.per_side + 1) if i < self.walls else None

    def evaluate(self, z, F, F_dot, fluctuation=0.0):
        """f (n, 2), elastic energy, Cauchy stress (2, 2); velocities Ḟ z + fluctuation."""
        cell, side = self.cell, self.cell.cell_side
        x, v = z @ F.T, z @ F_dot.T + fluctuation
        f, energy, virial = np.zeros_like(z), 0.0, np.zeros((2, 2))
        m, h = cell.fluid_particle_mass, cell.smoothing_length
        density = np.zeros(self.particles)
        for i in range(self.walls, self.particles):
            r = np.linalg.norm(x[self.walls :] - x[i], axis=1)
            density[i] = m * spline(r, h).sum()
            energy += m * cell.sound_speed**2 * np.log(density[i])
        for (i, j, shift), kind in self.kinds.items():
            if kind is None:
                continue
            offset = side * np.array(shift)
            r = x[j] + F @ offset - x[i]
            w = v[j] + F_dot @ offset - v[i]
            length = np.linalg.norm(r)
            force, stored = getattr(self, f"_{kind}")(r, w, length, density[i], density[j])
            f[i] += force
            f[j] -= force
            energy += stored
            virial += np.outer(force, r)
        return f, energy, virial / (np.linalg.det(F) * side**2)

    def _bond(self, r, w, length, *_):
        c, n = self.cell, r / length
        gamma = 2.0 * np.sqrt(c.wall_particle_mass * c.wall_stiffness) * c.wall_damping_ratio
        stretch = length - self.rest_length
        tension = c.wall_stiffness * stretch + gamma * (n @ w)
        return tension * n, 0.5 * c.wall_stiffness * stretch**2

    def _contact(self, r, w, length, *_):
        c, n, x0 = self.cell, r / length, self.cell.repulsion_cutoff
        if length >= x0:
            return np.zeros(2), 0.0
        strength = c.repulsion_strength
        damping = 2.0 * np.sqrt(6.0 * strength * c.wall_particle_mass / length**7)
        damping *= (1.0 - (length / x0) ** 6) * c.contact_damping_ratio
        repulsion = strength * (length**-6 - x0**-6) - damping * (n @ w)
        energy = strength * (length**-5 / 5 + length * x0**-6 - 1.2 * x0**-5)
        return -repulsion * n, energy

    def _fluid(self, r, w, length, density_i, density_j):
        c = self.cell
        slope = spline_slope(length, c.smoothing_length)
        m2 = c.fluid_particle_mass**2
        pressure = c.sound_speed**2 * (1.0 / density_i + 1.0 / density_j)
        viscous = 2.0 * c.viscosity / (density_i * density_j)
        return m2 * (pressure * slope * r / length - viscous * slope / length * w), 0.0
