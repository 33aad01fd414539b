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


def densities(cell, x, fluid_pairs):
    """(n,) of all particles at x (n, 2), of which those in no pair of fluid mean nothing."""
    m, h, (i, j, *_) = cell.fluid_particle_mass, cell.smoothing_length, fluid_pairs
    near, density = m * spline(np.hypot(*(x[j] - x[i]).T), h), np.full(len(x), m * spline(0.0, h))
    for k in (i, j):
        np.add.at(density, k, near)
    return density


def pair_forces(cell, rest_length, x, v, pairs):
    """By kind i, j, r (k, 2), the force on i (k, 2), stored energy and power lost (k,).

    pairs: by kind i, j (k,), the share of the pair that acts, and offsets of x_j and v_j.
    """
    c, x0, strength = cell, cell.repulsion_cutoff, cell.repulsion_strength
    per = 1.0 / densities(c, x, pairs["fluid"])
    for kind, (i, j, share, offset, drift) in pairs.items():
        r, w = x[j] + offset - x[i], v[j] + drift - v[i]
        length = np.hypot(*r.T)
        n = r / length[:, None]
        rate = (n * w).sum(axis=1)
        if kind == "bond":
            gamma = 2.0 * np.sqrt(c.wall_particle_mass * c.wall_stiffness) * c.wall_damping_ratio
            stretch = length - rest_length
            force = (c.wall_stiffness * stretch + gamma * rate)[:, None] * n
            stored, lost = 0.5 * c.wall_stiffness * stretch**2, gamma * rate**2
        elif kind == "contact":
            near = length < x0
            damping = 2.0 * np.sqrt(6.0 * strength * c.wall_particle_mass / length**7)
            damping *= near * (1.0 - (length / x0) ** 6) * c.contact_damping_ratio
            tension = damping * rate - near * strength * (length**-6 - x0**-6)
            force, lost = tension[:, None] * n, damping * rate**2
            stored = near * strength * (length**-5 / 5 + length * x0**-6 - 1.2 * x0**-5)
        else:
            slope = c.fluid_particle_mass**2 * spline_slope(length, c.smoothing_length) / length
            pressure = slope * c.sound_speed**2 * (per[i] + per[j])
            viscous = -2.0 * c.viscosity * slope * per[i] * per[j]
            force = pressure[:, None] * r + viscous[:, None] * w
            stored, lost = np.zeros_like(length), viscous * (w * w).sum(axis=1)
        share = np.broadcast_to(share, length.shape)
        yield kind, i, j, r, share[:, None] * force, share * stored, share * lost


class Twin:
    """Forces, energy and virial stress of one periodic square cell at material positions z.

    pairs: by kind i, j and the shift of j, (k, 2) columns and rows.
    """

    def __init__(self, cell: CellParameters, rest_length: float) -> None:
        self.cell, self.rest_length = cell, rest_length
        per_side = cell.wall_springs_per_side
        walls = self.walls = 2 * per_side - 1
        self.particles = walls + cell.fluid_particles_per_side**2
        # wall particles lie on the lines of a grid of springs: column and row
        grid = np.zeros((self.particles, 2), dtype=int)
        grid[:per_side, 0], grid[per_side:walls, 1] = np.arange(per_side), np.arange(1, per_side)
        i, j, image = np.indices((self.particles, self.particles, len(IMAGES))).reshape(3, -1)
        a, b = np.array(IMAGES)[image].T
        once = (i < j) | ((i == j) & ((a > 0) | ((a == 0) & (b > 0))))
        i, j, shift = i[once], j[once], np.stack([a, b], axis=1)[once]
        ring = per_side * shift
        bonded = (j < walls) & (abs(grid[j] + ring - grid[i]).sum(axis=1) == 1)
        # wall i seen from the cell of fluid j, which is shifted
        at = grid[i] - ring
        on_rim = (i < walls) & (j >= walls) & ((at >= 0) & (at <= per_side)).all(axis=1)
        fluid = (i >= walls) & ~shift.any(axis=1)
        contact = on_rim | ((j < walls) & ~bonded)
        kinds = {"bond": bonded, "contact": contact, "fluid": fluid}
        self.pairs = {kind: (i[of], j[of], shift[of]) for kind, of in kinds.items()}

    def evaluate(self, z, F, F_dot, fluctuation=0.0):
        """f (n, 2), elastic energy, Cauchy stress (2, 2); velocities Ḟ z + fluctuation."""
        cell, side = self.cell, self.cell.cell_side
        x, v = z @ F.T, z @ F_dot.T + fluctuation
        f, virial = np.zeros_like(z), np.zeros((2, 2))
        density = densities(cell, x, self.pairs["fluid"])[self.walls :]
        energy = cell.fluid_particle_mass * cell.sound_speed**2 * np.log(density).sum()
        pairs = {
            kind: (i, j, 1.0, side * shift @ F.T, side * shift @ F_dot.T)
            for kind, (i, j, shift) in self.pairs.items()
        }
        for _, i, j, r, force, stored, _ in pair_forces(cell, self.rest_length, x, v, pairs):
            np.add.at(f, i, force)
            np.add.at(f, j, -force)
            energy += stored.sum()
            virial += force.T @ r
        return f, energy, virial / (np.linalg.det(F) * side**2)
