"""The model of a tissue of square cells in plain numpy, pair by pair, over all images.

Written from the formulas, not from the kernels: no cut lists, no lanes. Wall particles are points
of a grid of springs, fluid belongs to a plant cell.
"""

import numpy as np

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


def sort_pairs(cell, grid, home, images=((0, 0),), edges=()):
    """By kind i, j (k,), the share of each pair that acts, and the shift of j by plant cells.

    grid: (walls, 2) columns and rows of wall particles; home: (fluid, 2) those of plant cells.
    edges: axes and lines of the grid on which walls are outer ones.
    """
    per_side, walls, n = cell.wall_springs_per_side, len(grid), len(grid) + len(home)
    i, j, image = np.indices((n, n, len(images))).reshape(3, -1)
    ahead = np.array([tuple(each) > (0, 0) for each in images])
    once = (i < j) | ((i == j) & ahead[image])
    i, j, shift = i[once], j[once], np.array(images)[image[once]]
    place = np.concatenate([grid, per_side * home])
    first, second = place[i], place[j] + per_side * shift
    way, both_walls = second - first, j < walls
    bonded = both_walls & (abs(way).sum(axis=1) == 1)
    # wall i on the rim of the plant cell of fluid j
    on_rim = (i < walls) & (j >= walls) & ((way <= 0) & (way >= -per_side)).all(axis=1)
    fluid = (i >= walls) & ~way.any(axis=1)
    share = np.ones(len(i))
    for axis, line in edges:
        outer = both_walls & (first[:, axis] == line) & (second[:, axis] == line)
        share[outer] = 0.5 * cell.outer_wall
    kinds = {"bond": bonded, "contact": on_rim | (both_walls & ~bonded), "fluid": fluid}
    return {kind: (i[of], j[of], share[of], shift[of]) for kind, of in kinds.items()}


def pair_forces(cell, rest_length, x, v, pairs, lattice, lattice_rate):
    """By kind i, j, shift, r (k, 2), the force on i (k, 2), stored energy and power lost (k,).

    lattice, lattice_rate: (2, 2) by which shifts move x_j and v_j.
    """
    c, x0, strength = cell, cell.repulsion_cutoff, cell.repulsion_strength
    per = 1.0 / densities(c, x, pairs["fluid"])
    for kind, (i, j, share, shift) in pairs.items():
        r = x[j] + shift @ lattice.T - x[i]
        w = v[j] + shift @ lattice_rate.T - v[i]
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
        yield i, j, shift, r, share[:, None] * force, share * stored, share * lost


def resultants(cell, rest_length, x, v, pairs, lattice, lattice_rate):
    """f (n, 2), elastic energy, power lost to damping and virial (2, 2)."""
    first_fluid = pairs["fluid"][0].min()
    density = densities(cell, x, pairs["fluid"])[first_fluid:]
    energy = cell.fluid_particle_mass * cell.sound_speed**2 * np.log(density).sum()
    f, lost, virial = np.zeros_like(x), 0.0, np.zeros((2, 2))
    of_pairs = pair_forces(cell, rest_length, x, v, pairs, lattice, lattice_rate)
    for i, j, _, r, force, stored, power in of_pairs:
        np.add.at(f, i, force)
        np.add.at(f, j, -force)
        energy, lost, virial = energy + stored.sum(), lost + power.sum(), virial + force.T @ r
    return f, energy, lost, virial


class Twin:
    """Forces, energy and virial stress of one periodic square cell at material positions z."""

    def __init__(self, cell, rest_length):
        self.cell, self.rest_length = cell, rest_length
        along, zero = (
            np.arange(cell.wall_springs_per_side),
            0 * np.arange(cell.wall_springs_per_side),
        )
        grid = np.concatenate([np.stack([along, zero], 1), np.stack([zero, along], 1)[1:]])
        home = np.zeros((cell.fluid_particles_per_side**2, 2), dtype=int)
        self.walls, self.pairs = len(grid), sort_pairs(cell, grid, home, IMAGES)

    def evaluate(self, z, F, F_dot, fluctuation=0.0):
        """f (n, 2), elastic energy, Cauchy stress (2, 2); velocities Ḟ z + fluctuation."""
        side, x, v = self.cell.cell_side, z @ F.T, z @ F_dot.T + fluctuation
        lattices = side * F, side * F_dot
        f, energy, _, virial = resultants(self.cell, self.rest_length, x, v, self.pairs, *lattices)
        return f, energy, virial / (np.linalg.det(F) * side**2)
